"""Points on a plane: the physics of most miniatures, and the parts that know it.

The plane is horizontal, or upright with gravity and a floor at height 0; its axes are the two
columns of every position. SI units.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.random import WorldStreams
from understudy.task import Actuation, Context, Encoder, Fields, InitialStates, Scene, Shape, box
from understudy_miniature.drawing import draw_points
from understudy_tensors.limits import limits
from understudy_tensors.simulator import TensorSimulator


class PlaneScene(Scene):
    """B points of one kilogram; forces push the first of them, springs tie some together."""

    recorded = ("positions", "target", "bar_height")

    @dataclass(frozen=True)
    class Options:
        bodies: int = 1  #: B, how many points there are, 1 to 1000
        pushed: int = 1  #: how many of the points are pushed: the first ones
        drag: float = 1.0  #: 1/s, from 0: what slows a point, in its velocity
        gravity: float = 0.0  #: m/s², acceleration down the second axis, which has a floor at 0
        springs: tuple[tuple[int, int], ...] = ()  #: pairs of points tied by springs of no length
        stiffness: float = 40.0  #: N/m, from 0, of each spring

        def __post_init__(self) -> None:
            check_range(self, "drag", "gravity", most=1e4)
            check_range(self, "stiffness", most=1e8)
            check_range(self, "bodies", "pushed", least=1, most=1000)
            check_range(self, "pushed", most=self.bodies)
            check_range(self, "drag", "gravity", "stiffness", least=0)
            if any(not 0 <= end < self.bodies for spring in self.springs for end in spring):
                raise ValueError(f"springs={self.springs} is not possible: there is no such point.")

    def __init__(self, options: Options, context: Context) -> None:
        self.options = options

    def describe(self) -> dict[str, Any]:
        return {"points": self.options.bodies, "mass_kg": 1.0}

    def draw(
        self, tracks: Mapping[str, np.ndarray], width: int = 640, height: int = 360
    ) -> Iterator[np.ndarray]:
        return draw_points(tracks, width, height, upright=self.options.gravity > 0)


class Plane(TensorSimulator):
    """Semi-implicit Euler of the points; a control is the force on each pushed one, (N, 2·pushed) N.

    Worlds may differ in ``drag``.

    *Limits:* points without extent: nothing collides.
    """

    state_fields = ("positions", "velocities")
    parameters = {"drag": ()}

    def __init__(self, options: None, context: Context) -> None:
        self._scene = scene = context.need_scene(PlaneScene, "simulator 'miniature/plane'").options
        n, device = context.num_worlds, context.device
        shape = (scene.bodies, 2)
        self.fields: Mapping[str, Shape] = {"positions": shape, "velocities": shape}
        self.control_size = 2 * scene.pushed
        self._dt, self._substeps = context.control_dt / context.substeps, context.substeps
        self._state = {name: torch.zeros(n, *shape, device=device) for name in self.fields}
        self._state["drag"] = torch.full((n,), scene.drag, device=device)
        self._ties = torch.zeros(scene.bodies, scene.bodies)  # of forces to positions
        for a, b in scene.springs:
            for i, j in ((a, b), (b, a)):
                self._ties[i, i] -= scene.stiffness
                self._ties[i, j] += scene.stiffness
        self._ties = self._ties.to(device)

    def vary(self, names: Sequence[str]) -> None:
        super().vary([name for name in names if name not in self.parameters])
        self.fields = {**self.fields, **{name: self.parameters[name] for name in names}}

    def step(self, control: Tensor, substeps: int | None = None) -> None:
        scene, (position, velocity, drag) = self._scene, self._state.values()
        push = control.view(len(control), scene.pushed, 2)
        for _ in range(substeps or self._substeps):
            force = self._ties @ position - drag[:, None, None] * velocity
            force[:, : scene.pushed] += push
            force[:, :, 1] -= scene.gravity
            velocity.add_(force, alpha=self._dt)
            position.add_(velocity, alpha=self._dt)
            if scene.gravity:
                landed = position[:, :, 1] <= 0
                position[:, :, 1].clamp_(min=0)
                velocity[:, :, 1].masked_fill_(landed, 0.0)

    def failed(self) -> Tensor:
        return ~(self._state["positions"].abs() < 1e6).flatten(1).all(dim=1)


class Somewhere(InitialStates):
    """All points together somewhere around a centre, moving in some direction.

    Ranges are uniform. With the difficulty, the centre's surroundings grow from the first number of
    ``spread`` to the second.
    """

    reads = ("difficulty",)

    @dataclass(frozen=True)
    class Options:
        centre: tuple[float, float] = (0.0, 0.0)  #: m, middle of the place where points begin
        #: m from the centre to each side, at difficulties 0 and 1
        spread: tuple[float, float] = (1.0, 1.0)
        run_up: float = 0.0  #: m/s, velocity along the first axis at the beginning
        speed: float = 0.0  #: m/s, at most, that is added to the velocity along each axis
        flat: bool = False  #: whether all points begin at the centre's height
        drag: tuple[float, float] | None = None  #: 1/s, its range among worlds; null: the scene's

        def __post_init__(self) -> None:
            check_range(self, "centre", "run_up", least=-1e3, most=1e3)
            check_range(self, "spread", "speed", least=0, most=1e3)
            check_range(self, "drag", least=0, most=1e4)

    def __init__(self, options: Options, context: Context) -> None:
        scene = context.need_scene(PlaneScene, "initial_states 'miniature/somewhere'")
        self._options, self._bodies = options, scene.options.bodies
        self.varies = ("drag",) if options.drag is not None else ()
        axes = [1.0, 0.0] if options.flat else [1.0, 1.0]
        self._axes, self._centre, self._velocity = torch.tensor(
            [axes, options.centre, [options.run_up, 0.0]], device=context.device
        )

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        options, (near, far) = self._options, self._options.spread
        u = 2 * streams.uniform(5) - 1
        reach = near + (far - near) * fields["difficulty"].unsqueeze(1)
        position = self._centre + u[:, 0:2] * reach * self._axes
        velocity = self._velocity + u[:, 2:4] * options.speed * self._axes
        found = {
            "positions": torch.stack([position] * self._bodies, dim=1),
            "velocities": torch.stack([velocity] * self._bodies, dim=1),
        }
        if options.drag is not None:
            low, high = options.drag
            found["drag"] = low + (high - low) * (0.5 + 0.5 * u[:, 4])
        return found


class Body(Fields):
    """Position and velocity of one point."""

    reads = ("positions", "velocities")
    provides = {"position": (2,), "velocity": (2,)}

    @dataclass(frozen=True)
    class Options:
        number: int = 0  #: which of the points, from 0

    def __init__(self, options: Options, context: Context) -> None:
        bodies = context.need_scene(PlaneScene, "fields 'miniature/body'").options.bodies
        if not 0 <= options.number < bodies:
            raise ConfigError(
                f"fields 'miniature/body': number={options.number} is none of the scene's points, which are 0 to "
                f"{bodies - 1}."
            )
        self._number = options.number

    def compute(self, positions: Tensor, velocities: Tensor) -> dict[str, Tensor]:
        return {
            "position": positions[:, self._number],
            "velocity": velocities[:, self._number],
        }


class Place(Fields):
    """A place that never moves."""

    reads = ("episode_time",)
    provides = {"place": (2,)}

    @dataclass(frozen=True)
    class Options:
        at: tuple[float, float]  #: m, the place

        def __post_init__(self) -> None:
            check_range(self, "at", least=-1e3, most=1e3)

    def __init__(self, options: Options, context: Context) -> None:
        self._at = torch.tensor(options.at, device=context.device)

    def compute(self, episode_time: Tensor) -> dict[str, Tensor]:
        return {"place": self._at.expand(len(episode_time), 2)}


class Offset(Fields):
    """The way from a position to a target, and how far it is."""

    reads = ("position", "target")
    provides = {"offset": (2,), "distance": ()}

    def __init__(self, options: None, context: Context) -> None:
        pass

    def compute(self, position: Tensor, target: Tensor) -> dict[str, Tensor]:
        offset = target - position
        return {"offset": offset, "distance": offset.norm(dim=1)}


class Reach(Encoder):
    """The way to go and the present velocity, (N, 4)."""

    reads = ("offset", "velocity")
    shape = (4,)
    columns = ("offset/x", "offset/y", "velocity/x", "velocity/y")

    def __init__(self, options: None, context: Context) -> None:
        pass

    def encode(self, offset: Tensor, velocity: Tensor) -> Tensor:
        return torch.cat([offset, velocity], dim=1)


class Motion(Encoder):
    """The present velocity alone, (N, 2)."""

    reads = ("velocity",)
    shape = (2,)
    columns = ("velocity/x", "velocity/y")

    def __init__(self, options: None, context: Context) -> None:
        pass

    def encode(self, velocity: Tensor) -> Tensor:
        return velocity.clone()


class Force(Actuation):
    """The action, squashed, is the force on every pushed point."""

    @dataclass(frozen=True)
    class Options:
        limit: float = 5.0  #: N, largest force along each axis

        def __post_init__(self) -> None:
            check_range(self, "limit", above=0)

    def __init__(self, options: Options, context: Context) -> None:
        assert context.simulator is not None
        self._limit = options.limit
        self.action_space = box(context.simulator.control_size)

    def control(self, action: Tensor) -> Tensor:
        return self._limit * torch.tanh(action)


@limits(scale=(1e-9, 1e3))
def near(
    distance: Tensor,
    *,
    scale: float = 1.0,  #: m, above 0: the distance at which the reward is 1/e
) -> Tensor:
    """exp(-distance / scale): 1 at the target."""
    return torch.exp(-distance / scale)


@limits(scale=(1e-9, 1e3))
def slow(
    velocity: Tensor,
    *,
    scale: float = 1.0,  #: m/s, above 0: the speed at which the reward is 1/e
) -> Tensor:
    """exp(-|velocity| / scale): 1 at rest."""
    return torch.exp(-velocity.norm(dim=1) / scale)

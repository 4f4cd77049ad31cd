"""N worlds of particles on one device: the state as torch views of Warp's arrays."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Literal

import numpy as np
import torch
import warp as wp
from torch import Tensor

from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.task import Context, Shape
from understudy_pbd.rules import Particles
from understudy_pbd.scene import ParticleModel, ParticleScene
from understudy_pbd.solver import build_kernels
from understudy_pbd.world import ROWS, SHARED_PARTICLES, Features, System
from understudy_warp_torch.compliance import Compliance
from understudy_warp_torch.shapes import build_tools, tool_views
from understudy_warp_torch.simulator import WarpSimulator
from understudy_warp_torch.world_state import WorldState

#: Beyond these a position (m) or a velocity (m/s) is one of a simulation that diverged: tables are a
#: few metres wide, and at this speed a particle passes them within a control period.
_EXTENT, _SPEED = 1e3, 1e3
#: Wider than any table, m.
_OPEN = 1e9
#: Of its own weight a pile becomes lower by this × layers × g Δt² / (width of a particle × iterations): an iteration passes
#: on to the next layer alone what the one above fell. Measured on piles of 4 to 12 layers with 2 to 32 iterations: 0.7 to
#: 1.3 of grains, 2 to 3 of those that springs tie, which share a correction with them.
_GRAINS_SINK, _SPRINGS_SINK = 1.2, 3.0
#: Lower by more than the first it is told, by more than the second refused: at its bottom particles overlap twice as much.
_LOWER, _TOO_LOW = 0.15, 0.5


class ParticleSimulator(WarpSimulator):
    """Position-based dynamics (Macklin et al. 2014): a control period is so many sub-steps, each one
    prediction and `iterations` of Jacobi.

    A control (N, 6·T) is the pose that each of T tools has when the period ends: position (m) and
    rotation vector (axis × angle, rad), both in the world frame. On the way it moves evenly.

    ===========================================  =========================================
    field                                        shape; T leads only if there are several tools
    ===========================================  =========================================
    ``particle_position``, ``particle_velocity``  (P, 3) m, m/s
    ``tool_position``, ``tool_orientation``      (3,) m, (4,) wxyz
    ``tool_velocity``, ``tool_angular_velocity``  (3,) m/s, rad/s, in the last sub-step
    ``contact_force``                            (P, 3) N, of tools on each particle, mean over the
                                                 control period
    ``active_particles``                         (P,), 0 where a world has no such particle
    ``spring_partners``, ``spring_lengths``      (P, K), −1 where no spring is; m
    ===========================================  =========================================

    Worlds may differ in ``gravity`` (3,), ``active_particles`` (P,), and for each of Q materials in
    ``friction``, ``cohesion`` and ``viscosity`` (Q,).

    *Limits:* all pairs of a world are looked at, which is quadratic beyond some thousand
    particles. Stiffness is what the iterations pass on. Nothing bounces, spheres roll
    without resistance, and no particle moves a tool.
    """

    @dataclass(frozen=True)
    class Options:
        iterations: int = 8  #: solver iterations of a sub-step, 1 to 1024
        #: ω of Macklin et al. 2014, section 4.2; under 2 a sum of averaged corrections converges
        relaxation: float = 1.5
        #: Of the speed that gravity gives in a sub-step: slower particles, unless of a fluid, stay where
        #: they are (section 4.5), so that heaps do not creep. At 1 nothing would begin to fall.
        sleep: float = 0.1
        neighbours: int | None = None  #: M, the most that a particle has; null: what can fit
        #: `block` keeps a world on one multiprocessor; `launches` has a kernel for each phase
        traversal: Literal["block", "launches"] = "block"
        threads: int = 256  #: of a block, at most

        def __post_init__(self) -> None:
            check_range(self, "iterations", "threads", least=1, most=1024)
            check_range(self, "relaxation", above=0, most=1.99)
            check_range(self, "sleep", least=0, most=0.9)
            if self.neighbours is not None:
                check_range(self, "neighbours", least=1, most=10_000)

    def __init__(self, options: Options, context: Context) -> None:
        scene = context.need_scene(ParticleScene, "simulator 'pbd'")
        self.model = model = scene.model()
        self._options = options
        super().__init__(context)
        with self._warp.scope():
            self._system, features = self._build(model)
            self._kernels = build_kernels(features)
        self._features, self._tools = features, self._system.tools
        self.control_size = 6 * len(model.tools)
        system = self._system
        p = system.particles
        views = {
            "particle_position": (wp.to_torch(system.position), (p, 3)),
            "particle_velocity": (wp.to_torch(system.velocity), (p, 3)),
            "active_particles": (wp.to_torch(system.active), (p,)),
        }
        k = system.spring_partner.shape[2]
        if k:
            views["spring_partners"] = (wp.to_torch(system.spring_partner), (p, k))
            views["spring_lengths"] = (wp.to_torch(system.spring_length), (p, k))
        t = len(model.tools)
        if t:
            views["contact_force"] = (wp.to_torch(system.contact_force), (p, 3))
        views |= tool_views(system.tools)
        read = {name: view.view(self._n, *shape) for name, (view, shape) in views.items()}
        self.fields: Mapping[str, Shape] = {name: shape for name, (_, shape) in views.items()}
        self.state_fields = ("particle_position", "particle_velocity")
        if t:
            self.state_fields += ("tool_position", "tool_orientation")
        parameters = {
            "active_particles": read["active_particles"],
            "gravity": wp.to_torch(system.gravity),
            "friction": wp.to_torch(system.friction),
            "cohesion": wp.to_torch(system.cohesion),
            "viscosity": wp.to_torch(system.viscosity),
        }
        self.parameters: Mapping[str, Shape] = {
            name: tuple(view.shape[1:]) for name, view in parameters.items()
        }
        self._particles = self._seen_by_rules()
        with self._warp.scope():
            for rule in model.rules:
                rule.build(self._particles)
            wp.synchronize_device()  # torch's streams wait for nobody
        kept = {
            f"rule_{number}_{name}": view
            for number, rule in enumerate(model.rules)
            for name, view in rule.state().items()
        }
        #: All that decides the future, beside varied parameters.
        state = {
            **{n: v for n, v in read.items() if n != "active_particles"},
            "substep": wp.to_torch(system.substep),
            **kept,
        }
        initial = {name: view[:1].clone() for name, view in state.items()}
        for name in (
            "tool_velocity",
            "tool_angular_velocity",
            "particle_velocity",
            "contact_force",
            *kept,
        ):
            if name in initial:
                initial[name].zero_()
        # torch makes no view of an array without elements on a GPU
        self._control = (
            wp.to_torch(system.control) if t else torch.zeros(self._n, 0, device=self._device)
        )
        self._counted = ("neighbour_overflows", wp.to_torch(system.overflow))
        self._worlds = WorldState(
            "pbd",
            views=read,
            state=state,
            initial=initial,
            set_by=self.state_fields,
            parameters=parameters,
            extent=_EXTENT,
            speed=_SPEED,
        )

    def _build(self, model: ParticleModel) -> tuple[Any, Features]:
        """The system on Warp's present device, and what its kernels have to know."""
        n, p = self._n, len(model.positions)
        radius = _each(model.radius, p, "radius")
        mass = _each(model.mass, p, "mass")
        material = _each(np.asarray(model.material), p, "material").astype(np.int32)
        materials = model.materials
        if p < 1 or (radius <= 0).any() or (mass < 0).any():
            raise ConfigError(
                "A scene of particles needs some, of positive radius and no negative mass."
            )
        if not ((material >= 0) & (material < len(materials))).all():
            raise ConfigError(
                f"A particle is of a material that the scene's {len(materials)} do not have."
            )
        fluids = [m.fluid for m in materials if m.fluid is not None]
        if len({fluid.smoothing for fluid in fluids}) > 1:
            raise ConfigError("All fluids of a scene need the same smoothing radius.")
        is_fluid = np.array([m.fluid is not None for m in materials])[material]
        if (mass[is_fluid] == 0).any():
            raise ConfigError("Particles of a fluid need a mass.")
        if not is_fluid.all():  # a fluid is held up by its density
            grains = np.asarray(model.positions, float)[~is_fluid]
            self._compliance = self._compliance_of(grains, 2 * float(radius[~is_fluid].max()))
            self._compliance.check(float(np.linalg.norm(model.gravity)), self._dt)
        smoothing = fluids[0].smoothing if fluids else 0.0
        widest = (
            2
            * float(radius.max())
            * max(1 + (m.cohesion_range if m.cohesion > 0 else 0.0) for m in materials)
        )
        # in a sub-step others come near; those within the slack are seen
        reach = max(1.2 * widest, smoothing, *(rule.reach for rule in model.rules), 0.0)
        room = self._options.neighbours or min(p - 1, most_neighbours(reach, float(radius.min())))
        partners, lengths = spring_slots(model, p)
        options, s = self._options, System()

        def each_world(value: Any, dtype: Any) -> Any:
            value = np.asarray(value, np.int32 if dtype is int else np.float32)
            return wp.array(np.tile(value, (n, *[1] * value.ndim)), dtype=dtype)

        def one_each(values: Sequence[float] | np.ndarray) -> Any:
            return wp.array(np.asarray(values, np.float32), dtype=float)

        s.position = each_world(model.positions, wp.vec3)
        s.velocity = wp.zeros((n, p), dtype=wp.vec3)
        s.active = wp.full((n, p), 1.0, dtype=float)
        s.contact_force = wp.zeros((n, p), dtype=wp.vec3)
        s.spring_partner, s.spring_length = each_world(partners, int), each_world(lengths, float)
        s.substep = wp.zeros(n, dtype=int)
        s.tools = build_tools(model.tools, n)
        s.control = wp.zeros((n, 6 * len(model.tools)), dtype=float)
        s.radius = one_each(radius)
        s.inverse_mass = one_each(np.divide(1.0, mass, out=np.zeros(p), where=mass > 0))
        s.material = wp.array(material, dtype=int)
        s.gravity = each_world(model.gravity, wp.vec3)
        s.friction = each_world([m.friction for m in materials], float)
        s.static_ratio = one_each(
            [
                m.static_friction / m.friction if m.static_friction and m.friction else 1.0
                for m in materials
            ]
        )
        s.cohesion = each_world([m.cohesion for m in materials], float)
        s.cohesion_range = one_each([m.cohesion_range for m in materials])
        s.damping = one_each([m.damping for m in materials])
        s.rest_density = one_each([m.fluid.rest_density if m.fluid else 0.0 for m in materials])
        s.viscosity = each_world([m.fluid.viscosity if m.fluid else 0.0 for m in materials], float)
        s.tension = one_each([m.fluid.tension if m.fluid else 0.0 for m in materials])
        s.softening = one_each([_softening(m.fluid) for m in materials])
        table = model.table
        s.sides = 0 if table is None else 5 if table.lower or table.upper else 1
        s.table_friction = table.friction if table else 0.0
        s.lower = wp.vec2(*((table and table.lower) or (-_OPEN, -_OPEN)))
        s.upper = wp.vec2(*((table and table.upper) or (_OPEN, _OPEN)))
        s.particles = p
        s.dt, s.substeps, s.iterations = self._dt, self._substeps, options.iterations
        s.relaxation, s.sleep = options.relaxation, options.sleep
        s.reach, s.smoothing = reach, smoothing
        s.room, s.slots = max(room, 1), partners.shape[1]
        s.per_iteration = 1.0 / options.iterations
        s.stiffness = 1.0 - (1.0 - model.springs.stiffness) ** s.per_iteration
        s.memory = wp.zeros(n * ROWS * p, dtype=wp.vec4)
        if self._device.type == "cuda":  # threads side by side read numbers side by side
            s.neighbour = wp.zeros((n, s.room, p), dtype=int).transpose((0, 2, 1))
        else:
            s.neighbour = wp.zeros((n, p, s.room), dtype=int)
        s.neighbour_count = wp.zeros((n, p), dtype=int)
        s.overflow = wp.zeros((n, p), dtype=int)
        rounds = math.ceil(p / options.threads)
        threads = 32 * math.ceil(math.ceil(p / rounds) / 32)
        rounded = 1 << (p - 1).bit_length()  # so that scenes of similar size share kernels
        shared = min(rounded, SHARED_PARTICLES) if p <= SHARED_PARTICLES else 0
        features = Features(
            fluids=bool(fluids),
            springs=partners.shape[1] > 0,
            alike=not fluids
            and len(materials) == 1
            and bool((radius == radius[0]).all() and (mass == mass[0]).all()),
            shared=shared if self._device.type == "cuda" else 0,
            threads=threads if self._device.type == "cuda" else 1,
        )
        return s, features

    def _compliance_of(self, positions: np.ndarray, width: float) -> Compliance:
        """Of piles as high as those of the `positions` (P, 3) m, of particles so wide."""
        columns = np.floor(positions[:, :2] / width)
        layers = int(np.unique(columns, axis=0, return_counts=True)[1].max())
        each = _SPRINGS_SINK if len(self.model.springs.pairs) else _GRAINS_SINK

        def says(share: float, rate: int) -> str:
            return (
                f"The particles' sub-step of {1e3 * self._dt:.3g} ms is too long: its own weight would make a pile of {layers} "
                f"layers some {100 * min(share, 1.0):.0f} % lower, where particles are {1e3 * width:.3g} mm wide. Let physics make "
                f"{rate} sub-steps a second or more (control.substeps or control.frequency), or each of them more of the "
                "simulator's iterations."
            )

        per_load = each * layers / (width * self._options.iterations)
        return Compliance(per_load, layers * width, _LOWER, _TOO_LOW, says)

    def _carrying(self) -> Tensor:
        found = super()._carrying()
        if self.model.tools:
            found |= self.read("contact_force").flatten(1).any(1, keepdim=True)
        return found

    def _seen_by_rules(self) -> Particles:
        """The system's arrays of the same names."""
        names = (field.name for field in fields(Particles))
        arrays = {name: getattr(self._system, name) for name in names if name != "dt"}
        return Particles(self._dt, **arrays)

    def _advance(self, count: int) -> None:
        """`count` sub-steps; rules are asked between them."""
        rules = self.model.rules
        if not rules:
            self._solve(count)
            return
        for _ in range(count):
            for rule in rules:
                rule.before(self._particles)
            self._solve(1)
            for rule in rules:
                rule.after(self._particles)

    def _solve(self, count: int) -> None:
        s, kernels, features = self._system, self._kernels, self._features
        if self._options.traversal == "block":
            wp.launch_tiled(
                kernels.block, dim=[self._n], inputs=[s, count], block_dim=features.threads
            )
            return
        p = s.particles
        everyone = (self._n, p)
        for _ in range(count):
            wp.launch(kernels.tools, dim=self._n, inputs=[s])
            wp.launch(kernels.predict, dim=everyone, inputs=[s])
            wp.launch(kernels.find, dim=everyone, inputs=[s])
            source = p
            for _ in range(self._options.iterations):
                if features.fluids:
                    wp.launch(kernels.density, dim=everyone, inputs=[s, source])
                wp.launch(kernels.solve, dim=everyone, inputs=[s, source])
                source = p - source
            wp.launch(kernels.finish, dim=everyone, inputs=[s, source])
            if features.fluids:
                wp.launch(kernels.viscosity, dim=everyone, inputs=[s, source])


def _each(value: Any, count: int, name: str) -> np.ndarray:
    """(P,), of one number or of so many."""
    value = np.asarray(value, float)
    if value.shape not in ((), (count,)):
        raise ConfigError(
            f"The scene's {name} has shape {value.shape}, not ({count},), nor is it one."
        )
    return np.broadcast_to(value, count).copy()


def most_neighbours(reach: float, radius: float) -> int:
    """How many spheres packed as densely as spheres can be have their centres within `reach`."""
    return math.ceil(math.pi / math.sqrt(18) * (reach / radius + 1) ** 3)


def spring_slots(model: ParticleModel, count: int) -> tuple[np.ndarray, np.ndarray]:
    """(P, K) partners and lengths of the scene's springs, each in a slot of both its ends.

    Raises
    ------
    ConfigError
        if a pair is none, or has no place in `slots`.
    """
    springs = model.springs
    pairs = np.asarray(springs.pairs, np.int64).reshape(-1, 2)
    lengths = np.asarray(springs.lengths, float)
    if lengths.shape != (len(pairs),) or (lengths <= 0).any():
        raise ConfigError(f"{len(pairs)} springs need as many lengths, all above 0.")
    if ((pairs < 0) | (pairs >= count)).any() or (pairs[:, 0] == pairs[:, 1]).any():
        raise ConfigError(
            "A spring ties a particle that the scene does not have, or one to itself."
        )
    used = np.bincount(pairs.reshape(-1), minlength=count)
    slots = springs.slots or int(used.max(initial=0))
    if used.max(initial=0) > slots:
        raise ConfigError(
            f"A particle has {used.max()} springs, but slots={slots}. Give as many or more (scene.springs of a "
            "visco-plastic material, Springs.slots of a scene of your own)."
        )
    partners, table = np.full((count, slots), -1), np.zeros((count, slots))
    filled = np.zeros(count, int)
    for (i, j), length in zip(pairs, lengths, strict=True):
        for own, other in ((i, j), (j, i)):
            partners[own, filled[own]], table[own, filled[own]] = other, length
            filled[own] += 1
    return partners, table


def _softening(fluid: Any) -> float:
    """ε of the density constraint (Macklin and Müller 2013, equation 11), (1/m²): a hundredth of the
    sum of squared gradients inside the fluid at rest, on a grid of half a smoothing radius."""
    if fluid is None:
        return 0.0
    h = fluid.smoothing
    axis = np.arange(-2, 3) * 0.5 * h
    r = np.linalg.norm(np.stack(np.meshgrid(axis, axis, axis)), axis=0)
    r = r[(r > 0) & (r < h)]
    slopes = (0.5 * h) ** 3 * 45 / math.pi / h**6 * (h - r) ** 2
    return 0.01 * float((slopes**2).sum())

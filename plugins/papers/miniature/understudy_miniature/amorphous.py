"""Grains on a table that a round tool pushes together; a policy sees them as an image."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from understudy.options import check_range
from understudy.random import WorldStreams
from understudy.task import Actuation, Context, Encoder, Fields, InitialStates, Scene, Shape, box
from understudy.task.terms import ranges
from understudy_tensors.limits import limits
from understudy_tensors.simulator import TensorSimulator


class GrainsScene(Scene):
    """G grains on a table, with so much friction that they rest where they are left, and a tool."""

    @dataclass(frozen=True)
    class Options:
        grains: int = 12  #: G, how many there are, 1 to 1000
        tool: float = 0.25  #: m, the tool's radius

        def __post_init__(self) -> None:
            check_range(self, "grains", least=1, most=1000)
            check_range(self, "tool", above=0, most=1e3)

    def __init__(self, options: Options, context: Context) -> None:
        self.options = options

    def describe(self) -> dict[str, Any]:
        return {"grains": self.options.grains, "tool_radius_m": self.options.tool}


class Grains(TensorSimulator):
    """The tool moves at the control's velocity (N, 2), m/s, and grains that it covers on the way are
    pushed to its edge.

    *Limits:* grains do not meet one another.
    """

    state_fields = ("grains", "tool")

    def __init__(self, options: None, context: Context) -> None:
        scene = context.need_scene(GrainsScene, "simulator 'miniature/grains'").options
        self._radius, self._substeps = scene.tool, context.substeps
        self._dt = context.control_dt / context.substeps
        self.fields: Mapping[str, Shape] = {"grains": (scene.grains, 2), "tool": (2,)}
        self.control_size = 2
        n, device = context.num_worlds, context.device
        self._state = {k: torch.zeros(n, *v, device=device) for k, v in self.fields.items()}

    def step(self, control: Tensor, substeps: int | None = None) -> None:
        grains, tool = self._state.values()
        for _ in range(substeps or self._substeps):
            tool.add_(self._dt * control)
            away = grains - tool.unsqueeze(1)
            distance = away.norm(dim=2, keepdim=True).clamp(min=1e-6)
            pushed = tool.unsqueeze(1) + away * (self._radius / distance)
            grains.copy_(torch.where(distance < self._radius, pushed, grains))

    def failed(self) -> Tensor:
        return ~(self._state["grains"].abs() < 1e6).flatten(1).all(dim=1)


class Clusters(InitialStates):
    """Grains around a few centres on the table, the tool beside them; at difficulty 0 all centres are
    one."""

    reads = ("difficulty",)

    @dataclass(frozen=True)
    class Options:
        clusters: int = 2  #: how many centres at difficulty 1, from 1
        table: float = 0.5  #: m, half of its side; centres are at most so far from its middle
        size: float = 0.2  #: m, above 0, that a cluster is wide
        tool: tuple[float, float] = (-1.0, 0.0)  #: m, where the tool is at first

        def __post_init__(self) -> None:
            check_range(self, "clusters", least=1, most=1000)
            check_range(self, "table", "size", above=0, most=1e3)
            check_range(self, "tool", least=-1e3, most=1e3)

    def __init__(self, options: Options, context: Context) -> None:
        scene = context.need_scene(GrainsScene, "initial_states 'miniature/clusters'")
        self._options, self._grains = options, scene.options.grains
        self._tool = torch.tensor(options.tool, device=context.device)
        self._cluster = torch.arange(self._grains, device=context.device) % options.clusters

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        options = self._options

        def spread(count: int) -> Tensor:
            return 2 * streams.uniform(2 * count).view(-1, count, 2) - 1

        centres = spread(options.clusters) * options.table
        apart = centres - centres[:, :1]
        centres = centres[:, :1] + apart * fields["difficulty"].view(-1, 1, 1)
        grains = centres[:, self._cluster] + spread(self._grains) * options.size
        return {"grains": grains, "tool": self._tool + spread(1).squeeze(1) * options.size}


class Heap(Fields):
    """How far, on average, the grains are from where they should be and from the tool, m."""

    reads = ("grains", "tool")
    provides = {"spread": (), "tool_spread": ()}

    @dataclass(frozen=True)
    class Options:
        goal: tuple[float, float] = (1.0, 0.0)  #: m, where the grains should be

        def __post_init__(self) -> None:
            check_range(self, "goal", least=-1e3, most=1e3)

    def __init__(self, options: Options, context: Context) -> None:
        self._goal = torch.tensor(options.goal, device=context.device)

    def compute(self, grains: Tensor, tool: Tensor) -> dict[str, Tensor]:
        return {
            "spread": (grains - self._goal).norm(dim=2).mean(dim=1),
            "tool_spread": (grains - tool.unsqueeze(1)).norm(dim=2).mean(dim=1),
        }


class DensityMap(Encoder):
    """Grains and their goal in the tool's frame, as an image (2, P, P).

    A grain is a Gaussian of a pixel's width, so the map changes smoothly, and the same way every
    time: nothing is scattered.
    """

    reads = ("grains", "tool")

    @dataclass(frozen=True)
    class Options:
        pixels: int = 12  #: P, pixels along each side, 2 to 1000
        goal: tuple[float, float] = (1.0, 0.0)  #: m, where the grains should be
        width: float = 3.0  #: m, above 0, that the image is wide

        def __post_init__(self) -> None:
            check_range(self, "pixels", least=2, most=1000)
            check_range(self, "width", above=0, most=1e3)
            check_range(self, "goal", least=-1e3, most=1e3)

    def __init__(self, options: Options, context: Context) -> None:
        half = 0.5 * options.width
        self.shape = (2, options.pixels, options.pixels)
        self._goal = torch.tensor(options.goal, device=context.device)
        self._pixel = options.width / options.pixels
        self._centres = torch.linspace(-half, half, options.pixels, device=context.device)

    def _density(self, points: Tensor) -> Tensor:
        """(N, P, P) of `points` (N, G, 2) in the tool's frame."""
        line = torch.exp(-((points.unsqueeze(3) - self._centres) / self._pixel).square())
        return torch.einsum("ngp,ngq->npq", line[:, :, 0], line[:, :, 1])

    def encode(self, grains: Tensor, tool: Tensor) -> Tensor:
        here = tool.unsqueeze(1)
        return torch.stack([self._density(grains - here), self._density(self._goal - here)], dim=1)


class ToolState(Encoder):
    """Where the tool is, where it is going, and how fast, (N, 6)."""

    reads = ("tool", "tool_target", "tool_velocity")
    shape = (6,)

    def __init__(self, options: None, context: Context) -> None:
        pass

    def encode(self, tool: Tensor, tool_target: Tensor, tool_velocity: Tensor) -> Tensor:
        return torch.cat([tool, tool_target - tool, tool_velocity], dim=1)


class ToolTarget(Actuation):
    """The action is where the tool should go, in the tool's frame; a critically damped spring takes
    it there."""

    reads = ("tool", "tool_velocity")
    every = "period"
    keeps = {"tool_target": (2,), "tool_velocity": (2,)}
    action_space = box(2)

    @dataclass(frozen=True)
    class Options:
        reach: float = 0.5  #: m, greatest distance of a target along each axis
        stiffness: float = 40.0  #: 1/s², stiffness of the spring that pulls the tool to its target

        def __post_init__(self) -> None:
            check_range(self, "reach", "stiffness", above=0)

    def __init__(self, options: Options, context: Context) -> None:
        self._options, self._dt = options, context.control_dt

    def begin(self, tool: Tensor, tool_velocity: Tensor) -> dict[str, Tensor]:
        return {"tool_target": tool, "tool_velocity": torch.zeros_like(tool)}

    def advance(self, action: Tensor, tool: Tensor, tool_velocity: Tensor) -> dict[str, Tensor]:
        stiffness, dt = self._options.stiffness, self._dt
        target = tool + self._options.reach * torch.tanh(action)
        damping = 2 * stiffness**0.5
        # implicit in the velocity, so that any stiffness is stable
        pull = tool_velocity + dt * stiffness * (target - tool)
        velocity = pull / (1 + dt * damping + dt * dt * stiffness)
        return {"tool_target": target, "tool_velocity": velocity}

    def control(self, action: Tensor, tool: Tensor, tool_velocity: Tensor) -> Tensor:
        return tool_velocity


@limits(scale=(-1e6, 1e6))
@ranges(-math.inf, math.inf)
def gathered(
    spread: Tensor,
    previous_spread: Tensor,
    *,
    scale: float = 10.0,  #: 1/m: reward for each metre that the grains come nearer
) -> Tensor:
    """How much nearer the grains came in this decision, times `scale` (1/m); negative if further."""
    return scale * (previous_spread - spread)

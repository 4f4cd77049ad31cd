"""Where episodes begin: clusters around the goal, a pile in the middle, a disk in the pan."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import pad

from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.random import WorldStreams
from understudy.task import Context, InitialStates, Shape
from understudy_amorphous.scene import AmorphousScene
from understudy_amorphous.tool import orientation

#: m, how far away what takes no part is.
FAR = 50.0


class _Blocks:
    """The scene's blocks, to be put somewhere."""

    def __init__(self, context: Context, who: str, only: int | None = None) -> None:
        scene = context.need_scene(AmorphousScene, who)
        if only is not None and scene.options.blocks != only:
            raise ConfigError(
                f"{who} places one block, and scene.blocks={scene.options.blocks}. Set scene.blocks=1."
            )
        block = torch.as_tensor(scene.block, dtype=torch.float32)
        self.block = block.to(context.device)  #: (B, 3) m
        self.count = scene.options.blocks  #: K
        parked = torch.as_tensor(scene.place(self.count), dtype=torch.float32)
        #: (K, B, 3) m, where blocks are that no episode uses: far from the table
        self.parked = parked.view(self.count, -1, 3).to(context.device) + FAR

    def put(self, centres: Tensor, turns: Tensor) -> Tensor:
        """(N, K, B, 3) m: blocks with the middle of their lower sides at `centres` (N, K, 3), turned
        about z by `turns` (N, K) rad."""
        cosine, sine = turns.cos()[..., None], turns.sin()[..., None]
        x, y, z = self.block.unbind(1)
        turned = [cosine * x - sine * y, sine * x + cosine * y, z.expand(*turns.shape, -1)]
        return centres.unsqueeze(2) + torch.stack(turned, dim=3)


def _at_rest(particles: Tensor, tool: Tensor, yaw: Tensor) -> dict[str, Tensor]:
    """A state at rest: `particles` (N, K, B, 3), and the tool at `tool` (N, 3), facing `yaw` (N,)."""
    position = particles.flatten(1, 2)
    return {
        "particle_position": position,
        "particle_velocity": torch.zeros_like(position),
        "tool_position": tool,
        "tool_orientation": orientation(pad(yaw.unsqueeze(1), (2, 0))),
    }


class AroundGoal(InitialStates):
    """As many blocks as the curriculum says (``clusters``), around the ``goal`` (2,) m (section 4.1).

    Each block has its own sector of the circle around the goal, so that none is in another. Which
    sectors are taken, and where in them a block is, is drawn. The other blocks are far away and inactive. The tool begins
    outside the circle and roughly faces the goal.
    """

    reads = ("clusters",)
    episode_fields: Mapping[str, Shape] = {"goal": (2,)}
    varies = ("active_particles",)

    @dataclass(frozen=True)
    class Options:
        distance: tuple[float, float] = (1.8, 2.8)  #: m, from the goal to a block: least, most
        goal: tuple[float, float] = (0.0, 0.0)  #: m, world, from which the goal is drawn
        goal_spread: float = 0.0  #: m, how far from there the goal may be drawn along x and y
        tool: tuple[float, float] = (3.9, 4.2)  #: m, from the goal to the tool: least, most
        facing: float = 1.0  #: rad, how far the tool may be turned from facing the goal
        spread: float = 0.5  #: share of its sector in which a block's middle may be

        def __post_init__(self) -> None:
            check_range(self, "distance", "goal_spread", "tool", most=1e3)
            check_range(self, "facing", most=100)
            check_range(self, "goal_spread", "facing", least=0)
            check_range(self, "spread", least=0, most=1)
            check_range(self, "goal", least=-1e3, most=1e3)
            for name in ("distance", "tool"):
                least, most = getattr(self, name)
                if not 0 <= least <= most:
                    raise ValueError(
                        f"{name}=[{least}, {most}] is not possible: least comes first."
                    )

    def __init__(self, options: Options, context: Context) -> None:
        self.options = options
        self._blocks = _Blocks(context, "initial_states 'amorphous/clusters'")
        self._goal = torch.tensor(options.goal, device=context.device)
        self._number = torch.arange(self._blocks.count, device=context.device)

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        options, blocks = self.options, self._blocks
        k = blocks.count

        def between(low: float, high: float, size: int) -> Tensor:
            return low + (high - low) * streams.uniform(size)

        goal = self._goal + between(-options.goal_spread, options.goal_spread, 2)
        sector = (self._number + between(0, 1, 1) + options.spread * between(-0.5, 0.5, k)) / k
        angle = 2 * math.pi * sector
        away = between(*options.distance, k)
        centres = torch.stack([away * angle.cos(), away * angle.sin()], dim=2) + goal.unsqueeze(1)
        centres = pad(centres, (0, 1))
        # ranks of random numbers: which blocks are taken, the first `clusters` of a shuffle
        rank = streams.uniform(k).argsort(dim=1).argsort(dim=1)
        active = (rank < fields["clusters"].unsqueeze(1)).float()
        placed = blocks.put(centres, between(-math.pi, math.pi, k))
        particles = torch.where(active[..., None, None] > 0, placed, blocks.parked)
        around = between(-math.pi, math.pi, 1)
        outward = torch.cat([around.cos(), around.sin()], dim=1)
        tool = pad(goal + between(*options.tool, 1) * outward, (0, 1))
        yaw = (around + math.pi + between(-options.facing, options.facing, 1)).squeeze(1)
        each = active.repeat_interleave(len(blocks.block), dim=1)
        return {"goal": goal, "active_particles": each, **_at_rest(particles, tool, yaw)}


class Pile(InitialStates):
    """One block in the middle of the table, turned by a random angle, and the tool at a random place
    around it, facing it (section 4.2)."""

    @dataclass(frozen=True)
    class Options:
        spread: float = 0.1  #: m, how far from the middle the block may be along x and y
        tool: float = 1.5  #: m, from the middle to the tool

        def __post_init__(self) -> None:
            check_range(self, "spread", "tool", least=0, most=1e3)

    def __init__(self, options: Options, context: Context) -> None:
        self.options = options
        self._blocks = _Blocks(context, "initial_states 'amorphous/pile'", only=1)

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        options = self.options
        drawn = 2 * streams.uniform(4) - 1
        centre = pad(options.spread * drawn[:, :2], (0, 1)).unsqueeze(1)
        particles = self._blocks.put(centre, math.pi * drawn[:, 2:3])
        angle = math.pi * drawn[:, 3]
        tool = options.tool * torch.stack([angle.cos(), angle.sin(), 0 * angle], dim=1)
        return _at_rest(particles, tool, angle + math.pi)


class OnTool(InitialStates):
    """One block on the tool, turned by a random angle about z (section 4.3)."""

    @dataclass(frozen=True)
    class Options:
        spread: float = 0.05  #: m, how far from its middle the block may be along x and y
        height: float = 1.0  #: m, of the tool above the table

        def __post_init__(self) -> None:
            check_range(self, "spread", "height", least=0, most=1e3)

    def __init__(self, options: Options, context: Context) -> None:
        self.options = options
        self._blocks = _Blocks(context, "initial_states 'amorphous/on_tool'", only=1)

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        options = self.options
        drawn = 2 * streams.uniform(3) - 1
        centre = pad(options.spread * drawn[:, :2], (0, 1), value=options.height)
        particles = self._blocks.put(centre.unsqueeze(1), math.pi * drawn[:, 2:3])
        tool = pad(0 * drawn[:, :2], (0, 1), value=options.height)
        return _at_rest(particles, tool, 0 * drawn[:, 0])

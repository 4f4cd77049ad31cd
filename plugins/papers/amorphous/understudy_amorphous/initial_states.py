"""Where episodes begin: clusters around the goal, a pile in the middle, a disk in the pan."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import pad

from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.random import WorldStreams
from understudy.task import Context, InitialStates, Shape
from understudy_amorphous.scene import PAN_RADIUS, AmorphousScene
from understudy_amorphous.tool import LIMITS, orientation
from understudy_tensors.limits import check_angle

#: m, how far away what takes no part is.
FAR = 50.0
#: m, that sums of lengths may be off.
_ROUND = 1e-6


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
        self.tool = scene.options.tool
        #: m, of the circle around a block, seen from above.
        self.radius = float(np.hypot(*scene.block[:, :2].T).max()) + scene.radius
        self._limits: Mapping[str, tuple[float, float]] = context.once(LIMITS, dict)
        parked = torch.as_tensor(scene.place(self.count), dtype=torch.float32)
        #: (K, B, 3) m, where blocks are that no episode uses: far from the table
        self.parked = parked.view(self.count, -1, 3).to(context.device) + FAR

    def need_reach(self, option: str, value: object, axis: str, least: float, most: float) -> None:
        """Refuse what an `option` places along an `axis` from `least` to `most` m, if the tool cannot get there.

        Raises
        ------
        ConfigError
            names the option and the tool's limits.
        """
        low, high = self._limits.get(axis, (-math.inf, math.inf))
        if not low - _ROUND <= least <= most <= high + _ROUND:
            raise ConfigError(
                f"initial_states.{option}={value} is not possible: along {axis} it places what episodes begin with from "
                f"{least:.3g} to {most:.3g} m, and the tool goes from {low:g} to {high:g} m (actuation.limits.{axis})."
            )

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
            check_angle(self, "facing", least=0)
            check_range(self, "goal_spread", least=0)
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
        self._check()
        self._goal = torch.tensor(options.goal, device=context.device)
        self._number = torch.arange(self._blocks.count, device=context.device)

    def _check(self) -> None:
        """Refuse blocks in one another or in the tool, and what the tool cannot get to."""
        options, blocks = self.options, self._blocks
        for axis, middle in zip("xy", options.goal, strict=True):
            for name, value, aside in (
                ("goal", list(options.goal), options.goal_spread),
                ("distance", list(options.distance), options.goal_spread + options.distance[1]),
                # a tool that begins beyond its limits is at them with the first decision
                ("tool", list(options.tool), options.tool[0]),
            ):
                blocks.need_reach(name, value, axis, middle - aside, middle + aside)
        if options.tool[0] < (outside := options.distance[1] + blocks.radius):
            raise ConfigError(
                f"initial_states.tool={list(options.tool)} is not possible: blocks lie up to {outside:.3g} m from the goal, and "
                "the tool begins outside of them."
            )
        # of two neighbours, as near to one another as their sectors let them be
        apart = 2 * options.distance[0] * math.sin(math.pi * (1 - options.spread) / blocks.count)
        if blocks.count > 1 and apart < 2 * blocks.radius:
            raise ConfigError(
                f"initial_states.distance={list(options.distance)} is not possible: with spread={options.spread:g} the middles of "
                f"two of {blocks.count} blocks may be {apart:.3g} m apart, and one is {2 * blocks.radius:.3g} m across. Put "
                "them farther away, or take fewer or smaller ones."
            )

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
        self._blocks = blocks = _Blocks(context, "initial_states 'amorphous/pile'", only=1)
        for axis in "xy":
            for name in ("spread", "tool"):
                far = getattr(options, name)
                blocks.need_reach(name, far, axis, -far, far)
        if options.tool < (outside := options.spread + 0.5 * math.sqrt(2) * blocks.radius):
            raise ConfigError(
                f"initial_states.tool={options.tool:g} is not possible: the block reaches {outside:.3g} m from the middle, and the "
                "tool begins outside of it."
            )

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
        self._blocks = blocks = _Blocks(context, "initial_states 'amorphous/on_tool'", only=1)
        if blocks.tool != "pan":
            raise ConfigError(
                f"initial_states 'amorphous/on_tool' lays a block on the tool, and on a {blocks.tool} none stays. Set "
                "scene.tool=pan, or choose other initial_states."
            )
        reach = math.sqrt(2) * options.spread + blocks.radius
        if reach > PAN_RADIUS:
            raise ConfigError(
                f"initial_states.spread={options.spread:g} is not possible: the block would reach {reach:.3g} m from the pan's "
                f"middle, and the pan {PAN_RADIUS:g} m. Give less, or a smaller block (scene.block)."
            )
        blocks.need_reach("height", options.height, "z", options.height, options.height)

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        options = self.options
        drawn = 2 * streams.uniform(3) - 1
        centre = pad(options.spread * drawn[:, :2], (0, 1), value=options.height)
        particles = self._blocks.put(centre.unsqueeze(1), math.pi * drawn[:, 2:3])
        tool = pad(0 * drawn[:, :2], (0, 1), value=options.height)
        return _at_rest(particles, tool, 0 * drawn[:, 0])

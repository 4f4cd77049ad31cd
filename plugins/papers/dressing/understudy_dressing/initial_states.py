"""Where dressing begins."""

from __future__ import annotations

import itertools
import math
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.random import WorldStreams
from understudy.task import Context, InitialStates
from understudy_dressing.body import Side
from understudy_dressing.jacket import JacketScene
from understudy_dressing.person import PersonScene, depth_in, neutral_pose
from understudy_dressing.shirt import ShirtScene, Worn
from understudy_dressing.shirt_state import ShirtState
from understudy_dressing.sleeve import HangingScene
from understudy_dressing.state import SleeveState, refuse_other_side
from understudy_dressing.waypoints import IN_SLEEVE

#: m/s that a gripper goes.
_FASTEST = 2.0
#: m: places in which the gripper may begin are looked at so near to each other, but no more along an axis.
_APART, _MOST = 0.05, 16
#: So many along an axis where the person's pose is looked at with its noise.
_FEW = 3
#: m: so deep may noise put the person into settled cloth, which then gives way; and draws that are looked at.
_DEEP, _DRAWS = 0.03, 8


class Track(InitialStates):
    """The person neutral, and before it the hanging sleeve, which goes in a straight line to the shoulder
    (section 8.3). The gripper floats there by itself: nothing slows it down. One that is driven begins at rest."""

    reads = ("episode_limit",)

    @dataclass(frozen=True)
    class Options:
        #: m, world frame: between these the gripper begins, uniformly (the 2018 code's gown)
        low: tuple[float, float, float] = (0.7, -0.42, -0.3)
        high: tuple[float, float, float] = (0.8, 0.21, 0.2)  #: m, of the other corner
        #: m, where it is after `seconds`: above the shoulder (section 8.3; the 2018 code stops 0.1 m before it)
        end: tuple[float, float, float] = (0.0, -0.21, 0.1)
        seconds: float = 12.5  #: until it arrives (2018 code: 250 decisions of 0.05 s)
        noise: float = 0.01  #: rad and rad/s, uniform, of pose and velocity

        def __post_init__(self) -> None:
            check_range(self, "seconds", above=0)
            check_range(self, "noise", least=0, most=1)
            for name in ("low", "high", "end"):
                check_range(self, name, least=-3, most=3)
            if any(a > b for a, b in zip(self.low, self.high, strict=True)):
                raise ValueError(f"low={self.low} is not possible: high={self.high} is below it.")
            ways = [
                math.dist(corner, self.end)
                for corner in itertools.product(*zip(self.low, self.high, strict=True))
            ]
            if (speed := max(ways) / self.seconds) > _FASTEST:
                raise ValueError(
                    f"seconds={self.seconds:g} is not possible: the gripper would go {max(ways):.3g} m to end={self.end} at "
                    f"{speed:.3g} m/s, and {_FASTEST:g} are the most; give at least {max(ways) / _FASTEST:.2g}."
                )

    def __init__(self, options: Options, context: Context) -> None:
        self.options = options
        who = "initial_states 'dressing/track'"
        person = context.need_scene(PersonScene, who)
        self._pose = neutral_pose(person).to(context.device)
        sleeve = context.need_scene(HangingScene, who)
        self._refuse_other_shoulder(context, sleeve)
        settled = context.once("dressing/settled", sleeve.settled)
        self._settled = torch.tensor(settled, dtype=torch.float32, device=context.device)
        low, high, end = (
            torch.tensor(t, dtype=torch.float32, device=context.device)
            for t in (options.low, options.high, options.end)
        )
        self._low, self._high, self._end = low, high, end
        self._turns = 3 if person.options.driven else 0
        self._asked = False
        self._refuse_inside(person, settled)

    def _refuse_other_shoulder(self, context: Context, sleeve: HangingScene) -> None:
        """A track that does not end on the side of the arm that goes in."""
        fields = [one.options for one in context.chosen.get("fields", ())]
        sides = {one.side for one in fields if isinstance(one, SleeveState.Options)}
        side = sleeve.held or (sides.pop() if len(sides) == 1 else None)
        if side is not None and self.options.end[1] * (1.0 if side == "left" else -1.0) < 0:
            raise ConfigError(
                f"initial_states.end={list(self.options.end)} is on the other side than the {side} arm, which goes in: y is to the "
                "left. Mirror y of end, low and high, or set side of the fields otherwise."
            )

    def _refuse_inside(self, person: PersonScene, settled: np.ndarray) -> None:
        """Starts, on a grid, at which a part of the neutral person is in the cloth."""
        pose, noise = self._pose.cpu().numpy(), self.options.noise
        depth = depth_in(person, pose)
        for start in self._starts(_MOST):
            deepest = float(depth(settled + start, near=0.0).max())
            if deepest > 0:
                x, y, z = start
                raise ConfigError(
                    f"initial_states: with the gripper at ({x:.2f}, {y:.2f}, {z:.2f}) m the cloth begins "
                    f"{100 * deepest:.1f} cm inside the person: move low and high away from it."
                )
        for one in _noisy(pose, noise) if noise else ():
            depth = depth_in(person, one)
            deepest = max(
                float(depth(settled + start, near=0.0).max()) for start in self._starts(_FEW)
            )
            if deepest > _DEEP:
                raise ConfigError(
                    f"initial_states: with a noise of {noise:g} rad the person begins {100 * deepest:.0f} cm inside the "
                    "cloth: give it less, or move low and high away."
                )

    def _starts(self, most: int) -> np.ndarray:
        """(S, 3) m: places of the gripper on a grid, `most` along an axis."""
        low, high = np.array(self.options.low), np.array(self.options.high)
        counts = np.clip(np.ceil((high - low) / _APART).astype(int) + 1, 1, most)
        sides = (np.linspace(a, b, n) for a, b, n in zip(low, high, counts, strict=True))
        return np.stack(np.meshgrid(*sides, indexing="ij"), -1).reshape(-1, 3)

    def _say_if_it_goes_on(self, limit: Tensor) -> None:
        """Of episodes (N,) s that are longer than the track, on whose way nothing stops the sleeve."""
        self._asked, seconds = True, self.options.seconds
        if not self._turns and (most := float(limit.max())) > seconds + 1e-6:
            warnings.warn(
                f"Episodes of {most:g} s go on after the {seconds:g} s in which the sleeve comes to its end, and the sleeve goes on past "
                f"the shoulder. Set initial_states.seconds={most:g}, or episode.seconds and evaluation.seconds to {seconds:g}.",
                stacklevel=2,
            )

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        limit = fields.get("episode_limit")
        # a GPU captures this, and nothing leaves it
        if not self._asked and limit is not None and limit.device.type == "cpu":
            self._say_if_it_goes_on(limit)
        hinges = len(self._pose)
        drawn = streams.uniform(3 + 2 * hinges)
        gripper = self._low + drawn[:, :3] * (self._high - self._low)
        noise = self.options.noise * (2.0 * drawn[:, 3:] - 1.0)
        speed = (self._end - gripper) / self.options.seconds
        if self._turns:  # it begins at rest, and goes where it is driven
            speed = torch.zeros_like(speed)
        turns = gripper.new_zeros(len(gripper), self._turns)
        cloth = self._settled + gripper.unsqueeze(1)
        return {
            "qpos": torch.cat([self._pose + noise[:, :hinges], gripper, turns], dim=1),
            "qvel": torch.cat([noise[:, hinges:], speed, turns], dim=1),
            "cloth_position": cloth,
            "cloth_velocity": speed.unsqueeze(1).expand_as(cloth).contiguous(),
        }


def _noisy(pose: np.ndarray, noise: float) -> Iterator[np.ndarray]:
    """The farthest that uniform `noise` takes the `pose` (H,), all hinges at once, in some directions."""
    signs = np.random.default_rng(0).choice([-1.0, 1.0], size=(_DRAWS, len(pose)))
    yield from pose + noise * signs


class _Settled(InitialStates):
    """The whole person in one of some poses, and cloth as it settled there, pose (22,) rad and vertices (V, 3) m of each; uniform
    `noise`, rad, of the pose, `rates`, rad/s, of its velocity, and a `push`, m/s, of all of the cloth in a random direction."""

    def __init__(
        self, context: Context, who: str, settled: Sequence[tuple[np.ndarray, np.ndarray]], noise: float,
        rates: float, push: float = 0.0,
    ) -> None:  # fmt: skip
        person = context.need_scene(PersonScene, who)
        if len(person.hinges) != len(PersonScene(PersonScene.Options()).hinges):
            raise ConfigError(f"{who} needs the whole person: leave `still` of its scene empty.")
        pose, cloth = (np.stack(them) for them in zip(*settled, strict=True))
        self._pose = torch.tensor(pose, dtype=torch.float32, device=context.device)
        self._cloth = torch.tensor(cloth, dtype=torch.float32, device=context.device)
        self._rest = person.spec().compile().nq - pose.shape[1]
        self._noise, self._rates, self._push = noise, rates, push
        ends = [(end, x) for one, x in settled for end in _noisy(one, noise)]
        deepest = max(float(depth_in(person, one)(x, near=0.0).max()) for one, x in ends)
        if deepest > _DEEP:
            raise ConfigError(
                f"{who}: with a noise of {noise:g} rad the person begins {100 * deepest:.0f} cm inside the cloth: give it less."
            )

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        count, hinges = self._pose.shape
        uniform = streams.uniform(2 * hinges + 3)
        drawn = 2.0 * uniform[:, :-1] - 1.0
        which = (uniform[:, -1] * count).long().clamp(max=count - 1)
        gripper = drawn.new_zeros(len(drawn), self._rest)
        cloth = self._cloth[which]
        up, turn = drawn[:, -2], torch.pi * drawn[:, -1]
        flat = (1.0 - up * up).clamp(min=0.0).sqrt()
        push = self._push * torch.stack([flat * turn.cos(), flat * turn.sin(), up], dim=1)
        return {
            "qpos": torch.cat(
                [self._pose[which] + self._noise * drawn[:, :hinges], gripper], dim=1
            ),
            "qvel": torch.cat([self._rates * drawn[:, hinges:-2], gripper], dim=1),
            "cloth_position": cloth,
            "cloth_velocity": push.unsqueeze(1).expand_as(cloth).contiguous(),
        }


class WornShirt(_Settled):
    """A shirt on the shoulders, the neck in its collar (section 8.1), and a push of all of it in a random direction; or,
    so that later subtasks can begin without a bank, its hem held in front and an arm under it or in its sleeve."""

    @dataclass(frozen=True)
    class Options:
        worn: Worn = "on_shoulders"  #: how far: `held` by the other hand, `tucked`: the arm under it, too, `raised`: with its hand before the chin (the second arm), `in_sleeve`: its hand in the sleeve, `dressed`: the arm
        side: Side = "left"  #: the arm that goes in (the paper's first)
        other_dressed: bool = False  #: whether the other arm is in its own sleeve
        push: float = 0.5  #: m/s, of all of the cloth (2018 code: 0.5, of an unknown unit)
        noise: float = 0.01  #: rad, uniform, of the pose
        #: rad/s, uniform, of its velocity (2018 code: 0.1 of the first two subtasks)
        rates: float = 0.1

        def __post_init__(self) -> None:
            check_range(self, "push", "noise", "rates", least=0, most=10)
            if self.worn == "raised" and not self.other_dressed:
                raise ValueError(
                    "worn=raised needs other_dressed=true: with both arms bare the hand would go through the front."
                )

    def __init__(self, options: Options, context: Context) -> None:
        who = "initial_states 'dressing/worn_shirt'"
        shirt = context.need_scene(ShirtScene, who)
        refuse_other_side(context, ShirtState.Options, options.side, who)
        key = f"dressing/shirt/{options.worn}/{options.side}/{options.other_dressed}"
        bent = IN_SLEEVE if options.worn == "in_sleeve" else IN_SLEEVE[:1]
        settled = context.once(
            key,
            lambda: [
                shirt.settled(options.worn, options.side, arm, options.other_dressed)
                for arm in bent
            ],
        )
        super().__init__(context, who, settled, options.noise, options.rates, options.push)


class HeldJacket(_Settled):
    """A jacket that hangs from the left hand (2018 code)."""

    @dataclass(frozen=True)
    class Options:
        noise: float = 0.01  #: rad and rad/s, uniform, of pose and velocity

        def __post_init__(self) -> None:
            check_range(self, "noise", least=0, most=10)

    def __init__(self, options: Options, context: Context) -> None:
        who = "initial_states 'dressing/held_jacket'"
        jacket = context.need_scene(JacketScene, who)
        settled = [context.once("dressing/jacket", jacket.hung)]
        super().__init__(context, who, settled, options.noise, options.noise)

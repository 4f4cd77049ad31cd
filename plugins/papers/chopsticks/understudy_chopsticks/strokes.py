"""A brush whose tip follows a curve (thesis, section 5.7.4): closed curves, the arm that traces them, errors.

A curve is level and closed, and begins where the tip is; the brush keeps its direction, so that the palm moves as
the tip should and the arm follows in closed form. N worlds, C curves, T frames of 10 ms; m, s, rad.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from understudy import random
from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.random import WorldStreams
from understudy.task import Context, Fields, InitialStates, Shape
from understudy.task.terms import ranges
from understudy_chopsticks.plan import AHEAD, PLANNED, frame_at, gripping, planned
from understudy_hand.table import ARM_POSE
from understudy_hand.tools import TIP
from understudy_tensors import rotations
from understudy_tensors.limits import limits
from understudy_tool_planner import arm

#: s between frames.
DT = 0.01
#: Waves along a curve, and points at which it is compared with where the tip is.
_WAVES, _POINTS = 2, 128
#: s in which a stroke gathers speed.
_START = 0.3
#: Curves that are drawn for one that the arm can follow, and rad that it keeps from the ends of its ranges.
_TRIES, _INSIDE = 8, 0.02


@dataclass(frozen=True)
class Curves:
    """What arms and tips do along each curve."""

    start: np.ndarray  #: (7,) rad: the arm's pose in which all begin
    arms: Tensor  #: (C, T, 7) rad
    tips: Tensor  #: (C, T, 3) m, in the world, where the tip should be
    points: Tensor  #: (C, S, 3) m, along the whole curve


class Strokes(InitialStates):
    """Holding the brush over the table; each episode has a curve that the tip is to follow again and again.

    ``stroke_row`` () is the curve's number. Evaluations draw from curves that no training has.
    """

    reads = ("episode_limit",)
    episode_fields: Mapping[str, Shape] = {"stroke_row": ()}

    @dataclass(frozen=True)
    class Options:
        curves: int = 256  #: how many curves there are; each is drawn once
        size: float = 0.025  #: m, distance of a curve's farthest point from its middle
        rate: float = 0.5  #: Hz, how often a curve is traced
        height: float = 0.02  #: m, height of the tip above the table
        longest: float = 8.0  #: s that an episode can last; it holds its last frame after that

        def __post_init__(self) -> None:
            check_range(self, "curves", least=1, most=100_000)
            check_range(self, "size", above=0, most=0.1)
            check_range(self, "rate", above=0, most=5.0)
            check_range(self, "height", least=0.005, most=0.3)
            check_range(self, "longest", above=0, most=60.0)

    def __init__(self, options: Options, context: Context) -> None:
        made = gripping(context, "initial_states 'chopsticks/strokes'")
        if len(made.grips) > 1 or made.parts != 1:
            raise ConfigError(
                "initial_states 'chopsticks/strokes' needs one grip of a brush. Set scene.tool=brush grip.name=brush."
            )
        own = context.once("strokes", lambda: _drawn(options, context))
        device = context.device
        start = made.begin(own.start)[0]
        self._start = torch.tensor(start, dtype=torch.float32, device=device)
        self._velocity = torch.zeros(made.scene.model.nv, device=device)
        self._count, self._longest, self._asked = options.curves, options.longest, False

    def _say_if_it_stops(self, limit: Tensor) -> None:
        """Of episodes (N,) s that are longer than the curves."""
        self._asked = True
        if (most := float(limit.max())) > self._longest + 1e-6:
            warnings.warn(
                f"Episodes of {most:g} s go on after the {self._longest:g} s for which curves are planned, and the brush then stands "
                f"still. Set initial_states.longest={most:g}.",
                stacklevel=2,
            )

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        limit = fields.get("episode_limit")
        # a GPU captures this, and nothing leaves it
        if not self._asked and limit is not None and limit.device.type == "cpu":
            self._say_if_it_stops(limit)
        row = (streams.uniform(1)[:, 0] * self._count).long().clamp(max=self._count - 1)
        return {
            "qpos": self._start.expand(len(row), -1),
            "qvel": self._velocity.expand(len(row), -1),
            "stroke_row": row.float(),
        }


def _drawn(options: Strokes.Options, context: Context) -> Curves:
    """The curves of a training, or of an evaluation.

    Raises
    ------
    ConfigError
        the arm cannot follow so many.
    """
    made = gripping(context, "initial_states 'chopsticks/strokes'")
    which = "evaluation" if context.evaluating else "training"
    stream = random.generator(context.seed, f"strokes/{which}")
    palm, turn = arm.forward(torch.tensor(ARM_POSE, dtype=torch.float64))
    swivel = arm.swivel_of(torch.tensor(ARM_POSE, dtype=torch.float64))
    lower = made.lower[0].double().cpu()
    reach = turn @ (lower[:3] + rotations.rotate(lower[3:], lower.new_tensor(TIP)))
    palm = torch.cat([palm[:2], (options.height - reach[2])[None]])
    times = torch.arange(round(options.longest / DT) + 1, dtype=torch.float64) * DT
    # It begins at rest, and at full speed some tenths of a second later.
    gone = times - _START * (1.0 - torch.exp(-times / _START))
    wave = torch.randn(_TRIES * options.curves, _WAVES, 2, 2, generator=stream, dtype=torch.float64)
    curve = torch.linspace(0.0, 2.0 * math.pi, _POINTS, dtype=torch.float64)
    poses, alongs, wholes, missing = [], [], [], options.curves
    for some in wave.split(options.curves):  # mostly the first are enough
        around = _curve(some, curve)
        from_middle = (around - around.mean(1, keepdim=True)).norm(dim=-1).amax(1)
        some = options.size / from_middle[:, None, None, None] * some
        along = _curve(some, 2.0 * math.pi * options.rate * gone)
        solved = arm.solve(palm + along, turn, swivel)
        good = (solved.inside.amin(1) > _INSIDE).nonzero()[:missing, 0]
        poses.append(solved.pose[good])
        alongs.append(along[good])
        wholes.append(_curve(some[good], curve))
        missing -= len(good)
        if not missing:
            break
    else:
        raise ConfigError(
            f"The arm can follow {options.curves - missing} of {len(wave)} curves of initial_states.size={options.size:g} m, "
            f"initial_states.height={options.height:g} m above the table. Set it to less, the height otherwise, or initial_states.curves "
            "to fewer."
        )
    tip, device, pose = palm + reach, context.device, torch.cat(poses)
    return Curves(
        pose[0, 0].numpy(),
        *(
            part.float().to(device)
            for part in (pose, tip + torch.cat(alongs), tip + torch.cat(wholes))
        ),
    )


def _curve(wave: Tensor, phase: Tensor) -> Tensor:
    """(C, T, 3) m, level, from 0 on, at `phase` (T,) rad of the closed curves `wave` (C, waves, 2, 2)."""
    number = torch.arange(1, wave.shape[1] + 1, dtype=wave.dtype)
    turns = number * phase[:, None]
    basis = torch.stack([turns.cos() - 1.0, turns.sin()], dim=-1) / number[:, None]
    flat = torch.einsum("twk,cwkx->ctx", basis, wave)
    return torch.cat([flat, torch.zeros_like(flat[..., :1])], dim=-1)


class Stroke(Fields):
    """The plan of a brush at each world's time: what ``chopsticks/plan`` gives, and its tip.

    - ``planned_tip`` (3,) m, where the tip should be, in the world
    - ``tip_offset`` (3,) m, from there to where it is, in the palm's frame; ``tip_error`` () m, how long that is
    - ``curve_distance`` () m, of the tip from the curve, wherever on it
    """

    reads = ("stroke_row", "episode_time", "xpos", "xquat")
    provides: Mapping[str, Shape] = {
        **PLANNED,
        "planned_tip": (3,),
        "tip_offset": (3,),
        "tip_error": (),
        "curve_distance": (),
    }

    def __init__(self, options: None, context: Context) -> None:
        self._gripping = made = gripping(context, "fields 'chopsticks/stroke'")
        self._context = context
        self.provides = {**self.provides, **planned(made.scene.hinges)}
        model, device, count = made.scene.model, context.device, len(ARM_POSE)
        # A servo whose velocity target is 0 lags by kd / kp.
        lag = -model.actuator_biasprm[:count, 2] / model.actuator_gainprm[:count, 0]
        self._lead = torch.tensor(lag, dtype=torch.float32, device=device)
        self._steps = torch.tensor([0, *(round(t / DT) for t in AHEAD)], device=device)
        self._body, self._palm = model.body(made.scene.tool_bodies[0]).id, model.body("palm").id
        self._tip = torch.tensor(TIP, device=device)

    def compute(
        self, stroke_row: Tensor, episode_time: Tensor, xpos: Tensor, xquat: Tensor
    ) -> dict[str, Tensor]:
        made, curves = self._gripping, self._context.once("strokes", _unmade)
        row = stroke_row.long().clamp(0, len(curves.arms) - 1)
        last = curves.arms.shape[1] - 1
        whole, share = frame_at(episode_time)
        frame = whole.long()[:, None] + self._steps
        here, after = frame.clamp(0, last), (frame + 1).clamp(0, last)
        arms = curves.arms[row[:, None], here]
        way = curves.arms[row[:, None], after] - arms
        arms, speed = arms + share[:, None, None] * way, way / DT
        hand = made.poses[0, 0].expand(*arms.shape[:2], -1)
        pose = torch.cat([arms, hand], dim=-1)
        velocity = torch.cat([speed, torch.zeros_like(hand)], dim=-1)
        lower = made.lower.expand(*arms.shape[:2], 7)
        gripper = torch.cat(
            [lower, torch.zeros_like(lower), torch.zeros_like(lower[..., :1])], dim=-1
        )
        ahead = torch.cat([pose, velocity, gripper], dim=-1)
        wanted = curves.tips[row, here[:, 0]]
        wanted = wanted + share[:, None] * (curves.tips[row, after[:, 0]] - wanted)
        turn = xquat[:, self._body]
        tip = xpos[:, self._body] + rotations.rotate(turn, self._tip.expand(len(turn), 3))
        away = tip - wanted
        nearest = (curves.points[row] - tip[:, None]).norm(dim=-1).amin(1)
        targets = made.targets[0, 0].expand(len(arms), -1)
        return {
            "planned_angle": torch.zeros_like(episode_time),
            "planned_targets": torch.cat([arms[:, 0] + self._lead * speed[:, 0], targets], dim=1),
            "planned_pose": pose[:, 0],
            "planned_velocity": velocity[:, 0],
            "planned_upper": lower[:, 0],
            "planned_lower": lower[:, 0],
            "plan_ahead": ahead[:, 1:],
            "planned_tip": wanted,
            "tip_offset": rotations.inverse_rotate(xquat[:, self._palm], away),
            "tip_error": away.norm(dim=-1),
            "curve_distance": nearest,
        }


def _unmade() -> Curves:
    raise ConfigError(
        "fields 'chopsticks/stroke' needs curves. Set initial_states=chopsticks/strokes."
    )


@limits(scale=(0, 1e6))
@ranges(0.0, 1.0)
def tip(
    tip_error: Tensor,
    *,
    scale: float = 40.0,  #: 1/m, factor of the tip's distance, as of an object's (eq. 5.4)
) -> Tensor:
    """The brush's tip as planned, exp(-40 ‖p - p̃‖): eq. 5.4 with the tip in the object's place."""
    return torch.exp(-scale * tip_error)

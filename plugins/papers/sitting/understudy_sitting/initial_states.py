"""Where episodes begin (section 6): in the reference, where another skill ended, or around the chair."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.random import WorldStreams
from understudy.task import Context, InitialStates, Shape
from understudy_characters.scene import CharacterScene, reference_motion
from understudy_sitting.chair import BODY, Chair
from understudy_skills import bank
from understudy_tensors import rotations

PLACE, TURN = f"mocap_pos/{BODY}", f"mocap_quat/{BODY}"
#: m: the seat's front edge is so far ahead of the seated hips (as in the generated clip ``sit``).
OVERLAP = 0.08


Range = tuple[float, float]


@dataclass(frozen=True)
class Chairs:
    """Chairs of other sizes, uniformly drawn for each episode, m; null leaves the chair's own. They
    must have no mesh."""

    #: m above the floor, (least, greatest) height of the seat, within 0.2 to 1; null: the chair's
    #: own
    seat_height: Range | None = None
    #: m, (least, greatest) width of the seat from side to side, within 0.2 to 1; null: the chair's
    #: own
    width: Range | None = None
    #: m, (least, greatest) depth of the seat from front to back, within 0.2 to 1; null: the chair's
    #: own
    depth: Range | None = None

    def __post_init__(self) -> None:
        for name in ("seat_height", "width", "depth"):
            chosen = getattr(self, name)
            if chosen is not None and not 0.2 <= chosen[0] <= chosen[1] <= 1.0:
                raise ValueError(
                    f"{name}={chosen} is not possible: give 0.2 <= LEAST <= MOST <= 1."
                )


class _Sizes:
    """What chairs are drawn."""

    def __init__(self, chair: Chair, chosen: Chairs) -> None:
        self._chair, own = chair, chair.options
        self._ranges = [
            getattr(chosen, name) or (getattr(own, name),) * 2
            for name in ("seat_height", "width", "depth")
        ]
        varied = chosen != Chairs()
        if varied and own.mesh is not None:
            raise ConfigError(
                "initial_states.chairs: a chair of a mesh has the mesh's size. Leave chair.mesh out."
            )
        self.varies = chair.sizes if varied else ()
        #: m, of the largest seat, between two corners.
        self.across = math.hypot(self._ranges[1][1], self._ranges[2][1])

    def draw(self, streams: WorldStreams) -> tuple[Tensor, dict[str, Tensor]]:
        """The seats' depth (N,), and the parameters of chairs that differ."""
        drawn = streams.uniform(3)
        sizes = [low + (high - low) * drawn[:, k] for k, (low, high) in enumerate(self._ranges)]
        return sizes[2], self._chair.sized(*sizes) if self.varies else {}


class _ChairBehind:
    """The chair where the reference sits down, more or less; nothing in tasks without a chair."""

    def __init__(self, context: Context, metres: float, degrees: float, chairs: Chairs) -> None:
        reference = reference_motion(context)
        chair = context.sections.get("chair")
        self.varies: tuple[str, ...] = ()
        self._metres, self._turn = metres, math.radians(degrees)
        if not isinstance(chair, Chair):
            return
        self._sizes = _Sizes(chair, chairs)
        self.varies = (PLACE, TURN, *self._sizes.varies)
        end = reference.sample(torch.tensor([reference.duration], device=context.device))
        self._heading = end["reference_root_heading"]
        self._ahead = torch.stack([self._heading.cos(), self._heading.sin()], dim=1)
        self._hips = end["reference_root_position"][:, :2]

    def parameters(
        self, streams: WorldStreams, there: tuple[Tensor, Tensor, Tensor] | None = None
    ) -> dict[str, Tensor]:
        """`there`: for which worlds (N,) it stands elsewhere, where (N, 2) and with which heading (N,)."""
        if not self.varies:
            return {}
        drawn = 2 * streams.uniform(3) - 1
        depth, sizes = self._sizes.draw(streams)
        place = self._hips + (OVERLAP - 0.5 * depth)[:, None] * self._ahead
        heading = self._heading
        if there is not None:
            place = torch.where(there[0][:, None], there[1], place)
            heading = torch.where(there[0], there[2], heading)
        place = place + self._metres * drawn[:, :2]
        turn = rotations.from_heading(heading + self._turn * drawn[:, 2])
        return {PLACE: torch.nn.functional.pad(place, (0, 1)), TURN: turn, **sizes}


class FromReference(InitialStates):
    """The reference's state at a time drawn within ``span``, the chair where it will sit down.

    ``span: [0, 0]`` is its first frame, [0, 1] reference-state initialisation (Peng et al. 2018). For a
    share ``first`` of the episodes the time is where the span begins.
    """

    @dataclass(frozen=True)
    class Options:
        span: tuple[float, float] = (0.0, 0.0)  #: shares of the clip
        first: float = 0.0  #: share of the episodes, in [0, 1]
        #: m along each axis and degrees by which the chair is elsewhere, at most. The paper's is fixed.
        metres: float = 0.0
        degrees: float = 0.0  #: by which the figure may be turned at most, either way
        chairs: Chairs = Chairs()  #: sizes from which the chair's is drawn

        def __post_init__(self) -> None:
            check_range(self, "first", least=0, most=1)
            check_range(self, "metres", least=0, most=10)
            check_range(self, "degrees", least=0, most=180)
            if not 0 <= self.span[0] <= self.span[1] <= 1:
                raise ValueError(f"span={self.span} is not possible: give shares, rising.")

    episode_fields: Mapping[str, Shape] = {"motion_start": ()}

    def __init__(self, options: Options, context: Context) -> None:
        self._reference = reference_motion(context)
        self._span, self._first = options.span, options.first
        self._chair = _ChairBehind(context, options.metres, options.degrees, options.chairs)
        self.varies = self._chair.varies

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        first, last = self._span
        drawn, kind = streams.uniform(2).unbind(1)
        share = first + (last - first) * torch.where(kind < self._first, 0.0, drawn)
        time = share * self._reference.duration
        state = self._reference.sample(time)
        return {
            "qpos": state["reference_qpos"],
            "qvel": state["reference_qvel"],
            "motion_start": time,
            **self._chair.parameters(streams),
        }


def _banked(
    banks: tuple[str, ...], scene: CharacterScene, context: Context, *, chair: bool = False
) -> dict[str, Tensor]:
    """The states of all `banks`: qpos (M, nq), qvel (M, nv), and where the `chair` stood (M, 3), (M, 4).

    Raises
    ------
    ConfigError
        if one is of another figure, or has no chair.
    """
    found = [bank.starts(file, context, "initial_states") for file in banks]
    wanted = {
        "qpos": scene.model.nq,
        "qvel": scene.model.nv,
        **({PLACE: 3, TURN: 4} if chair else {}),
    }
    for file, states in zip(banks, found, strict=True):
        for name, size in wanted.items():
            shape = tuple(states[name].shape[1:]) if name in states else None
            if shape != (size,):
                raise ConfigError(
                    f"initial_states: the bank {file} does not fit this figure: '{name}' is "
                    f"{shape or 'missing'} there and {(size,)} here."
                )
    return {name: torch.cat([s[name] for s in found]).to(context.device) for name in wanted}


class WhereOthersEnded(InitialStates):
    """Where episodes of other skills ended, turned and moved to where the reference begins.

    The second stage of training the skills (section 6); the clip begins with the episode. ``share`` of
    the episodes begin so, the others in the clip's first frame. ``speed`` is what their velocities are
    multiplied by, drawn uniformly: a figure that walks slower is easier to stop. With ``chair_too`` a chair is
    not where the reference sits down but where it was, seen from the figure; the bank then has it
    (``job.fields=[mocap_pos/chair,mocap_quat/chair]``).
    """

    @dataclass(frozen=True)
    class Options:
        banks: tuple[str, ...]  #: banks of states, or the folders of runs that have one
        share: float = 1.0  #: of the episodes, in [0, 1]
        speed: Range = (1.0, 1.0)  #: least and greatest factor of the velocities
        metres: float = 0.0  #: these three as of ``sitting/from_reference``
        degrees: float = 0.0  #: by which the figure may be turned at most, either way
        chairs: Chairs = Chairs()  #: sizes of the chairs
        chair_too: bool = False  #: whether the chair stands where it was

        def __post_init__(self) -> None:
            check_range(self, "share", least=0, most=1)
            check_range(self, "speed", least=0, most=100)
            check_range(self, "metres", least=0, most=10)
            check_range(self, "degrees", least=0, most=180)
            if not 0 <= self.speed[0] <= self.speed[1]:
                raise ValueError(f"speed={self.speed} is not possible: give two numbers, rising.")
            if not self.banks:
                raise ValueError("banks=() is not possible: name the folder of a harvest.")

    episode_fields: Mapping[str, Shape] = {"motion_start": ()}

    def __init__(self, options: Options, context: Context) -> None:
        scene = context.need_scene(CharacterScene, "initial_states 'sitting/where_others_ended'")
        self._layout = layout = scene.layout.to(context.device)
        states = _banked(options.banks, scene, context, chair=options.chair_too)
        self._qpos, self._qvel = states["qpos"], states["qvel"]
        start = reference_motion(context).sample(torch.zeros(1, device=context.device))
        heading = start["reference_root_heading"]
        own = rotations.heading(self._qpos[:, layout.root_address + 3 : layout.root_address + 7])
        place = start["reference_root_position"][:, :2].expand(len(own), 2)
        self._stands = None
        if options.chair_too:
            was = self._qpos[:, layout.root_address : layout.root_address + 2]
            away = rotations.turned_flat(states[PLACE][:, :2] - was, heading - own)
            self._stands = place + away, rotations.heading(states[TURN]) + heading - own
        self._qpos, self._qvel = layout.moved(self._qpos, self._qvel, heading - own, place)
        self._first = start["reference_qpos"], start["reference_qvel"]
        self._share, self._speed = options.share, options.speed
        self._chair = _ChairBehind(context, options.metres, options.degrees, options.chairs)
        self.varies = self._chair.varies

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        drawn = streams.uniform(3)
        row = (drawn[:, 0] * len(self._qpos)).long().clamp(max=len(self._qpos) - 1)
        ended = (drawn[:, 1] < self._share)[:, None]
        slow, fast = self._speed
        speed = (slow + (fast - slow) * drawn[:, 2])[:, None]
        qpos, qvel = self._first
        there = None
        if self._stands is not None:
            there = ended[:, 0], self._stands[0][row], self._stands[1][row]
        return {
            "qpos": torch.where(ended, self._qpos[row], qpos),
            "qvel": torch.where(ended, speed * self._qvel[row], qvel),
            "motion_start": torch.zeros_like(drawn[:, 0]),
            **self._chair.parameters(streams, there),
        }


#: Degrees from the chair's front at which the zones end (figure 4; the paper gives no number): the
#: front half plane, the sides, and behind.
ZONES = (90.0, 135.0, 180.0)


@dataclass(frozen=True)
class AtChair:
    """Training episodes that begin before the chair, in any direction, where turns ended or were.

    Ours: the paper's controller must find a walk, a turn of seconds and a sit in one episode by chance
    before eq. 8 rewards any of it. From here first the sit is found, then the turn, then the way.
    """

    #: banks of states, or the folders of runs that have one; none: no such episodes
    banks: tuple[str, ...] = ()
    #: share of the training episodes that begin near the chair; evaluations have none
    share: float = 0.25
    #: m, (least, greatest) distance before the seat's middle; the clip of sitting begins 0.45 m
    #: from it
    ahead: Range = (0.4, 0.9)
    aside: float = 0.2  #: m, from 0: greatest distance to each side of the seat's middle
    #: degrees, greatest turn to each side of the direction in which the chair faces
    degrees: float = 180.0

    def __post_init__(self) -> None:
        check_range(self, "ahead", "aside", most=10)
        check_range(self, "share", least=0, most=1)
        check_range(self, "aside", least=0)
        check_range(self, "degrees", least=0, most=180)
        if not 0 <= self.ahead[0] <= self.ahead[1]:
            raise ValueError(f"ahead={self.ahead} is not possible: give two numbers, rising.")


class AroundChair(InitialStates):
    """Standing some metres from the chair and roughly facing it, in one of the zones of figure 4.

    With the difficulty d the zone rises: 1 below 1/2, 2 below 1, then 3. ``zone`` fixes it. Earlier
    zones remain among the starts for a share ``keep`` of the episodes; some may begin ``at_chair``. With a
    ``sector`` the angle rises evenly instead, from 90° at d = 0 to 180° at 1, and what is newest are its
    last degrees: from zone to zone is a step from where the way to the chair's front is free to where the
    chair stands in it. In evaluations all zones that the difficulty allows are alike.

    The pose is the first of the task's clip, which begins with the episode. The field ``zone`` (N,) is 1,
    2 or 3, or 0 ``at_chair``; ``newest`` (N,) is 1 in the last zone, or sector, that the difficulty allows, which
    a curriculum may judge; ``side`` (N,) is 1 where the figure begins on the chair's left.
    """

    reads = ("difficulty",)
    episode_fields: Mapping[str, Shape] = {
        "zone": (), "newest": (), "side": (), "motion_start": (),
    }  # fmt: skip

    @dataclass(frozen=True)
    class Options:
        zone: int | None = None  #: 1, 2 or 3; null follows the difficulty
        keep: float = 0.5  #: share of the episodes that begin in an earlier zone or this one
        #: degrees of the newest sector in training; null: zones, as in the paper
        sector: float | None = None
        distance: float = 2.0  #: m from the seat's middle
        spread: float = 0.2  #: m, by which that distance may be more or less
        degrees: float = 30.0  #: off the direction to the chair, to each side
        chairs: Chairs = Chairs()  #: sizes from which the chair's is drawn
        at_chair: AtChair = AtChair()  #: of starts near the chair

        def __post_init__(self) -> None:
            check_range(self, "zone", least=1, most=len(ZONES))
            check_range(self, "keep", least=0, most=1)
            check_range(self, "distance", above=0, most=100)
            check_range(self, "spread", least=0, most=10)
            check_range(self, "degrees", least=0, most=180)
            if self.sector is not None:
                check_range(self, "sector", above=0, most=ZONES[0])

    def __init__(self, options: Options, context: Context) -> None:
        self._options = options
        follows = options.zone is None and not context.evaluating
        self._sector = options.sector if follows else None
        scene = context.need_scene(CharacterScene, "initial_states 'sitting/around_chair'")
        self._layout = scene.layout.to(context.device)
        chair = context.need_section("chair", Chair, "initial_states 'sitting/around_chair'")
        self._sizes = _Sizes(chair, options.chairs)
        nearest, seat = options.distance - options.spread, 0.5 * self._sizes.across
        if nearest < seat:
            raise ConfigError(
                f"initial_states.distance={options.distance:g} with spread={options.spread:g} is not possible: figures would begin "
                f"{nearest:.3g} m from the seat's middle, and the chair reaches {seat:.3g} m."
            )
        self.varies = (PLACE, TURN, *self._sizes.varies)
        standing = reference_motion(context).sample(torch.zeros(1, device=context.device))
        self._qpos, self._qvel = standing["reference_qpos"], standing["reference_qvel"]
        self._heading = standing["reference_root_heading"]
        ends = torch.tensor((0.0, *ZONES), device=context.device).deg2rad()
        self._begin, self._width = ends[:-1].clone(), ends.diff()
        self._keep = 1.0 if context.evaluating else options.keep
        self._at_chair = None
        if options.at_chair.banks and not context.evaluating:
            states = _banked(options.at_chair.banks, scene, context)
            self._at_chair = states["qpos"], states["qvel"]

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        options, difficulty = self._options, fields["difficulty"]
        drawn = streams.uniform(6)
        hardest = (
            1.0 + (difficulty >= 0.5 - 1e-6) + (difficulty >= 1.0 - 1e-6)
            if options.zone is None
            else torch.full_like(difficulty, float(options.zone))
        )
        any_zone = (drawn[:, 4] * hardest).floor() + 1.0
        keeps = (drawn[:, 5] < self._keep) if options.zone is None else torch.zeros_like(
            difficulty, dtype=torch.bool
        )  # fmt: skip
        zone = torch.where(keeps, any_zone.clamp(max=3.0), hardest)
        row = (zone.long() - 1).clamp(0, len(self._begin) - 1)
        angle = self._begin[row] + self._width[row] * drawn[:, 1]
        newest = zone == hardest
        if self._sector is not None:
            first, width = math.radians(ZONES[0]), math.radians(self._sector)
            end = first + (math.pi - first) * difficulty
            begin = torch.where(keeps, 0.0, end - width)
            angle = begin + (end - begin) * drawn[:, 1]
            newest = angle >= end - width
            zone = 1.0 + (angle[:, None] > self._begin[1:]).sum(dim=1)
        side = torch.where(drawn[:, 0] < 0.5, 1.0, -1.0)
        angle = side * angle
        away = options.distance + options.spread * (2 * drawn[:, 2] - 1)
        place = away[:, None] * torch.stack([angle.cos(), angle.sin()], dim=1)
        off = math.radians(options.degrees) * (2 * drawn[:, 3] - 1)
        qpos, qvel = (value.expand(len(zone), -1) for value in (self._qpos, self._qvel))
        qpos, qvel = self._layout.moved(qpos, qvel, angle + math.pi + off - self._heading, place)
        if self._at_chair is not None:
            there = (streams.uniform(1) < options.at_chair.share).expand(-1, 1)
            near_qpos, near_qvel = self._before_chair(streams, *self._at_chair)
            qpos, qvel = torch.where(there, near_qpos, qpos), torch.where(there, near_qvel, qvel)
            zone, newest = zone.masked_fill(there[:, 0], 0), newest & ~there[:, 0]
        chair = torch.zeros(len(zone), 3, device=zone.device)
        _, sizes = self._sizes.draw(streams)
        return {
            "qpos": qpos,
            "qvel": qvel,
            "zone": zone,
            "newest": newest.float(),
            "side": (side > 0).float(),
            "motion_start": torch.zeros_like(side),
            PLACE: chair,
            TURN: rotations.from_heading(chair[:, 0]),
            **sizes,
        }

    def _before_chair(
        self, streams: WorldStreams, qpos: Tensor, qvel: Tensor
    ) -> tuple[Tensor, Tensor]:
        """States (N, nq), (N, nv) of those banked, each in a direction and at a place of its own."""
        options, drawn = self._options.at_chair, streams.uniform(4)
        row = (drawn[:, 0] * len(qpos)).long().clamp(max=len(qpos) - 1)
        qpos, qvel = qpos[row], qvel[row]
        near, far = options.ahead
        ahead, aside = near + (far - near) * drawn[:, 1], options.aside * (2 * drawn[:, 2] - 1)
        heading = math.radians(options.degrees) * (2 * drawn[:, 3] - 1)
        at = self._layout.root_address
        own = rotations.heading(qpos[:, at + 3 : at + 7])
        return self._layout.moved(qpos, qvel, heading - own, torch.stack([ahead, aside], dim=1))

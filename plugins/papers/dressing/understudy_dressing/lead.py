"""Leads an arm out from under the hem and into its sleeve.

At the end of the tuck the front of the shirt is gathered above the elbow, the hand is in front of the chin and the sleeve behind
the shoulder, so an arm that makes straight for its sleeve goes through the front. Led the other way round it goes in: the holding
hand lowers the hem, the elbow rises in front of the chest while the fingertip goes through the sleeve's entrance, and then the arm
goes out to its side.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from torch import Tensor

from understudy.options import check_range
from understudy.task import Context
from understudy_dressing.body import Side
from understudy_dressing.leading import Leading, LeadingOptions, Way
from understudy_dressing.led import Led, Place
from understudy_dressing.moves import PERIOD
from understudy_dressing.state import SleeveState, refuse_other_side
from understudy_dressing.waypoints import BACK_AT, BEYOND_AT, HELD_AT, LOWERED_AT, TUCKED_AT

#: Which hand (the one that goes in, or the one that holds) goes to which place: under the hem, and back to the shoulder.
_UNDER = tuple(("in", place) for place in (*TUCKED_AT, *BEYOND_AT))
_BACK = (("holds", LOWERED_AT), *(("in", place) for place in BACK_AT))


class Lead(Leading):
    """Leads arms into their sleeves in a task of ``dressing/shirt_sleeve``, from states of a bank that ``job=harvest`` made of
    ``dressing/shirt_tuck``; or into the second sleeve, when the other arm is already in its own.

    If `held`, the bank is of a held hem, and the arm first goes under it; ``tucks`` are states on that part of the way. From
    there, or if `back` from where a policy brought the arm, the hand goes back along the chest to its shoulder.
    Banks are left in the folders ``ends`` (where the arms began), ``low`` (the hem on its way down), ``half`` and ``near`` (the
    hand on its way, and nearer or in), ``out`` (the arm on its way out) and ``dressed`` (where it ended), for each arm that went
    all the way without going through cloth; see :class:`~understudy_dressing.leading.Leading`.
    """

    portions = ("tucks", "ends", "low", "half", "near", "out", "dressed")
    _from, _went = "dressing/shirt_tuck", "came into the sleeve"

    @dataclass(frozen=True)
    class Options(LeadingOptions):
        #: s in which the hem comes down; if `held` or `back`, for each step of that
        lowers: float = 0.6
        speed: float = 0.8  #: m/s, speed of fingertip and elbow, which go their own ways
        most: float = 2.2  #: s within which the hand has to be in
        out: float = 1.6  #: s in which the arm goes out to its side
        torn: float = 2.6  #: area ratio from which on states are not kept
        enough: float = 0.08  #: progress at which the arm begins to go out to its side
        #: m, place to which the left elbow goes
        elbow: tuple[float, float, float] = (0.28, 0.09, -0.08)
        #: whether arms are first led under the hem, from a bank of the held hem (`initial_states.worn=held`); the hem is
        #: lowered as the hand goes back to its shoulder, and the bank `tucks` has the way until then
        held: bool = False
        #: if `held`, whether the other hand has only just taken the hem: it first brings it to the front, the trunk upright
        taken: bool = False
        goes: float = 0.6  #: s from each place to the next on the way under the hem
        #: whether the hand goes back to its shoulder as the hem is lowered, as it does if `held`: for states in which a policy
        #: has brought the hand no further than under the hem
        back: bool = False
        #: the arm that goes in: `left`, the paper's first, or `right`, the second
        side: Side = "left"

        def __post_init__(self) -> None:
            super().__post_init__()
            check_range(self, "lowers", "most", "out", least=0.1, most=10)
            check_range(self, "speed", least=0.05, most=5)
            check_range(self, "enough", least=0.01, most=0.6)
            check_range(self, "elbow", least=-1e3, most=1e3)
            check_range(self, "goes", least=0.1, most=10)
            if self.taken and not self.held:
                raise ValueError("taken=true is not possible with held=false: give held=true, too.")

    options: Options

    def _refuse_other_arm(self, context: Context) -> None:
        refuse_other_side(context, SleeveState.Options, self.options.side, "job 'dressing/lead'")

    @property
    def _longest(self) -> float:
        options = self.options
        lowers = options.lowers * (len(_BACK) if options.held or options.back else 1)
        return lowers + options.most + options.out

    def _lead(self, pose: np.ndarray, cloth: np.ndarray) -> Way:
        """Ends when the arm goes through cloth, is not in its sleeve in time, or is out at its side."""
        options = self.options
        arm = Led(self._shirt, options.side, pose, cloth)
        way = Way(arm, self._every, phase=-1 if options.held else 0)

        def steps(seconds: float) -> range:
            return range(1, round(seconds / PERIOD) + 1)

        def through(phase: int) -> bool:
            way.note(phase)
            return way.through

        def gone(place: tuple[float, float, float], hand: str, phase: int) -> bool:
            """Whether that hand came to the place; the trunk is upright while it brings the hem to the front."""
            mine: Side = options.side
            other: Side = "left" if mine == "right" else "right"
            who = mine if hand == "in" else other
            seconds = options.goes if phase < 0 else options.lowers
            begin = arm.found()[0].copy()
            end = arm.reached(who, arm.mirrored * np.array(place), upright=place == HELD_AT)
            for k in steps(seconds):
                arm.go(end, k / len(steps(seconds)), begin)
                if through(phase):
                    return False
            return True

        def near() -> bool:
            """Whether the hand came to where it can make for its sleeve, by the way that the options ask for."""
            if not options.held and not options.back:
                side = options.side
                lowered = self._shirt.settled("in_sleeve", side, other_dressed=side == "right")[0]
                for k in steps(options.lowers):
                    arm.lower(k / len(steps(options.lowers)), pose, lowered)
                    if through(0):
                        return False
                return True
            route = [(hand, place, 0) for hand, place in _BACK]
            if options.held:
                route = [*((hand, place, -1) for hand, place in _UNDER), *route]
            if options.taken:
                route = [("holds", HELD_AT, -1), *route]
            return all(gone(place, hand, phase) for hand, place, phase in route)

        if not near():
            return way
        for _ in steps(options.most):
            arm.approach(PERIOD * options.speed, np.array(options.elbow))
            if through(1) or way.places[-1].progress > options.enough:
                break
        if way.places[-1].progress <= options.enough or way.through:
            return way
        begin = arm.found()[0].copy()
        for k in steps(options.out):
            arm.spread(k / len(steps(options.out)), begin)
            if through(2):
                return way
        way.arrived = way.places[-1].phase == 2
        return way

    def _keep(self, places: list[Place], at: Callable[..., dict[str, Tensor]]) -> None:
        options, kept = self.options, self._kept
        under = sum(place.phase < 0 for place in places)
        end = max(0, under - 1)  # the decision at which the arm is under the hem
        kept["ends"].append(at(end))
        kept["dressed"].append(at(len(places) - 1))
        if under:
            kept["tucks"].append(at(0, end))
        hand = sum(place.phase == 1 for place in places)
        first = sum(place.phase <= 0 for place in places)
        for k in range(options.keep, len(places), options.keep):
            phase = places[k].phase
            if places[k].ratio >= options.torn or k == end:
                continue
            if phase < 0:
                kept["tucks"].append(at(k, end))
            else:
                kept[("low", "half" if k < first + hand // 2 else "near", "out")[phase]].append(
                    at(k)
                )

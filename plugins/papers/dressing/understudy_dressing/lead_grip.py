"""Leads the hand of a dressed arm to the hem that the other hand holds."""

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
from understudy_dressing.shirt_state import ShirtState
from understudy_dressing.state import refuse_other_side


class LeadGrip(Leading):
    """Leads a hand whose arm is in its sleeve to the hem that the other hand holds, in a task of ``dressing/shirt_regrip``, from
    states of a bank that ``job=harvest`` made of ``dressing/shirt_sleeve`` (ours).

    Banks are left in the folders ``ends`` (where the hands began), ``far`` and ``near`` (in the first and the second half of their
    way) and ``taken`` (where they ended), for each hand that got there while its arm went through no cloth; see
    :class:`~understudy_dressing.leading.Leading`.
    """

    portions = ("ends", "far", "near", "taken")
    _from, _went = "dressing/shirt_sleeve", "came to the hem"

    @dataclass(frozen=True)
    class Options(LeadingOptions):
        speed: float = 0.8  #: m/s, speed of the fingertip
        most: float = 3.0  #: s within which the hand has to be there
        near: float = 0.03  #: m, distance from the grip's target within which the hand has arrived
        side: Side = "left"  #: the hand that is to grip

        def __post_init__(self) -> None:
            super().__post_init__()
            check_range(self, "most", least=0.1, most=10)
            check_range(self, "speed", least=0.05, most=5)
            check_range(self, "near", least=0.005, most=0.2)

    options: Options

    def _refuse_other_arm(self, context: Context) -> None:
        who = "job 'dressing/lead_grip'"
        refuse_other_side(context, ShirtState.Options, self.options.side, who, "hand")

    @property
    def _longest(self) -> float:
        return self.options.most

    def _lead(self, pose: np.ndarray, cloth: np.ndarray) -> Way:
        """Ends when the hand has arrived, the arm goes through cloth, or it takes too long."""
        options = self.options
        arm = Led(self._shirt, options.side, pose, cloth)
        way = Way(arm, self._every)
        for _ in range(round(options.most / PERIOD)):
            away = arm.grip(PERIOD * options.speed)
            if way.note() and (way.through or away < options.near):
                way.arrived = not way.through
                break
        return way

    def _keep(self, places: list[Place], at: Callable[..., dict[str, Tensor]]) -> None:
        self._keep_halves(places, at, "taken")

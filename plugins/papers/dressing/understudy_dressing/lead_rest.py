"""Leads a dressed person back to the neutral pose."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from torch import Tensor

from understudy.options import check_range
from understudy_dressing.leading import Leading, LeadingOptions, Way
from understudy_dressing.led import Led, Place
from understudy_dressing.moves import PERIOD


class LeadRest(Leading):
    """Leads a person whose arms are both in their sleeves back to the neutral pose, in a task of ``dressing/shirt_finish``, from
    states of a bank that ``job=harvest`` made of ``dressing/shirt_sleeve_second`` (ours).

    Banks are left in the folders ``ends`` (where the way began), ``far`` and ``near`` (in its first and its second half) and
    ``rested`` (where it ended), for each person of whom no arm went through cloth; see
    :class:`~understudy_dressing.leading.Leading`.
    """

    portions = ("ends", "far", "near", "rested")
    _from, _went = "dressing/shirt_sleeve_second", "came to rest"

    @dataclass(frozen=True)
    class Options(LeadingOptions):
        seconds: float = 1.6  #: s that the way back takes

        def __post_init__(self) -> None:
            super().__post_init__()
            check_range(self, "seconds", least=0.1, most=10)

    options: Options

    @property
    def _longest(self) -> float:
        return self.options.seconds

    def _lead(self, pose: np.ndarray, cloth: np.ndarray) -> Way:
        """Ends when the person is neutral, or an arm goes through cloth."""
        arm = Led(self._shirt, "right", pose, cloth, holds=False)
        way = Way(arm, self._every)
        steps = round(self.options.seconds / PERIOD)
        for k in range(1, steps + 1):
            arm.rest(k / steps, pose)
            if way.note() and (way.through or arm.through("left")):
                return way
        way.arrived = True
        return way

    def _keep(self, places: list[Place], at: Callable[..., dict[str, Tensor]]) -> None:
        self._keep_halves(places, at, "rested")

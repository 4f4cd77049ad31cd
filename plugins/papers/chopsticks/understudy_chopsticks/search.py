"""Algorithm 2 (thesis, section 5.5): for each style the places on the sticks, by GP-UCB, all styles in one search."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from understudy import random
from understudy.errors import ConfigError
from understudy.options import check_range
from understudy_bayes.gp_ucb import GPUCB
from understudy_bayes.space import Parameter
from understudy_bayes.surrogate import SurrogateOptions
from understudy_gripping.pose import first_guess
from understudy_gripping.styles import Style, read_style, styles, written
from understudy_hand.table import FEWEST, FINGERS
from understudy_hand.tools import HALF_LENGTH
from understudy_sweeps.loops import OuterLoop, Report, Trial


class GripSearch(OuterLoop):
    """A search of its own for each style, asked in turn. A trial is a training of one candidate.

    A candidate whose fingers do not reach, or that lets the sticks fall within a second, costs no sample; it
    counts as an evaluation that failed.
    """

    extendable = ("evaluations",)

    @dataclass(frozen=True)
    class Options:
        #: digits from the thumb on; empty takes all of the hand (seventeen for five fingers)
        styles: tuple[str, ...] = ()
        fingers: int = 5  #: of the hand, 3 to 5
        evaluations: int = 10  #: of each style (thesis, section 5.5.1)
        initial: int = 4  #: of them, at points that no model chose
        #: m: how far each finger's place may be from a first guess, either way
        spread: float = 0.025
        #: how a style's scores are modelled
        surrogate: SurrogateOptions = field(default_factory=SurrogateOptions)

        def __post_init__(self) -> None:
            check_range(self, "fingers", least=FEWEST, most=len(FINGERS))
            check_range(self, "evaluations", "initial", least=1)
            check_range(self, "spread", above=0, most=HALF_LENGTH)

    def __init__(self, options: Options, seed: int = 0) -> None:
        chosen: Sequence[Style] = [read_style(text, options.fingers) for text in options.styles]
        chosen = list(dict.fromkeys(chosen)) or styles(options.fingers)
        self._evaluations = options.evaluations
        self._searches = {written(style): _search(style, options, seed) for style in chosen}
        self._infeasible = 0
        self._told = 0

    def ask(self, number: int) -> Trial | None:
        names = list(self._searches)
        turn, row = divmod(number, len(names))
        if turn >= self._evaluations:
            return None
        trial = self._searches[names[row]].ask(turn)
        if trial is None:
            return None
        return dataclasses.replace(
            trial, key=f"{names[row]}-{turn}", overrides=(f"grip.style='{names[row]}'",)
        )

    def recall(self, trial: Trial) -> bool:
        style, own = self._own(trial.key)
        if style not in self._searches:
            raise ConfigError(
                f"Trial '{trial.key}' is of a style that this search has not got. Give run.dir another folder."
            )
        return self._searches[style].recall(dataclasses.replace(trial, key=own, overrides=()))

    def tell(self, report: Report) -> Literal["stop"] | None:
        style, own = self._own(report.key)
        if style not in self._searches:
            return None
        # Of a style without a feasible candidate the others know nothing.
        with contextlib.suppress(ConfigError):
            self._searches[style].tell(dataclasses.replace(report, key=own))
        if report.final:
            self._told += 1
            self._infeasible += report.status != "ok" and report.cost == 0
            self.share = self._told / (self._evaluations * len(self._searches))
            if self._infeasible == self._told == len(self._searches) > 1:
                raise ConfigError(
                    f"No style's first candidate could begin; of '{report.key}', {report.status} Correct "
                    "the experiment, and give run.dir another folder."
                )
        return None

    def summary(self) -> list[dict[str, Any]]:
        """The trials by style, each style's best marked as its answer."""
        return [
            {**row, "trial": f"{style}-{row['trial'].removeprefix('trial')}", "style": style}
            for style, search in self._searches.items()
            for row in search.summary()
        ]

    @staticmethod
    def _own(key: str) -> tuple[str, str]:
        style, _, number = key.rpartition("-")
        return style, f"trial{number}"


def _search(style: Style, options: GripSearch.Options, seed: int) -> GPUCB:
    touching = [f for f, stick in zip(FINGERS, style, strict=False) if stick]
    parameters = {
        f"grip.places.{finger}": Parameter(
            max(guess - options.spread, -HALF_LENGTH), min(guess + options.spread, HALF_LENGTH)
        )
        for finger, guess in zip(touching, first_guess(style), strict=True)
    }
    own = GPUCB.Options(
        parameters, trials=options.evaluations, initial=options.initial, failed=0.0,
        surrogate=options.surrogate,
    )  # fmt: skip
    return GPUCB(own, random.derive_seed(seed, f"grips/{written(style)}"))

"""Algorithm 2 (thesis, section 5.5): for each style the places on the sticks, by GP-UCB, all styles in one search."""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from understudy import random
from understudy.errors import ConfigError
from understudy.options import check_range
from understudy_bayes.gp_ucb import GPUCB
from understudy_bayes.side_by_side import CANDIDATE, reports, together
from understudy_bayes.space import Parameter
from understudy_bayes.surrogate import SurrogateOptions
from understudy_gripping.holding import holding
from understudy_gripping.section import NONE_HOLDS
from understudy_gripping.styles import Style, read_style, styles, written
from understudy_hand.table import FEWEST, FINGERS
from understudy_hand.tools import HALF_LENGTH
from understudy_sweeps.loops import OuterLoop, Report, Trial


class GripSearch(OuterLoop):
    """Each style has a search of its own, and the searches are asked in turn. A trial trains one candidate, or, with
    `together`, one candidate of each of several styles in one job.

    A candidate whose fingers do not reach, or that lets the sticks fall within a second, costs no sample; it
    counts as an evaluation that failed. A job that could not begin for another reason tells nothing about its candidates:
    they are asked for once more, together, and count as failed only if that job does not begin either.
    """

    extendable = ("evaluations",)

    @dataclass(frozen=True)
    class Options:
        #: styles, each as digits from the thumb on; empty takes all styles of the hand (seventeen
        #: for five fingers)
        styles: tuple[str, ...] = ()
        fingers: int = 5  #: how many fingers the hand has, 3 to 5
        #: how many candidates of each style are evaluated (thesis, section 5.5.1)
        evaluations: int = 10
        initial: int = 4  #: how many of them are at points that no model chose
        #: m, how far each finger's place may be from a first guess, either way
        spread: float = 0.025
        #: how many styles have candidates that share one job, each in worlds of its own
        together: int = 1
        #: Samples of each candidate that shares a job, after which the job ends: at the first
        #: evaluation by which all that hold the sticks have had as many. Null leaves the end to the
        #: budget; then the fewer candidates there are, the more samples each has.
        samples: int | None = None
        #: how a style's scores are modelled
        surrogate: SurrogateOptions = field(default_factory=SurrogateOptions)

        def __post_init__(self) -> None:
            check_range(self, "fingers", least=FEWEST, most=len(FINGERS))
            check_range(self, "evaluations", "initial", "together", least=1)
            check_range(self, "samples", least=1, most=math.inf)
            check_range(self, "spread", above=0, most=HALF_LENGTH)

    def __init__(self, options: Options, seed: int = 0) -> None:
        chosen: Sequence[Style] = [read_style(text, options.fingers) for text in options.styles]
        chosen = list(dict.fromkeys(chosen)) or styles(options.fingers)
        self._evaluations, self._shared = options.evaluations, options.together > 1
        self._samples = options.samples
        self._searches = {written(style): _search(style, options, seed) for style in chosen}
        names = list(self._searches)
        #: The styles of each of a round's trials.
        self._jobs = [
            names[k : k + options.together] for k in range(0, len(names), options.together)
        ]
        self._begun: set[str] = set()  #: styles with a candidate that could begin
        self._told = 0
        #: Of shared jobs: what was asked, by key, and the keys of those that said nothing, in order.
        self._asked: dict[str, Trial] = {}
        self._void: list[str] = []

    def ask(self, number: int) -> Trial | None:
        for key in self._void:
            if (again := key + _AGAIN) not in self._asked:
                trial = dataclasses.replace(self._asked[key], key=again)
                return self._asked.setdefault(again, trial)
        number -= sum(key.endswith(_AGAIN) for key in self._asked)
        turn, row = divmod(number, len(self._jobs))
        if turn >= self._evaluations:
            return None
        asked = {style: self._searches[style].ask(turn) for style in self._jobs[row]}
        trials = {style: trial for style, trial in asked.items() if trial is not None}
        if len(trials) < len(asked):
            return None
        if self._shared:
            shared = {_NAME + style: _of(style, trial, _SHARED) for style, trial in trials.items()}
            trial = together(f"round{turn}-{row}", shared, (_MEASURE,))
            return self._asked.setdefault(trial.key, trial)
        ((style, trial),) = trials.items()
        return dataclasses.replace(_of(style, trial, "grip."), key=f"{style}-{turn}")

    def recall(self, trial: Trial) -> bool:
        wanted, expected = [], list[str]()
        for style, key in self._own(trial.key).items():
            if style not in self._searches:
                raise ConfigError(
                    f"Trial '{trial.key}' is of a style that this search has not got. Give run.dir another folder."
                )
            search = self._searches[style]
            front = _SHARED.replace(CANDIDATE, _NAME + style) if self._shared else "grip."
            expected += _of(style, Trial(key), front).overrides
            expected += [_MEASURE.replace(CANDIDATE, _NAME + style)] if self._shared else []
            point = {
                "grip." + path.removeprefix(front): value
                for path, value in trial.point.items()
                if path.startswith(front)
            }
            wanted.append(search.recall(Trial(key, point=point)))
        if trial.overrides != tuple(expected):  # a journal may be a stranger's
            raise ConfigError(
                f"Trial '{trial.key}' had other overrides when this search began: {', '.join(trial.overrides)}. Give "
                "run.dir another folder."
            )
        if self._shared:
            self._asked[trial.key] = trial
        return all(wanted)

    def tell(self, report: Report) -> Literal["stop"] | None:
        own = {s: key for s, key in self._own(report.key).items() if s in self._searches}
        if self._shared and report.key not in self._asked:
            return None  # of what nobody asked for, as where a journal is damaged
        if self._shared and report.final and _is_void(report):
            self._void.append(report.key)
            return None
        if self._shared and report.final:
            named = {_NAME + style: key for style, key in own.items()}
            found = reports(report, named, _OBJECTIVE)
            told = {style: found[_NAME + style] for style in own}
        else:
            told = {style: dataclasses.replace(report, key=key) for style, key in own.items()}
        for style, one in told.items():
            # Of a style without a feasible candidate the others know nothing.
            with contextlib.suppress(ConfigError):
                self._searches[style].tell(one)
            if report.final:
                self._told += 1
                self._begun |= {style} if one.status == "ok" or one.cost > 0 else set()
                self.share = self._told / (self._evaluations * len(self._searches))
        if report.final and not self._begun and self._told == len(self._searches) > 1:
            raise ConfigError(
                f"No style's first candidate could begin; of '{report.key}', {report.status} Correct "
                "the experiment, and give run.dir another folder."
            )
        return "stop" if self._enough(report, own) else None

    def _enough(self, report: Report, own: Iterable[str]) -> bool:
        """Whether each candidate that holds the sticks has had its samples of a job that goes on."""
        if report.final or not self._shared or self._samples is None:
            return False
        scores = [report.measures.get(_OBJECTIVE.replace(CANDIDATE, _NAME + s)) for s in own]
        held = sum(score is not None and math.isfinite(score) for score in scores)
        return report.cost >= self._samples * max(held, 1)

    def summary(self) -> list[dict[str, Any]]:
        """The trials by style, each style's best marked as its answer; of a shared job, which one."""
        rows = []
        for place, styles_of in enumerate(self._jobs):
            for style in styles_of:
                for row in self._searches[style].summary():
                    number = row["trial"].removeprefix("trial")
                    named = {**row, "trial": f"{style}-{number}", "search": style}
                    key = f"round{number}-{place}"
                    again = key + _AGAIN
                    job = {"job": again if again in self._asked else key} if self._shared else {}
                    rows.append({**named, **job})
        return rows

    def _own(self, key: str) -> dict[str, str]:
        """By style of the trial `key`: its name in that style's search."""
        if not self._shared:
            style, _, number = key.rpartition("-")
            return {style: f"trial{number}"}
        turn, _, row = key.removeprefix("round").removesuffix(_AGAIN).partition("-")
        numbers = key.startswith("round") and turn.isdecimal() and row.isdecimal()
        if not (numbers and int(row) < len(self._jobs)):
            raise ConfigError(
                f"Trial '{key}' is of a search with other jobs (outer_loop.together). Give run.dir another folder."
            )
        return dict.fromkeys(self._jobs[int(row)], f"trial{turn}")


#: How the key ends of a job that is asked for once more.
_AGAIN = "-again"
#: A candidate's name is a style's digits after this: a number is no name of a field.
_NAME = "s"
#: Where a candidate of several stands, and by which measure it is judged.
_SHARED = f"grip.candidates.{CANDIDATE}."
_OBJECTIVE = f"score_{CANDIDATE}"
_MEASURE = (
    f"measure.{_OBJECTIVE}={{name: value_where, reads: {{value: reward, where: from_{CANDIDATE}}}, "
    "reduce: mean}"
)


def _is_void(report: Report) -> bool:
    """Whether a job broke off before any training, and not since none of its candidates can begin."""
    return (
        report.status != "ok"
        and report.cost == 0
        and NONE_HOLDS not in report.status
        and not report.key.endswith(_AGAIN)
    )


def _of(style: str, trial: Trial, front: str) -> Trial:
    """A style's `trial` as one whose options stand behind `front` in the configuration."""
    point = {front + path.removeprefix("grip."): value for path, value in trial.point.items()}
    return dataclasses.replace(trial, overrides=(f"{front}style='{style}'",), point=point)


def _search(style: Style, options: GripSearch.Options, seed: int) -> GPUCB:
    touching = [f for f, stick in zip(FINGERS, style, strict=False) if stick]
    parameters = {
        f"grip.places.{finger}": Parameter(
            max(guess - options.spread, -HALF_LENGTH), min(guess + options.spread, HALF_LENGTH)
        )
        for finger, guess in zip(touching, holding("sticks").first_guess(style), strict=True)
    }
    own = GPUCB.Options(
        parameters, trials=options.evaluations, initial=options.initial, failed=0.0,
        surrogate=options.surrogate,
    )  # fmt: skip
    return GPUCB(own, random.derive_seed(seed, f"grips/{written(style)}"))

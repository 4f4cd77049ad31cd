"""What the last evaluation found."""

from __future__ import annotations

from collections.abc import Iterator

from markupsafe import Markup

from understudy.records.runs import Run
from understudy_report import words
from understudy_report.headline import percent_interval
from understudy_report.markup import bar, grid, nested, piece, table
from understudy_report.section import ReportSection
from understudy_report.values import Row, interval, mapping, number, read_evaluation


class EvaluationSection(ReportSection):
    """The last evaluation: all episodes, what they violated, and the measures of the task."""

    title = "Evaluation"
    order = 40

    def html(self, run: Run) -> str | None:
        evaluation = read_evaluation(run)
        if not evaluation:
            return None
        facts = table((k, nested(v)) for k, v in _facts(evaluation) if v is not None)
        violated = table(
            (name, bar(share))
            for name, value in mapping(evaluation.get("violated")).items()
            if (share := number(value)) is not None
        )
        measures = grid(
            ("Measure", "Over an episode", "Mean", "95 % interval", "Spread"), _measures(evaluation)
        )
        cards = [("All episodes", Markup(facts))]
        if violated:
            cards.append(("Episodes with a violation", Markup(violated)))
        return str(piece("evaluation", cards, Markup(measures)))


def _facts(evaluation: Row) -> Iterator[tuple[str, object]]:
    rate, length, lasted, samples, unsound = (
        number(evaluation.get(k))
        for k in ("success_rate", "seconds", "mean_episode_seconds", "samples", "unsound")
    )
    objective = mapping(evaluation.get("objective"))
    reached = number(objective.get("value"))
    yield "Policy", evaluation.get("policy")
    yield "Samples learned from", None if samples is None else f"{samples:,.0f}"
    yield "Episodes", evaluation.get("episodes")
    yield "Starts", evaluation.get("starts")
    yield "Different starts", evaluation.get("different_starts")
    yield "Longest possible", None if length is None else f"{length:g} s"
    yield "Mean length", None if lasted is None else f"{lasted:.2f} s"
    yield "Success means", evaluation.get("success")
    yield "Succeeded", None if rate is None else words.share(rate)
    yield "95 % interval", percent_interval(evaluation) or None
    yield "Numbers went wrong in", words.share(unsound) if unsound else None
    yield "At half the time step", _half_step(mapping(evaluation.get("half_step")))
    if reached is not None:
        yield "Objective", f"{words.text(objective.get('name', ''))} {reached:.4g}".strip()


_VERDICTS = {
    "depends": "the motion depends on the time step",
    "independent": "the motion does not depend on the time step",
    "undecided": "too few episodes to say whether the motion depends on the time step",
}


def _half_step(found: Row) -> str | None:
    """What physics at half the time step gave, and whether that is another result."""
    rate, hertz = number(found.get("success_rate")), number(found.get("physics_hz"))
    if rate is None or hertz is None:
        return None
    ends = interval(found.get("difference_95"))
    apart = f", by {100 * ends[0]:+.0f} to {100 * ends[1]:+.0f} points (95 %)" if ends else ""
    verdict = _VERDICTS.get(words.text(found.get("verdict", "")))
    return f"{words.share(rate)} succeeded ({hertz:,.0f} Hz){apart}" + (
        f": {verdict}" if verdict else ""
    )


def _measures(evaluation: Row) -> Iterator[tuple[str, ...]]:
    """Rows of the table of measures, those without a number as dashes."""
    for name, value in mapping(evaluation.get("measures")).items():
        found = mapping(value)
        mean, spread = number(found.get("mean")), number(found.get("spread"))
        ends = interval(found.get("mean_95"))
        yield (
            words.text(name),
            words.text(found.get("reduce", "–")),
            "–" if mean is None else f"{mean:.3g}",
            "–" if ends is None else f"{ends[0]:.3g} to {ends[1]:.3g}",
            "–" if spread is None else f"{spread:.3g}",
        )

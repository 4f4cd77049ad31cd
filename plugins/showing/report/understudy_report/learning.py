"""Learning curves: metrics against samples, with marks where something changed."""

from __future__ import annotations

from collections.abc import Sequence

from understudy.records.runs import Run
from understudy_report.charts import Chart, Mark, draw_chart
from understudy_report.section import ReportSection
from understudy_report.values import Row, number, own_evaluation

_USUAL = (
    Chart("Episode length", "episode/episode_seconds", "s", low=0.0),
    Chart("Reward per step", "reward"),
    Chart("Explained variance of returns", "explained_variance", cut=(-1.0, 1.0)),
    Chart("KL divergence per update", "kl", low=0.0),
    Chart("Samples per second", "samples_per_second", low=0.0),
    Chart("Episodes that lasted to the end", "episode/truncated", "%", low=0.0, high=100.0),
)
#: What rows of metrics hold beside numbers: why episodes ended, what evaluations found, and marks,
#: whose text follows and whose value is not 0 where they happened.
_ENDED_BY, _EVALUATION, _MARK = "episode/ended_by/", "evaluation/", "mark/"
_SUCCESS, _OBJECTIVE = "evaluation/success_rate", "evaluation/objective"
#: Whether a row's success is only the most that it could be.
AT_MOST = "evaluation/at_most"
#: Of an evaluation that was stopped once the criterion was out of reach.
_GIVEN_UP = "evaluation/success_rate_at_most"
_CONFIRMED = "confirmation/success_rate"
#: Of evaluations at the coarse physics that a training begins with, and whether it is that.
_REHEARSED, _REHEARSED_AT_MOST = "rehearsal/success_rate", "rehearsal/at_most"


class LearningCurves(ReportSection):
    """A grid of curves: evaluations, the usual metrics, why episodes ended."""

    title = "Learning"
    order = 60

    def html(self, run: Run) -> str | None:
        rows = with_success(run.metrics(), own_evaluation(run))
        marks = marks_of(rows)
        end = max((x for row in rows if (x := number(row.get("samples"))) is not None), default=0.0)
        ended = [
            Chart(f"Ended by {key.removeprefix(_ENDED_BY)}", key, "%", low=0.0, high=100.0)
            for key in _keys(rows, _ENDED_BY)
        ]
        groups = {
            "Evaluations": _evaluations(rows),
            "Training": _USUAL,
            "Why training episodes ended": ended,
        }
        drawn = {
            name: "".join(draw_chart(chart, rows, marks, end) for chart in charts)
            for name, charts in groups.items()
        }
        parts = [
            f'<h3>{name}</h3><div class="charts">{charts}</div>'
            for name, charts in drawn.items()
            if charts
        ]
        return "".join(parts) or None


def marks_of(rows: Sequence[Row]) -> list[Mark]:
    """The marks that the rows of metrics `rows` hold."""
    return [
        Mark(samples, key.removeprefix(_MARK))
        for row in rows
        if (samples := number(row.get("samples"))) is not None
        for key, value in row.items()
        if key.startswith(_MARK) and number(value)
    ]


def with_success(rows: Sequence[Row], evaluation: Row) -> list[Row]:
    """`rows` with the success of each evaluation under one key: what it found, else what its
    confirmation or the share at which it was given up says; the last is the run's `evaluation`."""
    found: list[Row] = []
    for row in rows:
        share = next((row[k] for k in (_CONFIRMED, _SUCCESS, _GIVEN_UP) if k in row), None)
        at_most = share is not None and _CONFIRMED not in row and _SUCCESS not in row
        row = row if share is None else {**row, _SUCCESS: share, AT_MOST: at_most}
        if (most := row.get(f"{_REHEARSED}_at_most")) is not None:
            row = {**row, _REHEARSED: most, _REHEARSED_AT_MOST: True}
        found.append(row)
    last = {"samples": evaluation.get("samples"), _SUCCESS: evaluation.get("success_rate")}
    return [*found, last] if None not in last.values() else found


def _keys(rows: Sequence[Row], prefix: str) -> list[str]:
    return sorted({key for row in rows for key in row if key.startswith(prefix)})


def _evaluations(rows: Sequence[Row]) -> list[Chart]:
    """Success first, then the objective unless that is success, then the other measures."""
    objective_is_success = all(row.get(_OBJECTIVE) == row.get(_SUCCESS) for row in rows)
    known = [
        Chart("Episodes that succeeded", _SUCCESS, "%", 0.0, 100.0, dots=True, at_most=AT_MOST)
    ]
    if any(_REHEARSED in row for row in rows):
        known.append(
            Chart("Of them at coarse physics", _REHEARSED, "%", 0.0, 100.0, dots=True, at_most=_REHEARSED_AT_MOST)
        )  # fmt: skip
    if not objective_is_success:
        known.append(Chart("Objective", _OBJECTIVE, dots=True))
    return known + [
        Chart(key.removeprefix(_EVALUATION).replace("_", " "), key, dots=True)
        for key in _keys(rows, _EVALUATION)
        if key not in (_SUCCESS, _OBJECTIVE, _GIVEN_UP, AT_MOST)
    ]

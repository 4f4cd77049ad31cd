"""Success by where in the clip episodes begin, on the report page, beside where that can be flown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from understudy.records.runs import Run
from understudy_report.charts import Axes, grid, svg
from understudy_report.section import ReportSection
from understudy_report.values import mapping, read_evaluation
from understudy_spacetime.initial_states import fall_of
from understudy_spacetime.section import context_of

#: Of a run that was judged with ``+starts=spacetime/phases``: from each part, and from what can be flown.
PREFIX = "success_from_phase_"
FLYABLE, ANY = "success_from_flyable", "success_from_any_phase"


class ByPhaseSection(ReportSection):
    """How many episodes succeed from each part of the clip, and how many of its starts cannot be flown, whatever
    a policy does, since a body that is let go there lands beside the clip."""

    title = "Success by where episodes begin"
    order = 45

    def html(self, run: Run) -> str | None:
        found = measured(run)
        shares = by_part(found)
        if not shares:
            return None
        fall = fall_of(context_of(run))
        return (
            '<div class="charts"><div class="card chart"><h4>By phase: success, and (dashed) starts that can be flown'
            f"</h4>{drawn(shares, (1.0 - fall.by_phase(len(shares))).tolist())}</div></div>"
            f"<p>{escape(sentence(found, fall.share))}</p>"
        )


def measured(run: Run) -> Mapping[str, Any]:
    """The measures of the last evaluation of `run`."""
    return mapping(read_evaluation(run).get("measures"))


def by_part(found: Mapping[str, Any]) -> list[float]:
    """The share that succeeded from each part of the clip, in order; empty where they were not judged."""
    shares: list[float] = []
    while isinstance(mean := mapping(found.get(f"{PREFIX}{len(shares)}")).get("mean"), int | float):
        shares.append(float(mean))
    return shares


def sentence(found: Mapping[str, Any], impossible: float) -> str:
    """What was left out, and the shares with it and without."""
    words = (
        f"Of the clip's starts {impossible:.1%} cannot be flown: let go there in the clip's state, the body lands more "
        "than 0.2 m or 0.7 rad beside it. This is an estimate: policies save some of these, and lose others."
    )
    for name, text in (
        (FLYABLE, "Without those starts {:.0%} of episodes succeed."),
        (ANY, "With no start left out {:.0%} do."),
    ):
        mean = mapping(found.get(name)).get("mean")
        if isinstance(mean, int | float):
            words += " " + text.format(mean)
    return words


def drawn(shares: Sequence[float], flyable: Sequence[float]) -> str:
    """Two staircases over the phase."""
    axes, count = Axes(0.0, 1.0, 1.0), len(shares)

    def stairs(values: Sequence[float]) -> str:
        steps = [(x / count, float(y)) for i, y in enumerate(values) for x in (i, i + 1)]
        return axes.path(steps)

    return svg(
        f'{grid(axes, "phase")}<path class="axis" stroke-dasharray="4 3" d="{stairs(flyable)}"/>'
        f'<path class="line" d="{stairs(shares)}"/>',
        "success by the phase in which episodes begin, and the share of starts that can be flown",
    )

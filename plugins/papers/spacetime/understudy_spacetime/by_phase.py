"""Success by where in the clip episodes begin, on the report page, beside where that can be flown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from understudy.records.runs import Run
from understudy_report.charts import Axes, grid, svg
from understudy_report.section import ReportSection
from understudy_report.values import mapping, number, read_evaluation
from understudy_spacetime.clip_starts import fall_of
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
        duration = len(fall.times) * float(fall.times[1])
        chart = drawn(shares, fall.by_phase(len(shares)).tolist(), duration)
        return (
            f"<p>{escape(worst(found, shares, duration))}</p>"
            '<div class="charts"><div class="card chart"><h4>Episodes that succeed, by where they begin'
            "<small>grey: starts that nobody can follow</small></h4>"
            f"{chart}</div></div><p>{escape(sentence(found, fall.share))}</p>"
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


def worst(found: Mapping[str, Any], shares: Sequence[float], duration: float) -> str:
    """Where episodes that begin there succeed least, with what so few of them can tell."""
    at, part = min(range(len(shares)), key=shares.__getitem__), duration / len(shares)
    words = (
        f"Each of {len(shares)} parts of the clip was judged by itself. Episodes that begin between {part * at:.2f} and "
        f"{part * (at + 1):.2f} s of it succeed least often, {shares[at]:.0%}"
    )
    interval = mapping(found.get(f"{PREFIX}{at}")).get("mean_95")
    if isinstance(interval, list) and len(interval) == 2:
        low, high = (number(end) for end in interval)
        words += "" if low is None or high is None else f" (95% interval {low:.0%} to {high:.0%})"
    return f"{words}."


def sentence(found: Mapping[str, Any], impossible: float) -> str:
    """What was left out, and the shares with it and without."""
    words = (
        f"Grey are starts that cannot be flown, {impossible:.1%} of the clip's: a body that is let go there, as the clip has it and "
        "with no muscle at work, lands more than 0.2 m or 0.7 rad from where the clip does, so no policy can stay with the clip for "
        "long. This is an estimate: policies save some of these, and lose others."
    )
    for name, text in (
        (FLYABLE, "Without those starts {:.0%} of episodes succeed."),
        (ANY, "With no start left out {:.0%} do."),
    ):
        mean = mapping(found.get(name)).get("mean")
        if isinstance(mean, int | float):
            words += " " + text.format(mean)
    return words


def drawn(shares: Sequence[float], impossible: Sequence[float], duration: float) -> str:
    """A staircase over the clip's seconds, before columns of the starts that nobody can follow; both in percent."""
    axes, width = Axes(0.0, 100.0, duration), duration / len(shares)

    def stairs(values: Sequence[float]) -> list[tuple[float, float]]:
        return [(x * width, 100 * y) for i, y in enumerate(values) for x in (i, i + 1)]

    columns = axes.path([(0.0, 0.0), *stairs(impossible), (duration, 0.0)])
    return svg(
        f'<path fill="currentColor" opacity=".15" d="{columns}Z"/>{grid(axes, "the episode begins at, s of the clip; upwards: %")}<path class="line" d="{axes.path(stairs(shares))}"/>',
        "success in percent by where in the clip episodes begin, and the share of starts there that nobody can follow",
    )

"""The result of a run in a sentence, and the figures to remember."""

from __future__ import annotations

from collections.abc import Sequence

from understudy.records.runs import Run
from understudy.setup.registry import Registry
from understudy_report import words
from understudy_report.markup import piece
from understudy_report.section import ReportSection
from understudy_report.values import Row, interval, mapping, number, read_evaluation


class Headline(ReportSection):
    """The result: how many episodes succeeded, what that means, and what it cost."""

    title = ""
    order = 0

    def html(self, run: Run) -> str:
        evaluation, rows = read_evaluation(run), run.metrics()
        meaning = _meaning(run.info, evaluation, run.registry)
        meaning += _unsound(evaluation)
        if changed := words.text(evaluation.get("changed") or ""):
            meaning = f"Judged otherwise than it was trained: {changed}. {meaning}"
        sentence = _sentence(run.info, evaluation, rows)
        return str(piece("headline", sentence, meaning, _tiles(evaluation, rows)))


def percent_interval(evaluation: Row) -> str:
    """The 95 % interval of the success rate in words, or nothing."""
    found = interval(evaluation.get("success_rate_95"))
    return "" if found is None else f"{100 * found[0]:.0f}–{100 * found[1]:.0f} %"


def _meaning(info: Row, evaluation: Row, registry: Registry) -> str:
    """What a success is, in a sentence, and what it does not count; nothing if nothing is a success."""
    text = words.text(evaluation.get("success") or "")
    if not text:
        return ""
    measures = mapping(mapping(info.get("config")).get("measure"))
    name = next((name for name in measures if text.startswith(f"{name} ")), None)
    if name is not None:
        measure = mapping(measures[name])
        about = _about(measure, registry)
        over = _OVER.get(words.text(measure.get("reduce", "")), "{}").format(name)
        text = text.replace(name, f"{over} ({about}) is" if about else f"{over} is", 1)
        return f"An episode succeeds if {text}.{_cut(evaluation)}"
    left = {
        term: share
        for term, value in mapping(evaluation.get("violated")).items()
        if (share := number(value)) and term not in text
    }
    beside = ", ".join(f"{term} in {words.share(share)}" for term, share in left.items())
    also = (
        f" What else was violated meanwhile does not count: {beside} of the episodes."
        if left
        else ""
    )
    return f"An episode succeeds by this: {text}.{also}{_cut(evaluation)}"


def _cut(evaluation: Row) -> str:
    """What ended episodes earlier and is no failure, in a sentence after others."""
    shares = {k: number(v) for k, v in mapping(evaluation.get("cut")).items()}
    ended = ", ".join(f"{words.share(v)} of them by {k}" for k, v in shares.items() if v)
    return (
        f" Some were over earlier, and judged by what there was of them: {ended}." if ended else ""
    )


def _unsound(evaluation: Row) -> str:
    """How many episodes' numbers went wrong, in a sentence after others."""
    share = number(evaluation.get("unsound"))
    return (
        f" In {words.share(share)} of the episodes numbers went wrong, which is never a success."
        if share
        else ""
    )


#: How the values of an episode become one.
_OVER = {
    "min": "the least {} of the episode",
    "max": "the greatest {} of the episode",
    "any": "{} at any moment of the episode",
    "last": "{} at the end of the episode",
    "sum": "the sum of {} over the episode",
    "mean": "the mean {} of the episode",
}


def _about(measure: Row, registry: Registry) -> str:
    """What the measure's component says of itself, if it is installed; of one that is a field as it is, which one."""
    component = registry.components.get(("measure", words.text(measure.get("name", ""))))
    reads = mapping(measure.get("reads"))
    if component is not None and list(reads) == [component.name]:
        return f"the field {words.text(reads[component.name])}"
    return component.summary if component is not None else ""


def _sentence(info: Row, evaluation: Row, rows: Sequence[Row]) -> str:
    samples, seconds = _effort(evaluation, rows)
    rate, episodes = number(evaluation.get("success_rate")), number(evaluation.get("episodes"))
    effort = []
    if samples is not None:
        effort.append(f"{samples:,.0f} samples")
    if seconds is not None:
        effort.append(f"{words.duration(seconds)} of training{_hardware(info)}")
    after = " and ".join(effort)
    if rate is None or episodes is None:
        return f"Not evaluated yet, after {after}." if after else "Nothing has been learned yet."
    length = number(evaluation.get("seconds"))
    of_length = "" if length is None else f" of {length:g} s"
    if length is not None and any(
        number(share) for share in mapping(evaluation.get("cut")).values()
    ):
        mean = number(evaluation.get("mean_episode_seconds"))
        of_length = f" of at most {length:g} s" + (
            "" if mean is None else f" ({mean:.3g} s on average)"
        )
    bounds = percent_interval(evaluation)
    within = f" (95 % interval {bounds})" if bounds else ""
    return (
        f"{words.share(rate)} of {episodes:,.0f} episodes{of_length} succeeded{within}"
        + (f", after {after}" if after else "")
        + "."
    )


def _effort(evaluation: Row, rows: Sequence[Row]) -> tuple[float | None, float | None]:
    """Samples and training seconds behind the evaluated policy, or spent so far."""
    samples = number(evaluation.get("samples"))
    seconds = None
    for row in rows:
        seen = number(row.get("samples"))
        if seen is None or (evaluation and samples is not None and seen > samples):
            continue
        if "seconds" in row:  # not every row is one of an iteration
            seconds = number(row["seconds"])
        if not evaluation:
            samples = seen
    return samples, seconds


def _hardware(info: Row) -> str:
    device = mapping(info.get("config")).get("device", "cpu")
    cores = number(mapping(info.get("machine")).get("cores"))
    if device != "cpu":
        return f" on {words.text(device)}"
    return f" on {cores:.0f} core{'s' if cores > 1 else ''}" if cores else ""


def _tiles(evaluation: Row, rows: Sequence[Row]) -> list[tuple[str, str]]:
    samples, seconds = _effort(evaluation, rows)
    rate, lasted = (number(evaluation.get(k)) for k in ("success_rate", "mean_episode_seconds"))
    objective = mapping(evaluation.get("objective"))
    name, reached = words.text(objective.get("name", "objective")), number(objective.get("value"))
    tiles = [
        ("succeeded", None if rate is None else words.share(rate)),
        (name, None if reached is None or name == "success_rate" else words.short(reached)),
        ("mean episode", None if lasted is None else f"{lasted:.1f} s"),
        ("samples", None if samples is None else words.short(samples)),
        ("training", None if seconds is None else words.duration(seconds)),
    ]
    return [(label, value) for label, value in tiles if value is not None]

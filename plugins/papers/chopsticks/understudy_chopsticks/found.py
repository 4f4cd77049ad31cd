"""What a search over grips has found, style by style, however far it is."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from understudy_gripping.styles import NAMED, written
from understudy_sweeps.journal import Journal
from understudy_sweeps.loops import OuterLoop, Report

#: What a style has learned soon is so much of what its best candidate scores in the end.
SHARE = 0.9
_NAMES = {written(style): name for name, style in NAMED.items()}


def best_of_styles(loop: OuterLoop, journal: Journal) -> Iterator[dict[str, Any]]:
    """A row for each style of the search `loop`, which is told its `journal`; the best first.

    Evaluations that are finished, those whose grip held and so was trained, and of the best one its score, its number
    from 1 on, its trial, places and curve (samples of it alone, score).
    """
    for event in journal.events:
        loop.tell(event) if isinstance(event, Report) else loop.recall(event)
    found: dict[str, list[Mapping[str, Any]]] = {}
    for row in loop.summary():
        found.setdefault(row["search"], []).append(row)
    of_styles = [_of(style, trials, journal) for style, trials in found.items()]
    of_styles.sort(key=lambda row: -(row["score"] or 0.0))
    for rank, row in enumerate(of_styles, 1):
        yield {"of": len(of_styles), "rank": rank, **row}


def grip_file(folder: Path, row: Mapping[str, Any]) -> Path | None:
    """The grip of a style's best trial, which its run in the sweep's `folder` keeps; of a job that was asked for once
    more the later one."""
    style, _, number = str(row["trial"]).rpartition("-")
    names = (
        f"round{number}-*/inputs/*/s{style}.json",
        f"{row['trial']}/inputs/*/grip.json",
    )
    return next((path for name in names for path in sorted(folder.glob(name), reverse=True)), None)


def _of(style: str, trials: Sequence[Mapping[str, Any]], journal: Journal) -> dict[str, Any]:
    done = [row for row in trials if row["status"] != "running"]
    held = [row for row in done if row["y"] is not None]
    best = max(held, key=lambda row: row["y"], default=None)
    curve = [] if best is None else _curve(style, best, journal)
    return {
        "style": style,
        "name": _NAMES.get(style, ""),
        "evaluations": len(done),
        "held": len(held),
        "score": best and best["y"],
        "evaluation": best and int(str(best["trial"]).rpartition("-")[2]) + 1,
        "first": next((row["y"] for row in held), None),
        "trial": best and best["trial"],
        "places": best and {k.rpartition(".")[2]: v for k, v in best.items() if k.startswith("grip.")},
        "samples": sum(row["samples"] for row in done),
        "learned": next((x for x, y in curve if best and y >= SHARE * best["y"]), None),
        "curve": curve,
    }  # fmt: skip


def _curve(style: str, best: Mapping[str, Any], journal: Journal) -> list[list[float]]:
    """Samples of this candidate alone and its score, by the evaluations of its training."""
    points = []
    for event in journal.events:
        if not isinstance(event, Report) or event.key != best.get("job", best["trial"]):
            continue
        scores = [v for k, v in event.measures.items() if k.startswith("score_s")]
        share = max(1, sum(map(math.isfinite, scores)))  # those that hold have the samples together
        score = event.measures.get(f"score_s{style}", event.objective)
        if not event.final and score is not None and math.isfinite(score):
            points.append([event.cost / share, round(score, 5)])
    return points

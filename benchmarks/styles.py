"""Grips of all styles, searched for: how well each style's best one is learned, and how soon (thesis, figure 5.20).

``python benchmarks/styles.py FOLDER …`` reads folders of ``search=chopsticks/grips``, one a seed, however far they are, and puts a
row for each style and seed into ``docs/benchmarks/chopsticks_styles.jsonl`` in place of what was there of that seed. ``--grips FOLDER``
keeps the best grip of each style there, as ``STYLE.json``, for ``grip.file=…``.
"""

from __future__ import annotations

import argparse
import datetime
import json
import math
import shutil
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from understudy.setup.plugins import installed
from understudy.setup.validation import validate
from understudy_gripping.styles import NAMED, written
from understudy_sweeps.journal import Journal
from understudy_sweeps.loops import Report

RESULTS = Path(__file__).parents[1] / "docs" / "benchmarks" / "chopsticks_styles.jsonl"
#: What a style has learned soon is so much of what its best candidate scores in the end.
SHARE = 0.9
_NAMES = {written(style): name for name, style in NAMED.items()}


def rows(folder: Path) -> Iterator[dict[str, Any]]:
    """Of one search, a row for each style, the best first."""
    journal = Journal.read(folder / "journal.jsonl")
    compared = json.loads((folder / "sweep.json").read_text())["compared"]
    chosen = validate({"outer_loop": compared["outer_loop"]}, installed().registry)
    loop = chosen.need("outer_loop").build(compared["seed"])
    for event in journal.events:
        loop.tell(event) if isinstance(event, Report) else loop.recall(event)
    found: dict[str, list[Mapping[str, Any]]] = {}
    for row in loop.summary():
        found.setdefault(row["search"], []).append(row)
    of_styles = [_of(style, trials, journal) for style, trials in found.items()]
    of_styles.sort(key=lambda row: -(row["score"] or 0.0))
    for rank, row in enumerate(of_styles, 1):
        yield {"seed": compared["seed"], "of": len(of_styles), "rank": rank, **row}


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


def keep_grip(folder: Path, row: Mapping[str, Any], place: Path) -> None:
    """The grip of a style's best trial, which its run keeps."""
    trial = str(row["trial"])
    style, _, number = trial.rpartition("-")
    names = (f"round{number}-*/inputs/*/s{style}.json", f"{trial}/inputs/*/grip.json")
    for path in [p for name in names for p in folder.glob(name)][:1]:
        place.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, place / f"{style}.json")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)  # fmt: skip
    parser.add_argument("folders", nargs="+", type=Path, metavar="FOLDER")
    parser.add_argument("--machine", default="", help="what it was searched on")
    parser.add_argument("--out", type=Path, default=RESULTS)
    parser.add_argument("--grips", type=Path, help="of the first folder, each style's best grip")
    given = parser.parse_args()
    lines = given.out.read_text().splitlines() if given.out.exists() else []
    kept = [json.loads(line) for line in lines]
    for folder in given.folders:
        made = list(rows(folder))
        kept = [row for row in kept if row["seed"] != made[0]["seed"]]
        about = {"when": datetime.date.today().isoformat(), "machine": given.machine}
        kept += [{**about, **row} for row in made]
        for row in made:
            score = "–" if row["score"] is None else f"{row['score']:.3f}"
            soon = "–" if row["learned"] is None else f"{row['learned'] / 1e6:.3g} M"
            print(
                f"seed {row['seed']}  {row['rank']:>2}  {row['style']} {row['name']:<16} {score}  {SHARE:.0%} of it "
                f"after {soon}  held {row['held']} of {row['evaluations']}"
            )
            if given.grips and folder == given.folders[0] and row["trial"]:
                keep_grip(folder, row, given.grips)
    given.out.write_text("".join(json.dumps(row) + "\n" for row in kept))


if __name__ == "__main__":
    main()

"""Grips of all styles, searched for: how well each style's best one is learned, and how soon (thesis, figure 5.20).

``python benchmarks/styles.py FOLDER …`` reads folders of ``search=chopsticks/grips``, one a seed, however far they are, and puts a
row for each style and seed into ``docs/benchmarks/chopsticks_styles.jsonl`` in place of what was there of that seed. ``--grips FOLDER``
keeps the best grip of each style there, as ``STYLE.json``, for ``grip.file=…``; ``--gallery`` writes the page that a finished search
writes, ``gallery.html`` in each folder, of what there is.
"""

from __future__ import annotations

import argparse
import datetime
import json
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from understudy.setup.composition import load_experiment
from understudy.setup.plugins import installed
from understudy.setup.validation import validate
from understudy_chopsticks.found import SHARE, best_of_styles, grip_file
from understudy_chopsticks.gallery import Gallery
from understudy_sweeps.journal import Journal

RESULTS = Path(__file__).parents[1] / "docs" / "benchmarks" / "chopsticks_styles.jsonl"


def rows(folder: Path) -> Iterator[dict[str, Any]]:
    """Of one search, a row for each style, the best first."""
    journal = Journal.read(folder / "journal.jsonl")
    compared = json.loads((folder / "sweep.json").read_text())["compared"]
    chosen = validate({"outer_loop": compared["outer_loop"]}, installed().registry)
    loop = chosen.need("outer_loop").build(compared["seed"])
    for row in best_of_styles(loop, journal):
        yield {"seed": compared["seed"], **row, **_failures(row["style"], folder)}


def _failures(style: str, folder: Path) -> dict[str, int]:
    """How many candidates had no pose, and how many let the sticks fall, as their runs say; a job that never began kept nothing."""
    said = [json.loads(path.read_text()) for path in folder.glob("round*/inputs/*/against.txt")]
    against = [one[f"s{style}"] for one in said if f"s{style}" in one]
    poses = sum("has no pose" in why for why in against)
    return {"no_pose": poses, "falls": len(against) - poses}


def with_known(row: dict[str, Any], known: Mapping[str, Any]) -> dict[str, Any]:
    """A style's `row` whose failures are those of the rounds whose folders are here, with those of the other rounds as `known` has
    them, a row of the same search before it went on somewhere else."""
    names = ("no_pose", "falls")
    before, here = (sum(one[name] for name in names) for one in (known, row))
    failed = row["evaluations"] - row["held"]
    if failed == before:  # nothing is new
        return {**row, **{name: known[name] for name in names}}
    if failed == before + here:
        return {**row, **{name: known[name] + row[name] for name in names}}
    return row


def keep_grip(folder: Path, row: Mapping[str, Any], place: Path) -> None:
    """The grip of a style's best trial, which its run keeps."""
    if (path := grip_file(folder, row)) is not None:
        place.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, place / f"{row['style']}.json")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)  # fmt: skip
    parser.add_argument("folders", nargs="+", type=Path, metavar="FOLDER")
    parser.add_argument("--machine", default="", help="what it was searched on")
    parser.add_argument("--out", type=Path, default=RESULTS)
    parser.add_argument("--grips", type=Path, help="of the first folder, each style's best grip")
    parser.add_argument("--gallery", action="store_true", help="a card for each style")
    given = parser.parse_args()
    lines = given.out.read_text().splitlines() if given.out.exists() else []
    kept = [json.loads(line) for line in lines]
    for folder in given.folders:
        made = list(rows(folder))
        known = {row["style"]: row for row in kept if row["seed"] == made[0]["seed"]}
        made = [with_known(row, known.get(row["style"], row)) for row in made]
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
        if given.gallery:
            words = json.loads((folder / "sweep.json").read_text())["given"]
            experiment = load_experiment(words, installed())
            journal = Journal.read(folder / "journal.jsonl")
            print(Gallery().write(folder, "chopsticks/grips", experiment, journal))
    given.out.write_text("".join(json.dumps(row) + "\n" for row in kept))


if __name__ == "__main__":
    main()

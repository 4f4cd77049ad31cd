"""What searches answer, trained anew from nothing: equation 6.5 does not count the samples that a trial's policy inherited.

``python benchmarks/answers.py runs/toy --table cmfbo/toy --row jumper`` takes the best whole trial of every search in the folder of a
``understudy reproduce``, trains its point from nothing with other seeds, and appends a line each to
``docs/benchmarks/answers.jsonl``: the y that the search reported, and the y that the point has by itself.
What is there is not trained again.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
import time
from pathlib import Path
from typing import Any

import torch
from rows import append

from understudy.setup.composition import load_experiment
from understudy.setup.plugins import installed
from understudy_bayes.fidelity import Fidelity
from understudy_reproduce.comparison import Comparison
from understudy_reproduce.tables import load_table
from understudy_sweeps.journal import Journal
from understudy_sweeps.loops import Trial, Work
from understudy_sweeps.trial import run_trial

RESULTS = Path(__file__).parents[1] / "docs" / "benchmarks" / "answers.jsonl"


def answer(folder: Path, fidelity: Fidelity, scale: float) -> tuple[Trial, float] | None:
    """The whole trial of the highest y in the journal of `folder`, and that y."""
    journal: Any = Journal.read(folder / "journal.jsonl")
    asked = {event.key: event for event in journal.events if isinstance(event, Trial)}
    found = [
        (asked[key], (report.objective or 0.0) * math.exp(-report.cost / scale))
        for key, report in journal.finished.items()
        if report is not None and report.status == "ok" and fidelity.z(asked[key]) >= 1
    ]
    return max(found, key=lambda pair: pair[1], default=None)


def anew(
    trial: Trial, fidelity: Fidelity, seed: int, words: list[str], scale: float
) -> dict[str, Any]:
    """What the point of `trial` comes to from nothing, as a whole trial."""
    own = {name: value for name, value in trial.point.items() if name != fidelity.option}
    with tempfile.TemporaryDirectory() as folder:
        report: Any
        *_, report = run_trial(Trial("anew", point=own, seed=seed), Work(tuple(words), folder))
    if report.status != "ok":
        raise RuntimeError(report.status)
    value = (report.objective or 0.0) * math.exp(-report.cost / scale)
    return {"samples": report.cost, "objective": report.objective, "y": value}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("folder", type=Path, help="of the reproduction")
    parser.add_argument("--table", default="cmfbo/toy")
    parser.add_argument("--row", default="jumper")
    parser.add_argument("--seeds", nargs="+", type=int, default=[101, 102, 103])
    given = parser.parse_args()
    torch.set_num_threads(1)
    table = load_table(given.table, installed())
    lines = RESULTS.read_text(encoding="utf-8").splitlines() if RESULTS.exists() else []
    known = {
        tuple(json.loads(line)[k] for k in ("table", "column", "search", "seed")) for line in lines
    }
    comparison = Comparison(given.table, table, given.folder, [])
    for column in table.columns:
        for search in table.seeds:
            words = comparison.overrides_of(given.row, column, search)
            loop = load_experiment(words, installed()).need("outer_loop").effective()
            fidelity, scale = (
                Fidelity(**(loop.get("fidelity") or {})),
                float(loop["sample_scale"] or math.inf),
            )
            if (
                best := answer(comparison.place_of(given.row, column, search), fidelity, scale)
            ) is None:
                continue
            for seed in given.seeds:
                if (given.table, column, search, seed) in known:
                    continue
                kept = [w for w in words if not w.startswith(("outer_loop", "run.dir", "seed="))]
                row = {
                    "when": time.strftime("%Y-%m-%d"), "table": given.table, "column": column, "search": search,
                    "reported": best[1], "seed": seed, **anew(best[0], fidelity, seed, kept, scale),
                }  # fmt: skip
                append(RESULTS, row)
    rows = [json.loads(line) for line in RESULTS.read_text(encoding="utf-8").splitlines()]
    groups: dict[tuple[str, str, int], list[dict[str, Any]]] = {}
    for row in rows:
        groups.setdefault((row["table"], row["column"], row["search"]), []).append(row)
    means = [
        {"table": t, "column": c, "seed": s, "when": of[-1]["when"], "trainings": len(of), "y": sum(r["y"] for r in of) / len(of)}
        for (t, c, s), of in groups.items()
    ]  # fmt: skip
    text = "".join(json.dumps(row) + "\n" for row in means)
    RESULTS.with_name("answers_means.jsonl").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()

"""Poison every field of every shipped experiment, and say how many there were: ``make poison``."""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "faults"))

import torch
from miniatures import make_stages
from test_01_poisoned_fields import EXPERIMENTS, VALUES, Outcome, poisoned

from understudy.errors import UnderstudyError


def outcome(name: str, runs: Path) -> Outcome | str:
    """Of all poisons of an experiment, or why it cannot be tried."""
    torch.set_num_threads(1)
    try:
        return poisoned(name, runs)
    except UnderstudyError as error:
        return str(error).splitlines()[0]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--jobs", type=int, default=1, help="experiments at once")
    parser.add_argument(
        "names", nargs="*", help="those whose names begin so; all if there are none"
    )
    chosen = parser.parse_args()
    names = [e for e in EXPERIMENTS if e.startswith(tuple(chosen.names) or "")]
    begin, tried, alone = time.monotonic(), dict[str, Outcome](), list[str]()
    fresh = multiprocessing.get_context("spawn")
    with (
        tempfile.TemporaryDirectory() as folder,
        ProcessPoolExecutor(chosen.jobs, mp_context=fresh) as pool,
    ):
        runs = make_stages(Path(folder))
        under_way = {pool.submit(outcome, name, runs): name for name in names}
        for done in as_completed(under_way):
            name, found = under_way[done], done.result()
            if isinstance(found, str):
                alone.append(name)
                print(f"{name}: not tried. {found}", flush=True)
                continue
            tried[name] = found
            print(
                f"{name}: {found.tried // len(VALUES)} fields, {found.tried} poisons, "
                f"{found.failed} worlds failed, {len(found.escaped)} escapes",
                *found.escaped, sep="\n  ", flush=True,
            )  # fmt: skip
    poisons = sum(found.tried for found in tried.values())
    escapes = sum(len(found.escaped) for found in tried.values())
    print(
        f"{len(tried)} of {len(names)} experiments, {poisons // len(VALUES)} fields, {poisons} poisons, "
        f"{sum(found.failed for found in tried.values())} worlds failed, {escapes} escapes; "
        f"{time.monotonic() - begin:.0f} s"
    )
    return int(escapes > 0 or not tried)


if __name__ == "__main__":
    sys.exit(main())

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
from stages import make_all_stages
from test_01_poisoned_fields import EXPERIMENTS, VALUES, Outcome, poisoned

from understudy.errors import UnderstudyError

#: What takes longest, to begin with.
SLOW = ("dressing/", "amorphous/", "chopsticks/")


def outcome(name: str, value: str, runs: Path, until: float) -> Outcome | str:
    """Of an experiment's poisons by one value, or why they are not tried; none are begun after `until`, by the monotonic
    clock."""
    torch.set_num_threads(1)
    if time.monotonic() > until:
        return "There is no time left."
    try:
        return poisoned(name, runs, values=(value,))
    except UnderstudyError as error:
        return str(error).splitlines()[0]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--jobs", type=int, default=1, help="experiments at once")
    parser.add_argument(
        "--runs", type=Path, help="where the runs that others build on are, or are made"
    )
    parser.add_argument("--seconds", type=float, default=1e9, help="begin none after so long")
    parser.add_argument(
        "names", nargs="*", help="those whose names begin so; all if there are none"
    )
    chosen = parser.parse_args()
    names = [e for e in EXPERIMENTS if e.startswith(tuple(chosen.names) or "")]
    names.sort(key=lambda name: not name.startswith(SLOW))
    begin, tried = time.monotonic(), dict[str, Outcome]()
    fresh = multiprocessing.get_context("spawn")
    with (
        tempfile.TemporaryDirectory() as folder,
        ProcessPoolExecutor(chosen.jobs, mp_context=fresh) as pool,
    ):
        runs = chosen.runs or Path(folder)
        if not (chosen.runs and chosen.runs.is_dir()):
            runs.mkdir(exist_ok=True)
            make_all_stages(runs)
        print(f"stages made in {time.monotonic() - begin:.0f} s", flush=True)
        until = begin + chosen.seconds
        under_way = {
            pool.submit(outcome, name, value, runs, until): name
            for name in names
            for value in VALUES
        }
        parts = {name: list[Outcome | str]() for name in names}
        for done in as_completed(under_way):
            name = under_way[done]
            parts[name].append(done.result())
            if len(parts[name]) < len(VALUES):
                continue
            whole = [part for part in parts[name] if isinstance(part, Outcome)]
            if len(whole) < len(VALUES):
                why = next(part for part in parts[name] if isinstance(part, str))
                print(f"{name}: not tried. {why}", flush=True)
                continue
            found = tried[name] = Outcome(
                sum(part.tried for part in whole),
                sum(part.failed for part in whole),
                tuple(escape for part in whole for escape in part.escaped),
            )
            print(
                f"{name}: {found.tried // len(VALUES)} fields, {found.tried} poisons, "
                f"{found.failed} worlds failed, {len(found.escaped)} escapes; at {time.monotonic() - begin:.0f} s",
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

"""What trainings make together on one GPU, in turns and under CUDA's Multi-Process Service (MPS).

Starts as many trainings at once as ``--together`` says, each for ``--minutes``, and adds up the samples a
second of their second halves. With ``--mps`` once as they are and once under a service of its own, which
ends with this program. What is left of the command line are the trainings' overrides. Prints a table and
appends it, with the hardware, to ``docs/benchmarks/sharing.jsonl``::

    python benchmarks/sharing.py --mps --together 1 2 4 -- experiment=deepmimic/walk_gpu
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import torch
from rows import append

from understudy.records.runs import versions

RESULTS = Path(__file__).resolve().parents[1] / "docs" / "benchmarks" / "sharing.jsonl"
#: Nothing but training, for as long as they are given.
ALONE = (
    "evaluation.criterion=null", "evaluation.every_samples=1000000000", "evaluation.final_episodes=1",
    "evaluation.seconds=0.1", "run.video_seconds=0", "budget.samples=null",
)  # fmt: skip


@contextlib.contextmanager
def service() -> Iterator[dict[str, str]]:
    """An MPS of this program's own: the environment of those that use it."""
    with tempfile.TemporaryDirectory() as folder:
        environment = {"CUDA_MPS_PIPE_DIRECTORY": folder, "CUDA_MPS_LOG_DIRECTORY": folder}
        control = ["nvidia-cuda-mps-control"]
        subprocess.run([*control, "-d"], env=os.environ | environment, check=True)
        try:
            yield environment
        finally:
            subprocess.run(control, env=os.environ | environment, input=b"quit\n", check=False)


def together(count: int, minutes: float, overrides: list[str], more: dict[str, str]) -> float:
    """Samples a second of `count` trainings, in the second half of their time."""
    with tempfile.TemporaryDirectory() as folder:
        own = [*ALONE, f"budget.minutes={minutes}", *overrides]
        command = [sys.executable, "-m", "understudy", "train", *own]
        trainings = [
            subprocess.Popen(
                [*command, f"seed={seed}", f"run.dir={folder}/{seed}"],
                env=os.environ | more, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            )
            for seed in range(count)
        ]  # fmt: skip
        if any([training.wait() for training in trainings]):
            raise SystemExit(f"A training failed: understudy train {' '.join(own)}")
        return sum(rate(Path(folder) / str(seed) / "metrics.jsonl") for seed in range(count))


def rate(metrics: Path) -> float:
    """Samples a second from the middle of the training's time on."""
    rows = [json.loads(line) for line in metrics.read_text().splitlines()]
    last = rows[-1]
    middle = next(row for row in rows if row["seconds"] >= last["seconds"] / 2)
    return (last["samples"] - middle["samples"]) / (last["seconds"] - middle["seconds"])


def main() -> None:
    parser = argparse.ArgumentParser(description="Samples a second of trainings side by side.")
    parser.add_argument("--together", type=int, nargs="+", default=[1, 2, 4])
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--mps", action="store_true", help="also under a Multi-Process Service")
    parser.add_argument("overrides", nargs="*")
    options = parser.parse_args()
    found: list[dict[str, float | str]] = []
    for mps in (False, True) if options.mps else (False,):
        with service() if mps else contextlib.nullcontext({}) as environment:
            for count in options.together:
                made = together(count, options.minutes, options.overrides, environment)
                sharing = "under MPS" if mps else "in turns"
                found.append({"together": count, "sharing": sharing, "samples_per_second": made})
                ratio = made / float(found[0]["samples_per_second"])
                print(
                    f"{count} {sharing:10} {made:10.0f} samples/s   {ratio:.2f} × the first",
                    flush=True,
                )
    gpu = torch.cuda.is_available()
    machine = {
        "when": time.strftime("%Y-%m-%d"), "gpu": torch.cuda.get_device_name(0) if gpu else None,
        "cores": os.cpu_count(), "versions": versions(), "overrides": options.overrides,
        "minutes": options.minutes, "found": found,
    }  # fmt: skip
    append(RESULTS, machine)


if __name__ == "__main__":
    main()

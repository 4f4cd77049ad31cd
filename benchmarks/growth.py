"""Does anything grow or slow down, of what runs for long?

``walk``: a training of the walk, best on a GPU, watched from within after its iterations; evaluations and
checkpoints come in between, and their time is not speed's. ``sweep``: a sweep of short trials in one process.
``play``: the page of a skill with many websockets, of which every tenth reads nothing and every tenth comes and goes.
The latter two are watched from beside, in ``/proc``.

Prints one line of JSON and appends it to ``--out``. Of all that is held (MB, threads, descriptors) and of speed it has the mean,
the least-squares slope an hour and by how much of the mean the line rises over what is counted, with the 95 % intervals
of least squares, which take measurements as independent; and of speed the last quarter over the first. The first
quarter of the time warms up and is not counted. Speed is samples a second (walk), trials a second of processor time
(sweep), kilobytes a second to a visitor who reads (play, which says something where nothing else runs). Ends with 1 if
memory, threads or descriptors rise by more than 5 % and more than least squares leave open, or the last quarter is
slower than the first by more than 5 %::

    python benchmarks/growth.py walk --minutes 9
    python benchmarks/growth.py sweep --trials 200
    python benchmarks/growth.py play --clients 50 --minutes 5
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import itertools
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import understudy_mujoco  # isort: skip  # noqa: F401 - before torch, to tell its threads how to wait
import numpy as np
import torch
from rows import append
from scipy import stats

from understudy.records import runs
from understudy.running.training import Training
from understudy.setup.composition import load_experiment
from understudy_reinforcement.job import Reinforcement
from understudy_viewer.page import free_port

ROOT = Path(__file__).resolve().parents[1]
LIMIT = 0.05
SPEED = "speed"
#: What only describes: what was reserved of a GPU's memory stands in what is used of it.
TOLD = ("seconds", "gpu_allocated_mb", "kilobytes_per_processor_second")
WALK = (
    "experiment=spacetime/walk", "resolution.substeps=null", "evaluation.criterion=null", "evaluation.gate=0",
    "evaluation.seconds=4", "checkpoint.minutes=0.5", "budget.samples=null", "seed=1",
)  # fmt: skip
#: Two iterations and an evaluation.
TRIAL = (
    "experiment=miniature/stop", "outer_loop=grid", "num_worlds=16", "learner.rollout_steps=8", "budget.samples=256",
    "evaluation.every_samples=256", "evaluation.objective=slow", "evaluation.gate=0", "evaluation.episodes=8",
    "evaluation.final_episodes=8", "evaluation.seconds=1.0", "checkpoint.minutes=0",
)  # fmt: skip


def held(process: int) -> dict[str, float]:
    """What `process` holds now, and how many processes it began."""
    folder = Path("/proc") / str(process)
    status = dict(line.split(":", 1) for line in (folder / "status").read_text().splitlines())
    children = (folder / "task" / str(process) / "children").read_text().split()
    return {
        "memory_mb": int(status["VmRSS"].split()[0]) / 1024,
        "threads": int(status["Threads"]),
        "descriptors": len(os.listdir(folder / "fd")),
        "children": len(children),
    }


def processor_seconds(process: int) -> float:
    """Of `process` and of those of its children that ended."""
    fields = (Path("/proc") / str(process) / "stat").read_text().rpartition(")")[2].split()
    return sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")


def on_gpu() -> dict[str, float]:
    if not torch.cuda.is_available():
        return {}
    free, total = torch.cuda.mem_get_info()
    return {
        "gpu_used_mb": (total - free) / 2**20,  # of all that use it, Warp too
        "gpu_allocated_mb": torch.cuda.memory_allocated() / 2**20,
    }


def trend(seconds: np.ndarray, values: np.ndarray) -> dict[str, Any]:
    """Mean; slope an hour and the line's rise over `seconds` as a share of the mean, with 95 % intervals; and the last
    quarter over the first."""
    fit: Any = stats.linregress(seconds, values)
    quarter = max(len(values) // 4, 1)
    error = 0.0 if np.ptp(values) == 0 else float(fit.stderr)  # else 0 / 0
    half = float(stats.t.ppf(0.975, len(values) - 2)) * error
    slope, mean = float(fit.slope), float(values.mean())
    share = (seconds[-1] - seconds[0]) / mean if mean else 0.0
    return {
        "mean": round(mean, 3),
        "per_hour": round(slope * 3600, 4),
        "per_hour_95": [round((slope - half) * 3600, 4), round((slope + half) * 3600, 4)],
        "rise": round(slope * share, 5),
        "rise_95": [round((slope - half) * share, 5), round((slope + half) * share, 5)],
        "last_to_first_quarter": round(
            float(values[-quarter:].mean() / values[:quarter].mean()) if mean else 1.0, 5
        ),
    }  # fmt: skip


def counted(table: Sequence[dict[str, float]]) -> dict[str, dict[str, Any]]:
    """The trends of all columns, the first quarter of the time left out."""
    first, last = table[0]["seconds"], table[-1]["seconds"]
    kept = [row for row in table if row["seconds"] >= first + (last - first) / 4]
    if len(kept) < 8:
        raise SystemExit(f"{len(kept)} measurements are too few: let it run for longer.")
    seconds = np.array([row["seconds"] for row in kept])
    names = [name for name in kept[0] if name != "seconds"]
    return {name: trend(seconds, np.array([row[name] for row in kept])) for name in names}


def beyond(found: dict[str, dict[str, Any]]) -> list[str]:
    """What is not as it must be."""
    held_on = (name for name in found if name not in (SPEED, *TOLD))
    grown = [n for n in held_on if found[n]["rise"] > LIMIT and found[n]["rise_95"][0] > 0]
    slower = found[SPEED]["last_to_first_quarter"] < 1 - LIMIT
    return [*grown, *([SPEED] if slower else [])]


def walk(options: argparse.Namespace) -> dict[str, Any]:
    gpu = torch.cuda.is_available()
    worlds = options.worlds or (16384 if gpu else 64)
    fixed = [f"num_worlds={worlds}", f"evaluation.every_samples={options.evaluate_every or worlds * 500}"]  # fmt: skip
    fixed += ["device=cuda", "simulator=mujoco_warp"] if gpu else ["simulator.threads=1"]
    table: list[dict[str, float]] = []
    with tempfile.TemporaryDirectory() as folder:
        overrides = (*WALK, *fixed, f"run.dir={folder}/run", *options.overrides)
        experiment = load_experiment([*overrides, f"budget.minutes={10 * options.minutes}"])
        training = Training(experiment).prepare()
        training.attach(runs.create(experiment, overrides, training.job.sources()))
        began = measured = time.monotonic()
        before = evaluations = 0
        spent = 0.0
        for row in training.rows():
            now = time.monotonic()
            evaluations += any(name.startswith("evaluation/") for name in row)
            if now - measured >= options.every:
                speed = (row["samples"] - before) / (row["seconds"] - spent)
                own = held(os.getpid()) | on_gpu()
                table.append({"seconds": now - began, **own, SPEED: speed})
                before, spent, measured = row["samples"], row["seconds"], now
            if now - began >= 60 * options.minutes:
                break
        job = training.job
        assert isinstance(job, Reinforcement)
        captured = job.environment.captured_step.on
        unsound, samples = int(job.environment.quarantined), training.progress.samples
        training.close()
    return {
        "worlds": worlds, "samples": samples, "evaluations": evaluations, "unsound_worlds": unsound,
        "step_captured": captured, "watched": counted(table), "measurements": len(table),
    }  # fmt: skip


def watching(process: int, every: float, minutes: float) -> Iterator[dict[str, float]]:
    """What `process` holds, now and then, until it ends or the time is over."""
    began = time.monotonic()
    for number in itertools.count(1):
        time.sleep(max(0.0, began + number * every - time.monotonic()))
        try:
            row = {"seconds": time.monotonic() - began, **held(process)}
            row["processor"] = processor_seconds(process)
        except (OSError, KeyError):  # it ended: a zombie holds nothing
            return
        yield row
        if row["seconds"] >= 60 * minutes:
            return


def sweep(options: argparse.Namespace) -> dict[str, Any]:
    table: list[dict[str, float]] = []
    with tempfile.TemporaryDirectory() as folder:
        seeds = f"outer_loop.seeds=[{','.join(map(str, range(1, options.trials + 1)))}]"
        place = Path(folder) / "sweep"
        command = [sys.executable, "-m", "understudy", "sweep", *TRIAL, seeds, f"executor={options.executor}"]  # fmt: skip
        process = subprocess.Popen(
            [*command, f"run.dir={place}", *options.overrides],
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
            env={**os.environ, "OMP_NUM_THREADS": "1"},
        )  # fmt: skip
        ended, processor = 0, 0.0
        for row in watching(process.pid, options.every, 600.0):
            now = row.pop("processor")
            journal = place / "journal.jsonl"
            count = journal.read_text().count('"finished"') if journal.exists() else 0
            if count == ended or count == options.trials:  # the page is made in the end
                continue
            table.append({**row, SPEED: (count - ended) / (now - processor)})
            ended, processor = count, now
        _, errors = process.communicate()
        if process.returncode:
            raise SystemExit(f"The sweep ended with {process.returncode}: {errors[-500:]}")
        count = (place / "journal.jsonl").read_text().count('"finished"')
    return {
        "trials": count, "executor": options.executor, "measurements": len(table),
        "watched": counted(table[1:]),  # the first has the imports
    }  # fmt: skip


class Visitors:
    """`count` websockets at a page of viser, in a thread of their own."""

    def __init__(self, url: str, count: int) -> None:
        self.read = [0] * count  #: bytes, by visitor
        self.refused = 0
        self._url, self._ended = url, False
        self._thread = threading.Thread(target=lambda: asyncio.run(self._all(count)), daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._ended = True
        self._thread.join()

    async def _all(self, count: int) -> None:
        await asyncio.gather(*(self._visit(number) for number in range(count)))

    async def _visit(self, number: int) -> None:
        import viser
        from websockets.asyncio.client import connect
        from websockets.exceptions import WebSocketException
        from websockets.typing import Origin, Subprotocol

        kind = number % 10
        while not self._ended:
            try:
                async with connect(
                    self._url.replace("http", "ws"), origin=Origin(self._url), max_size=None,
                    subprotocols=[Subprotocol(f"viser-v{viser.__version__}")], compression=None, ping_interval=None,
                ) as talk:  # fmt: skip
                    stay = time.monotonic() + (3.0 + number / 10 if kind == 1 else 1e9)
                    while not self._ended and time.monotonic() < stay:
                        if kind == 0:  # reads nothing, until the page has enough of it
                            with contextlib.suppress(TimeoutError):
                                await asyncio.wait_for(talk.wait_closed(), timeout=1.0)
                                break
                            continue
                        self.read[number] += len(await asyncio.wait_for(talk.recv(), timeout=30.0))
            except (OSError, TimeoutError, WebSocketException):
                self.refused += 1
                await asyncio.sleep(1.0)


def play(options: argparse.Namespace) -> dict[str, Any]:
    port = free_port("127.0.0.1", 8900)
    process = subprocess.Popen(
        [sys.executable, "-m", "understudy", "play", options.skill, "--port", str(port), "--no-browser"],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1", "PYTHONUNBUFFERED": "1"},
    )  # fmt: skip
    table: list[dict[str, float]] = []
    try:
        assert process.stdout is not None
        told = ""
        while "http://" not in told:
            if not (line := process.stdout.readline()):
                raise SystemExit(f"The page does not begin: {told}")
            told += line
        visitors = Visitors(f"http://127.0.0.1:{port}", options.clients)
        before, processor, at = 0.0, processor_seconds(process.pid), 0.0
        for row in watching(process.pid, options.every, options.minutes):
            now = row.pop("processor")
            read = sum(n for i, n in enumerate(visitors.read) if i % 10 > 1) / 1024
            readers = sum(i % 10 > 1 for i in range(options.clients))
            speed = (read - before) / readers / (row["seconds"] - at)
            share = (read - before) / max(now - processor, 1e-3)
            table.append({**row, SPEED: speed, "kilobytes_per_processor_second": share})
            before, processor, at = read, now, row["seconds"]
        if process.poll() is not None:
            raise SystemExit(
                f"The page ended with {process.returncode}: {process.communicate()[0]}"
            )
        visitors.close()
        time.sleep(5.0)
        after = held(process.pid)
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=60)
    return {
        "clients": options.clients, "skill": options.skill, "measurements": len(table), "status": process.returncode,
        "lost_or_refused": visitors.refused, "when_all_left": after, "watched": counted(table),
    }  # fmt: skip


def machine() -> dict[str, Any]:
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    name = next((x.partition(": ")[2] for x in lines if x.startswith("model name")), "unknown")
    gpu = {"gpu": torch.cuda.get_device_name()} if torch.cuda.is_available() else {}
    return {
        "when": time.strftime("%Y-%m-%d"), "processor": name, "cores": os.cpu_count(), **gpu, "versions": runs.versions(),
    }  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("what", choices=("walk", "sweep", "play"))
    parser.add_argument("--minutes", type=float, default=9.0, help="walk, play (%(default)s)")
    parser.add_argument("--every", type=float, default=5.0, help="seconds between measurements")
    parser.add_argument("--worlds", type=int, help="16384 on a GPU, else 64")
    parser.add_argument("--evaluate-every", type=int, help="samples; else 500 a world")
    parser.add_argument("--trials", type=int, default=200)
    parser.add_argument("--executor", default="in_process")
    parser.add_argument("--clients", type=int, default=50)
    parser.add_argument("--skill", default="spacetime/walk")
    parser.add_argument("--out", type=Path)
    options, options.overrides = parser.parse_known_args(arguments)
    found = {"walk": walk, "sweep": sweep, "play": play}[options.what](options)
    record = {"what": options.what, **machine(), "minutes": options.minutes, **found}
    record["beyond"] = beyond(found["watched"])
    print(json.dumps(record))
    if options.out:
        append(options.out, record)
    return int(bool(record["beyond"]))


if __name__ == "__main__":
    sys.exit(main())

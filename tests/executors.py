"""What every executor keeps, as checks of a small real training; and ways to be cruel to it."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from commands import serve
from worlds import assert_same_state

from understudy.records import checkpoint, runs
from understudy.setup.composition import load_experiment
from understudy_sweeps.loops import Executor, Report, Trial, Work
from understudy_sweeps.trial import folder_of, note_stop

#: Five iterations of 128 samples, evaluated after 256 and 512 and in the end.
SMALL_STOP = (
    "experiment=miniature/stop",
    "num_worlds=16",
    "learner.rollout_steps=8",
    "budget.samples=640",
    "evaluation.every_samples=256",
    "evaluation.objective=slow",
    "evaluation.gate=0",
    "evaluation.episodes=8",
    "evaluation.final_episodes=8",
    "evaluation.seconds=1.0",
    "checkpoint.minutes=0",
)
#: Never ends by itself.
ENDLESS = ("budget.samples=1000000000", "evaluation.every_samples=1000000000")
TRIALS = (Trial("a", seed=1), Trial("b", ("policy.hidden=[8]",), seed=2), Trial("c", seed=3))

Make = Callable[..., Executor]


def work(folder: Path, *overrides: str) -> Work:
    return Work((*SMALL_STOP, *overrides), str(folder))


def make(name: str, given: Work, **options: Any) -> Executor:
    """The executor `name` with `options`."""
    if name == "processes":
        serve()  # whose forks begin sooner than those of a sweep's own
    words = [f"executor.{key}={value}" for key, value in options.items()]
    return load_experiment([f"executor={name}", *words]).need("executor").build(given)


def carry_out(
    executor: Executor,
    trials: Sequence[Trial],
    stopped: Collection[str] = (),
    given: Work | None = None,
    meanwhile: Callable[[Executor, Report | None], None] = lambda executor, report: None,
) -> list[Report]:
    """Run `trials` and end those in `stopped` at their first report; all reports, in order."""
    waiting, reports, running = list(trials), [], 0
    deadline = time.monotonic() + 240
    try:
        while waiting or running:
            assert time.monotonic() < deadline
            while waiting and executor.free() > 0:
                executor.start(waiting.pop(0))
                running += 1
            report = executor.wait()
            meanwhile(executor, report)
            if report is None:
                continue
            reports.append(report)
            running -= report.final
            if report.key in stopped and not report.final:
                assert given is not None
                note_stop(report.key, report.cost, given)
                executor.stop(report.key)
    finally:
        executor.close()
    return reports


def of(reports: Sequence[Report], key: str) -> list[Report]:
    """Those of one trial, less where it was."""
    return [replace(r, run="") for r in reports if r.key == key]


def state_of(folder: Path, key: str) -> dict[str, Any]:
    return checkpoint.load_newest(folder_of(key, folder) / "checkpoints")[0]


def iterations(folder: Path, key: str) -> list[int]:
    return [r["iteration"] for r in runs.Run(folder_of(key, folder), {}).metrics()]


def check_same_results(build: Callable[[Work], Executor], folder: Path) -> None:
    """As one after another in this process, to the last bit, a trial that is ended early too."""
    expected_in, found_in = folder / "expected", folder / "found"
    given = work(expected_in)
    expected = carry_out(make("in_process", given), TRIALS, ["b"], given)
    given = work(found_in)
    found = carry_out(build(given), TRIALS, ["b"], given)
    for trial in TRIALS:
        assert of(found, trial.key) == of(expected, trial.key)
        one, other = (state_of(place, trial.key) for place in (expected_in, found_in))
        assert_same_state(one, other)
    last = {r.key: r for r in found if r.final}
    assert [r.cost for r in of(found, "a")] == [256, 512, 640]
    assert (last["b"].outcome, last["b"].cost) == ("stopped", 256)
    assert (last["c"].status, last["c"].outcome) == ("ok", "budget")


def check_failure_is_a_report(build: Callable[[Work], Executor], folder: Path) -> None:
    """Of what the trial asks for; the others go on."""
    trials = [Trial("lost", initial_states=str(folder / "nowhere")), TRIALS[0]]
    last = {r.key: r for r in carry_out(build(work(folder)), trials) if r.final}
    assert last["lost"].status.startswith("failed: ")
    assert "nowhere" in last["lost"].status
    assert last["a"].status == "ok"


def check_resumes(build: Callable[[Work], Executor], folder: Path) -> None:
    """Closed in the middle, what it had learned is kept, and the end is the same."""
    straight, cut = folder / "straight", folder / "cut"
    expected = carry_out(make("in_process", work(straight)), TRIALS[:1])
    executor = build(work(cut))
    executor.start(TRIALS[0])
    while executor.wait() is None:
        pass
    executor.close()
    assert iterations(cut, "a") == [1, 2], "it pauses when it has reported"
    found = carry_out(build(work(cut)), TRIALS[:1])
    assert of(found, "a") == of(expected, "a"), "a report that may be lost is made again"
    assert iterations(cut, "a") == [1, 2, 3, 4, 5]
    assert_same_state(state_of(straight, "a"), state_of(cut, "a"))


def check_killed_worker_is_replaced(build: Callable[[Work], Executor], folder: Path) -> None:
    """A process that is killed is noticed, and its trial goes on from its checkpoint."""
    straight, cut = folder / "straight", folder / "cut"
    expected = carry_out(make("in_process", work(straight)), TRIALS[:1])
    killed: list[int] = []

    def kill_once(executor: Any, report: Report | None) -> None:
        if report is not None and not killed:
            killed.append(executor._running["a"].host.process)
            os.kill(killed[0], signal.SIGKILL)

    found = carry_out(build(work(cut)), TRIALS[:1], meanwhile=kill_once)
    assert killed
    assert of(found, "a")[1:] == of(expected, "a"), "the first report was made twice"
    assert iterations(cut, "a") == [1, 2, 3, 4, 5]
    assert_same_state(state_of(straight, "a"), state_of(cut, "a"))


def check_gives_up(build: Callable[[Work], Executor], folder: Path) -> None:
    """When a trial's process was killed more often than it is tried again (once)."""

    def kill(executor: Any, report: Report | None) -> None:
        for running in executor._running.values():
            if running.host.process is not None and iterations(folder, "a"):
                os.kill(running.host.process, signal.SIGKILL)

    (last,) = carry_out(build(work(folder, *ENDLESS)), TRIALS[:1], meanwhile=kill)
    assert last.status.startswith("failed 2 times: its process ")


def check_time_limit(build: Callable[[Work], Executor], folder: Path, seconds: int = 4) -> None:
    """Of so many seconds and a single retry: each try saves, the second goes on from the first."""
    (last,) = carry_out(build(work(folder, *ENDLESS)), TRIALS[:1])
    assert last.status == f"failed 2 times: it took longer than {seconds} s"
    done = iterations(folder, "a")
    assert done == list(range(1, len(done) + 1))
    saved = [int(p.name) for p in checkpoint.newest(folder_of("a", folder) / "checkpoints")]
    assert saved[0] == done[-1], "it was saved when it was told to end"


def check_hanging(build: Callable[[Work], Executor], folder: Path) -> None:
    """A process that does nothing any more is killed after its time (10 s) and the grace (1 s), and
    its trial goes on."""
    stopped: list[int] = []

    def stop_once(executor: Any, report: Report | None) -> None:
        if report is not None and not stopped:
            stopped.append(executor._running["a"].host.process)
            os.kill(stopped[0], signal.SIGSTOP)

    found = carry_out(build(work(folder)), TRIALS[:1], meanwhile=stop_once)
    assert stopped
    assert (found[-1].status, found[-1].cost) == ("ok", 640)
    assert iterations(folder, "a") == [1, 2, 3, 4, 5]

"""Trials on a real Ray cluster of this machine: the same results, whatever happens to its workers."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import executors
import pytest
from commands import forked
from executors import SMALL_STOP, TRIALS, iterations, make, work

pytest.importorskip("ray", reason="ray is not installed (the extra 'ray')")

import ray

from understudy.command.cli import main
from understudy.errors import ConfigError, UnderstudyError
from understudy.setup.composition import load_experiment
from understudy_ray_executor.executor import _connect

pytestmark = pytest.mark.timeout(300)


@pytest.fixture(scope="module", autouse=True)
def cluster() -> Iterator[None]:
    """One for all tests: executors join what is there."""
    ray.init(
        "local", num_cpus=2, include_dashboard=False, log_to_driver=False,
        object_store_memory=100 * 2**20,
    )  # fmt: skip
    yield
    ray.shutdown()


def built(**options: Any) -> Any:
    return functools.partial(make, "ray", **options)


def test_same_results(tmp_path: Path) -> None:
    executors.check_same_results(built(workers=2), tmp_path)
    assert ray.is_initialized(), "a cluster that was there before stays"


def test_a_failure_is_a_report(tmp_path: Path) -> None:
    executors.check_failure_is_a_report(built(), tmp_path)


def test_resumes(tmp_path: Path) -> None:
    executors.check_resumes(built(), tmp_path)


def test_a_killed_worker_is_replaced(tmp_path: Path) -> None:
    executors.check_killed_worker_is_replaced(built(), tmp_path)


def test_gives_up(tmp_path: Path) -> None:
    executors.check_gives_up(built(retries=1), tmp_path)


def test_time_limit(tmp_path: Path) -> None:
    executors.check_time_limit(built(retries=1, seconds=4), tmp_path)


def test_a_process_that_hangs(tmp_path: Path) -> None:
    executors.check_hanging(built(seconds=10, grace=1), tmp_path)


def test_a_sweep(tmp_path: Path) -> None:
    """By the command line: the same table as in this process."""
    grid = ("outer_loop=grid", "outer_loop.seeds=[1,2]")
    for name in ("in_process", "ray"):
        folder = f"run.dir={tmp_path / name}"
        assert main(["sweep", *SMALL_STOP, *grid, f"executor={name}", folder]) == 0
    one, other = ((tmp_path / n / "summary.json").read_text() for n in ("in_process", "ray"))
    assert one == other
    assert iterations(tmp_path / "ray", "base/seed2") == [1, 2, 3, 4, 5]


def test_as_many_as_the_cluster_has_room_for(tmp_path: Path) -> None:
    assert make("ray", work(tmp_path)).free() == 2
    assert make("ray", work(tmp_path), num_cpus=0.5).free() == 4
    assert make("ray", work(tmp_path), workers=7).free() == 7
    with pytest.raises(UnderstudyError, match=r"needs 3 CPU, and the Ray cluster has 2 CPU"):
        make("ray", work(tmp_path), num_cpus=3)
    with pytest.raises(UnderstudyError, match=r"needs 1 CPU and 1 GPU, and .* has 2 CPU, 0 GPU"):
        make("ray", work(tmp_path), num_gpus=1)


@pytest.mark.parametrize("option", ["num_cpus=0", "num_gpus=-1", "workers=0", "retries=-1"])
def test_options_out_of_range(option: str) -> None:
    with pytest.raises(ConfigError, match=rf"executor\.{option.partition('=')[0]}=.* not possible"):
        load_experiment(["executor=ray", f"executor.{option}"])


def test_only_data_is_sent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever reads what goes to the workers can run nothing from it: it is one string of JSON."""
    sent: list[Any] = []
    kind = type(ray.remote(executors.Trial))  # the class of actor classes
    remote = kind.remote

    def noted(self: Any, *arguments: Any, **more: Any) -> Any:
        sent.append((arguments, more))
        return remote(self, *arguments, **more)

    monkeypatch.setattr(kind, "remote", noted)
    executor: Any = make("ray", work(tmp_path))
    executor.start(TRIALS[0])
    executor.close()
    assert all(isinstance(a, str) for arguments, _ in sent for a in arguments)


WITHOUT_RAY = """
import sys
sys.modules["ray"] = None
from understudy.command.cli import main
sys.exit(main(sys.argv[1:]))
"""


def test_without_ray_a_sentence_says_how_to_install_it(tmp_path: Path) -> None:
    arguments = [
        "sweep",
        *SMALL_STOP,
        "outer_loop=grid",
        "executor=ray",
        f"run.dir={tmp_path / 's'}",
    ]
    done = forked(WITHOUT_RAY, *arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert "pip install 'understudy[ray]'" in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "s").exists()


def test_no_cluster_at_the_address() -> None:
    """Said at once, where Ray would try for minutes."""
    with pytest.raises(
        UnderstudyError, match=r"no Ray cluster at executor\.address=127\.0\.0\.1:1: "
    ):
        _connect("127.0.0.1:1")


def test_no_cluster_starts_here(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: Any, **__: Any) -> None:
        raise RuntimeError("no space left on device\nand more")

    monkeypatch.setattr(ray, "init", full)
    with pytest.raises(UnderstudyError, match=r"on this machine: no space left on device\. Stop"):
        _connect(None)

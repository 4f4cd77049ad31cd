"""Fault 30: loading plugins imports no heavy library; the first step needs no network and no home."""

from __future__ import annotations

from pathlib import Path

import pytest
from recorded_runs import make_run
from worlds import python


def test_plugins_load_without_heavy_imports(tmp_path: Path) -> None:
    code = """
import sys, understudy.setup.plugins
plugins = understudy.setup.plugins.load()
heavy = {"torch", "warp", "mujoco", "mujoco_warp", "scipy", "hydra", "omegaconf", "tensorboard", "imageio"}
print(sorted(heavy & sys.modules.keys()), [p.status for p in plugins.loaded if p.name in ("ppo", "mujoco")])
"""
    done = python(code, cwd=tmp_path)
    assert done.stdout.strip() == "[] ['ok', 'ok']", done.stdout + done.stderr


@pytest.mark.parametrize(
    "words",
    [["--help"], ["plugins"], ["tasks"], ["experiments"], ["train"], ["train", "--help"], ["resume", "--help"],
     ["sweep"], ["describe", "learner"], ["describe", "reward"], ["runs"], ["runs", "--json"], ["cite", "runs/run"], ["licence", "runs/run"],
     ["completion", "bash"], ["new", "plugin", "tall"]],
    ids=" ".join,
)  # fmt: skip
def test_what_needs_no_tensors_starts_without_torch(tmp_path: Path, words: list[str]) -> None:
    """Lists, help, and what only reads run folders; torch alone takes seconds of each start."""
    (tmp_path / "runs").mkdir()
    make_run(tmp_path / "runs")
    code = f"""
import contextlib, sys
from understudy.command.cli import main
with contextlib.suppress(SystemExit):
    main({words!r})
print("torch" in sys.modules)
"""
    done = python(code, cwd=tmp_path)
    assert done.stdout.splitlines()[-1:] == ["False"], done.stdout + done.stderr
    assert len(done.stdout + done.stderr) > 50  # it has done what it is for


def test_options_of_the_gpus_physics_are_known_without_it(tmp_path: Path) -> None:
    """Its import took half of the time of every ``config`` of an experiment for GPUs."""
    code = """
import sys
from understudy.command.cli import main
assert main(["config", "experiment=jumping/high_gpu", "simulator.contacts=77", "--json"]) == 0
print(sorted({"mujoco_warp", "warp"} & sys.modules.keys()))
"""
    done = python(code, cwd=tmp_path)
    assert done.stdout.splitlines()[-1:] == ["[]"], done.stdout + done.stderr
    assert '"contacts": 77' in done.stdout


@pytest.mark.parametrize("missing", ["mujoco_warp", "warp"])
def test_a_training_without_the_gpus_physics_says_what_to_install(
    missing: str, tmp_path: Path
) -> None:
    code = f"""
import sys
sys.modules[{missing!r}] = None
from understudy.command.cli import main
sys.exit(main(["train", "experiment=jumping/high_gpu", "device=cpu", "num_worlds=2", "run.dir=run"]))
"""
    done = python(code, cwd=tmp_path)
    assert done.returncode == 2
    assert "simulator=mujoco_warp needs MuJoCo Warp" in done.stderr
    assert "pip install 'understudy[gpu]', or choose simulator=mujoco." in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "run").exists()


def test_first_step_without_network_home_or_cache(tmp_path: Path) -> None:
    code = """
import socket, sys, time
def refuse(*a, **k): raise OSError("no network here")
socket.socket.connect = socket.getaddrinfo = socket.create_connection = refuse
began = time.monotonic()
import worlds
for task in (worlds.fake.FAKE_TASK, worlds.PADDLE_TASK):
    training = worlds.make_training(worlds.all_plugins(), [*task, *worlds.SMALL])
    training.iterate()
assert time.monotonic() - began < 60
"""
    nowhere = "/proc/no-home"
    done = python(
        code, cwd=tmp_path, HOME=nowhere, XDG_CACHE_HOME=nowhere, TORCH_HOME=nowhere,
        WARP_CACHE_PATH=nowhere, CUDA_VISIBLE_DEVICES="", PYTHONDONTWRITEBYTECODE="1",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr


def test_what_every_training_imports_leaves_out_what_few_need(tmp_path: Path) -> None:
    code = """
import sys
import understudy_motion.editing, understudy_characters.shapes
print(sorted({"scipy.signal", "scipy.stats", "trimesh"} & sys.modules.keys()))
"""
    done = python(code, cwd=tmp_path)
    assert done.stdout.strip() == "[]", done.stdout + done.stderr

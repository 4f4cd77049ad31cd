"""What several tests share: small tasks with and without physics, and trainings of them."""

from __future__ import annotations

import contextlib
import os
import resource
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import mujoco
import torch
from torch import Tensor

from understudy.random import WorldStreams
from understudy.records import runs
from understudy.running.training import Reporter, Training
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import Plugins, hookimpl, load
from understudy.setup.registry import Registrar
from understudy.task import Actuation, Context, Encoder, InitialStates, box
from understudy.testing import fake
from understudy_mujoco.scene import MujocoScene

#: Real clips, for the tests that want some; skipped with a reason where there are none.
_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
if _DATA.is_dir():
    os.environ.setdefault("UNDERSTUDY_DATA", str(_DATA))

#: A tiny learner and policy; with them an iteration takes milliseconds.
SMALL = (
    "+policy={name: mlp, hidden: [16]}",
    "+learner={name: ppo, rollout_steps: 8, minibatches: 4, epochs: 2}",
    "num_worlds=16",
    "evaluation.criterion=null",
)

#: A box that falls beside a motorised paddle, which can hit it: contacts, a sensor, truncations.
PADDLE_TASK = (
    "+scene={name: test/paddle}",
    "+simulator={name: mujoco, threads: 1}",
    "+encoder.state={name: test/state}",
    "+actuation={name: test/direct}",
    "+reward.terms.low={name: test/low}",
    "+termination.terms.gone={name: test/gone}",
    "+initial_states={name: test/above}",
    "episode.seconds=0.5",
    "control.substeps=5",
)


@contextlib.contextmanager
def little_memory() -> Iterator[None]:
    """Inside, the process may have half a GB more than now."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + 5 * 10**8, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


class PaddleScene(MujocoScene):
    """A free box, and a paddle on a vertical hinge with a motor and a velocity sensor."""

    def __init__(self, options: None = None, context: Context | None = None) -> None:
        pass

    def spec(self) -> mujoco.MjSpec:
        return mujoco.MjSpec.from_string("""
            <mujoco><worldbody>
              <geom type="plane" size="5 5 1"/>
              <body name="box" pos="0.3 0 0.3"><freejoint/><geom type="box" size=".1 .1 .1" mass="1"/></body>
              <body name="paddle" pos="0 0 0.1"><joint name="turn" axis="0 0 1" damping=".05"/>
                <geom type="capsule" fromto="0 0 0 .4 0 0" size=".05" mass=".5" contype="2" conaffinity="1"/>
              </body></worldbody>
              <actuator><motor joint="turn" gear="5"/></actuator>
              <sensor><jointvel joint="turn"/></sensor></mujoco>""")


class StateEncoder(Encoder):
    """Positions, velocities and the sensor, (N, nq + nv + 1)."""

    reads = ("qpos", "qvel", "sensordata")
    shape = (16,)

    def __init__(self, options: None, context: Context) -> None:
        pass

    def encode(self, **fields: Tensor) -> Tensor:
        return torch.cat([fields[name] for name in self.reads], dim=1)


class Direct(Actuation):
    """The action is the control."""

    def __init__(self, options: None, context: Context) -> None:
        assert context.simulator is not None
        self.action_space = box(context.simulator.control_size)

    def control(self, action: Tensor, **fields: Tensor) -> Tensor:
        return action


class Above(InitialStates):
    """The box up to 0.2 m above the floor, at rest; the paddle anywhere."""

    def __init__(self, options: None, context: Context) -> None:
        pass

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        u = streams.uniform(2)
        qpos = torch.zeros(u.shape[0], 8)
        qpos[:, 0], qpos[:, 2], qpos[:, 3] = 0.3, 0.1 + 0.2 * u[:, 0], 1.0
        qpos[:, 7] = 6.0 * u[:, 1]
        return {"qpos": qpos, "qvel": torch.zeros(u.shape[0], 7)}


def low(qpos: Tensor, sensordata: Tensor) -> Tensor:
    """High when the box is low; adds a little of the sensor so that it matters."""
    return torch.exp(-qpos[:, 2].abs()) + 1e-3 * sensordata[:, 0]


def gone(qpos: Tensor) -> Tensor:
    """The box left the scene."""
    return qpos[:, :3].norm(dim=1) > 1.0


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.component("scene", "test/paddle", PaddleScene)
    register.component("encoder", "test/state", StateEncoder)
    register.component("actuation", "test/direct", Direct)
    register.component("reward", "test/low", low)
    register.component("termination", "test/gone", gone)
    register.component("initial_states", "test/above", Above)


def all_plugins() -> Plugins:
    """The installed plugins, the fake task's parts and this module's."""
    return load(extra=[("fake", fake), ("test", sys.modules[__name__])])


def make_training(
    plugins: Plugins,
    overrides: Sequence[str],
    run: Path | None = None,
    reporter: Reporter | None = None,
) -> Training:
    """A training of `overrides`, in a new run folder if `run` is given."""
    overrides = [*overrides, *([f"run.dir={run}"] if run else [])]
    experiment = load_experiment(overrides, plugins)
    training = Training(experiment, reporter).prepare()
    if run is None:
        return training
    return training.attach(runs.create(experiment, overrides, training.job.sources()))


def resumed(
    plugins: Plugins, run: Path, messages: list[str] | None = None, more: Sequence[str] = ()
) -> Training:
    """The training in the folder `run`, continued from its newest checkpoint."""
    opened = runs.open_run(run)
    opened.lock()
    overrides = [*opened.info["overrides"], *more]
    experiment = load_experiment(overrides, plugins)
    opened.info["config"] = experiment.effective()
    training = Training(experiment).prepare()
    if messages is not None:
        training.reporter.message = messages.append
    training.attach(opened)
    training.resume()
    return training


def flat(state: Any, where: str = "") -> dict[str, Any]:
    """The leaves of a nested state, by path."""
    if isinstance(state, Mapping):
        return {
            k: v for name, item in state.items() for k, v in flat(item, f"{where}/{name}").items()
        }
    if isinstance(state, (list, tuple)):
        return {k: v for i, item in enumerate(state) for k, v in flat(item, f"{where}/{i}").items()}
    return {where: state}


def same_bits(first: Tensor, second: Tensor) -> bool:
    """Whether dtype, shape and every number are equal, NaN equal to NaN and to nothing else."""
    if first.dtype != second.dtype or first.shape != second.shape:
        return False
    return bool(((first == second) | ((first != first) & (second != second))).all())


def assert_same_state(
    first: Any, second: Any, ignore: Sequence[str] = ("/progress/seconds",)
) -> None:
    """Equal to the last bit, NaN equal to NaN."""
    one, two = flat(first), flat(second)
    assert one.keys() == two.keys()
    different = [
        key
        for key in one
        if key not in ignore
        and not (
            same_bits(one[key], two[key]) if isinstance(one[key], Tensor) else one[key] == two[key]
        )
    ]
    assert not different, different


def python(
    code: str, *arguments: str, cwd: Path, **environment: str
) -> subprocess.CompletedProcess[str]:
    """Run `code` in a fresh interpreter that can import this module."""
    return subprocess.run(
        [sys.executable, "-c", code, *arguments],
        cwd=cwd,
        env=child_environment(**environment),
        capture_output=True,
        text=True,
        timeout=120,
    )


def child_environment(**more: str) -> dict[str, str]:
    path = os.pathsep.join(filter(None, [str(Path(__file__).parent), os.environ.get("PYTHONPATH")]))
    return {**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": "1", **more}


#: Begins a child's code: the command line with the fake parts among the installed plugins.
CLI = """
import sys, understudy.setup.plugins as p, worlds
load, fake, parts = p.load, worlds.fake, worlds
p.load = lambda **k: load(extra=[("fake", fake), ("test", parts)])
from understudy.command.cli import main
"""

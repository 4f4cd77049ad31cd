"""A small character, and run folders with recordings of it; nothing is trained."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from understudy.records import runs
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import Plugins, hookimpl, load
from understudy.setup.registry import Registrar
from understudy.task import Context
from understudy.testing import fake
from understudy_mujoco.scene import MujocoScene

#: Of the croucher: a free root, a ball, and a hinge whose body is turned in the zero pose.
NQ = 12


def croucher() -> mujoco.MjSpec:
    """A trunk with a head on a ball and a leg on a hinge."""
    return mujoco.MjSpec.from_string("""
        <mujoco><worldbody>
          <geom type="plane" size="5 5 1"/>
          <body name="trunk" pos="0 0 0.9"><freejoint/>
            <geom type="box" size=".1 .15 .2" rgba=".2 .4 .8 1"/>
            <body name="head" pos="0 0 .3"><joint type="ball"/><geom size=".1" rgba=".9 .7 .6 1"/></body>
            <body name="leg" pos="0 0 -.2" euler="0 90 0"><joint axis="0 1 0"/>
              <geom type="capsule" fromto="0 0 0 .6 0 0" size=".05" rgba=".2 .4 .8 1"/></body>
          </body></worldbody></mujoco>""")


class CroucherScene(MujocoScene):
    """The croucher on its floor."""

    recorded = ("qpos", "reference_qpos")

    def __init__(self, options: None = None, context: Context | None = None) -> None:
        pass

    def spec(self) -> mujoco.MjSpec:
        return croucher()


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.component("scene", "croucher", CroucherScene)
    register.component("character", "croucher", croucher)


def croucher_plugins() -> Plugins:
    """The installed plugins, the fake task's parts, and the croucher."""
    return load(extra=[("fake", fake), ("croucher", sys.modules[__name__])])


SOURCES = {
    "motion": {
        "clip": "crouch",
        "source": "/clips/crouch.bvh",
        "licence": "CC BY 4.0",
        "url": "https://example.org/crouch.bvh",
        "attribution": "Recorded by Ada.",
        "seconds": 2.0,
    }
}


def make_run(folder: Path, sources: Any = SOURCES, scene: str = "croucher") -> Path:
    """The folder of a run without a recording."""
    overrides = [f"+scene={{name: {scene}}}", *fake.FAKE_TASK[1:], f"run.dir={folder / 'run'}"]
    experiment = load_experiment(overrides, croucher_plugins())
    runs.create(experiment, overrides, sources).unlock()
    return folder / "run"


def track(frames: int = 5) -> np.ndarray:
    """(F, 12) float32: the trunk moves and is turned, head and leg swing."""
    swing = 0.2 * np.arange(frames)
    qpos = np.zeros((frames, NQ), np.float32)
    qpos[:, 0] = 0.1 * np.arange(frames)
    qpos[:, 2] = 0.9
    qpos[:, 3], qpos[:, 6] = np.cos(0.1), np.sin(0.1)
    qpos[:, 7], qpos[:, 8] = np.cos(swing), np.sin(swing)
    qpos[:, 11] = swing
    return qpos


def record(run: Path, **changed: Any) -> None:
    """Write a recording of five frames, four of them of the first episode; None leaves one out."""
    arrays = {"control_dt": 1 / 30, "first_episode": 4, "qpos": track(), **changed}
    np.savez(run / "recording.npz", **{k: v for k, v in arrays.items() if v is not None})

"""The standard grip in both simulators: fixed targets hold both sticks."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch

from understudy.task import Context, Simulator
from understudy_gripping.grip import load_grip, standard
from understudy_gripping.hold import placed
from understudy_hand.scene import HandScene
from understudy_hand.table import ARM_POSE
from understudy_mujoco.fields import AT_ITERATIONS


def on_cpu(context: Context) -> Simulator:
    from understudy_mujoco.simulator import MujocoSimulator

    return MujocoSimulator(MujocoSimulator.Options(threads=1), context)


def on_warp(context: Context) -> Simulator:
    pytest.importorskip("mujoco_warp._src", reason="MuJoCo Warp is not installed")
    from understudy_mujoco_warp.simulator import MujocoWarpSimulator

    return MujocoWarpSimulator(MujocoWarpSimulator.Options(), context)


def check_held(make: Callable[[Context], Simulator], seconds: float, device: str = "cpu") -> None:
    """Less than 1 mm of slip from 0.3 s on, in two worlds."""
    scene, grip = HandScene(HandScene.Options()), load_grip(standard())
    context = Context(0, torch.device(device), 2, control_dt=0.01, substeps=2)
    context.scene = scene
    simulator = make(context)
    data = placed(scene, np.array(ARM_POSE), grip.poses[0], grip.upper[0], grip.lower)

    def both(values: np.ndarray) -> torch.Tensor:
        return torch.tensor(values, dtype=torch.float32, device=device).repeat(2, 1)

    everywhere = torch.ones(2, dtype=torch.bool, device=device)
    rest = {"qpos": both(data.qpos), "qvel": both(data.qvel)}
    simulator.set_state(everywhere, rest)
    targets = both(np.array([*ARM_POSE, *grip.targets[0]]))
    bodies = [scene.model.body(name).id for name in ("palm", *scene.tool_bodies)]
    settled = None
    for step in range(round(100 * seconds)):
        simulator.step(targets)
        places = simulator.read("xpos")[:, bodies]
        away = (places[:, 1:] - places[:, :1]).clone()
        if step == 30:
            settled = away
    assert settled is not None
    assert float((away - settled).norm(dim=-1).max()) < 1e-3
    assert not simulator.failed().any()
    assert set(simulator.report()) <= {AT_ITERATIONS}  # nothing overflows, no servo is at its limit


def test_mujoco_holds_it() -> None:
    check_held(on_cpu, 10.0)


@pytest.mark.slow
def test_mujoco_warp_holds_it_on_the_cpu() -> None:
    """Some minutes, most of them for its kernels to compile."""
    check_held(on_warp, 0.6)


@pytest.mark.gpu
def test_mujoco_warp_holds_it_on_a_gpu() -> None:
    if not torch.cuda.is_available():
        pytest.skip("no CUDA GPU")
    check_held(on_warp, 10.0, "cuda")

"""The CPU simulator on a small scene of its own."""

from __future__ import annotations

import mujoco
import pytest
import torch

from understudy.errors import ConfigError
from understudy.task import Context, Scene
from understudy.testing import check_simulator
from understudy.testing.fake import FakeScene
from understudy_mujoco.scene import MujocoScene
from understudy_mujoco.simulator import MujocoSimulator

BALL = """<mujoco><worldbody><geom type="plane" size="5 5 1"/>
  <body pos="0 0 0.5"><joint name="z" type="slide" axis="0 0 1"/><geom size=".1" mass="2"/></body>
  </worldbody><actuator><motor joint="z"/></actuator></mujoco>"""


class BallScene(MujocoScene):
    """A ball on a vertical slide above a floor."""

    def spec(self) -> mujoco.MjSpec:
        return mujoco.MjSpec.from_string(BALL)


def build(worlds: int = 4, scene: Scene | None = None, **options: int) -> MujocoSimulator:
    context = Context(0, torch.device("cpu"), worlds, control_dt=0.02, substeps=10)
    context.scene = scene or BallScene()
    return MujocoSimulator(MujocoSimulator.Options(**options), context)


def test_conforms() -> None:
    check_simulator(build(), 4)


def test_falls_as_the_physics_says() -> None:
    """Free fall from rest: z = -g t² / 2, up to the integrator's first-order error g t dt / 2."""
    simulator = build()
    for _ in range(10):
        simulator.step(torch.zeros(4, 1))
    height = simulator.read("qpos")[:, 0]
    expected = -9.81 * 0.2 * (0.2 + 0.002) / 2
    torch.testing.assert_close(height, torch.full((4,), expected), atol=1e-5, rtol=0)


def test_only_the_chosen_worlds_are_set() -> None:
    simulator = build()
    simulator.step(torch.ones(4, 1))
    before = simulator.read("qpos").clone()
    chosen = torch.tensor([False, True, False, False])
    state = {"qpos": torch.full((4, 1), 0.3), "qvel": torch.full((4, 1), -1.0)}
    simulator.set_state(chosen, state)
    after = simulator.read("qpos")
    assert after[1, 0] == pytest.approx(0.3)
    assert torch.equal(after[~chosen], before[~chosen])
    torch.testing.assert_close(simulator.read("xpos")[1, 1, 2], torch.tensor(0.8))


def test_one_and_two_threads_give_the_same_bits() -> None:
    first, second = build(threads=1), build(threads=2)
    for _ in range(20):
        first.step(torch.ones(4, 1))
        second.step(torch.ones(4, 1))
    assert torch.equal(first.snapshot()["state"], second.snapshot()["state"])


def test_a_scene_of_another_family_is_refused() -> None:
    with pytest.raises(
        ConfigError, match=r"needs a scene of type MujocoScene, but the task has Fake"
    ):
        build(scene=FakeScene())

"""The CPU simulator on a small scene of its own."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch
from arena import arena, check_derived, check_fields, check_parameters, everywhere, states

from understudy.errors import ConfigError
from understudy.task import Context, Scene, Simulator
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


def test_conforms_with_parameters() -> None:
    simulator = MujocoSimulator(MujocoSimulator.Options(threads=1), arena(4))
    check_simulator(simulator, 4, ["mocap_pos/hand", "geom_size/box", "gravity", "active/shelf"])


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


def test_controls_are_0_unless_they_are_given() -> None:
    simulator = build()
    simulator.step(torch.ones(4, 1))
    state = {"qpos": torch.zeros(4, 1), "qvel": torch.zeros(4, 1)}
    simulator.set_state(everywhere(simulator), {**state, "ctrl": torch.full((4, 1), 0.5)})
    assert torch.equal(simulator.read("ctrl"), torch.full((4, 1), 0.5))
    simulator.set_state(everywhere(simulator), state)
    assert torch.equal(simulator.read("ctrl"), torch.zeros(4, 1))


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


def test_fields_of_all_stages_are_those_of_plain_mujoco() -> None:
    check_fields(MujocoSimulator(MujocoSimulator.Options(threads=2), arena(6)), 1e-4, 1e-5)


def test_reading_changes_no_bit_of_what_follows() -> None:
    read, unread = (MujocoSimulator(MujocoSimulator.Options(threads=1), arena(4)) for _ in range(2))
    for simulator in (read, unread):
        simulator.set_state(torch.ones(4, dtype=torch.bool), states(4))
        for _ in range(5):
            simulator.step(torch.ones(4, 1))
            if simulator is read:
                simulator.read("sensor_touch"), simulator.read("cfrc_int")
    assert torch.equal(read.snapshot()["state"], unread.snapshot()["state"])


def test_substeps_are_physics_steps() -> None:
    """z = -g dt² (1 + … + k), semi-implicit Euler."""
    simulator, dt = build(), 0.002
    simulator.step(torch.zeros(4, 1), substeps=3)
    simulator.step(torch.zeros(4, 1), substeps=1)
    expected = torch.full((4,), -9.81 * dt**2 * (1 + 2 + 3 + 4))
    torch.testing.assert_close(simulator.read("qpos")[:, 0], expected)


def fails(simulator: MujocoSimulator) -> list[int]:
    return simulator.failed().nonzero().squeeze(1).tolist()


def test_a_control_that_is_not_finite_fails_its_world() -> None:
    """MuJoCo warns and goes on with controls 0, so the numbers themselves stay finite."""
    simulator = build()
    control = torch.zeros(4, 1)
    control[2] = torch.nan
    simulator.step(control)
    assert torch.isfinite(simulator.read("qpos")).all()
    assert fails(simulator) == [2] == fails(simulator), "asking twice gives the same answer"
    assert simulator.report() == {"badctrl": 10}
    simulator.step(torch.zeros(4, 1))
    assert fails(simulator) == []


def test_a_state_that_is_not_finite_fails_its_world() -> None:
    simulator = build()
    for name in ("qpos", "qvel"):
        state = {"qpos": torch.zeros(4, 1), "qvel": torch.zeros(4, 1)}
        state[name][1] = torch.inf
        simulator.set_state(torch.ones(4, dtype=torch.bool), state)
        assert fails(simulator) == [1]


def test_an_error_of_the_engine_fails_its_world_alone() -> None:
    simulator = build()
    simulator.batch.expand("opt.integrator")[3] = 99  # the engine raises at such a thing
    simulator.step(torch.zeros(4, 1))
    assert fails(simulator) == [3]
    height = simulator.read("qpos")[:, 0]
    assert height[3] == 0.0
    assert (height[:3] < 0.0).all()
    simulator.restore(simulator.snapshot())
    assert fails(simulator) == []


def test_warnings_are_counted_and_written_nowhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    simulator = build()
    simulator.step(torch.full((4, 1), torch.nan))
    assert simulator.report() == {"badctrl": 40}
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr() == ("", "")


def varied(*names: str, worlds: int = 3) -> MujocoSimulator:
    simulator = MujocoSimulator(MujocoSimulator.Options(threads=1), arena(worlds, substeps=10))
    simulator.vary(names)
    return simulator


def test_parameters_are_as_plain_mujoco_computes_them() -> None:
    def simulator(context: Context) -> MujocoSimulator:
        return MujocoSimulator(MujocoSimulator.Options(threads=2), context)

    check_parameters(simulator, "cpu", steps=20, atol=1e-5)


def test_what_derives_from_a_parameter_follows_it() -> None:
    def field(simulator: Simulator, name: str, world: int) -> np.ndarray:
        assert isinstance(simulator, MujocoSimulator)
        return getattr(simulator.batch.get_model(world), name)

    check_derived(lambda c: MujocoSimulator(MujocoSimulator.Options(threads=1), c), field)


def test_parameters_left_out_keep_their_values() -> None:
    simulator = varied("mocap_pos/hand", "gravity")
    given = {"mocap_pos/hand": torch.full((3, 3), 0.7), "gravity": torch.full((3, 3), -1.0)}
    simulator.set_state(everywhere(simulator), {**states(3), **given})
    simulator.set_state(torch.tensor([True, False, True]), states(3))
    for name, value in given.items():
        torch.testing.assert_close(simulator.read(name), value)
    torch.testing.assert_close(simulator.read("xpos")[:, 2], given["mocap_pos/hand"])


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["geom_size/bx"], r"no parameter 'geom_size/bx' .* Did you mean 'geom_size/box'\?"),
        (["geom_size/floor"], "no parameter"),
        (["body_pos/hand"], "no parameter"),
        (["geom_friction", "geom_friction/box"], "'geom_friction/box' twice"),
        (["gravity", "gravity"], "'gravity' twice"),
    ],
)
def test_parameters_that_are_not_there_are_refused(names: list[str], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        varied(*names)

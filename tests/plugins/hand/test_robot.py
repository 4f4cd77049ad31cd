"""Hands of other people's models: read from a file in a package, which is not imported."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from understudy.command.cli import main
from understudy.errors import ConfigError
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import Plugins
from understudy_gripping.grip import adroit, load_grip, standard
from understudy_hand.robot import Robot
from understudy_hand.scene import HandScene

needs_adroit = pytest.mark.skipif(
    importlib.util.find_spec("gymnasium_robotics") is None,
    reason="the Adroit hand's package is not installed (pip install --no-deps gymnasium-robotics)",
)
MINE = Robot("hand_of_mine", "models/hand.xml", links={"index_distal": "tip_of_the_index"})


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The human hand as somebody else would have it: an MJCF file, a body named otherwise, and code that nobody runs."""
    folder = tmp_path_factory.mktemp("packages") / "hand_of_mine"
    (folder / "models").mkdir(parents=True)
    (folder / "__init__.py").write_text("raise RuntimeError('imported')\n")
    spec = HandScene(HandScene.Options(tool="none")).spec()
    spec.body("index_distal").name = "tip_of_the_index"
    spec.compile()
    (folder / "models" / "hand.xml").write_text(spec.to_xml())
    sys.path.insert(0, str(folder.parent))
    yield folder
    sys.path.remove(str(folder.parent))


def scene(robot: Robot | None = None, **options: Any) -> HandScene:
    return HandScene(HandScene.Options(robot=robot, **options))


def test_a_hand_that_is_read_is_the_hand_that_was_written(package: Path) -> None:
    assert "hand_of_mine" not in sys.modules
    own, read = scene().model, scene(MINE).model
    assert "hand_of_mine" not in sys.modules, "nothing of a package is run"
    assert [own.body(b).name for b in range(own.nbody)] == [read.body(b).name for b in range(read.nbody)]  # fmt: skip
    for name in (
        "body_pos", "body_parentid", "body_mass", "jnt_axis", "jnt_pos", "jnt_range", "geom_type", "geom_size",
        "geom_pos", "geom_friction", "geom_contype", "geom_condim", "actuator_gainprm", "dof_armature",
    ):  # fmt: skip
        np.testing.assert_allclose(getattr(read, name), getattr(own, name), atol=2e-6, err_msg=name)
    data = [mujoco.MjData(model) for model in (own, read)]
    for one in data:
        one.qpos[:36] = np.linspace(0.0, 0.3, 36)
        mujoco.mj_kinematics(one.model, one)
    np.testing.assert_allclose(data[0].geom_xmat, data[1].geom_xmat, atol=1e-5)


def test_a_grip_belongs_to_the_model_that_it_was_found_for(package: Path) -> None:
    read, grip = scene(MINE), load_grip(standard())
    with pytest.raises(ConfigError, match="of another hand: the human one, and the scene's is hand_of_mine"):  # fmt: skip
        grip.need(read)
    own = replace(grip, robot=read.robot)
    own.need(read)
    assert own.held(read, 0, 1.0).fell is None, "as the human hand does"
    with pytest.raises(ConfigError, match="the scene's is the human one"):
        own.need(scene())


@pytest.mark.parametrize(
    ("robot", "said"),
    [
        (Robot("no_such_hand", "hand.xml"), "pip install --no-deps no-such-hand"),
        (Robot("no such hand", "hand.xml"), "which is not installed"),
        (replace(MINE, file="models/other.xml"), "has no file 'models/other.xml'"),
        (replace(MINE, palm="paw"), "has no body 'paw'"),
        (replace(MINE, links={"thumb_distal": "claw"}), "has no body 'claw'"),
        (replace(MINE, inner={"index_metacarpal": "pad"}), "has no shape 'pad' that touches anything"),
        (replace(MINE, inner={"index_pad": "pad", "thumb_pad": "pad"}), "scene.robot.inner has two names for 'pad'"),
        (Robot("__main__", "hand.xml"), "which is not installed"),
        (replace(MINE, file="../hand_of_mine/models/hand.xml"), "has no file '../hand_of_mine"),
        (replace(MINE, file="/etc/hostname"), "has no file '/etc/hostname'"),
        (replace(MINE, palm="world"), "has no body 'world'"),
        (replace(MINE, palm="forearm"), "Two links are called 'wrist' in arm and hand"),
        (replace(MINE, palm="tip_of_the_index"), "index_distal: the body 'tip_of_the_index' of models/hand.xml does not hang on the palm"),
        (replace(MINE, links={}), "has no body 'index_distal', the tip of a finger. Say which it is: scene.robot.links.index_distal=BODY"),
        (replace(MINE, links={"index_distal": "forearm"}), "links.index_distal: the body 'forearm' of models/hand.xml does not hang on the palm"),
        (replace(MINE, links={"palm": "tip_of_the_index"}), "Two links are called 'palm'"),
        (replace(MINE, links={"middle_distal": "tip_of_the_index"}), "Two links are called 'middle_distal'"),
        (replace(MINE, links={"index_distal": "tip_of_the_index", "index_tip": "tip_of_the_index"}), "links has two names for 'tip_of_the_index'"),
        (replace(MINE, links={**MINE.links, "claw": "ring_middle"}), "The body 'claw' of models/hand.xml turns, and it is not said of which finger"),
        (replace(MINE, rest={"claw": 1.0}), "scene.robot.rest: the hand has no hinge 'claw'"),
        (replace(MINE, rest={"index_proximal": 0.1, "ring_proximal": 3.0}), "rest.ring_proximal=3 is beyond what this hinge of models/hand.xml can do, -0.136 to 0.136 rad"),
        (replace(MINE, rest={"ring_proximal": float("nan")}), "rest.ring_proximal=nan is beyond"),
    ],
)  # fmt: skip
def test_what_is_no_hand_is_refused(robot: Robot, said: str, package: Path) -> None:
    with pytest.raises(ConfigError) as error:
        _ = scene(robot).model
    assert said in str(error.value)
    assert error.value.exit_status == 2


def test_each_body_of_a_hand_has_a_name(package: Path) -> None:
    text = (package / "models" / "hand.xml").read_text()
    assert '<body name="ring_middle"' in text
    (package / "models" / "nameless.xml").write_text(
        text.replace('<body name="ring_middle"', "<body")
    )
    with pytest.raises(
        ConfigError, match=r"A body on the palm 'palm' of models/nameless\.xml has no name"
    ):
        _ = scene(replace(MINE, file="models/nameless.xml")).model


def test_each_hinge_of_a_hand_has_a_range(package: Path) -> None:
    text = (package / "models" / "hand.xml").read_text()
    spec = mujoco.MjSpec.from_string(text)
    spec.joint("ring_proximal").limited = mujoco.mjtLimited.mjLIMITED_FALSE
    (package / "models" / "endless.xml").write_text(spec.to_xml())
    with pytest.raises(ConfigError, match="hinge 'ring_proximal' turns without end"):
        _ = scene(replace(MINE, file="models/endless.xml")).model


def test_a_robot_has_its_own_measures() -> None:
    with pytest.raises(ValueError, match="leave out fingers, finger_length and size"):
        scene(MINE, size=2.0)


def test_the_command_says_what_is_missing(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:  # fmt: skip
    assert main(["grip", "11120", str(tmp_path / "grip.json"), "--scene", "mjcf"]) == 2
    assert "scene" in capsys.readouterr().err
    if importlib.util.find_spec("gymnasium_robotics") is None:
        assert main(["grip", "11120", str(tmp_path / "grip.json"), "--scene", "hand/adroit"]) == 2
        assert "pip install --no-deps gymnasium-robotics" in capsys.readouterr().err
    words = ["--scene", "hand/adroit", "--fingers", "3"]
    assert main(["grip", "11120", str(tmp_path / "grip.json"), *words]) == 2
    assert "--scene hand/adroit is a hand of its own: leave out" in capsys.readouterr().err
    assert not (tmp_path / "grip.json").exists()


@needs_adroit
def test_the_adroit_hand_holds_two_sticks_for_ten_seconds(plugins: Plugins) -> None:
    """Parallel less than 1 mm of drift and 0.5 mm of penetration; at every angle less than 1 mm of both."""
    options = load_experiment(["scene=hand/adroit"], plugins).need("scene").options
    assert isinstance(options, HandScene.Options)
    made, grip = HandScene(options), load_grip(adroit())
    grip.need(made)
    for row in range(len(grip.angles)):
        held = grip.held(made, row, 10.0, 1.0)
        assert held.fell is None
        assert held.drift.max() < 1e-3
        assert held.depth < (5e-4 if row == 0 else 1e-3)
        assert {"thumb_distal", "index_distal", "middle_distal", "ring_distal"} <= held.links

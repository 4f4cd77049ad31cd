"""What stands around a character, from recordings that fit it and from others."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import recorded_runs
from recorded_runs import record

from understudy.errors import FileError
from understudy.records import runs
from understudy.setup import plugins as setup_plugins
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import Plugins, hookimpl, load
from understudy.setup.registry import Registrar
from understudy.testing import fake
from understudy_characters.character import Character
from understudy_characters.recording import recorded_surroundings
from understudy_characters.scene import other_bodies
from understudy_characters.surroundings import Surroundings


@dataclass(frozen=True)
class StoolOptions:
    radius: float = 0.2  #: m


class Stool(Surroundings):
    recorded = ("stool_position", "stool_height")

    def __init__(self, options: StoolOptions, *_: object) -> None:
        self.options = options

    def add(self, spec: mujoco.MjSpec) -> None:
        body = spec.worldbody.add_body(name="stool", mocap=True)
        size = [self.options.radius, 0.2, 0.0]
        body.add_geom(name="stool", type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=size)

    def place(
        self, model: mujoco.MjModel, data: mujoco.MjData, recorded: Mapping[str, np.ndarray]
    ) -> None:
        data.mocap_pos[0] = recorded["stool_position"]
        model.geom("stool").size[1] = 0.5 * float(recorded["stool_height"])


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.section("stool", StoolOptions, Stool)


@pytest.fixture
def plugins(monkeypatch: pytest.MonkeyPatch) -> Plugins:
    extra = [("fake", fake), ("croucher", recorded_runs), ("stool", sys.modules[__name__])]
    found = load(extra=extra)
    monkeypatch.setattr(setup_plugins, "installed", lambda: found)
    return found


@pytest.fixture
def run(plugins: Plugins, tmp_path: Path) -> Path:
    folder = tmp_path / "run"
    overrides = [
        "+scene={name: character, character: croucher}", "+stool={radius: 0.3}",
        *fake.FAKE_TASK[1:], f"run.dir={folder}",
    ]  # fmt: skip
    runs.create(load_experiment(overrides, plugins), overrides, {}).unlock()
    return folder


SOUND = {"stool_position": np.tile([1.0, 2.0, 0.2], (5, 1)), "stool_height": np.full(5, 0.4)}


def test_it_stands_where_it_was_recorded(run: Path) -> None:
    record(run, **SOUND)
    (stool,) = recorded_surroundings(run)
    np.testing.assert_allclose(stool.clip.root_position, SOUND["stool_position"][:4])


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"stool_position": np.zeros((3, 3))}, "of 'stool_position' 3 frames .* of 'qpos' 5"),
        ({"stool_height": np.zeros(9)}, "of 'stool_height' 9 frames .* of 'qpos' 5"),
        ({"stool_position": np.zeros((5, 5))}, r"\(ValueError: .*\); make another"),
        ({"stool_height": np.zeros((5, 5))}, r"\(TypeError: .*\); make another"),
        ({"stool_height": None}, r"\(KeyError: 'stool_height'\); make another"),
        ({"stool_height": np.full(5, np.nan)}, "not finite"),
    ],
)
def test_a_recording_that_does_not_fit_is_one_sentence(
    run: Path, changed: dict[str, Any], reason: str
) -> None:
    record(run, **{**SOUND, **changed})
    with pytest.raises(FileError, match=reason) as error:
        recorded_surroundings(run)
    assert "\n" not in str(error.value)


SCENE = """
<mujoco>
  <worldbody>
    <geom type="plane" size="1 1 0.1"/>
    <geom name="table" type="box" size="0.5 0.5 0.02" pos="0 0 -0.02"/>
    <body name="tool" pos="0 0 0.5"><freejoint/><geom type="capsule" size="0.01 0.1"/></body>
    <body name="arm" pos="0.3 0 0.2">
      <joint axis="0 1 0"/><geom type="capsule" size="0.02 0.1" pos="0 0 0.1"/>
      <body pos="0 0 0.2"><joint axis="0 1 0"/><geom type="sphere" size="0.03"/></body>
    </body>
    <body name="goal" mocap="true"><geom type="sphere" size="0.01"/></body>
    <body name="frame"/>
  </worldbody>
</mujoco>
"""


def test_a_scene_of_no_character_is_shown_whole() -> None:
    """The tool is what moves freely, and the arm that holds it and the table are beside it."""
    character = Character("tool", mujoco.MjModel.from_xml_string(SCENE))
    assert character.joint_names == ("tool",)
    qpos = np.zeros((2, 9))
    qpos[:, 2:4] = 0.5, 1.0
    qpos[1, 7] = 0.5 * np.pi  # the arm's first hinge, about y: up becomes forward
    things = {thing.name: thing for thing in other_bodies(character, qpos)}
    assert list(things) == ["world", "arm", "body3"]
    np.testing.assert_allclose(things["arm"].positions, [[0.3, 0, 0.2]] * 2)
    np.testing.assert_allclose(
        things["body3"].positions, [[0.3, 0, 0.4], [0.5, 0, 0.2]], atol=1e-12
    )
    half = np.sqrt(0.5)
    np.testing.assert_allclose(
        things["body3"].rotations, [[1, 0, 0, 0], [half, 0, half, 0]], atol=1e-12
    )
    (table,) = things["world"].shapes
    np.testing.assert_allclose(table.vertices.min(axis=0), [-0.5, -0.5, -0.04], atol=1e-12)

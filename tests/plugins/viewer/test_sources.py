"""What the command's arguments name: clips, characters, runs and what is drawn over them."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import recorded_runs
from recorded_runs import make_run, record, track

from understudy.errors import ConfigError, FileError
from understudy.setup import plugins
from understudy.setup.plugins import Plugins, hookimpl
from understudy.setup.registry import Registrar, Registry
from understudy.testing import fake
from understudy_characters.fitting import fitting_character
from understudy_characters.overlay import Gauge, Overlay, Region
from understudy_humanoid.character import build_spec
from understudy_motion import library
from understudy_motion.clip import Clip
from understudy_motion.writing import write_clip
from understudy_viewer import sources
from understudy_viewer.stage import Scene

BUNDLED = ("characters", "humanoid", "motion", "mujoco", "ppo")


class Lean(Overlay):
    """How high the trunk is."""

    def marks(
        self, config: Mapping[str, Any], tracks: Mapping[str, np.ndarray], registry: Registry
    ) -> Sequence[Gauge | Region]:
        height = tracks["qpos"][:, 2]
        phase = [Gauge("phase", tracks["phase"], 0.5 + 0 * height, "")] if "phase" in tracks else []
        assert config["num_worlds"] >= 1
        return [Gauge("height", height, 1.0 + 0 * height, "m"), *phase]


class Broken(Overlay):
    def marks(self, config: Any, tracks: Any, registry: Registry) -> Sequence[Gauge | Region]:
        raise FileError("Nothing can be drawn.")


class Parts:
    @hookimpl
    def understudy_register(self, register: Registrar) -> None:
        register.component("character", "test/biped", build_spec)
        register.component("character", "test/unusable", "no_such_module:nothing")
        register.component("overlay", "test/lean", Lean)
        register.component("overlay", "test/broken", Broken)


@pytest.fixture(scope="module")
def loaded() -> Plugins:
    extra = [("fake", fake), ("croucher", sys.modules[recorded_runs.__name__]), ("parts", Parts())]
    return plugins.load(only=BUNDLED, extra=extra)


@pytest.fixture
def registry(loaded: Plugins, monkeypatch: pytest.MonkeyPatch) -> Registry:
    monkeypatch.setattr(plugins, "installed", lambda: loaded)
    return loaded.registry


def opened(named: list[str], registry: Registry, character: str | None = None) -> Scene:
    return sources.open_scene(named, registry, lambda s: library.find(s, registry), character)


def test_a_name_is_a_generated_clip_and_its_character_is_found(registry: Registry) -> None:
    (walk,) = opened(["walk"], registry).subjects
    assert walk.clip.name == "walk"
    assert walk.character is not None
    assert set(walk.character.joint_names) <= set(walk.clip.joint_names)
    assert walk.origin == tuple(walk.clip.root_position[0, :2].tolist())


def test_a_clip_that_no_character_fits_is_shown_as_bones(
    registry: Registry, walk: Clip, tmp_path: Path
) -> None:
    bare = plugins.load(only=("motion", "mujoco", "characters"))
    assert fitting_character(walk, bare.registry) is None
    write_clip(walk, tmp_path / "walk.npz", registry)
    (shown,) = opened([str(tmp_path / "walk.npz")], bare.registry).subjects
    assert (shown.character, shown.clip.num_frames) == (None, walk.num_frames)


def test_a_character_of_fewer_joints_fits_less(registry: Registry) -> None:
    (run,) = opened(["walk"], registry).subjects
    assert run.character is not None
    assert run.character.name != "croucher"


def test_two_sources_stand_side_by_side(registry: Registry, tmp_path: Path) -> None:
    run = make_run(tmp_path)
    record(run, reference_qpos=track())
    scene = opened(["walk", str(run)], registry)
    assert [subject.clip.name for subject in scene.subjects] == ["walk", "run"]
    assert scene.marks == ()


def test_a_run_is_beside_its_reference_with_what_its_task_draws(
    registry: Registry, tmp_path: Path
) -> None:
    run = make_run(tmp_path)
    record(run, reference_qpos=track() + np.eye(1, track().shape[1], dtype=np.float32))
    scene = opened([str(run)], registry)
    learned, reference = scene.subjects
    assert [learned.role, reference.role] == ["learned", "reference"]
    assert learned.origin == reference.origin, "how far they are apart is seen"
    assert reference.clip.root_position[0, 0] - learned.clip.root_position[0, 0] == 1.0
    (height,) = scene.marks
    assert isinstance(height, Gauge)
    np.testing.assert_allclose(height.values, 0.9)
    assert len(height.values) == learned.clip.num_frames == 4
    assert scene.notes == ["Nothing can be drawn."]


def test_a_recorded_phase_reaches_the_overlays(registry: Registry, tmp_path: Path) -> None:
    run = make_run(tmp_path)
    record(run, phase=np.linspace(0.0, 0.8, 5, dtype=np.float32))
    scene = opened([str(run)], registry)
    assert len(scene.subjects) == 1
    phase = scene.marks[1]
    assert isinstance(phase, Gauge)
    np.testing.assert_allclose(phase.values, [0.0, 0.2, 0.4, 0.6], atol=1e-6)


def test_a_character_can_be_chosen(registry: Registry, tmp_path: Path) -> None:
    model = tmp_path / "biped.xml"
    model.write_text(build_spec().to_xml())
    (walk,) = opened(["walk"], registry, character=str(model)).subjects
    assert walk.character is not None
    assert walk.character.name == "biped"


@pytest.mark.parametrize(
    ("source", "character", "error", "reason"),
    [
        ("wlak", None, FileError, "Did you mean 'walk'"),
        ("missing.bvh", None, FileError, "no such file"),
        ("walk", "huamnoid", ConfigError, "There is no character 'huamnoid'"),
    ],
)
def test_what_is_not_there_is_named(
    registry: Registry, source: str, character: str | None, error: type[Exception], reason: str
) -> None:
    with pytest.raises(error, match=reason):
        opened([source], registry, character=character)

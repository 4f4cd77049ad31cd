"""A run's recording becomes clips, with the licence of what it learned from."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from recorded_runs import NQ, croucher_plugins, make_run, record, track

from understudy.errors import ConfigError, FileError, RunError
from understudy.setup import plugins as setup_plugins
from understudy.setup.registry import Component
from understudy_characters.recording import recorded_clips, recorded_surroundings, run_character
from understudy_tensors import rotations


@pytest.fixture(autouse=True)
def _plugins(monkeypatch: pytest.MonkeyPatch) -> None:
    plugins = croucher_plugins()
    monkeypatch.setattr(setup_plugins, "installed", lambda: plugins)


def test_the_first_episode_becomes_a_clip(tmp_path: Path) -> None:
    run = make_run(tmp_path)
    record(run, reference_qpos=track()[::-1])
    learned, reference = recorded_clips(run)
    assert reference is not None
    assert (learned.name, reference.name) == ("run", "run-reference")
    assert learned.joint_names == ("trunk", "head", "leg")
    assert learned.num_frames == reference.num_frames == 4
    assert learned.frame_rate == pytest.approx(30.0)
    assert not learned.loop
    torch.testing.assert_close(
        learned.root_position, torch.from_numpy(track()[:4, :3]).to(torch.float64)
    )
    swing = rotations.to_exponential_map(learned.rotations[:, 2])
    torch.testing.assert_close(swing[:, 1], 0.2 * torch.arange(4.0, dtype=torch.float64))
    assert reference.root_position[0, 0] == pytest.approx(0.4)


def test_licence_and_origin_travel_along(tmp_path: Path) -> None:
    run = make_run(tmp_path)
    record(run)
    learned, reference = recorded_clips(run)
    assert reference is None
    assert learned.source == str(run)
    assert learned.licence == "CC BY 4.0"
    assert learned.url == "https://example.org/crouch.bvh"
    assert learned.attribution == "Recorded by Ada."


@pytest.mark.parametrize("sources", [{}, [], {"motion": 3}, {"motion": {"licence": ["x"]}}])
def test_a_run_that_knows_no_licence_says_unknown(tmp_path: Path, sources: Any) -> None:
    run = make_run(tmp_path)
    info = json.loads((run / "run.json").read_text())
    (run / "run.json").write_text(json.dumps(info | {"sources": sources}))
    record(run)
    assert recorded_clips(run)[0].licence == "unknown"


def test_a_run_without_a_recording_says_how_to_make_one(tmp_path: Path) -> None:
    run = make_run(tmp_path)
    with pytest.raises(FileError, match=f"no recording .*understudy render {run}"):
        recorded_clips(run)
    with pytest.raises(RunError, match="no run folder"):
        recorded_clips(tmp_path)


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"first_episode": 1}, "ended before its second frame"),
        ({"first_episode": -2}, "ended before its second frame"),
        ({"first_episode": None}, "'first_episode' is missing"),
        ({"first_episode": np.nan}, "not one finite number"),
        ({"qpos": np.zeros((5, 3), np.float32)}, r"its shape is \(5, 3\)"),
        ({"qpos": np.full((5, NQ), np.nan, np.float32)}, "'qpos' is not finite"),
        ({"qpos": np.array([{}])}, "qpos.*holds object"),
        ({"control_dt": 0.0}, "time does not increase"),
        ({"reference_qpos": np.zeros((5, NQ), np.float32)}, "a rotation is not finite"),
        ({"reference_qpos": track(3)}, "of 'reference_qpos' 3 frames were recorded, of 'qpos' 5"),
        ({"phase": np.zeros(3)}, "of 'phase' 3 frames were recorded, of 'qpos' 5"),
    ],
)
def test_a_damaged_recording_is_named(tmp_path: Path, changed: Any, reason: str) -> None:
    run = make_run(tmp_path)
    record(run, **changed)
    with pytest.raises(FileError, match=reason):
        recorded_clips(run)


def test_no_more_frames_than_were_recorded(tmp_path: Path) -> None:
    run = make_run(tmp_path)
    record(run, first_episode=1e300)
    assert recorded_clips(run)[0].num_frames == 5


def test_the_character_is_the_scenes(tmp_path: Path) -> None:
    assert run_character(make_run(tmp_path)).joint_names == ("trunk", "head", "leg")


def test_the_simulator_need_not_be_here(tmp_path: Path) -> None:
    """Its library is missing, and another run's is not even known."""
    run = make_run(tmp_path)
    record(run)
    gone = Component("simulator", "gone", "no_such_library:Simulator", "test")
    setup_plugins.installed().registry.components[gone.kind, gone.name] = gone
    info = json.loads((run / "run.json").read_text())
    for name in ("gone", "unheard_of"):
        info["config"]["simulator"] = {"name": name}
        (run / "run.json").write_text(json.dumps(info))
        assert recorded_clips(run)[0].num_frames == 4
        assert recorded_surroundings(run) == []


def test_a_scene_without_a_character_is_refused(tmp_path: Path) -> None:
    run = make_run(tmp_path, scene="fake")
    with pytest.raises(ConfigError, match="'fake' is no MuJoCo model"):
        run_character(run)

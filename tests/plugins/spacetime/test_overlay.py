"""What is drawn of a run's bounds agrees with the terminations that the environment applies."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from understudy.errors import ConfigError, FileError
from understudy.running.environment import Environment
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import Plugins, installed
from understudy_characters.overlay import Gauge, Overlay, Region
from understudy_spacetime.overlay import BoundsOverlay
from understudy_tensors import rotations

WORLDS, STEPS = 6, 45
SIZES = {"com": 0.12, "root": 0.4, "joints": [[0.0, 0.5], [1.0, 0.9]], "end_effectors": 0.3}
GAUGES = {"com": "centre of mass", "root": "root", "joints": "joints", "end_effectors": "hands and feet"}  # fmt: skip

Tracks = dict[str, np.ndarray]


@pytest.fixture(scope="module")
def episode(plugins: Plugins) -> tuple[dict[str, Any], Tracks, dict[str, np.ndarray]]:
    """Worlds that stumble away from the walk: the configuration, the recorded tracks (T, N, …), and
    by term when each world was out of bounds, (T, N)."""
    sizes = [f"termination.terms.{name}.size={size}" for name, size in SIZES.items()]
    # Bounds only report, so that the worlds go on beyond them.
    overrides = ["experiment=spacetime/walk", *sizes, "evaluation.failures=[]"]
    experiment = load_experiment(overrides, plugins)
    environment = build_environment(
        experiment, num_worlds=WORLDS, episode_seconds=10.0, evaluating=True
    ).environment
    tracks: dict[str, list[np.ndarray]] = {"qpos": [], "reference_qpos": [], "phase": []}
    outside: dict[str, list[np.ndarray]] = {name: [] for name in SIZES}
    environment.reset(0)
    for _ in range(STEPS):
        for name, values in tracks.items():
            values.append(environment.table[name].numpy().copy())
        for name, verdict in verdicts(environment).items():
            outside[name].append(verdict)
        environment.step(0.7 * environment.table["reference_joint_targets"])
    environment.close()
    stacked = {name: np.stack(values) for name, values in tracks.items()}
    return experiment.effective(), stacked, {k: np.stack(v) for k, v in outside.items()}


def verdicts(environment: Environment) -> dict[str, np.ndarray]:
    return {
        term.name: term.function(**environment.table.pick(term.reads), **term.options).numpy()
        for term in environment.parts.terminations
        if term.name in SIZES
    }


def test_is_an_overlay_that_can_be_found(plugins: Plugins) -> None:
    found = plugins.registry.find("overlay", "spacetime/bounds").factory()
    assert isinstance(found, Overlay)


def test_gauges_are_beyond_their_limits_where_the_terminations_fire(
    episode: tuple[dict[str, Any], Tracks, dict[str, np.ndarray]],
) -> None:
    config, tracks, outside = episode
    for name, fired in outside.items():
        assert fired.any(), f"{name} is never out of bounds, so this would test nothing"
        assert not fired.all()
    for world in range(WORLDS):
        marks = BoundsOverlay().marks(
            config, {k: v[:, world] for k, v in tracks.items()}, installed().registry
        )
        gauges = {mark.name: mark for mark in marks if isinstance(mark, Gauge)}
        assert gauges.keys() == set(GAUGES.values())
        for name, fired in outside.items():
            gauge = gauges[GAUGES[name]]
            sure = np.abs(gauge.values - gauge.limits) > 1e-4  # the environment has float32
            assert sure.mean() > 0.9
            np.testing.assert_array_equal(
                (gauge.values > gauge.limits)[sure], fired[sure, world], err_msg=name
            )


def test_regions_hold_their_points_where_the_gauges_say_so(
    episode: tuple[dict[str, Any], Tracks, dict[str, np.ndarray]],
) -> None:
    config, tracks, _ = episode
    marks = BoundsOverlay().marks(
        config, {k: v[:, 0] for k, v in tracks.items()}, installed().registry
    )
    regions = {mark.name: mark for mark in marks if isinstance(mark, Region)}
    gauges = {mark.name: mark for mark in marks if isinstance(mark, Gauge)}
    assert {name: region.shape for name, region in regions.items()} == {
        "centre of mass": "box",
        "hands and feet": "ball",
    }
    for name, region in regions.items():
        away = region.points - region.centres
        norm = np.abs(away).max(-1) if region.shape == "box" else np.linalg.norm(away, axis=-1)
        np.testing.assert_allclose(norm.max(axis=1), gauges[name].values, atol=1e-9)
        np.testing.assert_array_equal(region.sizes, gauges[name].limits)


def test_a_character_on_its_reference_is_in_the_middle_of_all_regions(
    episode: tuple[dict[str, Any], Tracks, dict[str, np.ndarray]],
) -> None:
    config, tracks, _ = episode
    reference = tracks["reference_qpos"][:, 0]
    own = {"qpos": reference, "reference_qpos": reference, "phase": tracks["phase"][:, 0]}
    for mark in BoundsOverlay().marks(config, own, installed().registry):
        if isinstance(mark, Gauge):
            assert mark.values.max() < 1e-3
        else:
            np.testing.assert_allclose(mark.points, mark.centres, atol=1e-6)


def test_hands_and_feet_are_where_the_reference_has_them(
    episode: tuple[dict[str, Any], Tracks, dict[str, np.ndarray]],
) -> None:
    """The same centres in a world that is turned and shifted are turned and shifted with it."""
    config, tracks, _ = episode
    turn = rotations.from_heading(torch.tensor(2.0, dtype=torch.float64))
    shift = torch.tensor([3.0, -1.0, 0.0], dtype=torch.float64)

    def moved(qpos: np.ndarray) -> np.ndarray:
        whole = torch.from_numpy(qpos.astype(np.float64))
        whole[:, :3] = rotations.rotate(turn, whole[:, :3]) + shift
        whole[:, 3:7] = rotations.multiply(turn, whole[:, 3:7])
        return whole.numpy()

    here = {name: track[:, 0] for name, track in tracks.items()}
    there = here | {name: moved(here[name]) for name in ("qpos", "reference_qpos")}
    before, after = (
        [
            mark
            for mark in BoundsOverlay().marks(config, given, installed().registry)
            if isinstance(mark, Region)
        ]
        for given in (here, there)
    )
    for one, other in zip(before, after, strict=True):
        for points in ("centres", "points"):
            expected = rotations.rotate(turn, torch.from_numpy(getattr(one, points))) + shift
            np.testing.assert_allclose(getattr(other, points), expected.numpy(), atol=1e-6)


def test_a_size_over_phase_needs_the_phase(
    episode: tuple[dict[str, Any], Tracks, dict[str, np.ndarray]],
) -> None:
    config, tracks, _ = episode
    without = {name: tracks[name][:, 0] for name in ("qpos", "reference_qpos")}
    with pytest.raises(FileError, match="has no 'phase'"):
        BoundsOverlay().marks(config, without, installed().registry)


def marks_of(terms: dict[str, Any], **tracks: np.ndarray) -> list[Gauge | Region]:
    scene = {"name": "character", "character": "humanoid"}
    return list(
        BoundsOverlay().marks(
            {"scene": scene, "termination": {"terms": terms}}, tracks, installed().registry
        )
    )


def test_draws_nothing_of_other_runs() -> None:
    qpos = np.zeros((3, 43))
    terms = {"fall": {"name": "characters/fall"}, "com": None}
    assert marks_of(terms, qpos=qpos, reference_qpos=qpos) == []
    assert marks_of({"com": {"name": "spacetime/com_bound"}}, qpos=qpos) == []


def test_a_size_that_is_not_given_is_the_default() -> None:
    qpos = np.zeros((3, 43))
    qpos[:, 3] = 1.0
    found = marks_of({"com": {"name": "spacetime/com_bound"}}, qpos=qpos, reference_qpos=qpos)
    assert [mark.limits.tolist() for mark in found if isinstance(mark, Gauge)] == [[0.2] * 3]


def test_recordings_and_configurations_that_do_not_fit_are_refused() -> None:
    qpos = np.zeros((3, 43))
    with pytest.raises(FileError, match=r"qpos is \(3, 7\)"):
        marks_of({"com": {"name": "spacetime/com_bound"}}, qpos=qpos, reference_qpos=qpos[:, :7])
    joints = {"name": "spacetime/joint_bound", "joints": ["tail"]}
    with pytest.raises(ConfigError, match="no joint 'tail'"):
        marks_of({"joints": joints}, qpos=qpos, reference_qpos=qpos)

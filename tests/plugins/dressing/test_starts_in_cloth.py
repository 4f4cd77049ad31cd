"""Where the person would begin inside the cloth."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch
from scipy.spatial import ConvexHull

from understudy.command.cli import main
from understudy.errors import ConfigError
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy_dressing.body import limb
from understudy_dressing.initial_states import Track
from understudy_dressing.person import PersonScene, depth_in, neutral_pose
from understudy_dressing.sleeve import SleeveScene
from understudy_dressing.state import passes


def neutral_depth() -> Callable[..., np.ndarray]:
    person = PersonScene(PersonScene.Options())
    return depth_in(person, neutral_pose(person).numpy())


def test_depth_in_the_neutral_person() -> None:
    """The upper arm hangs from the shoulder; its radius falls from 65 to 50 mm over 30 cm."""
    depth = neutral_depth()
    points = np.array([[0, -0.21, -0.15], [0.1, -0.21, -0.15], [1.0, 0, 0], [0, 0, 0.325]])
    found = depth(points)
    assert found[0] == pytest.approx(0.0575, abs=1e-3)
    assert found[1] == pytest.approx(0.0575 - 0.1, abs=1e-3)
    assert found[2] < -0.8
    assert found[3] == pytest.approx(0.10), "the middle of the head's upper sphere"


@pytest.mark.parametrize("near", [0.0, 0.02])
def test_who_asks_for_what_is_near_hears_the_same_of_it(near: float) -> None:
    """And of nothing else: how deep a point is, the person being there or not, decides what is drawn over and refused."""
    depth = neutral_depth()
    points = np.random.default_rng(1).uniform([-0.2, -0.5, -0.6], [0.3, 0.5, 0.5], (20_000, 3))
    every, some = depth(points), depth(points, near=near)
    close = every > -near
    assert 500 < close.sum() < 15_000
    np.testing.assert_allclose(some[close], every[close], rtol=0, atol=1e-15)
    assert (some[~close] <= every[~close] + 1e-15).all()
    assert np.isneginf(some).sum() > 2_000
    assert np.isneginf(depth(points + 5.0, near=near)).all()


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("initial_states.seconds=1e-6", r"initial_states\.seconds=1e-06 is not possible: .* and 2 are the most; give at least 0\.38"),
        ("scenes.cloth.fabric.gap=1", r"fabric\.gap=1\.0 .* at most 0\.05"),
        ("scenes.cloth.fabric.thickness=1", r"fabric\.thickness=1\.0 .* at most 0\.2"),
    ],
)  # fmt: skip
def test_what_no_gripper_or_cloth_does_is_refused(words: str, sentence: str) -> None:
    with pytest.raises(ConfigError, match=sentence):
        load_experiment(["experiment=dressing/sleeve_small", words])


def test_the_track_ends_above_the_shoulder() -> None:
    """Section 8.3: the gown moves toward the location of the shoulder when the task began."""
    model = PersonScene(PersonScene.Options()).spec().compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    shoulder = data.body(limb("right")[4][0]).xpos
    assert Track.Options().end[:2] == pytest.approx(shoulder[:2])


@pytest.mark.parametrize(("held", "deepest"), [(20.0, -0.02), (75.0, 0.02)])
def test_what_is_held_passes_the_person(held: float, deepest: float) -> None:
    """Vertices that are held yield to nobody. Held along the top they pass above the shoulder; the upper half of the
    entrance would go into the collarbone, and the arm could never be in by three quarters."""
    scene = SleeveScene(SleeveScene.Options(held=held))
    vertices = scene.mesh[0][np.asarray(scene.model().grips[0].vertices)]
    depth = neutral_depth()
    way = [np.add(Track.Options().end, (x, 0.0, 0.0)) for x in np.linspace(0.0, 0.3, 31)]
    found = max(float(depth(vertices + place).max()) for place in way)
    assert found == pytest.approx(deepest, abs=0.012)


def test_the_entrance_goes_around_a_shoulder_that_is_raised() -> None:
    """Across the arm, the shortest loop from the strip that is held around the shoulder's joint (65 mm and the gap of 3 mm): longer than
    the entrance unless the shoulder is raised by a centimetre, and above three it is in the strip. Where the sleeve's axis comes to
    the shoulder (`sleeve_level`) the entrance fits as the shoulder is, and the strip passes above it."""
    options = SleeveScene.Options()
    scene = SleeveScene(options)
    held = np.asarray(scene.model().grips[0].vertices)
    first = scene.mesh[0][held[held < scene.loops["entrance"].size]]
    angle = 2 * np.pi * np.arange(720) / 720
    joint = 0.068 * np.stack([np.cos(angle), np.sin(angle)], axis=1)

    def loop(end: float, raised: float) -> float:
        strip = np.add(first[:, 1:], (0.0, end))
        points = np.concatenate([np.add(joint, (0.0, raised)), strip])
        around = points[ConvexHull(points).vertices]
        return float(np.linalg.norm(around - np.roll(around, -1, axis=0), axis=1).sum())

    high = Track.Options().end[2]
    assert loop(high, 0.0) == pytest.approx(0.476, abs=0.002)
    assert loop(high, 0.0) > options.around > loop(high, 0.012)
    assert high - 0.068 == pytest.approx(0.032)
    track = load_experiment(["experiment=dressing/sleeve_level"]).need("initial_states").options
    assert isinstance(track, Track.Options)
    level = track.end[2]
    assert track.end[:2] == Track.Options().end[:2]
    assert level == pytest.approx(options.around / (2 * np.pi), abs=0.001)
    assert loop(level, 0.0) == pytest.approx(0.434, abs=0.003)
    strip = np.add(first[:, 1:], (0.0, level))
    assert np.linalg.norm(strip, axis=1).min() > 0.068


def test_three_quarters_are_in_only_near_the_shoulder() -> None:
    """Of 0.975 m from the fingertip to the neck, 0.765 m are before the shoulder: success (0.75) is 3.4 cm before it, a
    track that ends 10 cm before it gives 0.68."""
    bones = np.array(
        [[0.765, 0, 0], [0.69, 0, 0], [0.65, 0, 0], [0.30, 0, 0], [0, 0, 0], [0, 0.21, 0]]
    )
    angle = 2 * np.pi * np.arange(24) / 24
    ring = np.stack([0 * angle, 0.073 * np.cos(angle), 0.073 * np.sin(angle)], axis=1)

    def progress(x: float) -> float:
        loop = torch.tensor(np.add(ring, (x, 0, 0)))[None]
        through, depth = passes(torch.tensor(bones)[None], loop)
        assert through[0].sum() == 1
        return float(depth[through]) / 0.975

    assert progress(0.1) == pytest.approx(0.682, abs=0.001)
    assert progress(0.034) == pytest.approx(0.75, abs=0.001)


def test_noise_that_puts_the_person_into_settled_cloth_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """By 1.4 cm with the 0.01 rad of all tasks, which the cloth's first step undoes; by 6 cm and more with 0.1."""
    pytest.importorskip("potpourri3d", reason="potpourri3d is not installed")
    run = tmp_path / "run"
    words = (
        "device=cpu",
        "simulators.person.name=mujoco",
        "scenes.cloth.edge=0.032",
        "num_worlds=1",
    )
    given = ("train", "experiment=dressing/shirt_grip", *words, "initial_states.noise=0.1", f"run.dir={run}")  # fmt: skip
    assert main(list(given)) == 2
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert "with a noise of 0.1 rad the person begins" in error
    assert "cm inside the cloth: give it less." in error
    assert not run.exists(), "before anything is written"


@pytest.mark.parametrize(
    ("low", "high"),
    [
        ("[-0.3,-0.21,0.1]", "[-0.3,-0.21,0.1]"),
        ("[-0.4,-0.4,-0.2]", "[0.8,0.2,0.2]"),
    ],
    ids=["all", "some"],
)
def test_cloth_that_begins_in_the_person_is_refused(
    low: str, high: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("potpourri3d", reason="potpourri3d is not installed")
    run = tmp_path / "run"
    words = (f"initial_states.low={low}", f"initial_states.high={high}", "num_worlds=2")
    assert main(["train", "experiment=dressing/sleeve_small", *words, f"run.dir={run}"]) == 2
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert "the cloth begins" in error
    assert "cm inside the person: move low and high away from it." in error
    assert not run.exists(), "before anything is written"


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ([], ""),
        (["episode.seconds=7"], r"go on after the 6 s .* past the shoulder. Set initial_states.seconds=7,"),
        (["initial_states.seconds=3"], "Episodes of 6 s go on after the 3 s"),
        (["initial_states.seconds=8"], ""),
    ],
)  # fmt: skip
def test_a_sleeve_that_goes_on_past_the_shoulder_is_told(words: list[str], told: str) -> None:
    pytest.importorskip("potpourri3d", reason="potpourri3d is not installed")
    given = ["experiment=dressing/sleeve_small", "num_worlds=1", *words]
    environment = build_environment(load_experiment(given)).environment
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        environment.reset(seed=0)
        environment.reset(seed=0)
    assert len(found) == bool(told), "once"
    assert not told or re.search(told, str(found[0].message))
    environment.close()


def test_noise_counts_where_the_sleeve_begins_away_from_the_person() -> None:
    """The neutral person was looked at alone, so arms began deep in the cloth without a word."""
    pytest.importorskip("potpourri3d", reason="potpourri3d is not installed")
    words = ["experiment=dressing/sleeve_coarse", "device=cpu", "num_worlds=2"]
    sentence = (
        "with a noise of 1 rad the person begins 3 cm inside the cloth: give it less, or move"
    )
    with pytest.raises(ConfigError, match=sentence):
        build_environment(load_experiment([*words, "initial_states.noise=1"]))
    build_environment(load_experiment(words)).environment.close()


def test_a_shirt_whose_sleeve_the_arm_would_begin_through_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In the mouth of a longer sleeve the elbow of the packaged pose is through the cloth before anyone has moved."""
    words = ["experiment=dressing/shirt_sleeve", "+garment=larger_shirt", "initial_states.worn=in_sleeve"]  # fmt: skip
    words += ["device=cpu", "num_worlds=1", "budget.samples=1", "evaluation.final_episodes=1"]
    words += ["simulators.person.name=mujoco", f"run.dir={tmp_path}/run"]
    assert main(["train", *words]) == 2
    said = capsys.readouterr().err
    assert "worn in_sleeve" in said
    assert "left arm" in said
    assert "initial_states.worn" in said
    assert not (tmp_path / "run").exists()

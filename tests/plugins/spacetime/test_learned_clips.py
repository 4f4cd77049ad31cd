"""A clip written back from what a run learned, and the picture of evolved initial states."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from understudy.command.cli import main
from understudy.errors import FileError
from understudy.records import runs
from understudy.records.runs import Run
from understudy.running.training import Training
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import Plugins, installed
from understudy_characters.reference import ReferenceMotion
from understudy_characters.scene import CharacterScene
from understudy_motion.clip import Clip, cycle_transform, velocities
from understudy_motion.library import read_clip
from understudy_report.markup import check_markup
from understudy_spacetime.learned import cycle_starts, learned_clip
from understudy_spacetime.section import EvolvedSection, evolution_of
from understudy_tensors.rotations import from_heading, multiply

WALK = ("experiment=spacetime/walk", "num_worlds=4", "learner.rollout_steps=64")


def test_where_cycles_begin() -> None:
    times = torch.arange(60, dtype=torch.float64) / 30
    phase = (times / 0.7 + 0.3) % 1.0
    expected = (torch.tensor([1.0, 2.0, 3.0]) - 0.3) * 0.7
    torch.testing.assert_close(cycle_starts(phase, times)[:2], expected[:2].double())
    assert len(cycle_starts(phase[:10], times[:10])) == 0


@pytest.fixture
def walked(tmp_path: Path, plugins: Plugins) -> Path:
    """A run folder of 3.5 s on the reference, but for a wobble that is less in its second cycle."""
    experiment = load_experiment([*WALK, f"run.dir={tmp_path / 'run'}"])
    run = runs.create(experiment, [], {"motion": {"licence": "CC0-1.0"}})
    run.unlock()
    scene = CharacterScene(CharacterScene.Options("humanoid"))
    clip: Clip = plugins.registry.find("clip", "walk").factory()
    reference = ReferenceMotion(clip, scene.character, scene.layout, control_dt=1 / 30)
    times = torch.arange(105) / 30 + 0.4
    found = reference.sample(times)
    qpos = found["reference_qpos"].clone()
    cycle = torch.floor(times / clip.duration)
    wobble = torch.where(cycle == 2, 0.005, 0.08) * torch.sin(17.0 * times)
    root = multiply(from_heading(wobble), qpos[:, 3:7])
    qpos[:, 3:7], qpos[:, 2] = root, qpos[:, 2] + 0.01 * torch.sin(5.0 * times)
    np.savez(
        run.path / "recording.npz", qpos=qpos.numpy(), phase=found["phase"].numpy(),
        reference_qpos=found["reference_qpos"].numpy(), control_dt=1 / 30, first_episode=105,
    )  # fmt: skip
    return run.path


def test_the_cycle_that_closes_best_is_written_as_a_loop(
    walked: Path, tmp_path: Path, plugins: Plugins, capsys: pytest.CaptureFixture[str]
) -> None:
    walk: Clip = plugins.registry.find("clip", "walk").factory()
    clip = learned_clip(str(walked))
    assert clip.loop
    assert clip.licence == "CC0-1.0"
    assert clip.duration == pytest.approx(walk.duration, abs=0.002)
    mine, its = cycle_transform(clip), cycle_transform(walk)
    assert mine.heading == pytest.approx(its.heading, abs=0.02)
    assert mine.displacement.norm() == pytest.approx(float(its.displacement.norm()), rel=0.02)
    linear, _ = velocities(clip)
    assert (linear[0] - linear[-1]).norm() < 0.1, "and no jump across its seam"
    out = tmp_path / "clip.npz"
    assert main(["motion", "learned", str(walked), str(out)]) == 0
    assert "one cycle of" in capsys.readouterr().out
    chosen = [*WALK, f"motion.file={out}"]
    training = Training(load_experiment(chosen)).prepare()  # it is learned from in its place
    assert training.iterate()["samples"] == 256
    training.close()


def test_it_is_on_the_terms_of_all_that_is_behind_its_run(walked: Path, tmp_path: Path) -> None:
    """It was on those of its own reference alone."""
    info = json.loads((walked / "run.json").read_text())
    behind = [{"clip": "fight", "licence": "CC BY-NC 4.0", "attribution": "Fought by Cid."}]
    info["sources"]["start"] = {"run": "runs/a", "sources": {}, "behind": behind}
    (walked / "run.json").write_text(json.dumps(info))
    assert main(["motion", "learned", str(walked), str(tmp_path / "clip.npz")]) == 0
    found = read_clip(tmp_path / "clip.npz", installed().registry)
    assert "CC0-1.0 (clip " in found.licence
    assert "CC BY-NC 4.0 (clip fight)" in found.licence
    assert found.attribution.startswith("Fought by Cid.")


def test_too_short_a_recording_says_what_to_do(walked: Path) -> None:
    with np.load(walked / "recording.npz") as arrays:
        tracks = {name: arrays[name] for name in arrays.files}
    np.savez(walked / "recording.npz", **{**tracks, "first_episode": 40})
    with pytest.raises(FileError, match=r"before a whole cycle.*understudy render"):
        learned_clip(str(walked))


@pytest.fixture(scope="module")
def evolved(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run whose initial states have evolved for an iteration."""
    folder = tmp_path_factory.mktemp("evolved") / "run"
    states = ["initial_states=spacetime/evolution", "initial_states.size=8"]
    experiment = load_experiment([*WALK, *states, f"run.dir={folder}"])
    training = Training(experiment).prepare()
    training.attach(runs.create(experiment, [], {}))
    training.iterate()
    training.save()
    training.close()
    assert training.run is not None
    training.run.unlock()
    return runs.open_run(folder)


def test_evolved_states_are_drawn_beside_the_reference(evolved: Run) -> None:
    html = EvolvedSection().html(evolved)
    assert html is not None
    check_markup(html)
    assert html.count("<circle") == 8
    found = evolution_of(evolved)
    assert found.distances.shape == (20, 8)
    assert 0.0 < found.distances.max() < 1.0


def test_states_that_have_not_evolved_are_the_reference(tmp_path: Path) -> None:
    states = ["initial_states=spacetime/evolution", "initial_states.size=8"]
    experiment = load_experiment([*WALK, *states, f"run.dir={tmp_path / 'run'}"])
    training = Training(experiment).prepare().attach(runs.create(experiment, [], {}))
    training.save()
    training.close()
    found = evolution_of(runs.open_run(tmp_path / "run"))
    assert found.distances.max() < 2e-3


def test_other_runs_have_no_such_section(walked: Path) -> None:
    assert EvolvedSection().html(runs.open_run(walked)) is None

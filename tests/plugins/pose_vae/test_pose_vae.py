"""The pose auto-encoder as a run, and what other tasks take from it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from spoiled_runs import spoiled
from worlds import assert_same_state

from understudy.command.cli import main
from understudy.errors import FileError, RunError, UnderstudyError
from understudy.records.runs import Run
from understudy.running.training import Training
from understudy.setup.composition import load_experiment, replaced
from understudy.testing import check_environment
from understudy_motion.readers import npz
from understudy_pose_vae.job import LearnPoses, PoseVAE, explained, needed, network_of
from understudy_pose_vae.report import PosesSection
from understudy_pose_vae.terms import learned_poses, naturalness
from understudy_reinforcement.job import Reinforcement
from understudy_tensors import rotations

SMALL = (
    "experiment=pose_vae/generated",
    "job.clips=[walk,run,hop]",
    "job.latent=4",
    "job.hidden=[64,64]",
    "job.batch=32",
    "job.learning_rate=2e-3",
    "evaluation.episodes=32",
    "evaluation.final_episodes=64",
)
TASK = (
    "task=spacetime/walk",
    "policy=mlp",
    "learner=ppo",
    "num_worlds=4",
    "learner.rollout_steps=64",
    "evaluation.episodes=2",
    "evaluation.final_episodes=2",
    "evaluation.seconds=0.2",
    "actuation=pose_vae/offset",
)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("poses") / "run"
    only = ("job.clips=[walk]", "budget.samples=40000", f"run.dir={folder}")
    assert main(["train", *replaced(SMALL, only)]) == 0
    return folder


def learner(*more: str) -> Training:
    return Training(load_experiment([*SMALL, *more])).prepare()


def in_task(run: Path, *more: str) -> Training:
    return Training(load_experiment([*TASK, f"actuation.run={run}", *more])).prepare()


def test_held_out_poses_are_rebuilt(run: Path) -> None:
    """Of the walk's end, far better than by the mean pose, which explains 0."""
    found = json.loads((run / "evaluation.json").read_text())["measures"]
    assert found["explained_variance"]["mean"] > 0.5
    assert found["rotation_error"]["mean"] < 15
    assert found["position_error"]["mean"] < 10


def test_no_held_out_pose_is_learned_from() -> None:
    job = learner().job
    assert isinstance(job, LearnPoses)
    apart = torch.cdist(job.poses.held_out_features, job.poses.features).amin(1)
    assert (apart > 0).float().mean() > 0.95
    assert 0 < len(job.poses.held_out_poses) < len(job.poses.poses)


def test_it_continues_exactly() -> None:
    training = learner()
    training.iterate()
    other = learner()
    for _ in range(3):
        other.iterate()
    other.load_state_dict(training.state_dict())
    assert training.iterate()["loss"] == other.iterate()["loss"]
    assert_same_state(training.state_dict(), other.state_dict())


def test_the_loss_is_equation_4_2() -> None:
    torch.manual_seed(0)
    network = PoseVAE(7, 2, (8, 8))
    x, noise = torch.randn(5, 7), torch.randn(5, 2)
    mean, log_variance = network.encode(x)
    given = torch.distributions.Normal(mean, (0.5 * log_variance).exp())
    divergence = torch.distributions.kl_divergence(given, torch.distributions.Normal(0.0, 1.0))
    made = network.decoder(mean + given.scale * noise)
    expected = (made - x).square().mean() + 0.3 * divergence.sum(1).mean()
    loss, error = network.loss(x, noise, 0.3)
    assert torch.allclose(loss, expected, atol=1e-6)
    assert torch.allclose(error, (made - x).square().mean())


def test_principal_components_say_how_many_numbers_are_needed() -> None:
    x = torch.randn(2000, 3, generator=torch.Generator().manual_seed(0)) * torch.tensor([3.0, 2, 1])
    share = explained(x)
    assert torch.allclose(share, torch.tensor([9, 13, 14]).double() / 14, atol=0.03)
    assert needed(share, 0.85) == 2
    assert needed(share, 0.5) == 1


def test_the_report_shows_poses(run: Path) -> None:
    html = PosesSection().html(Run(run, {}))
    assert html is not None
    assert html.count("<svg") == 2 + 4
    assert "Learned from" in html
    assert "Poses drawn from the codes" in (run / "report.html").read_text()


def test_a_task_takes_it_by_a_word(run: Path) -> None:
    training = in_task(run)
    assert all(value == value for value in training.iterate().values())
    job = training.job
    assert isinstance(job, Reinforcement)
    check_environment(job.environment)


def test_no_action_is_the_mean_pose_and_offsets_are_added(run: Path) -> None:
    job = in_task(run).job
    assert isinstance(job, Reinforcement)
    actuation = job.environment.parts.actuation.part
    nothing = torch.zeros(4, 4 + 28)
    mean = actuation.control(nothing)
    assert torch.equal(mean, mean[:1].expand(4, 28))
    assert mean.abs().max() < 3.2
    offset = nothing.clone()
    offset[:, 4 + 7] = 0.25
    assert torch.allclose(
        actuation.control(offset) - mean, 2 * offset[:, 4:], atol=1e-5
    )  # offset_scale: 2 rad for one unit
    kept = actuation.advance(offset)
    assert torch.allclose(kept["offset_norm"], torch.full((4,), 0.5))
    code = nothing.clone()
    code[:, 0] = 2.0
    assert (actuation.control(code) - mean).abs().max() > 0.02


def test_offsets_are_limited_together(run: Path) -> None:
    job = in_task(run, "actuation.offset_limit=3.0").job
    assert isinstance(job, Reinforcement)
    actuation = job.environment.parts.actuation.part
    action = torch.zeros(4, 32)
    action[:, 4:] = torch.tensor([0.01, 0.1, -1.0, 5.0])[:, None]
    kept = actuation.advance(action)
    assert torch.allclose(kept["offset_norm"], torch.tensor([0.56, 3.0, 3.0, 3.0]), atol=1e-5)


def test_targets_are_cut_to_ranges(run: Path) -> None:
    ranges = "{chest: [[-0.1, 0.2], [0.0, 0.3]], left_knee: [[0.5, 0.5]]}"
    job = in_task(run, f"+actuation.ranges={ranges}").job
    assert isinstance(job, Reinforcement)
    actuation = job.environment.parts.actuation.part
    offsets = torch.full((4, 28), 5.0)
    offsets[:2] *= -1.0
    targets = actuation.control(torch.cat([torch.zeros(4, 4), offsets], dim=1))
    scene = job.environment.parts.simulator
    model = scene.model  # type: ignore[attr-defined]
    column = {model.actuator(i).name: i for i in range(model.nu)}
    for name, expected in {
        "chest_x": (-0.1, 0.2), "chest_y": (0.0, 0.3), "left_knee": (0.5, 0.5),
    }.items():  # fmt: skip
        assert targets[[0, 2], column[name]].tolist() == pytest.approx(expected)
    assert targets[2, column["chest_z"]] > 9, "not limited"


def test_targets_are_kept_from_limits_only_where_a_joint_is_beyond_them(run: Path) -> None:
    """The rule of the authors' release: a joint within its limits may be asked for anything."""
    job = in_task(run, "+actuation.limits={left_knee: [[0.0, 2.0]]}").job
    assert isinstance(job, Reinforcement)
    check_environment(job.environment)
    actuation = job.environment.parts.actuation.part
    assert (actuation.reads, actuation.every) == (("actuator_length",), "period")
    model = job.environment.parts.simulator.model  # type: ignore[attr-defined]
    knee = model.actuator("left_knee").id
    asked = torch.zeros(4, 4 + 28)
    asked[:2, 4 + knee], asked[2:, 4 + knee] = -3.0, 3.0
    angles = torch.zeros(4, 28)
    angles[:, knee] = torch.tensor([-0.1, 0.1, 1.9, 2.1])
    targets = actuation.control(asked, actuator_length=angles)[:, knee]
    assert targets[[0, 3]].tolist() == [0.0, 2.0]
    assert targets[1] < -5
    assert targets[2] > 5


@pytest.mark.parametrize(
    ("ranges", "sentence"),
    [
        ("{tail: [[0.0, 1.0]]}", "there is no joint 'tail'"),
        ("{left_knee: [[1.0, 0.0]]}", "the first is the lower one"),
        ("{left_knee: [[0.0, 1.0], [0.0, 1.0]]}", "servos turn left_knee about 1"),
    ],
)
def test_ranges_that_cannot_be_are_one_sentence(run: Path, ranges: str, sentence: str) -> None:
    with pytest.raises(UnderstudyError, match=sentence):
        in_task(run, f"+actuation.ranges={ranges}")


def test_naturalness_is_equation_4_3() -> None:
    norm = torch.tensor([0.0, 12.0, 24.0, 48.0, 100.0])
    assert torch.allclose(naturalness(norm), torch.tensor([1.0, 0.9375, 0.75, 0.0, 0.0]))
    scheduled = naturalness(norm, torch.full((5,), 24.0))
    assert torch.allclose(scheduled, torch.tensor([1.0, 0.75, 0.0, 0.0, 0.0]))


def test_naturalness_and_distance_are_terms_of_a_task(run: Path) -> None:
    training = in_task(
        run,
        "+reward.terms.natural={name: pose_vae/naturalness, limit: 15.0}",
        f"+measure.unusual={{name: pose_vae/distance, run: '{run}', reduce: mean}}",
    )
    training.iterate()
    evaluation = training.job.evaluate("here", 2)
    assert 0 < evaluation.measures["unusual"].mean < 60


def test_jerk_is_the_third_derivative(run: Path) -> None:
    """Of positions that are cubic in time, from the third control period on; uniform motion has none."""
    job = in_task(run, "+memory.jerk={name: pose_vae/jerk}").job
    assert isinstance(job, Reinforcement)
    memory, dt = job.environment.parts.memories["jerk"].part, job.environment.control_dt
    bodies = job.environment.table["xpos"].shape[1]
    rate = torch.tensor([0.0, 50.0, -300.0, 20.0], dtype=torch.float64).view(4, 1, 1)

    def at(step: int) -> dict[str, torch.Tensor]:
        time = step * dt
        place = torch.tensor([1.0, 0.0, 0.0]) * (1.0 + 2.0 * time + rate * time**3 / 6)
        return {"xpos": place.expand(4, bodies, 3), "episode_step": torch.full((4,), step)}

    kept = memory.begin(**at(0))
    for step in range(1, 9):
        kept = memory.advance(kept, **at(step))
        expected = rate.flatten().abs() * (step >= 3)
        torch.testing.assert_close(kept["jerk"], expected, atol=1e-6, rtol=1e-6)


def test_a_run_keeps_the_auto_encoder_it_acts_by(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It is evaluated after that one's folder has gone, and how natural it is can be asked later."""
    poses, own = tmp_path / "poses", tmp_path / "own"
    shutil.copytree(run, poses)
    quick = ("budget.samples=256", "run.video_seconds=0", f"run.dir={own}")
    assert main(["train", *TASK, f"actuation.run={poses}", *quick]) == 0
    shutil.rmtree(poses)
    before = (own / "evaluation.json").read_text()
    words = ["evaluation.final_episodes=3", "evaluation.seconds=0.1"]
    assert main(["pose_vae", "naturalness", str(run), str(own), *words]) == 0
    found = json.loads((own / "naturalness.json").read_text())
    assert found["episodes"] == 3
    distance, jerk = (found["measures"][name]["mean"] for name in ("pose_distance", "jerk"))
    assert 0 < distance < 90
    assert jerk > 0
    row = capsys.readouterr().out.splitlines()[-1]
    assert row.startswith(f"{distance:.1f} [")
    assert row.endswith(str(own))
    assert (own / "evaluation.json").read_text() == before


def test_what_has_no_character_is_not_judged_by_poses(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It ended in a traceback, and left a judgement of another kind."""
    shutil.copytree(run, tmp_path / "poses")
    assert main(["pose_vae", "naturalness", str(run), str(tmp_path / "poses")]) == 2
    told = capsys.readouterr()
    assert "poses is judged by figures of its own, as no character moves in it" in told.err
    assert told.out == ""
    assert not (tmp_path / "poses" / "naturalness.json").exists()


def test_a_known_pose_is_at_no_distance(run: Path) -> None:
    job = in_task(run, f"+measure.unusual={{name: pose_vae/distance, run: '{run}'}}").job
    assert isinstance(job, Reinforcement)
    measure = next(m for m in job.environment.parts.measures if m.name == "unusual").function
    poses = torch.from_numpy(np.load(run / "poses.npy")[:5].astype(np.float32))
    assert measure(rotations.normalize(poses)).max() < 0.1
    turn = rotations.from_axis_angle(torch.tensor([1.0, 0.0, 0.0]), torch.tensor(3.0))
    assert measure(rotations.multiply(turn, poses)).min() > 5


@pytest.mark.parametrize(
    "poses",
    [
        np.full((3, 14, 4), np.nan, np.float16), np.zeros((3, 14, 4), np.float16),
        np.full((3, 14, 4), 3e38, np.float32), np.zeros((0, 14, 4), np.float16),
        np.ones((3, 14, 3), np.float16), np.ones(4), np.ones((3, 14, 4), np.int64),
        np.array([{}]), b"", b"PK", None,
    ],
    ids=[
        "nan", "zero", "large", "none", "shape", "dimensions", "integers", "objects", "empty",
        "archive", "header",
    ],
)  # fmt: skip
def test_poses_of_strangers_are_data(tmp_path: Path, poses: Any) -> None:
    file = tmp_path / "poses.npy"
    if isinstance(poses, bytes):
        file.write_bytes(poses)
    elif poses is None:
        with open(file, "wb") as stream:
            header = {"descr": "<f4", "fortran_order": False, "shape": (10**11, 14, 4)}
            np.lib.format.write_array_header_1_0(stream, header)
            stream.write(bytes(1000))
    else:
        np.save(file, poses)
    with pytest.raises(RunError, match=r"poses\.npy is damaged: .* train the auto-encoder again"):
        learned_poses(file, 14)


def test_damaged_and_missing_poses_are_one_sentence(run: Path, tmp_path: Path) -> None:
    shutil.copytree(run, tmp_path / "run")
    words = f"+measure.unusual={{name: pose_vae/distance, run: '{tmp_path / 'run'}'}}"
    file = tmp_path / "run" / "poses.npy"
    np.save(file, np.load(file)[:, :3])
    with pytest.raises(RunError, match=r"poses\.npy is damaged: it should hold poses of"):
        in_task(run, words)
    file.unlink()
    with pytest.raises(RunError, match="has no poses to compare with; finish it first"):
        in_task(run, words)


def test_pictures_no_larger_than_a_clip(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(npz, "MAX_ARRAY_BYTES", 1000)
    with pytest.raises(FileError, match="the arrays are larger than"):
        PosesSection().html(Run(run, {}))


def test_a_stronger_figure_of_the_same_joints_takes_it(run: Path) -> None:
    training = in_task(run, "scene.character=jumper")
    assert training.iterate()["samples"] == 256


@pytest.mark.parametrize(
    ("overrides", "sentence"),
    [
        (
            ("job.clips=[no_such_clip]",),
            "No motion clip 'no_such_clip'.*Nor is there a folder of this name",
        ),
        (("job.clips=[]",), "job.clips=\\(\\) is not possible"),
        (("job.held_out=1.0",), "job.held_out=1.0 is not possible"),
    ],
)
def test_bad_clips_are_one_sentence(overrides: tuple[str, ...], sentence: str) -> None:
    with pytest.raises(UnderstudyError, match=sentence) as error:
        learner(*overrides)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("network", [None, 3, {"code_mean": 3}], ids=str)
def test_an_auto_encoder_without_its_network_is_refused(
    network: Any, run: Path, tmp_path: Path
) -> None:
    with pytest.raises(UnderstudyError, match="is of no pose auto-encoder"):
        in_task(spoiled(run, tmp_path / "run", network=network))


def test_a_run_of_another_kind_is_refused(run: Path, tmp_path: Path) -> None:
    assert (
        main(["train", "experiment=miniature/poses", "budget.samples=256", f"run.dir={tmp_path}/m"])
        == 0
    )
    with pytest.raises(UnderstudyError, match="trained no pose auto-encoder"):
        in_task(tmp_path / "m")


def test_the_authors_clips(tmp_path: Path) -> None:
    """As many poses as the thesis says, and 13 components cover 85 % of their variance to a percent."""
    import os

    if "UNDERSTUDY_DATA" not in os.environ:
        pytest.skip("no recorded clips: UNDERSTUDY_DATA is not set")
    job = Training(load_experiment(["experiment=pose_vae/poses"])).job
    assert isinstance(job, LearnPoses)
    assert len(job.poses.poses) + len(job.poses.held_out_poses) == 20_230
    assert float(explained(job.poses.features)[12]) == pytest.approx(0.85, abs=0.01)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda state: state.pop("code_mean"), "it has no codes"),
        (lambda state: state.update(code_mean=torch.zeros(2, 2)), "it has no codes"),
        (lambda state: state.pop("encoder.0.bias"), "'network/encoder.0.bias'"),
        (
            lambda state: state.update({"encoder.0.bias": torch.zeros(7)}),
            "'network/encoder.0.bias'",
        ),
        (lambda state: state["encoder.0.bias"].fill_(torch.nan), "'network/encoder.0.bias'"),
    ],
)
def test_networks_of_strangers(change: Any, says: str) -> None:
    """One that does not fit, or is no number, is refused."""
    options: Any = SimpleNamespace(hidden=(8,))
    features: Any = SimpleNamespace(size=5)
    state = {k: v.clone() for k, v in PoseVAE(5, 3, (8,)).state_dict().items()}
    assert len(network_of({"network": state}, options, features).code_mean) == 3
    change(state)
    with pytest.raises(RunError, match=says):
        network_of({"network": state}, options, features)


def test_a_batch_may_be_larger_than_the_set() -> None:
    training = learner("job.batch=9999")
    job = training.job
    assert isinstance(job, LearnPoses)
    row = training.iterate()
    assert training.progress.samples == len(job.poses.features)
    assert row["loss"] > 0

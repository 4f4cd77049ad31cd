"""The Gram-matrix style: an auto-encoder trained as a job, and how far motions are from a style."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from spoiled_runs import spoiled

from understudy.command.cli import main
from understudy.errors import ConfigError, RunError
from understudy.inputs import Inputs
from understudy.running.training import Training
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import installed
from understudy.task import Context
from understudy_characters.reference import ReferenceMotion
from understudy_characters.scene import CharacterScene
from understudy_motion import library
from understudy_motion.section import Motion, MotionOptions
from understudy_motion.writing import write_clip
from understudy_reinforcement.job import Reinforcement
from understudy_styles.autoencoder import MotionAutoEncoder, trained_network
from understudy_styles.features import clip_features
from understudy_styles.gram import GramDistance, mean_gram

CLIPS = "job.clips=[walk,run,hop,turn_left]"
DT = 1 / 30


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An auto-encoder of generated clips."""
    folder = tmp_path_factory.mktemp("autoencoder") / "run"
    small = ["job.channels=16", "budget.samples=12800", f"run.dir={folder}"]
    assert main(["train", "experiment=styles/autoencoder", CLIPS, *small]) == 0
    return folder


@pytest.fixture(scope="module")
def context() -> Context:
    return Context(
        0, torch.device("cpu"), 4, control_dt=DT, substeps=20, registry=installed().registry,
        sections={"motion": Motion(MotionOptions(name="run"), installed().registry, Inputs())},
        scene=CharacterScene(CharacterScene.Options("humanoid")),
    )  # fmt: skip


def scene_of(context: Context) -> CharacterScene:
    assert isinstance(context.scene, CharacterScene)
    return context.scene


@pytest.mark.parametrize("network", [None, 3, {}], ids=str)
def test_an_auto_encoder_without_its_network_is_refused(
    network: object, trained: Path, context: Context, tmp_path: Path
) -> None:
    run = spoiled(trained, tmp_path / "run", network=network)
    with pytest.raises(RunError, match=r"The auto-encoder of .* 'network"):
        trained_network(str(run), scene_of(context), installed().registry)


@torch.no_grad()
def test_the_job_learns(trained: Path, context: Context) -> None:
    """Rebuilding windows that it never saw it errs by less than half of what no features at all do."""
    network = trained_network(str(trained), scene_of(context), installed().registry)
    fresh = MotionAutoEncoder(len(network.mean), 16, 9)
    fresh.mean.copy_(network.mean)
    fresh.deviation.copy_(network.deviation)
    clip = library.load("walk", None, installed().registry)
    windows = clip_features(clip, scene_of(context), DT, 32)[None, :32]
    errors = [
        float((n.decoder(n.features(windows)) - n.normalised(windows)).square().mean())
        for n in (network, fresh)
    ]
    assert errors[0] < 0.5 * errors[1]


def test_it_continues_exactly() -> None:
    def made() -> Training:
        chosen = ["experiment=styles/autoencoder", CLIPS, "job.channels=8", "job.batch=8"]
        return Training(load_experiment(chosen)).prepare()

    whole, first, second = made(), made(), made()
    for _ in range(3):
        expected = whole.iterate()
    first.iterate()
    second.load_state_dict(first.state_dict())
    second.iterate()
    assert second.iterate()["loss"] == expected["loss"]
    for training in (whole, first, second):
        training.close()


def test_features_of_a_clip_are_those_of_a_character_that_moves_so(context: Context) -> None:
    chosen = ["experiment=spacetime/walk", "+style=gram", "fields.gram=null", "num_worlds=4"]
    chosen += ["measure.gram_distance=null", "reward.terms.style=null", "motion.name=run"]
    environment = build_environment(load_experiment(chosen)).environment
    environment.reset(0)
    times = environment.table["motion_start"].double()
    scene, clip = scene_of(context), library.load("run", None, installed().registry)
    reference = ReferenceMotion(clip, scene.character, scene.layout, control_dt=DT)
    frames = clip_features(clip, scene, DT, 2)
    assert frames.shape[1] == environment.table["motion_features"].shape[1] == 50
    rows = (times / DT).long()
    nearest = reference.sample((rows * DT).float())
    assert torch.allclose(nearest["reference_root_position"][:, 2], frames[rows, 45], atol=1e-4)
    for world, row in enumerate(rows.tolist()):
        ends = frames[row : row + 2]
        got = environment.table["motion_features"][world]
        low, high = ends.amin(0) - 0.25, ends.amax(0) + 0.25
        assert ((got >= low) & (got <= high)).all()
    environment.close()


def test_a_gram_matrix_is_symmetric_and_knows_no_order(trained: Path, context: Context) -> None:
    network = trained_network(str(trained), scene_of(context), installed().registry)
    frames = clip_features(
        library.load("walk", None, installed().registry), scene_of(context), DT, 24
    )
    gram = network.gram(frames[None, :24])
    torch.testing.assert_close(gram, gram.mT)
    assert torch.linalg.eigvalsh(gram).min() > -1e-4
    cycle = frames[:24].repeat(2, 1)[None]
    torch.testing.assert_close(network.gram(cycle), gram, rtol=0.3, atol=0.3)


def test_the_reference_is_at_1_and_the_style_nearer_0(trained: Path, context: Context) -> None:
    made = GramDistance(GramDistance.Options(run=str(trained), style="hop"), context)
    scene, registry = scene_of(context), installed().registry
    network = trained_network(str(trained), scene, registry)

    def distance(name: str) -> float:
        frames = clip_features(library.load(name, None, registry), scene, DT, 24)
        windows = frames.unfold(0, 24, 1).mT.flip(1)  # the newest first, as the memory has them
        return float(made.compute(windows)["gram_distance"].mean())

    style, reference = distance("hop"), distance("run")
    assert style < 0.5
    assert 0.8 < reference < 1.5
    frames = clip_features(library.load("hop", None, registry), scene, DT, 24)
    assert mean_gram(network, frames, 24).shape == (16, 16)


def test_a_run_keeps_what_its_style_is_read_from(
    trained: Path, context: Context, tmp_path: Path
) -> None:
    registry, clip, run = installed().registry, tmp_path / "style.npz", tmp_path / "run"
    write_clip(library.load("hop", None, registry), clip, registry)
    shutil.copytree(trained, run)
    asked, inputs = GramDistance.Options(run=str(run), style=str(clip)), Inputs()
    first = GramDistance(asked, replace(context, inputs=inputs))
    kept = inputs.copy(tmp_path / "inputs")
    clip.unlink()
    shutil.rmtree(run)
    moved = replace(context, inputs=Inputs(tmp_path / "inputs", kept))
    frames = torch.rand(2, 24, 50)
    torch.testing.assert_close(
        GramDistance(asked, moved).compute(frames), first.compute(frames), rtol=0, atol=0
    )


def test_the_references_own_style_is_no_style(trained: Path, context: Context) -> None:
    with pytest.raises(ConfigError, match="style of the reference itself"):
        GramDistance(GramDistance.Options(run=str(trained), style="run"), context)


def test_what_is_no_auto_encoder_is_refused(
    trained: Path, context: Context, tmp_path: Path
) -> None:
    other = Context(
        0, torch.device("cpu"), 1, control_dt=DT, substeps=20, registry=installed().registry,
        sections=context.sections,
        scene=CharacterScene(CharacterScene.Options("jumper", end_effectors=())),
    )  # fmt: skip
    trained_network(str(trained), scene_of(other), installed().registry)  # the same links
    with pytest.raises(RunError, match="no run"):
        GramDistance(GramDistance.Options(run=str(tmp_path / "none"), style="hop"), context)


def test_a_clip_shorter_than_a_window_is_named(context: Context) -> None:
    clip = library.load("sit", None, installed().registry)
    with pytest.raises(RunError, match=r"frames at 30 Hz.*job\.window"):
        clip_features(clip, scene_of(context), DT, 10_000)
    with pytest.raises(
        RunError, match="Clip sit has"
    ):  # every generated one is of the source 'generated'
        clip_features(clip, scene_of(context), DT, 10_000, "sit")


def test_a_styled_run_trains(trained: Path) -> None:
    chosen = ["experiment=spacetime/walk", "motion.name=run", "+style=gram", "num_worlds=8"]
    chosen += [f"fields.gram.run={trained}", "fields.gram.style=hop", "learner.rollout_steps=8"]
    training = Training(load_experiment([*chosen, "learner.minibatches=4"])).prepare()
    row = training.iterate()
    assert 0.0 < row["reward"] < 1.0
    assert isinstance(training.job, Reinforcement)
    assert training.job.environment.table["feature_history"].shape == (8, 24, 50)
    training.close()


def test_windows_are_as_long_as_the_history(trained: Path, context: Context) -> None:
    """Else the reference is not at 1."""
    options = GramDistance.Options(run=str(trained), style="walk", frames=24)
    fields = GramDistance(options, context)
    size = 3 * len(scene_of(context).layout.link_names) + 5
    fields.compute(torch.zeros(2, 24, size))
    with pytest.raises(ConfigError, match=r"frames=24 is not possible: feature_history has 5"):
        fields.compute(torch.zeros(2, 5, size))

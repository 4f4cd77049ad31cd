"""The command: runs, files and names to files of every format."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from gltf_file import GltfFile
from motion_files import WRITE, walker
from moving_figures import angle_error, position_error
from recorded_runs import croucher_plugins, make_run, record, track

from understudy.command.cli import main
from understudy.errors import FileError
from understudy.setup import plugins
from understudy.setup.registry import Registry
from understudy_characters.character import Character, load_character
from understudy_characters.fitting import fitting_character, worn
from understudy_characters.recording import recorded_clips
from understudy_export import command
from understudy_export.command import timed
from understudy_motion.clip import Clip, cycle_transform, sample
from understudy_motion.reading import UNSAID, ReadOptions, read_clip
from understudy_motion.writers.table import NpzWriter

#: What a BVH file leaves unsaid.
IN_A_BVH = ReadOptions(unit="cm", up="y")


@pytest.fixture(autouse=True)
def registry(monkeypatch: pytest.MonkeyPatch) -> Registry:
    loaded = croucher_plugins()
    for module in (plugins, command):
        monkeypatch.setattr(module, "installed", lambda: loaded)
    return loaded.registry


@pytest.fixture
def run(tmp_path: Path) -> Path:
    made = make_run(tmp_path)
    record(made, reference_qpos=track()[::-1])
    return made


@pytest.fixture
def croucher(registry: Registry) -> Character:
    return load_character("croucher", registry)


def export(*arguments: object) -> int:
    return main(["export", *map(str, arguments)])


def complaint(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    assert export(*arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    return captured.err


# ---------------------------------------------------------------------- what is exported


def test_a_run_in_every_format(
    tmp_path: Path, run: Path, capsys: pytest.CaptureFixture[str], registry: Registry
) -> None:
    pytest.importorskip("pxr", reason="usd-core is not installed")
    learned, _ = recorded_clips(run)
    for ending in ("bvh", "csv", "glb", "gltf", "npz", "usd", "usda", "usdc"):
        path = tmp_path / f"out.{ending}"
        assert export(run, path) == 0
        assert capsys.readouterr().out == (
            f"{path}: 4 frames at 30 Hz · 0.10 s · 3 joints of croucher · licence: CC BY 4.0\n"
        )
        if ending in ("bvh", "csv", "npz"):
            found = read_clip(path, registry, IN_A_BVH if ending == "bvh" else UNSAID)
            assert angle_error(found.rotations.numpy(), learned) < 1e-5
            assert position_error(found.root_position.numpy(), learned) < 1e-6
            assert (found.licence == "CC BY 4.0") == (ending != "bvh")


def test_the_runs_character_is_shown(tmp_path: Path, run: Path) -> None:
    export(run, tmp_path / "a.glb")
    export(run, tmp_path / "b.glb", "--character", "none")
    shown, bones = GltfFile(tmp_path / "a.glb"), GltfFile(tmp_path / "b.glb")
    shown.check()
    colours = [
        m["pbrMetallicRoughness"]["baseColorFactor"][:3] for m in shown.document["materials"]
    ]
    np.testing.assert_allclose(colours, [[0.2, 0.4, 0.8], [0.9, 0.7, 0.6]], atol=1e-6)
    assert len(bones.document["materials"]) == 1
    np.testing.assert_array_equal(shown.root_positions(), bones.root_positions())
    lengths = np.linalg.norm(np.diff(shown.skinned(0)[0], axis=0), axis=1)
    assert lengths.max() < 2.0


@pytest.mark.slow
def test_a_skill_of_a_hand_has_its_hand_and_its_licence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert export("chopsticks/throw", Path("a.glb"), "--seconds", "0.1") == 0
    assert "licence: Apache-2.0" in capsys.readouterr().out
    names = {node["name"] for node in GltfFile(tmp_path / "a.glb").document["nodes"]}
    assert {"upper_stick", "lower_stick", "object", "thumb_distal", "forearm"} <= names


def test_the_reference_of_a_run(tmp_path: Path, run: Path) -> None:
    _, reference = recorded_clips(run)
    assert reference is not None
    assert export(run, tmp_path / "a.glb", "--reference") == 0
    file = GltfFile(tmp_path / "a.glb")
    assert position_error(file.root_positions(), reference) < 1e-6
    assert angle_error(file.joint_rotations(), reference) < 1e-6


def test_the_reference_beside_what_was_learned(tmp_path: Path, run: Path) -> None:
    learned, reference = recorded_clips(run)
    assert reference is not None
    assert export(run, tmp_path / "a.glb", "--beside") == 0
    file = GltfFile(tmp_path / "a.glb")
    names = [node["name"] for node in file.document["nodes"]]
    roots = [i for i, name in enumerate(names) if name == learned.joint_names[0]]
    for node, clip in zip(roots, (learned, reference), strict=True):
        path = np.array([file.world(node, f)[:3, 3] for f in range(clip.num_frames)])[:, [2, 0, 1]]
        moved = path - clip.root_position.numpy()
        np.testing.assert_allclose(moved, moved[:1].repeat(len(moved), axis=0), atol=1e-5)
    assert moved[0, 1] > 0.1, "to the left"
    assert moved[0, [0, 2]] == pytest.approx(0.0, abs=1e-5)


@pytest.mark.parametrize(("unit", "metres"), [("cm", 0.01), ("m", 1.0), ("inch", 0.0254)])
def test_the_unit_of_an_exported_run(
    tmp_path: Path, run: Path, registry: Registry, unit: str, metres: float
) -> None:
    learned, _ = recorded_clips(run)
    assert export(run, tmp_path / "a.bvh", "--unit", unit) == 0
    said = ReadOptions(unit=unit, up="y")  # type: ignore[arg-type]
    found = read_clip(tmp_path / "a.bvh", registry, said)
    assert position_error(found.root_position.numpy(), learned) < 1e-5
    assert found.skeleton is not None
    assert learned.skeleton is not None
    np.testing.assert_allclose(found.skeleton.offsets, learned.skeleton.offsets, atol=1e-5)


def test_other_options_of_clip_files_are_refused_for_runs(
    tmp_path: Path, run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "files are in metres" in complaint(capsys, run, tmp_path / "a.glb", "--unit", "cm")
    assert "--up is of clip files" in complaint(capsys, run, tmp_path / "a.bvh", "--up", "y")
    assert "--beside is not possible" in complaint(capsys, "walk", tmp_path / "a.glb", "--beside")


def test_a_run_without_a_reference_or_recording(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = make_run(tmp_path)
    assert f"understudy render {run}" in complaint(capsys, run, tmp_path / "a.glb")
    record(run)
    assert "no reference motion" in complaint(capsys, run, tmp_path / "a.glb", "--reference")
    assert not (tmp_path / "a.glb").exists()


@pytest.mark.parametrize("name", sorted(set(WRITE) - {"angles", "csv", "robot_npz"}))
def test_a_clip_file_of_any_format(tmp_path: Path, name: str, registry: Registry) -> None:
    source = WRITE[name](tmp_path)
    assert export(source, tmp_path / "a.glb", "--character", "none") == 0
    file = GltfFile(tmp_path / "a.glb")
    file.check()
    assert angle_error(file.joint_rotations(), read_clip(source, registry)) < 1e-6


def test_a_table_needs_a_character_where_bodies_are_shown(
    tmp_path: Path, run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "no skeleton" in complaint(capsys, WRITE["csv"](tmp_path), tmp_path / "a.glb")
    export(run, tmp_path / "croucher.csv")
    assert export(tmp_path / "croucher.csv", tmp_path / "a.glb") == 0


def test_what_a_file_leaves_unsaid_can_be_said(tmp_path: Path) -> None:
    source = WRITE["bvh"](tmp_path)
    assert export(source, tmp_path / "a.npz", "--unit", "m", "--up", "y", "--loop") == 0
    assert export(source, tmp_path / "b.npz", "--source-rate", "60") == 0
    a, b = np.load(tmp_path / "a.npz"), np.load(tmp_path / "b.npz")
    assert a["loop"]
    np.testing.assert_allclose(a["root_position"], 100 * b["root_position"], atol=1e-5)
    assert b["times"][-1] == pytest.approx(0.5 * a["times"][-1])


def test_sources_and_destinations_that_are_none(
    tmp_path: Path, run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "a.glb"
    assert "no run folder" in complaint(capsys, tmp_path, out)
    assert "no such file" in complaint(capsys, tmp_path / "missing", out)
    assert "No motion clip 'missing'" in complaint(capsys, "missing", out)
    assert "'.fbx' files. Known: " in complaint(capsys, run, tmp_path / "a.fbx")
    assert "cannot be written" in complaint(capsys, run, tmp_path / "none" / "a.glb")
    bvh = WRITE["bvh"](tmp_path)
    assert "is no run folder" in complaint(capsys, bvh, out, "--reference")
    assert "no character 'crocher'" in complaint(capsys, bvh, out, "--character", "crocher")
    assert "no joint 'head'" in complaint(capsys, bvh, out, "--character", "croucher")
    assert "does not loop" in complaint(capsys, bvh, out, "--cycles", 2)
    assert "recorded so often" in complaint(capsys, bvh, out, "--rate", "1e300")
    assert "s apart" in complaint(capsys, bvh, out, "--rate", "1e-300")
    assert "too many frames" in complaint(capsys, "walk", out, "--rate", "9000", "--seconds", "1e6")
    assert "less than two frames" in complaint(capsys, bvh, out, "--rate", "1", "--seconds", "0.5")
    assert not out.exists()


@pytest.mark.parametrize(
    "arguments",
    [
        "--rate 0",
        "--rate nan",
        "--seconds -1",
        "--seconds inf",
        "--cycles 0",
        "--cycles 1.5",
        "--cycles 2 --seconds 1",
    ],
)
def test_impossible_numbers_are_refused(
    tmp_path: Path, arguments: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert export(WRITE["bvh"](tmp_path), tmp_path / "a.glb", *arguments.split()) == 2
    assert arguments.split()[0] in capsys.readouterr().err


# ---------------------------------------------------------------------- time


def looping() -> Clip:
    """A second of walking that begins again half a metre further and turned by 0.3 rad."""
    clip = walker(frames=31)
    turn = torch.linspace(0.0, 0.3, 31, dtype=torch.float64)
    rotation = clip.rotations.clone()
    rotation[:, 0] = torch.stack((torch.cos(turn / 2), 0 * turn, 0 * turn, torch.sin(turn / 2)), -1)
    position = torch.stack((0.5 * clip.times, 0 * clip.times, 0.9 + 0 * clip.times), dim=-1)
    return replace(clip, loop=True, rotations=rotation, root_position=position)


def test_cycles_go_on_where_the_last_one_ended() -> None:
    once, thrice = looping(), timed(looping(), cycles=3)
    assert thrice.loop
    assert thrice.num_frames == 91
    assert thrice.duration == pytest.approx(3.0)
    position, rotation = sample(once, thrice.times)
    torch.testing.assert_close(thrice.root_position, position)
    torch.testing.assert_close(thrice.rotations, rotation)
    whole, part = cycle_transform(thrice), cycle_transform(once)
    displacement, heading = part.power(torch.tensor([3.0], dtype=torch.float64))
    torch.testing.assert_close(whole.displacement, displacement[0])
    assert whole.heading == pytest.approx(heading.item())


def test_rates_and_lengths() -> None:
    clip = walker(frames=31)
    assert timed(clip) is clip
    faster = timed(clip, rate=50.0)
    assert (faster.num_frames, faster.duration) == (51, pytest.approx(1.0))
    assert timed(clip, rate=7.3).frame_rate == pytest.approx(7.3)
    cut = timed(clip, seconds=0.25)
    assert (cut.num_frames, cut.frame_rate) == (8, pytest.approx(30.0))
    torch.testing.assert_close(cut.rotations, clip.rotations[:8])
    assert timed(clip, seconds=9.0).duration == pytest.approx(1.0)
    closed = timed(looping(), rate=7.3)
    assert closed.loop
    assert closed.duration == pytest.approx(1.0)
    longer = timed(looping(), seconds=9.0, rate=10.0)
    assert (longer.num_frames, longer.loop) == (91, False)
    with pytest.raises(FileError, match="too many frames"):
        timed(looping(), cycles=10**400)


# ---------------------------------------------------------------------- figures


def test_a_clip_that_fits_a_character_wears_it(
    tmp_path: Path, run: Path, registry: Registry, croucher: Character
) -> None:
    learned, _ = recorded_clips(run)
    found = fitting_character(learned, registry)
    assert found is not None
    assert found.name == "croucher"
    shuffled = replace(
        learned,
        joint_names=("hips", "leg", "head"),
        rotations=learned.rotations[:, [0, 2, 1]],
        skeleton=None,
    )
    assert fitting_character(shuffled, registry) is not None
    torch.testing.assert_close(worn(shuffled, croucher).rotations, learned.rotations)
    NpzWriter().write(shuffled, tmp_path / "shuffled.npz")
    assert export(tmp_path / "shuffled.npz", tmp_path / "a.glb") == 0
    file = GltfFile(tmp_path / "a.glb")
    assert len(file.document["materials"]) == 2
    assert angle_error(file.joint_rotations(), learned) < 1e-6


def test_a_clip_of_other_lengths_or_joints_keeps_its_bones(run: Path, registry: Registry) -> None:
    learned, _ = recorded_clips(run)
    skeleton = learned.skeleton
    assert skeleton is not None
    longer = replace(learned, skeleton=replace(skeleton, offsets=1.1 * skeleton.offsets))
    assert fitting_character(longer, registry) is None
    chain = replace(learned, skeleton=replace(skeleton, parents=(-1, 0, 1)))
    assert fitting_character(chain, registry) is None
    assert fitting_character(walker(), registry) is None


def test_a_clip_with_more_joints_wears_the_character_that_is_asked_for(
    run: Path, croucher: Character
) -> None:
    learned, _ = recorded_clips(run)
    names = ("trunk", "tail", "head", "leg")
    more = replace(
        learned, joint_names=names, rotations=learned.rotations[:, [0, 0, 1, 2]], skeleton=None
    )
    torch.testing.assert_close(worn(more, croucher).rotations, learned.rotations)


# ---------------------------------------------------------------------- a whole run


def test_a_trained_run_is_exported_without_simulating_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], registry: Registry
) -> None:
    if "humanoid" not in registry.names("character") or "walk" not in registry.names("clip"):
        pytest.skip("the plugin humanoid is not installed")
    if "spacetime/walk" not in registry.tasks:
        pytest.skip("the plugin spacetime is not installed")
    run = tmp_path / "run"
    quick = ["num_worlds=8", "learner.rollout_steps=4", "learner.minibatches=2"]
    quick += ["policy.feedback.hidden=[16]", "budget.samples=64", "evaluation.episodes=2"]
    quick += ["evaluation.final_episodes=2", "evaluation.seconds=0.5", "run.video_seconds=0.2"]
    assert main(["train", "experiment=spacetime/walk", *quick, f"run.dir={run}"]) == 0
    for checkpoint in (run / "checkpoints").iterdir():
        checkpoint.unlink()
    recorded = np.load(run / "recording.npz")
    capsys.readouterr()
    for arguments, track_name in (((), "qpos"), (("--reference",), "reference_qpos")):
        out = tmp_path / f"{track_name}.glb"
        assert export(run, out, *arguments) == 0
        assert "6 frames at 30 Hz · 0.17 s · 13 joints of humanoid" in capsys.readouterr().out
        file = GltfFile(out)
        file.check()
        root = recorded[track_name][:, :3].astype(float)
        np.testing.assert_allclose(file.root_positions(), root, atol=1e-6)


@pytest.mark.parametrize("ending", ["gltf", "usda"])
def test_the_answer_about_its_licence_travels(tmp_path: Path, run: Path, ending: str) -> None:
    if ending == "usda":
        pytest.importorskip("pxr", reason="USD is not installed (extra usd)")
    path = tmp_path / f"walk.{ending}"
    assert export(run, path) == 0
    text = path.read_text()
    assert "CC BY 4.0" in text
    assert "Recorded by Ada. Commercial use: nothing stands in the way." in text

"""A garment that was recorded, as glTF: read back, every vertex and body is where it was in each frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from gltf_file import GltfFile

from understudy.command.cli import main
from understudy_training.workflow import train

Y_UP = [1, 2, 0]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("potpourri3d", reason="potpourri3d is not installed")
    folder = tmp_path_factory.mktemp("cloth") / "run"
    train([
        "experiment=dressing/sleeve_small", "num_worlds=2", "scenes.cloth.edge=0.07", "job=settle", "job.count=2",
        "job.seconds=0.05", "run.video_seconds=0", f"run.dir={folder}",
    ])  # fmt: skip
    generator = np.random.default_rng(0)
    turns = generator.normal(size=(41, 12, 4))
    np.savez(
        folder / "recording.npz",
        cloth_position=generator.uniform(-1, 1, size=(41, 56, 3)),
        tool_position=generator.uniform(-1, 1, size=(41, 12, 3)),
        tool_orientation=turns / np.linalg.norm(turns, axis=-1, keepdims=True),
        control_dt=0.01,
        first_episode=40,
    )
    return folder


def exported(run: Path, path: Path, *words: str) -> GltfFile:
    assert main(["export", str(run), str(path), *words]) == 0
    return GltfFile(path)


@pytest.mark.parametrize("ending", [".glb", ".gltf"])
def test_it_reads_back_as_it_was_recorded(run: Path, tmp_path: Path, ending: str) -> None:
    found = exported(run, tmp_path / f"cloth{ending}")
    recorded = np.load(run / "recording.npz")
    document, arrays = found.document, found.arrays
    (garment,) = document["meshes"][0]["primitives"]
    base = arrays[garment["attributes"]["POSITION"]]
    targets = np.stack([arrays[t["POSITION"]] for t in garment["targets"]])
    channels = document["animations"][0]["channels"]
    samplers = document["animations"][0]["samplers"]
    (weights,) = [c for c in channels if c["target"]["path"] == "weights"]
    assert weights["target"]["node"] == 0
    assert document["nodes"][0]["mesh"] == 0
    shares = arrays[samplers[weights["sampler"]]["output"]].reshape(len(found.times), -1)
    assert shares.shape[1] == len(targets) == len(document["meshes"][0]["weights"])
    assert found.times == pytest.approx(0.04 * np.arange(10))
    moving = base + np.einsum("tk,kvx->tvx", shares, targets)
    wanted = recorded["cloth_position"][:40:4][..., Y_UP]
    assert np.abs(moving - wanted).max() < 1e-6
    assert document["materials"][garment["material"]]["doubleSided"], "a garment has two sides"
    # the bodies with a shape: all links but the gripper
    nodes = [n for n in range(1, len(document["nodes"]))]
    assert len(nodes) == 11
    for number in nodes:
        for frame in (0, 9):
            place = found.world(number, frame)
            assert place[:3, 3] == pytest.approx(
                recorded["tool_position"][4 * frame, number - 1][Y_UP], abs=1e-6
            )
            w, x, y, z = recorded["tool_orientation"][4 * frame, number - 1]
            up = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
            assert place[:3, 1] == pytest.approx(up[Y_UP], abs=1e-6), "z is y there"
    torso = arrays[document["meshes"][1]["primitives"][0]["attributes"]["POSITION"]]
    assert np.ptp(torso[:, 1]) == pytest.approx(0.45 + 0.15 + 0.07, abs=0.01), "its height"


@pytest.mark.parametrize("ending", [".usda", ".usdc"])
def test_usd_reads_back_as_it_was_recorded(run: Path, tmp_path: Path, ending: str) -> None:
    pxr = pytest.importorskip("pxr", reason="usd-core is not installed")
    from pxr import Usd, UsdGeom

    assert pxr
    path = tmp_path / f"cloth{ending}"
    assert main(["export", str(run), str(path)]) == 0
    stage, recorded = Usd.Stage.Open(str(path)), np.load(run / "recording.npz")
    assert stage.GetTimeCodesPerSecond() == 25.0
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (0.0, 9.0)
    garment = UsdGeom.Mesh(stage.GetPrimAtPath("/Recording/Garment"))
    assert garment.GetDoubleSidedAttr().Get()
    bodies = [p for p in stage.GetPrimAtPath("/Recording").GetChildren() if p.IsA(UsdGeom.Xform)]
    assert len(bodies) == 11
    for frame in (0, 4, 9):
        points = np.array(garment.GetPointsAttr().Get(frame))
        assert np.abs(points - recorded["cloth_position"][4 * frame]).max() < 1e-6
        for number, body in enumerate(bodies):
            place = np.array(UsdGeom.Xformable(body).ComputeLocalToWorldTransform(frame)).T
            assert place[:3, 3] == pytest.approx(recorded["tool_position"][4 * frame, number])
            w, x, y, z = recorded["tool_orientation"][4 * frame, number]
            axis = [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)]
            assert place[:3, 2] == pytest.approx(axis, abs=1e-6)
    torso = UsdGeom.Mesh(stage.GetPrimAtPath("/Recording/Body0/Shape"))
    height = np.ptp(np.array(torso.GetPointsAttr().Get())[:, 2])
    assert height == pytest.approx(0.45 + 0.15 + 0.07, abs=0.01)


def test_rate_and_length_are_as_asked(run: Path, tmp_path: Path) -> None:
    found = exported(run, tmp_path / "cloth.glb", "--rate", "50", "--seconds", "0.1")
    assert found.times == pytest.approx(0.02 * np.arange(6))


@pytest.mark.parametrize(
    ("name", "words", "sentence"),
    [
        ("cloth.bvh", (), "a garment is written to .glb, .gltf, .usd, .usda and .usdc files"),
        ("cloth.glb", ("--reference",), "--reference is for motions"),
        ("cloth.glb", ("--seconds", "0.01"), "1 frames at 25 Hz cannot be written"),
    ],
)
def test_what_cannot_be_is_said(
    run: Path,
    tmp_path: Path,
    name: str,
    words: tuple[str, ...],
    sentence: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["export", str(run), str(tmp_path / name), *words]) == 2
    assert sentence in capsys.readouterr().err
    assert not (tmp_path / name).exists()


def test_a_recording_of_another_garment_is_refused(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recorded = dict(np.load(run / "recording.npz"))
    recorded["cloth_position"] = recorded["cloth_position"][:, 1:]
    try:
        kept = (run / "recording.npz").read_bytes()
        np.savez(run / "recording.npz", **recorded)
        assert main(["export", str(run), str(tmp_path / "cloth.glb")]) == 2
    finally:
        (run / "recording.npz").write_bytes(kept)
    assert "cloth_position" in capsys.readouterr().err

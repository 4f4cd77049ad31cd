"""The SMPL reader: which way the figure stands, all layouts, and archives that mean harm."""

from __future__ import annotations

import io
import pickle
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from motion_files import smpl_arrays, write_smpl
from scipy.spatial.transform import Rotation

from understudy.errors import FileError
from understudy_motion.clip import Clip
from understudy_motion.kinematics import forward_kinematics, tip_positions
from understudy_motion.readers.smpl import SmplReader
from understudy_motion.reading import UNSAID, ReadOptions
from understudy_tensors import rotations


def read(folder: Path, arrays: Mapping[str, Any], options: ReadOptions = UNSAID) -> Clip:
    path = folder / "clip.npz"
    np.savez(path, **arrays)
    return SmplReader().read(path, options)


def test_the_figure_stands(tmp_path: Path) -> None:
    clip = SmplReader().read(write_smpl(tmp_path))
    positions, world = forward_kinematics(clip)
    tips = tip_positions(clip, positions, world)
    at = {name: positions[0, i] for i, name in enumerate(clip.joint_names)}
    assert clip.skeleton is not None
    crown = tips[0, list(clip.skeleton.tips).index("head"), 2]
    assert at["left_foot"][2].abs() < 0.01  # trans is the pelvis, 0.93 m above the soles
    assert crown == pytest.approx(1.7, abs=0.02)
    # As AMASS' T-pose turned about x by a quarter: it faces -y, so its left is +x.
    assert rotations.heading(clip.rotations[0, 0]) == pytest.approx(-np.pi / 2)
    assert at["left_wrist"][0] - at["right_wrist"][0] > 1.2
    assert tips[0, list(clip.skeleton.tips).index("left_foot"), 1] < -0.1
    # A positive turn about the body's x (left) bends the knee: the ankle goes back.
    knee = clip.joint_names.index("left_knee")
    bend = rotations.to_exponential_map(clip.rotations[-1, knee])
    assert bend.tolist() == pytest.approx([0.0, 1.0, 0.0])
    assert positions[-1, clip.joint_names.index("left_ankle"), 1] > 0.2
    assert clip.frame_rate == pytest.approx(120.0)


def test_a_world_with_y_up(tmp_path: Path) -> None:
    arrays = smpl_arrays()
    arrays["poses"][:, 0] = 0.0
    arrays["trans"] = np.tile([0.1, 0.93, 0.3], (6, 1))
    clip = read(tmp_path, arrays, ReadOptions(up="y"))
    assert clip.root_position[0].tolist() == pytest.approx([0.3, 0.1, 0.93])
    torch.testing.assert_close(
        clip.rotations[0, 0], torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64)
    )


def test_a_world_whose_axis_is_not_plain_is_asked_for(tmp_path: Path) -> None:
    """A body that stands with y up was laid on its back, silently."""
    arrays = smpl_arrays()
    arrays["poses"][:, :3] = 0.0
    arrays["trans"] = np.tile([0.1, 0.93, 0.3], (6, 1))
    with pytest.raises(FileError, match=r"give motion\.up=y or z \(--up\)"):
        read(tmp_path, arrays)
    assert read(tmp_path, arrays, ReadOptions(up="y")).root_position[0, 2] == pytest.approx(0.93)
    assert read(tmp_path, arrays, ReadOptions(up="z")).root_position[0, 1] == pytest.approx(0.93)
    arrays["trans"][:, 1] = 0.1  # on the floor: it lies
    assert read(tmp_path, arrays).root_position[0, 2] == pytest.approx(0.3)


def test_poses_of_the_body_beside_its_root(tmp_path: Path) -> None:
    arrays = smpl_arrays()
    expected = read(tmp_path, arrays)
    poses = arrays.pop("poses")
    for root in ("root_orient", "global_orient"):
        clip = read(tmp_path, {**arrays, "poses": poses[:, 3:], root: poses[:, :3]})
        assert torch.equal(clip.rotations, expected.rotations)


def test_a_batch_of_one_with_joints_apart(tmp_path: Path) -> None:
    arrays = smpl_arrays()
    expected = read(tmp_path, arrays)
    poses = arrays["poses"].reshape(6, -1, 3)
    for batch in (poses[None], poses[:, None]):
        clip = read(tmp_path, {**arrays, "poses": batch})
        assert torch.equal(clip.rotations, expected.rotations)


@pytest.mark.parametrize("factor", [0.0, -1.0, 2.0])
def test_matrices_that_are_no_rotations(tmp_path: Path, factor: float) -> None:
    """The first ended in a traceback, the others were made rotations, silently."""
    matrices = np.tile(np.eye(3), (6, 24, 1, 1))
    matrices[4, 3] *= factor
    with pytest.raises(
        FileError, match="frame 4: array 'poses' holds a matrix that is no rotation"
    ):
        read(tmp_path, {**smpl_arrays(), "poses": matrices})


@pytest.mark.parametrize("joints", [22, 24, 52, 55])
def test_every_body_of_the_family(tmp_path: Path, joints: int) -> None:
    clip = read(tmp_path, smpl_arrays(joints=joints))
    assert len(clip.joint_names) == joints
    positions, _ = forward_kinematics(clip)
    at = {name: positions[0, i] for i, name in enumerate(clip.joint_names)}
    for name, position in at.items():  # left and right mirror each other; the figure faces -y
        if name.startswith("left_") and "knee" not in name:
            other = at[name.replace("left_", "right_")]
            if name in ("left_ankle", "left_foot"):
                continue  # the left knee bends
            assert position[0] == pytest.approx(-other[0]), name
            assert position[0] > 0.02, name


def test_parts_instead_of_poses(tmp_path: Path) -> None:
    whole = smpl_arrays(joints=55)
    whole["poses"] = np.random.default_rng(1).normal(size=(6, 165))
    parts = {key: value for key, value in whole.items() if key != "poses"}
    start = 0
    for name, joints in (
        ("root_orient", 1), ("pose_body", 21), ("pose_jaw", 1), ("pose_eye", 2), ("pose_hand", 30),
    ):  # fmt: skip
        parts[name] = whole["poses"][:, start : start + 3 * joints]
        start += 3 * joints
    assert torch.equal(read(tmp_path, parts).rotations, read(tmp_path, whole).rotations)
    assert len(read(tmp_path, {k: parts[k] for k in ("root_orient", "pose_body", "trans", "mocap_framerate")}).joint_names) == 22  # fmt: skip
    parts["pose_body"] = parts["pose_body"][:-1]
    with pytest.raises(FileError, match="differ in their number of frames"):
        read(tmp_path, parts)


def test_rates(tmp_path: Path) -> None:
    arrays = smpl_arrays()
    del arrays["mocap_framerate"]
    with pytest.raises(
        FileError, match=r"does not say its frame rate; give motion\.rate \(--source-rate\)"
    ):
        read(tmp_path, arrays)
    assert read(tmp_path, arrays, ReadOptions(rate=30.0)).frame_rate == pytest.approx(30.0)
    for name, value in (
        ("mocap_frame_rate", np.float32(60)), ("fps", np.array([60])), ("mocap_fps", np.array("60")),
        ("fps", np.array(b"60.0")),
    ):  # fmt: skip
        assert read(tmp_path, {**arrays, name: value}).frame_rate == pytest.approx(60.0)
    for value in (0.0, -1.0, np.nan, "fast", "6_0", [60.0, 60.0]):
        with pytest.raises(FileError, match="mocap_framerate"):
            read(tmp_path, {**arrays, "mocap_framerate": value})


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("poses", np.zeros((6, 65)), "65 pose values per frame are no body"),
        ("poses", np.zeros((5, 66)), r"'trans': its shape is \(6, 3\) and should be \(5, 3\)"),
        (
            "poses",
            np.zeros((6, 66), dtype=bool),
            "'poses': holds bool where floats or whole numbers",
        ),
        ("poses", np.zeros((6, 21, 3)), "63 pose values per frame are no body"),
        (
            "poses",
            np.zeros((6, 22, 4)),
            "frame 0: array 'poses' holds a quaternion that is no rotation",
        ),
        (
            "poses",
            np.ones((6, 22, 6)),
            "frame 0: array 'poses' holds a pair of a matrix' columns that is no rotation",
        ),
        (
            "poses",
            np.zeros((6, 20, 3)),
            "60 pose values per frame are no body",
        ),
        (
            "poses",
            np.zeros((6, 3, 22)),
            r"'poses': its shape is \(6, 3, 22\); write it as \(frames, joints, 3\)",
        ),
        ("poses", np.zeros((6, 66), dtype=complex), "'poses': holds complex128"),
        ("poses", np.full((6, 66), np.nan), "frame 0: 'poses' is not finite"),
        ("poses", np.zeros(396), r"'poses': its shape is \(396,\)"),
        ("poses", np.zeros((0, 66)), "'trans': its shape"),
        ("poses", np.zeros((6, 66), dtype=[("a", "f8")]), "'poses': holds"),
        ("trans", np.zeros((6, 2)), "'trans': its shape"),
        ("trans", np.full((6, 3), 1e300), "root position is more than"),
    ],
)
def test_damage_is_named(tmp_path: Path, name: str, value: np.ndarray, message: str) -> None:
    with pytest.raises(FileError, match=message) as caught:
        read(tmp_path, {**smpl_arrays(), name: value})
    assert str(tmp_path / "clip.npz") in str(caught.value)


def test_a_missing_array_is_named(tmp_path: Path) -> None:
    arrays = smpl_arrays()
    del arrays["trans"]
    with pytest.raises(FileError, match="the array 'trans' is missing"):
        read(tmp_path, arrays)


class Payload:
    """Creates a file when it is unpickled."""

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (Path("executed"),)


def test_objects_are_not_unpickled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert b"executed" in pickle.dumps(Payload())
    payload = np.empty((6, 66), dtype=object)
    payload[0, 0] = Payload()
    with pytest.raises(FileError, match="'poses': holds object where floats or"):
        read(tmp_path, {**smpl_arrays(), "poses": payload})
    rate = np.array([30, Payload()], dtype=object)[1:]
    with pytest.raises(
        FileError, match="'mocap_framerate': holds objects where numbers are needed"
    ):
        read(tmp_path, {**smpl_arrays(), "mocap_framerate": rate})
    assert not Path("executed").exists()


@pytest.mark.parametrize("rate", [30, 30.0, [30]])
def test_a_rate_saved_as_an_object(tmp_path: Path, rate: Any) -> None:
    arrays = {**smpl_arrays(), "mocap_framerate": np.array(rate, dtype=object)}
    assert read(tmp_path, arrays).frame_rate == pytest.approx(30.0)


@pytest.mark.parametrize("objects", [[30, 60], [], ["30"], [None], [[30]], [{30: 60}], [True]])
def test_an_object_that_is_no_rate(tmp_path: Path, objects: list[Any]) -> None:
    value = np.empty(len(objects), dtype=object)
    value[:] = objects
    with pytest.raises(FileError, match="'mocap_framerate'"):
        read(tmp_path, {**smpl_arrays(), "mocap_framerate": value})


def test_other_shapes_and_names_of_the_arrays(tmp_path: Path) -> None:
    """A joint's axis of its own, rotation matrices, whole numbers, and the body model's names."""
    arrays = smpl_arrays(joints=24)
    arrays["trans"] = np.tile([1, 2, 3], (6, 1))
    expected = read(tmp_path, arrays)
    assert expected.root_position[0].tolist() == [1.0, 2.0, 3.0]
    vectors = arrays.pop("poses").reshape(6, 24, 3)
    matrices = Rotation.from_rotvec(vectors.reshape(-1, 3)).as_matrix().reshape(6, 24, 3, 3)
    renamed = {**arrays, "transl": arrays["trans"], "framerate": 120}
    del renamed["trans"], renamed["mocap_framerate"]
    parts = {"global_orient": vectors[:, 0], "body_pose": vectors[:, 1:22]}
    hands = {"global_orient": vectors[:, :1], "body_pose": vectors[:, 1:]}
    for others in (
        {**arrays, "poses": vectors},
        {**arrays, "poses": vectors, "trans": arrays["trans"][:, None]},
        {**renamed, **hands},
        {**arrays, "poses": matrices},
        {**renamed, **parts},
        {**arrays, "poses": vectors.reshape(1, 6, 72), "trans": arrays["trans"][None]},  # a batch
        {**arrays, "poses": vectors.reshape(6, 1, 72), "trans": arrays["trans"][:, None]},
    ):
        clip = read(tmp_path, others)
        assert SmplReader().recognises(b"PK\x03\x04", tmp_path / "clip.npz")
        torch.testing.assert_close(clip.root_position, expected.root_position)
        joints = len(clip.joint_names)
        assert joints == (22 if others.get("body_pose", hands["body_pose"]).shape[1] == 21 else 24)
        torch.testing.assert_close(clip.rotations, expected.rotations[:, :joints])
        assert clip.frame_rate == pytest.approx(120.0)


def _halves(matrices: np.ndarray, layout: str) -> np.ndarray:
    """(F, J, 6) of (F, J, 3, 3)."""
    if layout == "side by side":
        return matrices[..., :2].reshape(*matrices.shape[:2], 6)
    parts = matrices if layout == "rows" else matrices.swapaxes(2, 3)
    return parts[:, :, :2].reshape(*matrices.shape[:2], 6)


@pytest.mark.parametrize("joints", [22, 24, 52, 55])
@pytest.mark.parametrize("flat", [True, False])
def test_rotations_in_any_layout(tmp_path: Path, joints: int, flat: bool) -> None:
    """Matrices, their halves by columns and rows, and quaternions of either order are the same motion."""
    arrays = smpl_arrays(joints=joints)
    generator = np.random.default_rng(3)
    turns = arrays["poses"].reshape(6, joints, 3) + generator.normal(0, 0.1, (6, joints, 3))
    turns[:, [4, 5], 0] += 0.5  # knees bend
    expected = read(tmp_path, {**arrays, "poses": turns}).rotations
    rotation = Rotation.from_rotvec(turns.reshape(-1, 3))
    matrices = rotation.as_matrix().reshape(6, joints, 3, 3)
    quaternions = rotation.as_quat().reshape(6, joints, 4)
    layouts = [
        matrices, matrices.reshape(6, joints, 9), quaternions, quaternions[..., [3, 0, 1, 2]], matrices[..., :2],
        *(_halves(matrices, name) for name in ("columns", "rows", "side by side")),
    ]  # fmt: skip
    for values in layouts:
        given = values.reshape(6, -1) if flat else values
        found = [read(tmp_path, {**arrays, "poses": given})]
        if not flat:
            found.append(read(tmp_path, {**arrays, "poses": given[None]}))  # a batch
        if joints in (22, 24):
            apart = {"global_orient": values[:, 0], "body_pose": values[:, 1:]}
            rest = {key: value for key, value in arrays.items() if key != "poses"}
            apart = {key: value.reshape(6, -1) if flat else value for key, value in apart.items()}
            found.append(read(tmp_path, {**rest, **apart}))
        for clip in found:
            alike = (clip.rotations * expected).sum(dim=-1).abs()
            assert alike.shape == expected.shape[:2]
            assert alike.min() == pytest.approx(1.0)


def test_halves_of_which_rows_and_columns_are_alike_are_asked_for(tmp_path: Path) -> None:
    """Nothing bends, so the turn of the root may be either; its inverse would lie on its back."""
    arrays = smpl_arrays()
    turns = arrays["poses"].reshape(6, -1, 3)
    turns[:, 1:] = 0.0
    matrices = Rotation.from_rotvec(turns.reshape(-1, 3)).as_matrix().reshape(6, -1, 3, 3)
    with pytest.raises(FileError, match="rows or columns of matrices cannot be told"):
        read(tmp_path, {**arrays, "poses": _halves(matrices, "rows")})
    read(tmp_path, {**arrays, "poses": _halves(matrices, "side by side")})


def test_parts_as_body_models_name_them(tmp_path: Path) -> None:
    """A side each, of which coefficients of hands and a face without hands are left out."""
    whole = smpl_arrays(joints=55)
    whole["poses"] = np.random.default_rng(2).normal(size=(6, 165))
    rest = {key: value for key, value in whole.items() if key != "poses"}
    names = {
        "global_orient": 3, "body_pose": 63, "jaw_pose": 3, "leye_pose": 3, "reye_pose": 3,
        "left_hand_pose": 45, "right_hand_pose": 45,
    }  # fmt: skip
    ends = np.cumsum(list(names.values()))[:-1]
    parts = dict(zip(names, np.split(whole["poses"], ends, axis=1), strict=True))
    expected = read(tmp_path, whole)
    for changed in ({}, {"transl": whole["trans"], "trans": None}):
        arrays = {k: v for k, v in {**rest, **parts, **changed}.items() if v is not None}
        assert torch.equal(read(tmp_path, arrays).rotations, expected.rotations)
    body = expected.rotations[:, :22]
    few = {side: np.zeros((6, 12)) for side in ("left_hand_pose", "right_hand_pose")}
    for others in (few, dict.fromkeys(few, np.zeros((6, 0))), {"pose_hand": np.zeros((6, 0))}):
        kept = {k: v for k, v in parts.items() if "hand" not in k}
        assert torch.equal(read(tmp_path, {**rest, **kept, **others}).rotations, body)
    faceless = {k: v for k, v in parts.items() if "eye" not in k and "jaw" not in k}
    assert read(tmp_path, {**rest, **faceless}).rotations.shape[1] == 52
    short = {**parts, "left_hand_pose": parts["left_hand_pose"][:5]}
    with pytest.raises(FileError, match="differ in their number of frames"):
        read(tmp_path, {**rest, **short})


def archive(folder: Path, poses: bytes, compression: int = zipfile.ZIP_DEFLATED) -> Path:
    """The arrays of a valid file, `poses` replaced by these bytes."""
    path = folder / "clip.npz"
    with zipfile.ZipFile(path, "w", compression) as file:
        for name, value in smpl_arrays().items():
            content = io.BytesIO()
            np.save(content, value)
            file.writestr(f"{name}.npy", poses if name == "poses" else content.getvalue())
    return path


def header(shape: str, descr: str = "'<f8'") -> bytes:
    text = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text


@pytest.mark.parametrize(
    "poses",
    [
        header("(10**12, 66)"),
        header("(1000000000000, 66)") + bytes(1000),
        header("(-6, 66)") + bytes(6 * 66 * 8),
        header("(6, 66)") + bytes(6 * 66 * 8 - 1),
        header("(6, 66)", "'|O'") + bytes(6 * 66 * 8),
        header("(6, 66)", "'<f99'") + bytes(6 * 66 * 8),
        header("(" * 200 + ")" * 200),
        header("__import__('os')"),
        b"\x93NUMPY\x09\x00" + bytes(100),
        b"\x93NUMPY\x02\x00\xff\xff\xff\xff" + bytes(100),
        b"",
        b"not an array",
    ],
)
def test_headers_that_lie(tmp_path: Path, poses: bytes) -> None:
    with pytest.raises(FileError, match="array 'poses'"):
        SmplReader().read(archive(tmp_path, poses))


def test_bombs_are_refused_unopened(tmp_path: Path) -> None:
    bomb = archive(tmp_path, header("(300000, 66)") + bytes(300_000 * 66 * 8))
    assert bomb.stat().st_size < 2**20
    with pytest.raises(FileError, match="array 'poses': the arrays are larger than 128 MB"):
        SmplReader().read(bomb)
    other = archive(tmp_path, bytes(1000), zipfile.ZIP_BZIP2)
    with pytest.raises(FileError, match="compressed in a way that is not read"):
        SmplReader().read(other)
    crowd = tmp_path / "crowd.npz"
    with zipfile.ZipFile(crowd, "w") as file:
        for index in range(1000):
            file.writestr(f"a{index}.npy", b"")
    with pytest.raises(FileError, match="more than 256 arrays"):
        SmplReader().read(crowd)


def test_what_is_no_archive(tmp_path: Path) -> None:
    path = tmp_path / "clip.npz"
    for content in (
        b"",
        b"PK\x03\x04",
        b"PK\x05\x06" + bytes(18),
        write_smpl(tmp_path).read_bytes()[:-30],
    ):
        path.write_bytes(content)
        assert not SmplReader().recognises(content, path)
        with pytest.raises(FileError):
            SmplReader().read(path)


def test_scaled_places_and_spellings_of_the_rate(tmp_path: Path) -> None:
    arrays = dict(smpl_arrays())
    usual = read(tmp_path, arrays)
    rate = next(name for name in arrays if "rate" in name)
    arrays["mocap_frameRate"] = arrays.pop(rate)
    arrays["smpl_trans"] = 100.0 * arrays.pop("trans")
    arrays["smpl_scaling"] = np.array([100.0])
    clip = read(tmp_path, arrays)
    torch.testing.assert_close(clip.root_position, usual.root_position)
    torch.testing.assert_close(clip.times, usual.times)


def test_other_units_are_named(tmp_path: Path) -> None:
    arrays = smpl_arrays()
    with pytest.raises(FileError, match="in degrees"):
        read(tmp_path, {**arrays, "poses": 1000.0 + 0.0 * arrays["poses"]})
    millimetres = {**arrays, "trans": 1000.0 * arrays["trans"] + [0.0, 0.0, 1000.0]}
    with pytest.raises(FileError, match=r"m from the floor; give motion\.unit"):
        read(tmp_path, millimetres)
    assert read(tmp_path, millimetres, ReadOptions(unit="mm")).num_frames > 1


@pytest.mark.parametrize("shape", [(0, 0), (0, 66), (0, 22, 3), (5, 0), (0, 5, 0)])
def test_arrays_of_nothing_end_in_a_sentence(tmp_path: Path, shape: tuple[int, ...]) -> None:
    np.savez(tmp_path / "x.npz", poses=np.zeros(shape), trans=np.zeros((shape[0], 3)), fps=30.0)
    with pytest.raises(FileError):
        SmplReader().read(tmp_path / "x.npz")

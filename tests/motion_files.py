"""A small figure that walks on the spot, and files of it in every format that is read."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from understudy_motion.clip import Clip, Skeleton
from understudy_motion.readers import deepmimic
from understudy_motion.writers.bvh import BvhWriter
from understudy_motion.writers.table import CsvWriter, NpzWriter
from understudy_tensors import rotations

SKELETON = Skeleton(
    joint_names=("hips", "chest", "l_thigh", "l_shin", "r_thigh", "r_shin"),
    parents=(-1, 0, 0, 2, 0, 4),
    offsets=np.array(
        [[0, 0, 0], [0, 0, 0.2], [0, 0.1, 0], [0, 0, -0.45], [0, -0.1, 0], [0, 0, -0.45]]
    ),
    tips={
        "chest": np.array([0.0, 0.0, 0.55]),
        "l_shin": np.array([0.05, 0.0, -0.45]),
        "r_shin": np.array([0.05, 0.0, -0.45]),
    },
)


def walker(frames: int = 6, rate: float = 30.0) -> Clip:
    """The figure, 1.65 m tall, facing x, its legs swinging."""
    times = torch.arange(frames, dtype=torch.float64) / rate
    swing = 0.4 * torch.sin(2 * torch.pi * times)
    vectors = torch.zeros(frames, len(SKELETON.joint_names), 3, dtype=torch.float64)
    vectors[:, 2, 1], vectors[:, 4, 1] = swing, -swing
    vectors[:, 3, 1] = 0.3
    return Clip(
        name="walker",
        times=times,
        root_position=torch.stack((times, 0 * times, 0.9 + 0 * times), dim=-1),
        rotations=rotations.from_exponential_map(vectors),
        joint_names=SKELETON.joint_names,
        loop=False,
        skeleton=SKELETON,
        licence="CC0",
    )


ASF = """# a comment
:version 1.10
:name small
:units
  mass 1.0
  length 0.45
  angle deg
:root
   order TX TY TZ RX RY RZ
   axis XYZ
   position 0 0 0
   orientation 0 0 0
:bonedata
  begin
     id 1
     name lthigh
     direction 0.3 -0.9 0.1
     length 8
     axis 10 20 30 XYZ
    dof rx ry rz
    limits (-160.0 20.0)
           (-70.0 70.0)
           (-60.0 70.0)
  end
  begin
     id 2
     name lshin
     direction 0 -1 0
     length 7
     axis 0 0 20 XYZ
    dof rx
  end
  begin
     id 3
     name rhipjoint
     direction -1 0 0
     length 2
     axis 0 0 0 XYZ
  end
  begin
     id 4
     name rthigh
     direction 0 -1 0
     length 8
     axis -90 0 -20 ZYX
    dof rz rx
  end
:hierarchy
  begin
    root lthigh rhipjoint
    lthigh lshin
    rhipjoint rthigh
  end
"""


def amc_text(frames: int = 6) -> str:
    lines = ["#!OML:ASF small.ASF", ":FULLY-SPECIFIED", ":DEGREES"]
    for frame in range(frames):
        lines += [
            str(frame + 1),
            f"root {0.1 * frame:g} 17.5 0 1 {5 + frame} 2",
            f"rthigh -3 {20 - frame}",
            f"lthigh 12.5 {frame} -7e-001",
            "lshin 30",
        ]
    return "\r\n".join(lines) + "\r\n"


def write_amc(folder: Path) -> Path:
    (folder / "small.asf").write_text(ASF, newline="\r\n")
    path = folder / "small_01.amc"
    path.write_text(amc_text(), newline="")
    return path


def write_bvh(folder: Path) -> Path:
    path = folder / "walker.bvh"
    BvhWriter().write(walker(), path)
    return path


def write_csv(folder: Path) -> Path:
    path = folder / "walker.csv"
    CsvWriter().write(walker(), path)
    return path


def write_angles(folder: Path) -> Path:
    """Of a robot of two hinges, as mjlab has it."""
    path = folder / "walker.csv"
    path.write_text("\n".join(f"{0.1 * k},0,0.9,0,0,0,1,{0.01 * k},-0.2" for k in range(6)))
    return path


def write_robot_npz(folder: Path) -> Path:
    frames = 6
    turns = np.tile([0.0, 0.0, 0.0, 1.0], (frames, 1))
    np.savez(
        folder / "clip.npz",
        root_pos=np.tile([0.0, 0.0, 0.8], (frames, 1)),
        root_rot=turns,
        dof_pos=np.zeros((frames, 3)),
        fps=30,
    )
    return folder / "clip.npz"


def write_npz(folder: Path) -> Path:
    path = folder / "walker.npz"
    NpzWriter().write(walker(), path)
    return path


def write_deepmimic(folder: Path) -> Path:
    row: list[Any] = [0.1, 0, 0.9, 0]
    for _, width in deepmimic.JOINTS:
        row += [1, 0, 0, 0] if width == 4 else [0.1]
    path = folder / "walker.json"
    path.write_text(json.dumps({"Loop": "none", "Frames": [row] * 6}))
    return path


def smpl_arrays(frames: int = 6, joints: int = 22) -> dict[str, Any]:
    """The T-pose turned from y up to z up, as in AMASS; the left knee bends."""
    poses = np.zeros((frames, 3 * joints))
    poses[:, 0] = np.pi / 2
    poses[:, 12] = np.linspace(0.0, 1.0, frames)
    trans = np.tile([0.0, 0.0, 0.93], (frames, 1))
    return {"trans": trans, "gender": "neutral", "mocap_framerate": 120.0, "poses": poses}


def write_smpl(folder: Path) -> Path:
    path = folder / "stand_poses.npz"
    np.savez(path, **smpl_arrays())
    return path


#: By the reader's name: writes a valid file into a folder.
WRITE: Mapping[str, Callable[[Path], Path]] = {
    "amc": write_amc,
    "angles": write_angles,
    "bvh": write_bvh,
    "csv": write_csv,
    "deepmimic": write_deepmimic,
    "npz": write_npz,
    "robot_npz": write_robot_npz,
    "smpl": write_smpl,
}

"""Clips of random skeletons, and how far what was read back is from what was written."""

from __future__ import annotations

import numpy as np
import torch
from hypothesis import strategies as st

from understudy_motion.clip import Clip, Skeleton
from understudy_motion.writing import Shape
from understudy_tensors import rotations


@st.composite
def clips(draw: st.DrawFn, *, far: float = 8.0) -> Clip:
    """Clips with a skeleton, of up to 8 joints with any names, anywhere in a cube of `far` metres."""
    name = st.text(min_size=1, max_size=8)
    names = draw(st.lists(name, min_size=1, max_size=8, unique=True))
    parents = [-1, *(draw(st.integers(0, row - 1)) for row in range(1, len(names)))]
    random = np.random.default_rng(draw(st.integers(0, 2**32)))
    frames = draw(st.integers(2, 6))
    offsets = random.uniform(-1.0, 1.0, (len(names), 3)) * draw(st.sampled_from([0.0, 0.01, 1.0]))
    offsets[0] = 0.0
    tips = {n: random.normal(size=3) for n in draw(st.sets(st.sampled_from(names)))}
    steps = random.uniform(1e-3, 0.2, frames - 1)
    return Clip(
        name=draw(name),
        times=torch.from_numpy(np.concatenate(([0.0], np.cumsum(steps)))),
        root_position=torch.from_numpy(random.uniform(-far, far, (frames, 3))),
        rotations=rotations.normalize(
            torch.from_numpy(random.normal(size=(frames, len(names), 4)))
        ),
        joint_names=tuple(names),
        loop=draw(st.booleans()),
        skeleton=Skeleton(tuple(names), tuple(parents), offsets, tips),
        source=draw(st.text(max_size=8)),
        licence=draw(name),
    )


def boxes(clip: Clip) -> list[Shape]:
    """A box of its own size and colour for each joint."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
    faces = [[0, 1, 3], [0, 3, 2], [4, 7, 5], [4, 6, 7], [0, 5, 1], [0, 4, 5]]
    faces += [[2, 3, 7], [2, 7, 6], [0, 6, 4], [0, 2, 6], [1, 5, 7], [1, 7, 3]]
    return [
        Shape(name, (0.1 + 0.02 * row) * corners, np.array(faces), (0.1 * (row % 3), 0.2, 0.3, 1.0))
        for row, name in enumerate(clip.joint_names)
    ]


def angle_error(found: np.ndarray, clip: Clip) -> float:
    """The largest angle in rad between wxyz quaternions (F, J, 4) and the clip's."""
    return rotations.angle_between(torch.from_numpy(found), clip.rotations).max().item()


def position_error(found: np.ndarray, clip: Clip) -> float:
    """The largest distance in m between root positions (F, 3) and the clip's."""
    return float(np.linalg.norm(found - clip.root_position.numpy(), axis=-1).max())

"""The bounds of a run, for pictures of its recorded motion."""

# MuJoCo has no stubs.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import mujoco
import numpy as np
import torch
from torch import Tensor

from understudy import rotations
from understudy.errors import ConfigError, FileError, suggestion
from understudy.options import checked_options, options_of
from understudy.rotations import angle_between
from understudy.task import Context
from understudy_characters.overlay import Gauge, Overlay, Region
from understudy_humanoid.kinematics import kinematics
from understudy_humanoid.scene import HumanoidScene
from understudy_spacetime import bounds
from understudy_spacetime.alignment import Alignment
from understudy_spacetime.bounds import Size, size_at

Fields = Mapping[str, Tensor]


class BoundsOverlay(Overlay):
    """A box around the reference's centre of mass and balls around its hands and feet, of the sizes
    that the run's terminations ``spacetime.*`` have; and how near each deviation is to its bound."""

    def marks(
        self, config: Mapping[str, Any], tracks: Mapping[str, np.ndarray]
    ) -> Sequence[Gauge | Region]:
        terms = {
            where: term
            for where, term in config["termination"]["terms"].items()
            if term is not None and term["name"] in _DRAWN
        }
        if not terms or "reference_qpos" not in tracks:
            return []
        fields = _fields(tracks)
        found: list[Gauge | Region] = []
        for where, term in terms.items():
            term_target, draw = _DRAWN[term["name"]]
            schema = options_of(term_target)
            given = {key: value for key, value in term.items() if key != "name"}
            options = {key: option.default for key, option in schema.items()} | checked_options(
                schema, given, f"termination.terms.{where}"
            )
            size = _sizes(options.pop("size"), tracks)
            found.extend(draw(fields, size, **options))
        return found


def _sizes(size: Size, tracks: Mapping[str, np.ndarray]) -> np.ndarray:
    """(T,): the bound's size in each frame."""
    frames = len(tracks["qpos"])
    if isinstance(size, list) and "phase" not in tracks:
        raise FileError(
            "The recording has no 'phase', on which a bound's size depends; make it again with "
            "`understudy render RUN`."
        )
    phase = torch.from_numpy(np.asarray(tracks.get("phase", np.zeros(frames)), dtype=np.float64))
    return np.broadcast_to(np.asarray(size_at(size, phase)), (frames,))


def _fields(tracks: Mapping[str, np.ndarray]) -> Fields:
    """The fields that the bounds read, float64: of the character, of the ``reference_…``, aligned."""
    scene = HumanoidScene(HumanoidScene.Options())
    learned = _kinematics(scene, tracks["qpos"])
    reference = _kinematics(scene, tracks["reference_qpos"])
    fields = learned | {f"reference_{name}": field for name, field in reference.items()}
    context = Context(0, torch.device("cpu"), 1, control_dt=1.0, substeps=1)
    alignment = Alignment(None, context)
    aligned = alignment.compute(**{name: fields[name] for name in alignment.reads})
    return {**fields, **aligned}


def _kinematics(scene: HumanoidScene, track: np.ndarray) -> dict[str, Tensor]:
    """The humanoid's kinematics of ``qpos`` (T, nq)."""
    model, data = scene.model, mujoco.MjData(scene.model)
    if track.shape[1:] != (model.nq,):
        raise FileError(
            f"The recording's qpos is {track.shape}; the humanoid's is (T, {model.nq})."
        )
    found: dict[str, list[np.ndarray]] = {k: [] for k in ("xpos", "xquat", "cvel", "subtree_com")}
    for qpos in track:
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        for name, values in found.items():
            values.append(getattr(data, name).copy())
    arrays = {name: torch.from_numpy(np.stack(values)) for name, values in found.items()}
    qpos = torch.from_numpy(np.asarray(track, dtype=np.float64))
    return kinematics(scene.layout, qpos=qpos, **arrays)


def _com(fields: Fields, size: np.ndarray) -> list[Gauge | Region]:
    reference, own = fields["reference_com_position"], fields["com_position"]
    distance = (own - reference).abs().amax(dim=1)
    name = "centre of mass"
    return [
        Gauge(name, distance.numpy(), size, "m"),
        Region(name, "box", reference[:, None].numpy(), size, own[:, None].numpy()),
    ]


def _root(fields: Fields, size: np.ndarray) -> list[Gauge | Region]:
    angle = angle_between(fields["root_rotation"], fields["reference_root_rotation"])
    return [Gauge("root", angle.numpy(), size, "rad")]


def _joints(fields: Fields, size: np.ndarray, joints: tuple[str, ...]) -> list[Gauge | Region]:
    names = HumanoidScene(HumanoidScene.Options()).layout.joint_names
    for name in joints:
        if name not in names:
            raise ConfigError(f"spacetime.joint_bound: no joint '{name}'.{suggestion(name, names)}")
    chosen = [names.index(name) for name in joints or names]
    angles = angle_between(fields["joint_rotations"], fields["reference_joint_rotations"])
    return [Gauge("joints", angles[:, chosen].amax(dim=1).numpy(), size, "rad")]


def _end_effectors(fields: Fields, size: np.ndarray) -> list[Gauge | Region]:
    reference = fields["reference_end_effector_positions"]
    own = fields["aligned_end_effector_positions"]
    distance = (own - reference).norm(dim=2).amax(dim=1)
    name = "hands and feet"
    # Both are relative to the roots, in the reference's heading frame.
    turn = rotations.from_heading(fields["reference_root_heading"])[:, None]
    root = fields["reference_root_position"][:, None]
    centres, points = root + rotations.rotate(turn, reference), root + rotations.rotate(turn, own)
    return [
        Gauge(name, distance.numpy(), size, "m"),
        Region(name, "ball", centres.numpy(), size, points.numpy()),
    ]


_DRAWN: Mapping[str, tuple[Any, Callable[..., list[Gauge | Region]]]] = {
    "spacetime.com_bound": (bounds.com_bound, _com),
    "spacetime.root_bound": (bounds.root_bound, _root),
    "spacetime.joint_bound": (bounds.JointBound, _joints),
    "spacetime.end_effector_bound": (bounds.end_effector_bound, _end_effectors),
}

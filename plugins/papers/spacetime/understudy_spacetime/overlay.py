"""The bounds of a run, for pictures of its recorded motion."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from understudy.errors import ConfigError, FileError, suggestion
from understudy.options import make_options
from understudy.setup.registry import Registry
from understudy.task import Context
from understudy_characters.overlay import Gauge, Overlay, Region
from understudy_characters.scene import CharacterScene
from understudy_spacetime import bounds
from understudy_spacetime.alignment import Alignment
from understudy_spacetime.bounds import BoundSize, Size
from understudy_tensors import rotations
from understudy_tensors.rotations import angle_between

Fields = Mapping[str, Tensor]


class BoundsOverlay(Overlay):
    """A box around the reference's centre of mass and balls around its hands and feet, of the sizes
    that the run's terminations ``spacetime/*`` have; and how near each deviation is to its bound."""

    def marks(
        self, config: Mapping[str, Any], tracks: Mapping[str, np.ndarray], registry: Registry
    ) -> Sequence[Gauge | Region]:
        terms = {
            where: term
            for where, term in config["termination"]["terms"].items()
            if term is not None and term["name"] in _DRAWN
        }
        if not terms or "reference_qpos" not in tracks:
            return []
        scene = _scene(config, registry)
        fields = _fields(scene, tracks)
        found: list[Gauge | Region] = []
        for where, term in terms.items():
            bound, draw = _DRAWN[term["name"]]
            given = {key: value for key, value in term.items() if key not in ("name", "outcome")}
            options = make_options(bound.Options, given, f"termination.terms.{where}")
            found.extend(draw(scene, fields, _sizes(options.size, term["name"], tracks), options))
        return found


def _scene(config: Mapping[str, Any], registry: Registry) -> CharacterScene:
    """The run's scene, of a task with spacetime bounds."""
    given = {key: value for key, value in config["scene"].items() if key != "name"}
    context = Context(
        0, torch.device("cpu"), 1, control_dt=1 / 30, substeps=20, registry=registry
    )  # fmt: skip
    return CharacterScene(make_options(CharacterScene.Options, given, "scene"), context)


def _sizes(size: Size, who: str, tracks: Mapping[str, np.ndarray]) -> np.ndarray:
    """(T,): the bound's size in each frame."""
    frames = len(tracks["qpos"])
    if isinstance(size, list) and "phase" not in tracks:
        raise FileError(
            "The recording has no 'phase', on which a bound's size depends; make it again with "
            "`understudy render RUN`."
        )
    phase = torch.from_numpy(np.asarray(tracks.get("phase", np.zeros(frames)), dtype=np.float64))
    sizes = BoundSize(size, who, torch.device("cpu"), torch.float64).at(phase)
    return np.broadcast_to(sizes.numpy(), (frames,))


def _fields(scene: CharacterScene, tracks: Mapping[str, np.ndarray]) -> Fields:
    """The fields that the bounds read, float64: of the character, of the ``reference_…``, aligned."""
    learned = _state(scene, tracks["qpos"])
    reference = _state(scene, tracks["reference_qpos"])
    fields = learned | {f"reference_{name}": field for name, field in reference.items()}
    context = Context(0, torch.device("cpu"), 1, control_dt=1.0, substeps=1, scene=scene)
    alignment = Alignment(None, context)
    aligned = alignment.compute(**{name: fields[name] for name in alignment.reads})
    return {**fields, **aligned}


def _state(scene: CharacterScene, track: np.ndarray) -> dict[str, Tensor]:
    """The state of the character at ``qpos`` (T, nq)."""
    if track.shape[1:] != (scene.model.nq,):
        raise FileError(
            f"The recording's qpos is {track.shape}; that of {scene.character.name} is "
            f"(T, {scene.model.nq})."
        )
    return scene.poses.state(torch.from_numpy(np.asarray(track, dtype=np.float64)))


def _com(
    scene: CharacterScene, fields: Fields, size: np.ndarray, options: Any
) -> list[Gauge | Region]:
    reference, own = fields["reference_com_position"], fields["com_position"]
    distance = (own - reference).abs().amax(dim=1)
    name = "centre of mass"
    return [
        Gauge(name, distance.numpy(), size, "m"),
        Region(name, "box", reference[:, None].numpy(), size, own[:, None].numpy()),
    ]


def _root(
    scene: CharacterScene, fields: Fields, size: np.ndarray, options: Any
) -> list[Gauge | Region]:
    angle = angle_between(fields["root_rotation"], fields["reference_root_rotation"])
    return [Gauge("root", angle.numpy(), size, "rad")]


def _joints(
    scene: CharacterScene, fields: Fields, size: np.ndarray, options: Any
) -> list[Gauge | Region]:
    names = scene.layout.joint_names
    for name in options.joints:
        if name not in names:
            raise ConfigError(f"spacetime/joint_bound: no joint '{name}'.{suggestion(name, names)}")
    chosen = [names.index(name) for name in options.joints or names]
    angles = angle_between(fields["joint_rotations"], fields["reference_joint_rotations"])
    return [Gauge("joints", angles[:, chosen].amax(dim=1).numpy(), size, "rad")]


def _end_effectors(
    scene: CharacterScene, fields: Fields, size: np.ndarray, options: Any
) -> list[Gauge | Region]:
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
    "spacetime/com_bound": (bounds.ComBound, _com),
    "spacetime/root_bound": (bounds.RootBound, _root),
    "spacetime/joint_bound": (bounds.JointBound, _joints),
    "spacetime/end_effector_bound": (bounds.EndEffectorBound, _end_effectors),
}

"""A trained policy as an ONNX model, with its normaliser inside: observations in, action out.

``understudy export RUN policy.onnx``. N worlds, or robots, at once; float32.

Inputs are the observations that the policy reads, each (N, …), named after the task's encoders. Outputs are
the parts of the action by name, that of highest probability: boxes (N, size), choices (N,) int64; and, where
the actuation needs nothing but the action, ``control`` (N, U), what it makes of it: for a character the
targets of its servos. The model's metadata say in JSON what each of these is (:func:`metadata`).

A policy that follows a motion observes the reference at the present time. That table is written beside the
model (:func:`reference_table`), because no robot knows it otherwise.
"""

from __future__ import annotations

import contextlib
import importlib.util
import inspect
import io
import json
import logging
import os
import shutil
import tempfile
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import mujoco
import numpy as np
import torch
from torch import Tensor, nn

from understudy import __version__
from understudy.errors import FileError
from understudy.setup.building import Built, build_environment
from understudy.setup.config import Chosen
from understudy.signals import StopRequest
from understudy_characters.parts import Reference
from understudy_characters.scene import CharacterScene, reference_motion
from understudy_characters.servos import lags
from understudy_export.command import REFERENCE_TABLE
from understudy_motion.clip import cycle_transform
from understudy_motion.origin import without_folder
from understudy_motion.section import Motion
from understudy_mujoco.scene import MujocoScene
from understudy_reinforcement.policy import Policy, build_policy
from understudy_skills.skill import Skill

#: Rows of the reference's table in a control period.
ROWS = 4


class Acting(nn.Module):
    """The policy as a function of tensors: the observations `names`, in this order, to the outputs."""

    def __init__(self, policy: Policy, built: Built, names: tuple[str, ...]) -> None:
        super().__init__()
        self.policy, self.names = policy, names
        self._actuation = built.environment.parts.actuation.part
        self._space = self._actuation.action_space
        self._controls = controls_itself(built)

    @property
    def outputs(self) -> list[str]:
        return [*self._space.parts, *(["control"] if self._controls else [])]

    def forward(self, *observations: Tensor) -> tuple[Tensor, ...]:
        seen = dict(zip(self.names, observations, strict=True))
        action = self.policy.distribution(seen).mode()
        parts = tuple(self._space.split(action).values())
        if not self._controls:
            return parts
        # Of its own, as it can be the action itself, and a tensor has one name in a model.
        return (*parts, self._actuation.control(action).clone())


def controls_itself(built: Built) -> bool:
    """Whether the control is a function of the action alone."""
    actuation = built.environment.parts.actuation.part
    return not actuation.reads and not actuation.keeps


class _Noting(dict[str, Tensor]):
    """Notes which observations are read."""

    def __init__(self, content: Mapping[str, Tensor]) -> None:
        super().__init__(content)
        self.read: dict[str, None] = {}

    def __getitem__(self, name: str) -> Tensor:
        self.read[name] = None
        return super().__getitem__(name)


def write_policy(skill: Skill, path: Path, licence: Mapping[str, Any]) -> list[str]:
    """Write `skill` as the ONNX model `path` with what it was made of on what terms (`licence`, see
    :func:`understudy_credits.walk.answer`), and beside it ``NAME.reference.npz`` if its task has a
    reference motion; returns a line on each file.

    Raises
    ------
    FileError
        ONNX is not installed, the policy cannot be one, or the folder cannot be written.
    """
    if any(importlib.util.find_spec(name) is None for name in ("onnx", "onnxscript")):
        raise FileError(
            f"{path}: ONNX models are written with onnx and onnxscript, which are not installed: "
            "pip install 'understudy[onnx]'."
        )
    built = build_environment(skill.experiment, num_worlds=1, evaluating=True)
    try:
        policy = build_policy(skill.experiment, built.context)
        skill.give(policy)
        observations = _Noting(built.environment.reset(0, "export"))
        with torch.no_grad():
            policy.distribution(observations)
        acting = Acting(policy.eval(), built, tuple(observations.read))
        facts = {**metadata(skill, built, acting), "licence": json.dumps(licence)}
        lines, others = [f"{path}: {_summary(facts)}"], dict[Path, bytes]()
        table = reference_table(built)
        if table is not None:
            beside = path.with_suffix(REFERENCE_TABLE)
            content = io.BytesIO()
            np.savez_compressed(content, **cast(dict[str, Any], table))
            others[beside] = content.getvalue()
            lines.append(f"{beside}: the reference that it observes, {len(table['time'])} rows")
        example = [observations[name] for name in acting.names]
        write_model(acting, example, facts, path, others)
    finally:
        built.environment.close()
    return lines


def write_model(
    acting: Acting,
    example: Sequence[Tensor],
    facts: Mapping[str, str],
    path: Path,
    others: Mapping[Path, bytes] | None = None,
) -> None:
    """Write `acting` as the ONNX model `path` with the metadata `facts`, and `others`, files in the same
    folder: all of them or none. `example` are observations of one world.

    Raises
    ------
    FileError
        as :func:`write_policy`.
    """
    import onnx

    worlds = torch.export.Dim("worlds", min=1)
    # Twice, as an axis of length 1 is taken for one that cannot be longer.
    example = [observation.repeat(2, *([1] * (observation.ndim - 1))) for observation in example]
    with tempfile.TemporaryDirectory() as folder, torch.no_grad(), _quiet():
        file = Path(folder) / "policy.onnx"
        try:
            torch.onnx.export(
                acting,
                tuple(example),
                str(file),
                input_names=list(acting.names),
                output_names=acting.outputs,
                dynamic_shapes={"observations": tuple({0: worlds} for _ in example)},
                external_data=False,
                dynamo=True,
            )
        except Exception as error:  # whatever a plugin's policy is made of
            reason = str(error).strip().splitlines()
            raise FileError(
                f"{path}: this policy ({type(acting.policy).__name__}) cannot be an ONNX model: "
                f"{reason[0] if reason else type(error).__name__}"
            ) from error
        model = onnx.load(str(file))
    for part in (model.graph, *model.functions):  # where in whose files its code is
        for held in (*part.node, part):
            del held.metadata_props[:]
    model.producer_name, model.producer_version = "understudy", __version__
    onnx.helper.set_model_props(model, dict(facts))
    onnx.checker.check_model(model)
    _save({path: model.SerializeToString(), **(others or {})})


def _save(files: Mapping[Path, bytes]) -> None:
    """Write the `files` of one folder; if one cannot be written, all are left as they were."""
    path, *_ = files
    try:
        with (
            tempfile.TemporaryDirectory(dir=path.parent, prefix=".writing-") as folder,
            StopRequest(),  # a signal waits until all are there
            contextlib.ExitStack() as undo,
        ):
            made, kept = Path(folder) / "made", Path(folder) / "kept"
            made.mkdir()
            kept.mkdir()
            for path, content in files.items():
                (made / path.name).write_bytes(content)
                if path.is_file():
                    shutil.copy2(path, kept)
            for path in files:
                os.replace(made / path.name, path)
                if (before := kept / path.name).exists():
                    undo.callback(os.replace, before, path)
                else:
                    undo.callback(path.unlink)
            undo.pop_all()
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise FileError(f"{path}: cannot be written: {reason}.") from error


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Without the exporter's progress, which is not about anything that a user could change."""
    loggers = [logging.getLogger(name) for name in ("torch.onnx", "onnxscript", "onnx_ir")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.ERROR)
    try:
        with (
            warnings.catch_warnings(),
            open(os.devnull, "w") as nowhere,
            contextlib.redirect_stdout(nowhere),
        ):
            warnings.simplefilter("ignore")
            yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


# ---------------------------------------------------------------------- what it all means


def metadata(skill: Skill, built: Built, acting: Acting) -> dict[str, str]:
    """By key, JSON:

    - ``task``, ``samples`` it learned from, ``success`` rate of its last evaluation and what that means;
    - ``control``: ``frequency`` Hz at which the policy is to be asked, ``servo_timestep`` s;
    - ``observations``: by input its ``shape``, the names of its ``columns``, its ``encoder``, what that is made of,
      and the fields it reads;
    - ``action``: its ``parts`` (name and size), the ``actuation`` that takes it, what that does with it,
      and the fields that this needs besides (none, where the model has the output ``control``);
    - ``controls``: for each column of ``control`` the ``actuator`` and its ``joint``, ``axis`` of a ball
      joint, ``kp`` N m/rad, ``kd`` N m s/rad, torque ``limit`` N m, and ``lag`` s, by which it follows a
      moving target late;
    - ``character``: its ``links``, ``end_effectors`` and ``joints`` in the order of the fields of that name;
    - ``motion``: clip, source, licence, attribution of the reference motion.
    """
    root, environment = skill.experiment.root, built.environment
    dt = environment.control_dt
    parts = environment.parts
    shapes = built.context.observation_shapes
    encoders = {chosen.name: chosen for chosen in skill.experiment.many("encoder")}
    actuation = parts.actuation
    space = actuation.part.action_space
    found: dict[str, Any] = {
        "task": root.task,
        "samples": skill.samples,
        "control": {
            "frequency": 1.0 / (dt * environment.decision),
            "servo_timestep": dt / root.control.substeps,
        },
        "observations": {
            name: {
                "shape": list(shapes[name]),
                "columns": list(environment.observation_columns[name]),
                **_made_of(encoders[name], type(parts.encoders[name].part)),
                "reads": {
                    field: list(environment.table.shapes[field])
                    for field in parts.encoders[name].reads.values()
                },
            }
            for name in acting.names
        },
        "action": {
            "parts": {name: part.columns for name, part in space.parts.items()},
            **_made_of(skill.experiment.need("actuation"), type(actuation.part)),
            "reads": sorted({*actuation.reads.values(), *actuation.part.keeps}),
        },
    }
    evaluation = skill.card.get("evaluation") or {}
    if evaluation.get("success_rate") is not None:
        found["success"] = {
            "rate": evaluation["success_rate"],
            "means": evaluation.get("success"),
        }
    if isinstance(built.scene, MujocoScene):
        found["controls"] = _controls(built.scene.spec().compile())
    if isinstance(built.scene, CharacterScene):
        layout = built.scene.layout
        found["character"] = {
            "name": built.scene.character.name,
            "links": layout.link_names,
            "end_effectors": layout.end_effectors,
            "joints": layout.joint_names,
        }
    motion = built.context.sections.get("motion")
    if isinstance(motion, Motion):
        found["motion"] = {**motion.provenance(), "source": without_folder(motion.clip.source)}
    return {key: json.dumps(value) for key, value in found.items()}


def _made_of(chosen: Chosen, part: type) -> dict[str, str]:
    about = inspect.getdoc(part) or ""
    return {chosen.component.kind: chosen.component.name, "about": about}


def _controls(model: mujoco.MjModel) -> list[dict[str, Any]]:
    """What drives what, in the order of the control's columns."""
    found: list[dict[str, Any]] = []
    late = lags(model) if model.nu else np.zeros(0)
    for index in range(model.nu):
        actuator = model.actuator(index)
        one: dict[str, Any] = {"actuator": actuator.name}
        if model.actuator_trntype[index] == mujoco.mjtTrn.mjTRN_JOINT:
            joint = int(model.actuator_trnid[index, 0])
            one["joint"] = model.joint(joint).name
            if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_BALL:
                one["axis"] = "xyz"[int(np.abs(model.actuator_gear[index, :3]).argmax())]
        if model.actuator_biastype[index] == mujoco.mjtBias.mjBIAS_AFFINE:
            kp, kv = model.actuator_gainprm[index, 0], -model.actuator_biasprm[index, 2]
            one |= {"kp": float(kp), "kd": float(kv - kp * model.opt.timestep)}
            one["lag"] = float(late[index])
        if model.actuator_forcelimited[index]:
            one["limit"] = float(np.abs(model.actuator_forcerange[index]).max())
        found.append(one)
    return found


def reference_table(built: Built) -> dict[str, np.ndarray] | None:
    """The reference motion by field, each (T, …), at ``time`` (T,) s, evenly spaced from the clip's beginning.

    There are about :data:`ROWS` rows in a control period. Where the motion does not ``loop`` the last row
    is its end. Where it does, the first row follows the last one, its root turned by ``cycle_turn`` rad
    about the vertical and then moved by ``cycle_displacement`` (2,) m. None without a reference.
    """
    if not any(isinstance(wired.part, Reference) for wired in built.environment.parts.fields):
        return None
    motion = reference_motion(built.context)
    count = max(2, round(motion.duration / motion.control_dt * ROWS))
    time = torch.arange(count if motion.loop else count + 1) * (motion.duration / count)
    table = {name: value.cpu().numpy() for name, value in motion.sample(time).items()}
    table |= {"time": time.numpy(), "loop": np.array(motion.loop)}
    if motion.loop:
        cycle = cycle_transform(motion.clip)
        table["cycle_displacement"] = cycle.displacement.numpy()
        table["cycle_turn"] = np.array(cycle.heading)
    return table


def _summary(facts: Mapping[str, str]) -> str:
    def sizes(shapes: Mapping[str, Any]) -> str:
        return ", ".join(f"{name} {shape}" for name, shape in shapes.items())

    observations = {n: o["shape"] for n, o in json.loads(facts["observations"]).items()}
    parts = json.loads(facts["action"])["parts"]
    frequency = json.loads(facts["control"])["frequency"]
    return f"{sizes(observations)} → {sizes(parts)} · {frequency:g} Hz"

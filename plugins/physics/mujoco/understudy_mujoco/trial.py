"""A stranger's model is first compiled in a process of its own, within limits.

A few bytes of MJCF (``replicate``, ``lengthrange``, ``nkey``) have MuJoCo compute for hours or allocate
without end, and an exception within it (MuJoCo 4.0) leaves the thread's log handler pointing at itself:
the next warning never returns. What ends here costs that process alone.
"""

from __future__ import annotations

import hashlib
import os
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np

from understudy.errors import FileError
from understudy_mujoco.apart import Limits, read_apart, serve
from understudy_mujoco.mjcf import Mjcf, read_mjcf

__all__ = ["spec_of", "try_out"]

LIMITS = Limits()
"""For reading and compiling a model."""

_CARRIED = ("numeric", "key", "_")
"""Of fields that no simulation reads; those that end in 0 are worked out of others."""
_OBJECTS = {
    "body": mujoco.mjtObj.mjOBJ_BODY,
    "geom": mujoco.mjtObj.mjOBJ_GEOM,
    "jnt": mujoco.mjtObj.mjOBJ_JOINT,
    "actuator": mujoco.mjtObj.mjOBJ_ACTUATOR,
}

_WAYS = {
    "no decoder found for mesh file": "export the mesh as STL or OBJ",
    "stl_decoder": "export the mesh as a binary STL or an OBJ",
    "mass and inertia of moving bodies must be larger": "give it a mass, and an inertia that is not 0",
}
"""What to do where MuJoCo's reason begins so."""

_NOT_BELOW_0 = (
    "dof_damping",
    "dof_armature",
    "dof_frictionloss",
    "geom_friction",
    "pair_friction",
    "density",
    "viscosity",
)
"""Of a model or its options. What resists a motion would drive it."""
_RANGES = ("jnt_range", "actuator_ctrlrange", "actuator_forcerange")
"""One that is upside down MuJoCo takes for none."""
_HEAVIEST = 1e6
"""kg that a body which moves may have."""
_GRAVITY = 1e4
"""m/s² at most."""

_MEMORY = 16 * 2**20
"""Bytes for contacts and what is computed in a step, at least: about as much as MuJoCo takes where a model says nothing."""

_MOST_ATTACHED = 500
"""Models in a model."""

_passed: set[bytes] = set()


def spec_of(model: Mjcf) -> mujoco.MjSpec:
    """What MuJoCo makes of `model`. A URDF's first link is free: the format has no floating base.

    Sizes that a model states (``<size memory>``) are for what its author did with it. What does not fit, such as contacts
    with a floor that is added, MuJoCo leaves out; so they are only made larger.

    Raises
    ------
    ValueError
        it refuses it.
    """
    _check_attached(model.text, model.assets, {})
    # Models that it attaches are among its assets. Else MuJoCo would open files of their names.
    models = {name: content for name, content in model.assets.items() if name.endswith(".xml")}
    try:
        spec = mujoco.MjSpec.from_string(model.text, include=models, assets=dict(model.assets))
    except ValueError as error:
        if found := re.search(r"could not find body '(.*)' in model asset '(.*)'", str(error)):
            body, other = found.groups()
            raise ValueError(
                f"the model '{other}' that it attaches has no body '{body}'."
            ) from error
        raise
    spec.nconmax = spec.njmax = spec.nstack = -1
    spec.memory = max(spec.memory, _MEMORY) if spec.memory >= 0 else -1
    if model.urdf:
        base = spec.worldbody.first_body()
        if base is not None and not list(base.joints):
            base.add_freejoint()
    return spec


def _check_attached(text: str, assets: Mapping[str, bytes], known: dict[str, int]) -> int:
    """How many models the model `text` attaches in all, `known` by the name of those among its `assets` that were counted.
    A few files of a few lines can ask for more than any memory holds."""
    if "<attach" not in text:
        return 0
    root = ElementTree.fromstring(text)
    files = {model.get("name"): model.get("file", "") for model in root.iter("model")}

    def count(element: ElementTree.Element, times: int) -> int:
        if element.tag == "replicate" and (word := element.get("count", "")).strip().isdecimal():
            times *= int(word)
        if element.tag != "attach":
            return sum(count(child, times) for child in element)
        if (model := element.get("model", "")) not in files:
            raise ValueError(f"it attaches the model '{model}', which it does not name.")
        if (name := files[model]) not in known:
            known[name] = _check_attached(assets[name].decode(), assets, known)
        return times * (1 + known[name])

    if (found := count(root, 1)) > _MOST_ATTACHED:
        raise ValueError(f"it attaches more than {_MOST_ATTACHED} models in all.")
    return found


def try_out(path: Path, root: Path, model: Mjcf) -> None:
    """Compile the model at `path`, which may refer to files below `root`, once for what `model` holds
    of it.

    Raises
    ------
    FileError
        it does not compile, or not within the limits.
    """
    digest = hashlib.sha256(model.text.encode())
    for name, content in sorted(model.assets.items()):
        digest.update(f"\0{name}\0{len(content)}\0".encode() + content)
    if digest.digest() in _passed:
        return
    refusal = f"The model {path} does not compile"
    read_apart(__name__, path, refusal, LIMITS, os.fsencode(root.absolute()))
    _passed.add(digest.digest())


def attempt(path: Path) -> str:
    """Read and compile the model at `path` in this process, which may refer to files below the folder
    that standard input names; nothing to tell.

    Raises
    ------
    FileError
        it does not load or compile.
    """
    model = read_mjcf(path, Path(os.fsdecode(sys.stdin.buffer.read())))
    doing = "load"
    try:
        spec = spec_of(model)
        doing = "compile"
        compiled = spec.compile()
    except (ValueError, RuntimeError, mujoco.FatalError, MemoryError) as error:
        said = reason_of(error)
        raise FileError(f"The model {path} does not {doing}: {said}") from error
    if damaged := not_finite(compiled):
        raise FileError(f"The model {path} does not compile: its {damaged} is no finite number.")
    if wrong := impossible(compiled):
        raise FileError(f"The model {path} does not compile: its {wrong}.")
    return ""


def reason_of(error: Exception) -> str:
    """What MuJoCo says of a model, and of which element; its lines are not the file's, where that includes others."""
    said, _, more = str(error).strip().partition("\n")
    if not said or said == "Caught an unknown exception!":
        return "MuJoCo gives no reason, which may be that it needs more memory."
    said = said.removeprefix("Error: ").removesuffix(":")
    way = next((f"; {way}" for start, way in _WAYS.items() if said.startswith(start)), "")
    element = re.match(r"Element (?:name )?'([^']*)'(?:, id (\d+))?", more)
    if element is None or not any(element.groups()):
        return said + way
    return f"{said} (element {repr(element[1]) if element[1] else element[2]}){way}"


def not_finite(model: mujoco.MjModel) -> str:
    """The first number of `model` that is none, and whose it is; nothing if all are finite. MuJoCo takes them, and
    simulates nothing with them. A range may be infinite; what it only carries along may be anything."""
    for holder in (model, model.opt):
        for name in dir(holder):
            value = getattr(holder, name)
            plain = isinstance(value, float) or (
                isinstance(value, np.ndarray) and value.dtype.kind == "f"
            )
            if not plain or name.startswith(_CARRIED) or name.endswith("0") or "user" in name:
                continue
            wrong = np.isnan(value) if "range" in name else ~np.isfinite(value)
            if wrong.any():
                return _named(model, name, int(np.argwhere(np.atleast_1d(wrong))[0, 0]))
    return ""


def _named(model: mujoco.MjModel, name: str, row: int) -> str:
    """The field `name`, and whose its `row` is where that has a name."""
    kind = name.partition("_")[0]
    if kind == "dof":
        kind, row = "jnt", int(model.dof_jntid[row])
    of = mujoco.mj_id2name(model, _OBJECTS[kind], row) if kind in _OBJECTS else ""
    return f"{name} of {of!r}" if of else name


def impossible(model: mujoco.MjModel) -> str:
    """The first number of `model` that nothing in the world has, whose it is and what to do; nothing if there is none.
    MuJoCo takes them."""
    for name in _NOT_BELOW_0:
        values = np.atleast_1d(getattr(model if "_" in name else model.opt, name))
        if (values < 0.0).any():
            row = int(np.argwhere(values < 0.0)[0, 0])
            return f"{_named(model, name, row)} is {values.min():g}; let it be 0 or more"
    for name in _RANGES:
        ranges = getattr(model, name)
        for row in np.flatnonzero(ranges[:, 0] > ranges[:, 1])[:1]:
            low, high = ranges[row]
            return f"{_named(model, name, int(row))} begins at {low:g}, above its end at {high:g}; turn it round"
    moving = np.flatnonzero((model.body_weldid != 0) & (model.body_mass > _HEAVIEST))
    if moving.size:
        mass = model.body_mass[moving[0]]
        return (
            f"{_named(model, 'body_mass', int(moving[0]))} is {mass:.3g} kg, more than {_HEAVIEST:g}; lengths are metres, "
            "and densities kg/m³"
        )
    if (strength := float(np.abs(model.opt.gravity).max())) > _GRAVITY:
        return f"gravity of {strength:g} m/s² is more than {_GRAVITY:g}; the earth's is 9.81"
    return ""


if __name__ == "__main__":
    serve(attempt)

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
from pathlib import Path

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

_MEMORY = 16 * 2**20
"""Bytes for contacts and what is computed in a step, at least: about as much as MuJoCo takes where a model says nothing."""

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
    spec = mujoco.MjSpec.from_string(model.text, assets=dict(model.assets))
    spec.nconmax = spec.njmax = spec.nstack = -1
    spec.memory = max(spec.memory, _MEMORY) if spec.memory >= 0 else -1
    if model.urdf:
        base = spec.worldbody.first_body()
        if base is not None and not list(base.joints):
            base.add_freejoint()
    return spec


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
                kind, row = name.partition("_")[0], int(np.argwhere(np.atleast_1d(wrong))[0, 0])
                if kind == "dof":
                    kind, row = "jnt", int(model.dof_jntid[row])
                of = mujoco.mj_id2name(model, _OBJECTS[kind], row) if kind in _OBJECTS else ""
                return f"{name} of {of!r}" if of else name
    return ""


if __name__ == "__main__":
    serve(attempt)

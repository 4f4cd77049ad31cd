"""What of a MuJoCo model may differ between worlds, by name: ``FIELD`` or ``FIELD/OBJECT``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import mujoco

from understudy.errors import ConfigError, suggestion
from understudy.task import Shape

__all__ = ["MOCAP", "Parameter", "chosen", "parameters"]

#: Fields of MjModel (mocap poses: of MjData), and the kind of object that each has a row for.
FIELDS = {
    "mocap_pos": "mocap",
    "mocap_quat": "mocap",
    "body_mass": "body",
    "body_inertia": "body",
    "body_ipos": "body",
    "body_pos": "body",
    "body_quat": "body",
    "geom_size": "geom",
    "geom_pos": "geom",
    "geom_quat": "geom",
    "geom_friction": "geom",
    "dof_damping": "joint",
    "dof_armature": "joint",
    "actuator_gainprm": "actuator",
    "actuator_biasprm": "actuator",
}
MOCAP = ("mocap_pos", "mocap_quat")

_PRIMITIVES = {
    int(mujoco.mjtGeom.mjGEOM_SPHERE),
    int(mujoco.mjtGeom.mjGEOM_CAPSULE),
    int(mujoco.mjtGeom.mjGEOM_ELLIPSOID),
    int(mujoco.mjtGeom.mjGEOM_CYLINDER),
    int(mujoco.mjtGeom.mjGEOM_BOX),
}

_DOFS = (6, 3, 1, 1)  # of joints: free, ball, slide, hinge


@dataclass(frozen=True)
class Parameter:
    """`rows` of the field `field`, or for ``active`` the geoms that it switches on and off."""

    name: str
    field: str
    rows: int | slice
    shape: Shape


def parameters(model: mujoco.MjModel) -> dict[str, Parameter]:
    """All parameters of `model`, by name.

    ``gravity`` (3,), m/s²; every field of :data:`FIELDS` as a whole; ``FIELD/OBJECT`` for every named
    object it has a row for (joints: one number a degree of freedom); and ``active/BODY`` (), which
    takes all contacts from a body and those attached to it where it is 0, or ``active/GEOM``, from one
    geom that is not named like a body.
    """
    found = {"gravity": Parameter("gravity", "gravity", slice(None), (3,))}
    data = mujoco.MjData(model)
    for field, kind in FIELDS.items():
        whole = getattr(data if field in MOCAP else model, field)
        if not len(whole):
            continue
        found[field] = Parameter(field, field, slice(None), tuple(whole.shape))
        for name, rows in _objects(model, kind):
            if field == "geom_size" and int(model.geom_type[rows]) not in _PRIMITIVES:
                continue  # a mesh has its own extent, a plane none
            shape = tuple(whole[rows].shape)
            found[f"{field}/{name}"] = Parameter(f"{field}/{name}", field, rows, shape)
    for body in range(1, model.nbody):
        name, geoms = model.body(body).name, _geoms_below(model, body)
        if name and geoms.stop > geoms.start:
            found[f"active/{name}"] = Parameter(f"active/{name}", "active", geoms, ())
    for geom in range(model.ngeom):
        if (name := f"active/{model.geom(geom).name}") not in found and model.geom(geom).name:
            found[name] = Parameter(name, "active", slice(geom, geom + 1), ())
    return found


def chosen(known: Mapping[str, Parameter], names: Sequence[str], who: str) -> list[Parameter]:
    """The parameters `names`.

    Raises
    ------
    ConfigError
        for an unknown name, one given twice, or a field given as a whole and in part.
    """
    for name in names:
        if name not in known:
            raise ConfigError(
                f"{who} has no parameter '{name}' in this scene.{suggestion(name, known)}"
            )
        field = name.partition("/")[0]
        if names.count(name) > 1 or (field != name and field in names):
            raise ConfigError(
                f"{who} is asked to vary '{name}' twice. Name a field as a whole ({field}), or its "
                f"objects ({field}/NAME), each once."
            )
    return [known[name] for name in names]


def _objects(model: mujoco.MjModel, kind: str) -> Iterator[tuple[str, int | slice]]:
    """The named objects of a kind, and their rows."""
    rows = {
        # a mocap body's pose belongs to the state, every other body's to the model
        "mocap": {i: int(m) for i, m in enumerate(model.body_mocapid) if m >= 0},
        "body": {i: i for i, m in enumerate(model.body_mocapid) if i > 0 and m < 0},
        "geom": {i: i for i in range(model.ngeom)},
        "actuator": {i: i for i in range(len(model.actuator_gainprm))},
        "joint": {
            i: slice(int(start), int(start) + _DOFS[int(model.jnt_type[i])])
            for i, start in enumerate(model.jnt_dofadr)
        },
    }[kind]
    named = getattr(model, "body" if kind == "mocap" else kind)
    for index, row in rows.items():
        if named(index).name:
            yield named(index).name, row


def _geoms_below(model: mujoco.MjModel, body: int) -> slice:
    """The geoms of a body and of all bodies attached to it; MuJoCo numbers them in one row."""
    last = body + 1
    while last < model.nbody and model.body_parentid[last] >= body:
        last += 1
    geoms = [i for i in range(model.ngeom) if body <= model.geom_bodyid[i] < last]
    return slice(geoms[0], geoms[-1] + 1) if geoms else slice(0, 0)

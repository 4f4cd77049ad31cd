"""What MuJoCo would compute of a scene without effect, left out. The physics stays what it is."""

from __future__ import annotations

import ctypes

import mujoco
import numpy as np

#: Parameters that worlds may differ in only where nothing is left out.
NEED_ALL = ("active", "geom_friction", "dof_damping")

_PASSIVE = (
    *("jnt_stiffness", "jnt_stiffnesspoly", "dof_damping", "dof_dampingpoly"),
    *("actuator_damping", "actuator_dampingpoly", "body_gravcomp"),
)
_MIXED = ("geom_priority", "geom_solref", "geom_solimp")
#: Beyond this, looking at all pairs costs more than it can save.
_MOST_GEOMS = 1000
_OF_GEOMS = ("geom_margin", "geom_gap", "geom_surfacevel")


def lean(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """The compiled `spec`, which is changed: without lights; with the contacts that are possible as
    predefined pairs, where all are between a floor and something else; and without the stages that do
    nothing in this scene.

    Raises
    ------
    ValueError, mujoco.FatalError
        if it does not compile.
    """
    for light in list(spec.lights):
        spec.delete(light)
    model = spec.compile()
    if _pair_with_floors(spec, model):
        model = spec.compile()
    model.opt.disableflags |= _idle(model)
    return model


def _idle(model: mujoco.MjModel) -> int:
    """Flags that switch off what does nothing here."""
    flags, disable = 0, mujoco.mjtDisableBit
    if model.ntree <= 1:  # one tree is one island
        flags |= int(disable.mjDSBL_ISLAND)
    media = (model.opt.density, model.opt.viscosity, model.ntendon, model.nflex, model.nplugin)
    forces = any(np.any(getattr(model, name)) for name in _PASSIVE)
    if not any(media) and not forces and mujoco.get_mjcb_passive() is None:
        flags |= int(disable.mjDSBL_SPRING | disable.mjDSBL_DAMPER)
    return flags


def _pair_with_floors(spec: mujoco.MjSpec, model: mujoco.MjModel) -> bool:
    """Predefine the pairs of geoms that may touch, if one of each is a plane fixed to the world; returns
    whether it did.

    MuJoCo sorts all bodies along an axis in each step to find which might touch one another, also
    where none may. A floor is tested with everything anyway.
    """
    if model.ngeom > _MOST_GEOMS:
        return False
    pairs = _possible_contacts(model)
    floors = (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE) & (model.geom_bodyid == 0)
    alike = all((getattr(model, n) == getattr(model, n)[:1]).all() for n in _MIXED)
    if not (
        alike
        and all(floors[a] and model.geom(a).name and model.geom(b).name for a, b in pairs)
        and not any(np.any(getattr(model, name)) for name in _OF_GEOMS)
        and not (model.npair or model.nexclude or model.nflex)
    ):  # fmt: skip
        return False
    for a, b in pairs:
        slide, spin, roll = np.maximum(model.geom_friction[a], model.geom_friction[b])
        spec.add_pair(
            geomname1=model.geom(a).name,
            geomname2=model.geom(b).name,
            condim=int(max(model.geom_condim[[a, b]])),
            friction=[slide, slide, spin, roll, roll],
            solref=model.geom_solref[a],
            solimp=model.geom_solimp[a],
        )
    for body in spec.bodies:
        for geom in body.geoms:
            geom.contype = geom.conaffinity = 0
    return True


def _possible_contacts(model: mujoco.MjModel) -> list[tuple[int, int]]:
    """Pairs of geoms that MuJoCo lets touch, planes first."""
    kind, affinity = model.geom_contype, model.geom_conaffinity
    welded = model.body_weldid[model.geom_bodyid]
    above = model.body_weldid[model.body_parentid[welded]]
    meant = (kind[:, None] & affinity) | (affinity[:, None] & kind)
    related = (welded[:, None] == above) | (above[:, None] == welded)
    related &= (welded[:, None] != 0) & (welded != 0)
    if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_FILTERPARENT:
        related[:] = False
    possible = (meant != 0) & (welded[:, None] != welded) & ~related
    pairs = np.argwhere(np.triu(possible)).tolist()
    return [(b, a) if model.geom_type[b] < model.geom_type[a] else (a, b) for a, b in pairs]


def read_no_clock() -> None:
    """Keep MuJoCo from reading the clock for ``mjData.timer``, 30 times in each step.

    Python's ``mujoco.set_mjcb_time(None)`` brings back the clock, so the pointer itself is cleared.
    """
    try:
        bindings = ctypes.CDLL(mujoco._callbacks.__file__)
        ctypes.c_void_p.in_dll(bindings, "mjcb_time").value = None
    except (AttributeError, OSError, ValueError):
        pass  # not where this platform or version has it; only speed is lost

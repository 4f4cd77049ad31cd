"""Position servos on all joints of a character: the model's own, or ones made for it.

A servo's velocity gain is ``kd + kp * timestep``: with implicit integration of the velocity term that is
stable PD (Tan et al. 2011), which compares the target with the position one step ahead, ``q + timestep *
qdot``. Its torque is limited.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass

import mujoco
import numpy as np

from understudy.options import check_range
from understudy_characters.character import Character
from understudy_characters.staging import free_name

__all__ = ["add_servo", "lags"]

_HINGE, _BALL = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_BALL)
_JOINT = int(mujoco.mjtTrn.mjTRN_JOINT)
_IN_PARENT = int(mujoco.mjtTrn.mjTRN_JOINTINPARENT)


#: Of the weight times the length of a figure: torque of a joint that carries all of it. With the cube
#: root of smaller shares this gives every limit of the DeepMimic character to within a factor of 2.4.
STRENGTH = 0.45
EARTH = 9.81
"""m/s^2"""
#: Of the inertia that a servo's gains are for: what a joint has to move at least, its rotor included. Of
#: that character's ankles it is as much, with its armature of 0.01 kg m^2.
ROTOR = 0.02
#: s: up to this time step servos are left as they are made (600 Hz: thesis, section 3.5).
FINE = 1 / 600
#: rad/s by which a servo's whole torque may turn its joint in one step. Below, joints that are shaken by 0.15
#: rad stay within 0.2 rad of where they are at 2400 Hz, of six characters and robots; above, within 0.1 to 470.
SHAKING = 40.0
#: rad/s, of ``step_speed`` in coarse physics.
COARSE_SPEED = 10.0


@dataclass(frozen=True)
class ServoOptions:
    """How servos are made for a model that lacks them.

    With the defaults kd is 0.1 s times kp, the ratio of the released DeepMimic character, whose gains
    :func:`gains` finds from its torque limits to within a factor of two.
    """

    keep: bool = True  #: whether a model whose joints are all driven by position servos keeps these
    #: rad/s, above 0, at which a servo with its load would swing undamped
    natural_frequency: float = 20.0
    damping_ratio: float = 1.0  #: 1 is critical damping; above 0
    #: rad off its target at which a servo gives its whole torque: at least and at most.
    deflection: tuple[float, float] = (0.1, 0.3)
    #: rad/s by which a servo's whole torque turns its joint in one sub-step, at most; where these are
    #: longer than 1/600 s, rotors get the inertia for it. Null does so only in coarse physics
    #: (``resolution.substeps``), at 10 rad/s.
    step_speed: float | None = None

    def __post_init__(self) -> None:
        check_range(self, "natural_frequency", "step_speed", most=1e3)
        check_range(self, "deflection", most=100)
        check_range(self, "natural_frequency", "damping_ratio", "step_speed", above=0)
        if not 0.0 < self.deflection[0] <= self.deflection[1]:
            raise ValueError(
                f"deflection={self.deflection} is not possible: give 0 < LEAST <= MOST."
            )


@dataclass(frozen=True)
class Drive:
    """One degree of freedom that is driven: a hinge, or one axis of a ball."""

    joint: int  #: id
    axis: int  #: 0, or which of a ball's three
    dof: int


def drives(character: Character) -> list[Drive]:
    """The figure's degrees of freedom without the root's, in the model's order."""
    model = character.model
    ids = [
        model.body_jntadr[joint.body] + k
        for joint in character.joints[1:]
        for k in range(model.body_jntnum[joint.body])
    ]
    return [
        Drive(int(j), k, int(model.jnt_dofadr[j]) + k)
        for j in ids
        for k in range(3 if model.jnt_type[j] == _BALL else 1)
    ]


def _driven(model: mujoco.MjModel, actuator: int) -> tuple[int, int] | None:
    """Joint and axis that the actuator drives directly, if it is a joint's."""
    kind = int(model.actuator_trntype[actuator])
    if kind not in (_JOINT, _IN_PARENT):
        return None
    joint, gear = int(model.actuator_trnid[actuator, 0]), model.actuator_gear[actuator, :3]
    if model.jnt_type[joint] == _HINGE:  # of which both kinds are the same
        return joint, 0
    if kind != _JOINT:
        return None
    if model.jnt_type[joint] == _BALL and np.count_nonzero(gear) == 1:
        return joint, int(np.flatnonzero(gear)[0])
    return None


def has_servos(character: Character) -> bool:
    """Whether the model's actuators are position servos, one for each degree of freedom except the root's."""
    model = character.model
    wanted = sorted((drive.joint, drive.axis) for drive in drives(character))
    found = [_driven(model, actuator) for actuator in range(model.nu)]
    return sorted(place for place in found if place) == wanted and all(
        place and _is_servo(model, actuator) for actuator, place in enumerate(found)
    )


def _is_servo(model: mujoco.MjModel, actuator: int) -> bool:
    gain, bias = model.actuator_gainprm[actuator], model.actuator_biasprm[actuator]
    return bool(
        model.actuator_trntype[actuator] == _JOINT
        and model.actuator_gaintype[actuator] == mujoco.mjtGain.mjGAIN_FIXED
        and model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_AFFINE
        and model.actuator_dyntype[actuator] == mujoco.mjtDyn.mjDYN_NONE
        and gain[0] > 0.0
        and bias[0] == 0.0
        and np.isclose(bias[1], -gain[0])
        and np.isclose(model.actuator_gear[actuator, :3].max(), 1.0)
    )


def gains_of(model: mujoco.MjModel) -> dict[str, str]:
    """By gains in words (kp, kd less what stable PD adds to it, torque limit): the actuators."""
    found: dict[str, list[str]] = {}
    for actuator in range(model.nu):
        kp, kd = model.actuator_gainprm[actuator, 0], -model.actuator_biasprm[actuator, 2]
        kd -= kp * model.opt.timestep
        limit = np.abs(model.actuator_forcerange[actuator]).max()
        limited = f", at most {limit:g} N m" if model.actuator_forcelimited[actuator] else ""
        gains = f"kp {kp:.4g} N m/rad, kd {kd:.4g} N m s/rad{limited}"
        found.setdefault(gains, []).append(model.actuator(actuator).name)
    return {gains: ", ".join(names) for gains, names in found.items()}


def torque_limits(character: Character) -> np.ndarray:
    """(U,) N m: the strength of each of :func:`drives`, from the model if it says so.

    A model says so by limits of its joints' or actuators' forces, or of motors' controls. Otherwise it is
    :data:`STRENGTH` times the figure's weight (on Earth, if there is no gravity), times its length, times the cube root
    of the share of its mass that hangs on the joint.
    """
    model = character.model
    stated: dict[tuple[int, int], float] = {}
    for actuator in range(model.nu):
        place, strength = _driven(model, actuator), _strength(model, actuator)
        if place is not None and strength is not None:
            stated[place] = max(strength, stated.get(place, 0.0))
    mass = float(model.body_subtreemass[character.root])
    weight = mass * (float(np.linalg.norm(model.opt.gravity)) or EARTH)
    found = []
    for drive in drives(character):
        beyond = float(model.body_subtreemass[model.jnt_bodyid[drive.joint]]) / mass
        limit = stated.get((drive.joint, drive.axis), np.inf)
        if model.jnt_actfrclimited[drive.joint]:
            limit = min(limit, float(np.abs(model.jnt_actfrcrange[drive.joint]).max()))
        if not np.isfinite(limit):
            limit = STRENGTH * weight * character.length * beyond ** (1 / 3)
        found.append(limit)
    return np.array(found)


def _strength(model: mujoco.MjModel, actuator: int) -> float | None:
    """N m: the most that the actuator does to its joint, if the model limits it."""
    gear = float(np.abs(model.actuator_gear[actuator, :3]).max())
    if model.actuator_forcelimited[actuator]:
        return gear * float(np.abs(model.actuator_forcerange[actuator]).max())
    motor = (
        model.actuator_gaintype[actuator] == mujoco.mjtGain.mjGAIN_FIXED
        and model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_NONE
    )
    if motor and model.actuator_ctrllimited[actuator]:
        most = float(np.abs(model.actuator_ctrlrange[actuator]).max())
        return gear * float(np.abs(model.actuator_gainprm[actuator, 0])) * most
    return None


def carried_inertia(character: Character) -> np.ndarray:
    """(U,) kg m^2: the diagonal of the mass matrix in the zero pose, of each of :func:`drives`."""
    return _mass_matrix(character).diagonal()[[drive.dof for drive in drives(character)]]


def free_inertia(character: Character) -> np.ndarray:
    """(U,) kg m^2: what the torque of each of :func:`drives` accelerates alone, in the zero pose, with
    nothing held: one over the diagonal of the mass matrix's inverse. At most :func:`carried_inertia`."""
    inverse = np.linalg.inv(_mass_matrix(character))
    return 1.0 / inverse.diagonal()[[drive.dof for drive in drives(character)]]


def _mass_matrix(character: Character) -> np.ndarray:
    """(nv, nv), in the zero pose, rotors included."""
    model, data = character.model, character.zero_pose
    mujoco.mj_comPos(model, data)
    mujoco.mj_crb(model, data)
    matrix = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, matrix)
    return matrix


def steadying_rotors(
    character: Character, limits: np.ndarray, timestep: float, speed: float
) -> np.ndarray:
    """(U,) kg m^2: the rotor inertia that each of :func:`drives` lacks for its whole torque, `limits` (U,)
    N m, to turn it by no more than `speed` rad/s in one `timestep` s; infinite limits need none.

    A servo is stable at any step while its velocity term is integrated implicitly. One at its limit
    is not: its torque is constant for a whole step, after which a light joint has overshot whatever
    it was to reach, and is driven back as hard. More inertia bounds by how much. It adds to the free
    inertia exactly, whatever is added to the other joints.
    """
    needed = np.where(np.isfinite(limits), limits, 0.0) * timestep / speed
    return np.clip(needed - free_inertia(character), 0.0, None)


def gains(
    character: Character, limits: np.ndarray, options: ServoOptions
) -> tuple[np.ndarray, np.ndarray]:
    """kp (U,) N m/rad and kd (U,) N m s/rad of servos with the torque `limits` (U,).

    kp = I w^2 and kd = 2 z I w, with w the natural frequency and z the damping ratio. The effective
    inertia I is what the joint moves: the mass matrix's diagonal in the zero pose, which is what hangs
    on it. An ankle that carries a light foot also moves all the rest about the foot, and a waist may
    have legs hanging on it that it cannot swing; what a joint is made to move its strength tells. So I
    is kept where the servo gives its whole torque within the range of deflections.
    """
    frequency = options.natural_frequency
    stiff, soft = (limits / deflection / frequency**2 for deflection in options.deflection)
    inertia = np.clip(carried_inertia(character), soft, stiff)
    return inertia * frequency**2, 2.0 * options.damping_ratio * inertia * frequency


def drive(
    spec: mujoco.MjSpec,
    character: Character,
    timestep: float,
    options: ServoOptions,
    longest: float | None = None,
) -> None:
    """Have every joint of `character`, the compiled `spec`, driven by a position servo at `timestep`.

    Other actuators, their sensors, and key frames (which contain controls) are removed. Joints that
    carry very little get the inertia of the rotor that their torque needs, without which a hand would
    shake; and all get what they need at the `longest` time step that this model is for, this one unless
    given (:func:`steadying_rotors`).
    """
    if options.keep and has_servos(character):
        for actuator in spec.actuators:  # their velocity gain is for the time step they came with
            # Compiled, since a file may say it as a damping ratio.
            actuator.biasprm[2] = character.model.actuator_biasprm[actuator.id, 2]
            actuator.biasprm[2] -= actuator.gainprm[0] * (timestep - spec.option.timestep)
            actuator.biasprm[2] = min(actuator.biasprm[2], 0.0)
    else:
        _make_servos(spec, character, timestep, options)
    longest = timestep if longest is None else longest
    if options.step_speed is not None and longest > 1.001 * FINE:
        driven = Character(character.name, spec.compile())
        rotors = steadying_rotors(driven, _most(driven), longest, options.step_speed)
        _add_rotors(spec, driven, rotors)


def warn_of_shaking(character: Character, timestep: float) -> None:
    """Warn if a servo of a driven character is too strong at this time step for what it moves."""
    limits = _most(character)
    speeds = np.where(np.isfinite(limits), limits, 0.0) * timestep / free_inertia(character)
    worst = int(speeds.argmax())
    if speeds[worst] > SHAKING:
        joint = character.model.joint(drives(character)[worst].joint).name
        finer = math.ceil(speeds[worst] / SHAKING / timestep)
        warnings.warn(
            f"The time step of {1e3 * timestep:.3g} ms is too long for the servo of {character.name}'s joint "
            f"'{joint}': its whole torque turns it by {speeds[worst]:.0f} rad/s in one step, and it may shake. "
            f"Raise control.substeps until physics runs at {finer} Hz, or give the rotors more inertia: "
            "scene.servos.step_speed=10.",
            stacklevel=2,
        )


def _most(character: Character) -> np.ndarray:
    """(U,) N m: the limits of a driven character's servos, in the order of :func:`drives`."""
    model, limits = character.model, {}
    for actuator in range(model.nu):
        limited = model.actuator_forcelimited[actuator]
        most = np.abs(model.actuator_forcerange[actuator]).max() if limited else np.inf
        limits[_driven(model, actuator)] = most
    return np.array([limits[one.joint, one.axis] for one in drives(character)])


def _add_rotors(spec: mujoco.MjSpec, character: Character, rotors: np.ndarray) -> None:
    """Add `rotors` (U,) kg m^2 to the joints of `character`, the compiled `spec`: of a ball's three the most."""
    added: dict[int, float] = {}
    for one, missing in zip(drives(character), rotors, strict=True):
        added[one.joint] = max(added.get(one.joint, 0.0), float(missing))
    for joint in spec.joints:
        joint.armature += added.get(joint.id, 0.0)


def _make_servos(
    spec: mujoco.MjSpec, character: Character, timestep: float, options: ServoOptions
) -> None:
    """Replace all actuators of `character`, the compiled `spec`, by servos."""
    for sensor in list(spec.sensors):
        if sensor.objtype == mujoco.mjtObj.mjOBJ_ACTUATOR:
            spec.delete(sensor)
    for item in [*spec.actuators, *spec.keys]:
        spec.delete(item)
    limits = torque_limits(character)
    stiffness, damping = gains(character, limits, options)
    rotors = ROTOR * stiffness / options.natural_frequency**2 - carried_inertia(character)
    _add_rotors(spec, character, rotors)
    joints = {joint.id: joint for joint in spec.joints}
    for one, limit, kp, kd in zip(drives(character), limits, stiffness, damping, strict=True):
        joint = joints[one.joint]
        joint.name = joint.name or free_name(f"joint{one.joint}", spec.joints)
        ball = character.model.jnt_type[one.joint] == _BALL
        add_servo(spec, joint.name, one.axis if ball else None, limit, kp, kd + kp * timestep)


def add_servo(
    spec: mujoco.MjSpec, joint: str, axis: int | None, limit: float, kp: float, kv: float
) -> None:
    """A position servo of at most `limit` N m on a hinge, or about one `axis` of a ball joint."""
    actuator = spec.add_actuator(
        name=free_name(joint if axis is None else f"{joint}_{'xyz'[axis]}", spec.actuators),
        target=joint,
        trntype=mujoco.mjtTrn.mjTRN_JOINT,
        gaintype=mujoco.mjtGain.mjGAIN_FIXED,
        biastype=mujoco.mjtBias.mjBIAS_AFFINE,
        dyntype=mujoco.mjtDyn.mjDYN_NONE,
        ctrllimited=False,
        forcelimited=True,
        forcerange=[-limit, limit],
        gear=[float(k == (axis or 0)) for k in range(6)],
    )
    actuator.gainprm[0] = kp
    actuator.biasprm[0], actuator.biasprm[1], actuator.biasprm[2] = 0.0, -kp, -kv


def lags(model: mujoco.MjModel) -> np.ndarray:
    """(nu,) s: how late each servo follows a moving target, (kd + the joint's damping) / kp."""
    kp = model.actuator_gainprm[:, 0]
    dofs = model.jnt_dofadr[model.actuator_trnid[:, 0]]
    kd = -model.actuator_biasprm[:, 2] - kp * model.opt.timestep + model.dof_damping[dofs]
    return np.clip(kd / kp, 0.0, 0.5)

"""What the skills and the controller above them see of figure, goal and chair (section 4, figure 3).

"Root (i.e. torso)": the link ``torso``, which hangs on the free root, the pelvis, by one joint. The
*figure's frame* ("humanoid centric coordinates") has its origin at the torso, z up, and x along the
torso's heading.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import torch
from torch import Tensor

from understudy.errors import ConfigError, suggestion
from understudy.options import check_range
from understudy.task import Context, Encoder, Fields, Shape
from understudy_characters.layout import XYZ, Layout
from understudy_characters.scene import CharacterScene
from understudy_sitting.chair import BODY, FEET, SEAT, SEATED, THICKNESS, Chair
from understudy_tensors import rotations
from understudy_tensors.limits import check_degrees

#: Link of the humanoids that the paper calls root.
TORSO = "chest"


class Joints:
    """The joints as U numbers: the angles of all hinges, then the exponential maps of all balls, rad;
    and their velocities, rad/s."""

    def __init__(self, layout: Layout, device: torch.device) -> None:
        used = layout.hinge_used.bool()
        self._hinges = layout.hinge_qpos[used].to(device)
        self._balls = layout.ball_rows.to(device)
        self._dofs = torch.cat([layout.hinge_dofs[used], layout.ball_dofs.flatten()]).to(device)
        self.count = len(self._dofs)  #: U

    def coordinates(self, qpos: Tensor, joint_rotations: Tensor) -> Tensor:
        """(N, U)"""
        balls = rotations.to_exponential_map(joint_rotations[:, self._balls]).flatten(1)
        return torch.cat([qpos[:, self._hinges], balls], dim=1)

    def velocities(self, qvel: Tensor) -> Tensor:
        """(N, U)"""
        return qvel[:, self._dofs]

    def names(self, scene: CharacterScene) -> list[str]:
        """Of the U numbers, after the joints of the model."""
        model, layout = scene.model, scene.layout
        at = {int(model.jnt_qposadr[j]): model.joint(j).name for j in range(model.njnt)}
        hinges = [at[address] for address in self._hinges.tolist()]
        balls = [layout.joint_names[row] for row in layout.ball_rows.tolist()]
        return hinges + [f"{ball}/{axis}" for ball in balls for axis in XYZ]


def torso_link(context: Context, name: str, who: str) -> tuple[CharacterScene, int]:
    """The scene, and the model's id of the torso, which must be the root or hang on it directly."""
    scene = context.need_scene(CharacterScene, who)
    character = scene.character
    known = {joint.name: joint for joint in character.joints}
    if name not in known:
        raise ConfigError(f"{who}: there is no joint '{name}'.{suggestion(name, known)}")
    if known[name].parent > 0:
        raise ConfigError(f"{who}: torso={name} must hang on the root itself.")
    return scene, known[name].body


class Body(Fields):
    """The figure (section 4, "proprioceptive feature"), and the torso's motion in the world.

    ``proprioception`` (N, 2 U + 8): joint angles (U) and velocities (U), rad and rad/s; the torso's
    height, its linear velocity in the figure's frame (3), pitch and roll; whether the left and the
    right foot touch the floor, 1 or 0. With U = 21 these are the paper's 50.

    ``torso_angles`` (N, 3) rad: pitch, yaw and roll. ``joint_coordinates`` (N, U).
    """

    reads = ("qpos", "qvel", "joint_rotations", "xpos", "xquat", "cvel", "subtree_com",
             *(f"sensor_{foot}" for foot in FEET))  # fmt: skip
    provides: Mapping[str, Shape] = {
        "proprioception": (0,),
        "torso_position": (3,),
        "torso_velocity": (3,),
        "torso_angles": (3,),
        "torso_yaw": (),
        "joint_coordinates": (0,),
        "joint_velocities": (0,),
    }

    @dataclass(frozen=True)
    class Options:
        torso: str = TORSO  #: the figure's link that the paper calls root

    def __init__(self, options: Options, context: Context) -> None:
        scene, self._torso = torso_link(context, options.torso, "fields 'sitting/body'")
        self._joints = Joints(scene.layout, context.device)
        self._root, count = scene.layout.root_body, self._joints.count
        self.provides = {
            **self.provides,
            "proprioception": (2 * count + 8,),
            "joint_coordinates": (count,),
            "joint_velocities": (count,),
        }

    def compute(
        self,
        qpos: Tensor,
        qvel: Tensor,
        joint_rotations: Tensor,
        xpos: Tensor,
        xquat: Tensor,
        cvel: Tensor,
        subtree_com: Tensor,
        **touching: Tensor,
    ) -> dict[str, Tensor]:
        position = xpos[:, self._torso]
        angular, linear = cvel[:, self._torso].split(3, dim=-1)  # at the figure's centre of mass
        velocity = linear + torch.linalg.cross(angular, position - subtree_com[:, self._root])
        angles = rotations.pitch_yaw_roll(xquat[:, self._torso])
        pitch, yaw, roll = angles.unbind(-1)
        ahead = rotations.turned_flat(velocity[:, :2], -yaw)
        joints = self._joints.coordinates(qpos, joint_rotations)
        speeds = self._joints.velocities(qvel)
        contacts = torch.cat([touching[f"sensor_{foot}"] for foot in FEET], dim=1) > 0
        proprioception = torch.cat(
            [
                joints,
                speeds,
                position[:, 2:],
                ahead,
                velocity[:, 2:],
                torch.stack([pitch, roll], dim=1),
                contacts.float(),
            ],
            dim=1,
        )
        return {
            "proprioception": proprioception,
            "torso_position": position,
            "torso_velocity": velocity,
            "torso_angles": angles,
            "torso_yaw": yaw,
            "joint_coordinates": joints,
            "joint_velocities": speeds,
        }


class Reference(Fields):
    """The same of the reference motion: torso and joints, in the world."""

    reads = ("reference_qpos", "reference_qvel", "reference_joint_rotations",
             "reference_root_rotation")  # fmt: skip
    provides: Mapping[str, Shape] = {
        "reference_torso_velocity": (3,),
        "reference_torso_angles": (3,),
        "reference_joint_coordinates": (0,),
        "reference_joint_velocities": (0,),
    }

    @dataclass(frozen=True)
    class Options:
        torso: str = TORSO  #: name of the body

    def __init__(self, options: Options, context: Context) -> None:
        scene, body = torso_link(context, options.torso, "fields 'sitting/reference'")
        row = next(k for k, joint in enumerate(scene.character.joints) if joint.body == body)
        self._torso = row - 1 if row else None  # among the joints without the root
        offset = scene.character.rest_positions[row]
        self._offset = torch.tensor(offset, dtype=torch.float32, device=context.device)
        self._joints = Joints(scene.layout, context.device)
        self._root_dof, count = scene.layout.root_dof, self._joints.count
        self.provides = {
            **self.provides,
            "reference_joint_coordinates": (count,),
            "reference_joint_velocities": (count,),
        }

    def compute(
        self,
        reference_qpos: Tensor,
        reference_qvel: Tensor,
        reference_joint_rotations: Tensor,
        reference_root_rotation: Tensor,
    ) -> dict[str, Tensor]:
        root, dof = reference_root_rotation, self._root_dof
        angular = rotations.rotate(root, reference_qvel[:, dof + 3 : dof + 6])
        lever = rotations.rotate(root, self._offset.expand(len(root), 3))
        velocity = reference_qvel[:, dof : dof + 3] + torch.linalg.cross(angular, lever)
        torso = root
        if self._torso is not None:
            torso = rotations.multiply(root, reference_joint_rotations[:, self._torso])
        return {
            "reference_torso_velocity": velocity,
            "reference_torso_angles": rotations.pitch_yaw_roll(torso),
            "reference_joint_coordinates": self._joints.coordinates(
                reference_qpos, reference_joint_rotations
            ),
            "reference_joint_velocities": self._joints.velocities(reference_qvel),
        }


class Goal(Fields):
    """``goal_direction`` (N, 2) = [sin ψ, cos ψ], ψ the azimuth of ``target`` (N, 2), m in the world,
    in the figure's frame; ``target_distance`` (N,) m, horizontally."""

    reads = ("target", "torso_position", "torso_yaw")
    provides: Mapping[str, Shape] = {"goal_direction": (2,), "target_distance": ()}

    def __init__(self, options: None, context: Context) -> None:
        pass

    def compute(
        self, target: Tensor, torso_position: Tensor, torso_yaw: Tensor
    ) -> dict[str, Tensor]:
        away = target - torso_position[:, :2]
        azimuth = torch.atan2(away[:, 1], away[:, 0]) - torso_yaw
        return {
            "goal_direction": torch.stack([azimuth.sin(), azimuth.cos()], dim=1),
            "target_distance": away.norm(dim=1),
        }


class Seat(Fields):
    """The chair, and how the pelvis is to its seat.

    ``chair_state`` (N, 7): from the pelvis to the centre of the seat's surface (3), m, and the chair's
    rotation (4) with w >= 0, both in the figure's frame. ``seat_distance`` (N,) m is D^sit,
    ``seat_contact`` (N,) 1 or 0 is z_contact: the simulator has a contact of the pelvis with the seat.
    ``seated`` (N,) is 1 where that is sitting: the torso is upright and faces as the chair does, and the pelvis is
    not on the seat's edge.
    """

    reads = ("xpos", "xquat", "geom_xpos", "torso_angles", f"sensor_{SEATED}")
    provides: Mapping[str, Shape] = {
        "chair_state": (7,),
        "chair_position": (3,),
        "chair_rotation": (4,),
        "seat_position": (3,),
        "seat_distance": (),
        "seat_contact": (),
        SEATED: (),
    }

    @dataclass(frozen=True)
    class Options:
        #: degrees, greatest lean of the torso from the vertical; null: lying across the seat counts
        upright: float | None = 45.0
        #: degrees, greatest turn from where the chair faces; null: any direction counts
        facing: float | None = 60.0
        #: m, greatest distance from the seat's middle to the pelvis, which is 0.1 to 0.2 m from it
        #: when sitting; null: the seat's edges count, too. A figure that sits as the clip does, at
        #: the front, needs more on seats deeper than 0.6 m.
        within: float | None = 0.25

        def __post_init__(self) -> None:
            check_degrees(self, "upright", "facing")
            check_range(self, "within", above=0, most=1e3)

    def __init__(self, options: Options, context: Context) -> None:
        scene = context.need_scene(CharacterScene, "fields 'sitting/seat'")
        self._options = options
        self._chair, self._seat = chair_of(scene.model)
        pelvis = context.need_section("chair", Chair, "fields 'sitting/seat'").options.pelvis
        self._pelvis = scene.model.body(pelvis).id

    def compute(
        self,
        xpos: Tensor,
        xquat: Tensor,
        geom_xpos: Tensor,
        torso_angles: Tensor,
        **contact: Tensor,
    ) -> dict[str, Tensor]:
        pitch, yaw, roll = torso_angles.unbind(-1)
        rotation = xquat[:, self._chair]
        seat = geom_xpos[:, self._seat]  # the middle of a slab
        lift = torch.zeros_like(seat)
        lift[:, 2] = 0.5 * THICKNESS
        seat = seat + lift
        away = seat - xpos[:, self._pelvis]
        to_figure = rotations.from_heading(-yaw)
        turned = rotations.canonical(rotations.multiply(to_figure, rotation))
        place = rotations.rotate(to_figure, away)
        touching = contact[f"sensor_{SEATED}"][:, 0] > 0
        sits = touching
        if self._options.upright is not None:
            sits = sits & (pitch.cos() * roll.cos() > math.cos(math.radians(self._options.upright)))
        if self._options.facing is not None:
            # of the chair's x axis, in the figure's frame
            ahead = rotations.to_matrix(turned)[:, 0, 0]
            sits = sits & (ahead > math.cos(math.radians(self._options.facing)))
        distance = away.norm(dim=1)
        if self._options.within is not None:
            sits = sits & (distance <= self._options.within)
        return {
            "chair_state": torch.cat([place, turned], dim=1),
            "chair_position": xpos[:, self._chair],
            "chair_rotation": rotation,
            "seat_position": seat,
            "seat_distance": distance,
            "seat_contact": touching.float(),
            SEATED: sits.float(),
        }


def chair_of(model: mujoco.MjModel) -> tuple[int, int]:
    """Ids of the chair's body and of its seat's geom."""
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, BODY)
    geom = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, SEAT)
    if body < 0 or geom < 0:
        raise ConfigError("This task's scene has no chair. Add one: +chair={seat_height: 0.45}.")
    return body, geom


class State(Encoder):
    """s^walk (52), s^turn (50) or s^sit and s^meta (57): proprioception, then goal and chair if asked."""

    @dataclass(frozen=True)
    class Options:
        goal: bool = False  #: whether the 2 numbers of the walking target are observed
        chair: bool = False  #: whether the 7 numbers of the chair are observed

    def __init__(self, options: Options, context: Context) -> None:
        scene = context.need_scene(CharacterScene, "encoder 'sitting/state'")
        joints = Joints(scene.layout, context.device).names(scene)
        self.columns = [
            *(f"joint_coordinates/{name}" for name in joints),
            *(f"joint_velocities/{name}" for name in joints),
            "torso_position/z", *(f"torso_velocity/{part}" for part in ("ahead", "left", "up")),
            "torso_angles/pitch", "torso_angles/roll", *(f"{foot}/touches" for foot in FEET),
            *((f"goal_direction/{part}" for part in ("sin", "cos")) if options.goal else ()),
            *((f"chair_state/{k}" for k in range(7)) if options.chair else ()),
        ]  # fmt: skip
        self.reads = (
            "proprioception",
            *(("goal_direction",) if options.goal else ()),
            *(("chair_state",) if options.chair else ()),
        )
        self.shape = (len(self.columns),)

    def encode(self, **parts: Tensor) -> Tensor:
        return torch.cat([parts[name] for name in self.reads], dim=1)

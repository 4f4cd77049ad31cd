"""Where a character's parts are in MuJoCo's arrays, and which of them are limbs; known from its model.

L links (all bodies of the figure, in the model's order), J joints (those of a clip without the root),
E end-effectors, U actuators.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
import torch
from torch import Tensor

from understudy.errors import ConfigError, suggestion
from understudy_characters.character import Character
from understudy_tensors import rotations

__all__ = ["LINK_COLUMNS", "XYZ", "Layout", "columns", "layout_of"]

XYZ = ("x", "y", "z")
#: By field of the links the columns of one link: a rotation is the components of its x axis, then of its z axis.
LINK_COLUMNS = {
    "link_positions": XYZ,
    "link_rotations": ("xx", "xy", "xz", "zx", "zy", "zz"),
    "link_linear_velocities": XYZ,
    "link_angular_velocities": XYZ,
}

#: A chain of bodies is a limb if it has this share of the longest one's length …
LIMB_LENGTH = 0.3
#: … and so many joints of its own. Heads and fingers are shorter or simpler than that.
LIMB_JOINTS = 2


def columns(what: str, of: Sequence[str], parts: Sequence[str] = XYZ) -> list[str]:
    """Names of the columns of a field (N, len(of), len(parts)), flattened: ``link_positions/chest/x``."""
    return [f"{what}/{one}/{part}" for one in of for part in parts]


@dataclass(frozen=True)
class Layout:
    """Indices of a character's parts. K is the largest number of hinges of one joint."""

    link_names: tuple[str, ...]
    joint_names: tuple[str, ...]
    end_effectors: tuple[str, ...]  #: links: hands and feet
    upright: tuple[str, ...]  #: links that no gait puts on the floor: root, trunk and head
    num_actuators: int
    root_body: int
    root_address: int  #: of the root's position and quaternion in qpos
    root_dof: int  #: of its velocities in qvel
    link_bodies: Tensor  #: (L,) body ids
    link_axes: Tensor  #: (6 L,) where ``xmat``, flat, has the links' x axes and z axes, in turn
    effector_bodies: Tensor  #: (E,) body ids
    ball_rows: Tensor  #: (B,) rows of the ball joints among the J
    ball_qpos: Tensor  #: (B, 4) their addresses in qpos
    ball_dofs: Tensor  #: (B, 3) and in qvel
    hinge_qpos: Tensor  #: (H, K) addresses in qpos of the hinges of the other joints, first to last
    hinge_dofs: Tensor  #: (H, K) and in qvel
    hinge_axes: Tensor  #: (H, K, 3) in the body's frame
    hinge_used: Tensor  #: (H, K) 1, or 0 where a joint has fewer hinges
    joint_rows: Tensor  #: (J,) of each joint, its row among the balls followed by the others

    def moved(
        self, qpos: Tensor, qvel: Tensor, turn: Tensor, place: Tensor
    ) -> tuple[Tensor, Tensor]:
        """States (N, nq), (N, nv) turned by `turn` (N,) rad about the root and put at `place` (N, 2) m."""
        at, dof = self.root_address, self.root_dof
        rotation = rotations.multiply(rotations.from_heading(turn), qpos[:, at + 3 : at + 7])
        linear = rotations.turned_flat(qvel[:, dof : dof + 2], turn)
        # The rotation's velocity is the body's own.
        velocity = torch.cat([qvel[:, :dof], linear, qvel[:, dof + 2 :]], dim=1)
        height, joints = qpos[:, at + 2 : at + 3], qpos[:, at + 7 :]
        return torch.cat([qpos[:, :at], place, height, rotation, joints], dim=1), velocity

    def to(self, device: torch.device) -> Layout:
        """The same on another device, in float32."""
        tensors = {k: v.to(device) for k, v in vars(self).items() if isinstance(v, Tensor)}
        return replace(
            self, **{k: v.float() if v.is_floating_point() else v for k, v in tensors.items()}
        )


def layout_of(character: Character, end_effectors: Sequence[str] = ()) -> Layout:
    """The layout of `character`, whose hands and feet are the links named, or else the limbs' ends.

    Raises
    ------
    ConfigError
        it has no link of one of these names.
    """
    model, bodies = character.model, sorted(character.carrier)
    names = tuple(_name(model, body) for body in bodies)
    tips = limb_ends(character)
    for name in end_effectors:
        if name not in names:
            raise ConfigError(
                f"scene.end_effectors: {character.name} has no body '{name}'."
                f"{suggestion(name, names)}"
            )
    chosen = [bodies[names.index(name)] for name in end_effectors] or tips
    joints = character.joints[1:]
    balls = [row for row, joint in enumerate(joints) if len(joint.axes) == 0]
    hinges = [row for row, joint in enumerate(joints) if len(joint.axes) > 0]
    most = max((len(joints[row].axes) for row in hinges), default=1)
    axes, used = np.zeros((len(hinges), most, 3)), np.zeros((len(hinges), most))
    addresses, dofs = np.zeros((2, len(hinges), most), dtype=np.int64)
    for place, row in enumerate(hinges):
        count = len(joints[row].axes)
        axes[place, :count], used[place, :count] = joints[row].axes, 1.0
        addresses[place, :count] = joints[row].addresses
        dofs[place, :count] = model.body_dofadr[joints[row].body] + np.arange(count)
    order = [*balls, *hinges]
    return Layout(
        link_names=names,
        joint_names=tuple(joint.name for joint in joints),
        end_effectors=tuple(_name(model, body) for body in chosen),
        upright=tuple(_name(model, body) for body in upright_bodies(character, tips)),
        num_actuators=model.nu,
        root_body=character.root,
        root_address=character.root_address,
        root_dof=int(model.body_dofadr[character.root]),
        link_bodies=torch.tensor(bodies),
        link_axes=(9 * torch.tensor(bodies)[:, None] + torch.tensor([0, 3, 6, 2, 5, 8])).flatten(),
        effector_bodies=torch.tensor(chosen, dtype=torch.long),
        ball_rows=torch.tensor(balls, dtype=torch.long),
        ball_qpos=_run([joints[row].addresses[0] for row in balls], 4),
        ball_dofs=_run([int(model.body_dofadr[joints[row].body]) for row in balls], 3),
        hinge_qpos=torch.from_numpy(addresses),
        hinge_dofs=torch.from_numpy(dofs),
        hinge_axes=torch.from_numpy(axes),
        hinge_used=torch.from_numpy(used),
        joint_rows=torch.tensor([order.index(row) for row in range(len(joints))], dtype=torch.long),
    )


def limb_ends(character: Character) -> list[int]:
    """Body ids of the ends of the limbs, in the model's order.

    The tree of bodies is divided into chains, the longest first: each begins at the root or at a longer chain, and
    continues to the farthest end that hangs there.
    """
    model, place = character.model, character.zero_pose
    bodies = sorted(character.carrier)
    offset = {b: np.linalg.norm(place.xpos[b] - place.xpos[model.body_parentid[b]]) for b in bodies}
    reach, onward = dict.fromkeys(bodies, 0.0), dict.fromkeys(bodies, -1)
    for body in bodies:  # to the centre of mass of what ends a chain
        reach[body] = float(np.linalg.norm(place.xipos[body] - place.xpos[body]))
    best = dict.fromkeys(bodies, 0.0)
    for body in reversed(bodies[1:]):
        parent = int(model.body_parentid[body])
        if onward[body] >= 0:
            reach[body] = best[body]
        length = float(offset[body]) + reach[body]
        if length >= best[parent]:
            best[parent], onward[parent] = length, body
    if onward[character.root] >= 0:
        reach[character.root] = best[character.root]
    chains = []
    for body in bodies:
        parent = int(model.body_parentid[body])
        if body != character.root and onward[parent] == body:
            continue  # goes on with its parent's chain
        length = reach[body] + (float(offset[body]) if body != character.root else 0.0)
        joints, end = int(model.body_jntnum[body] > 0), body
        while onward[end] >= 0:
            end = onward[end]
            joints += int(model.body_jntnum[end] > 0)
        chains.append((length, joints, end))
    longest = max(length for length, _, _ in chains)
    found = [
        end
        for length, joints, end in chains
        if length >= LIMB_LENGTH * longest and joints >= LIMB_JOINTS
    ]
    return sorted(found) or [character.root]


def upright_bodies(character: Character, ends: Sequence[int]) -> list[int]:
    """Bodies of the root, of the trunk that the limbs share, and of what hangs on these but limbs."""
    parents, bodies = character.model.body_parentid, sorted(character.carrier)
    shared = dict.fromkeys(bodies, 0)
    for end in ends:
        body = end
        while body != character.root:
            shared[body] += 1
            body = int(parents[body])
    up = {character.root}
    for body in bodies[1:]:
        if int(parents[body]) in up and shared[body] != 1:
            up.add(body)
    return sorted(up)


def _run(starts: list[int], length: int) -> Tensor:
    """(S, length): from each start on."""
    return torch.tensor(starts, dtype=torch.long).reshape(-1, 1) + torch.arange(length)


def _name(model: mujoco.MjModel, body: int) -> str:
    return model.body(body).name or f"body{body}"

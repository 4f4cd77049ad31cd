"""Kinematic quantities of the character, batched over worlds (N).

The heading frame has its origin at the root, z up, and x along the root's heading: what is expressed
in it does not change when the character stands elsewhere or faces another way.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import mujoco
import torch
from torch import Tensor

from understudy import rotations
from understudy_humanoid.character import BODIES, END_EFFECTORS


@dataclass(frozen=True)
class CharacterLayout:
    """Where the character's parts are in MuJoCo's arrays. L links, J joints."""

    link_names: tuple[str, ...]
    joint_names: tuple[str, ...]
    end_effectors: tuple[str, ...]
    num_actuators: int
    link_bodies: Tensor  #: (L,) body ids
    ball_joints: Tensor  #: (B,) rows of the ball joints among the J
    ball_qpos: Tensor  #: (B, 4) addresses in qpos
    hinge_joints: Tensor  #: (H,)
    hinge_qpos: Tensor  #: (H,)
    hinge_axes: Tensor  #: (H, 3)
    effector_links: Tensor  #: (E,) rows among the links
    geom_centres: Tensor  #: (L, 3) in the link's frame
    geom_boxes: Tensor  #: (L, 3) half sizes whose corners, inflated by the radius, bound the geom
    geom_radii: Tensor  #: (L,)

    def to(self, device: torch.device) -> CharacterLayout:
        """The same on another device."""
        return replace(
            self, **{k: v.to(device) for k, v in vars(self).items() if isinstance(v, Tensor)}
        )


def character_layout(model: mujoco.MjModel, prefix: str = "") -> CharacterLayout:
    """The layout of the character named with `prefix` in `model`."""
    links = tuple(row.name for row in BODIES)
    joints = [row for row in BODIES if row.joint is not None]
    address = {row.name: int(model.joint(prefix + row.name).qposadr[0]) for row in joints}
    balls = [(i, row) for i, row in enumerate(joints) if row.joint and row.joint.kind == "ball"]
    hinges = [(i, row) for i, row in enumerate(joints) if row.joint and row.joint.kind == "hinge"]
    boxes, radii = [], []
    for row in BODIES:
        radii.append(0.0 if row.shape == "box" else row.size[0])
        boxes.append(
            {
                "box": lambda size: list(size),
                "capsule": lambda size: [0.0, 0.0, size[1]],
                "sphere": lambda size: [0.0, 0.0, 0.0],
            }[row.shape](row.size)
        )
    return CharacterLayout(
        link_names=links,
        joint_names=tuple(row.name for row in joints),
        end_effectors=END_EFFECTORS,
        num_actuators=3 * len(balls) + len(hinges),
        link_bodies=torch.tensor([model.body(prefix + name).id for name in links]),
        ball_joints=torch.tensor([i for i, _ in balls]),
        ball_qpos=torch.tensor([[address[r.name] + k for k in range(4)] for _, r in balls]),
        hinge_joints=torch.tensor([i for i, _ in hinges]),
        hinge_qpos=torch.tensor([address[r.name] for _, r in hinges]),
        hinge_axes=torch.tensor([r.joint.axis for _, r in hinges if r.joint], dtype=torch.float32),
        effector_links=torch.tensor([links.index(name) for name in END_EFFECTORS]),
        geom_centres=torch.tensor([row.centre for row in BODIES], dtype=torch.float32),
        geom_boxes=torch.tensor(boxes, dtype=torch.float32),
        geom_radii=torch.tensor(radii, dtype=torch.float32),
    )


def joint_rotations(layout: CharacterLayout, qpos: Tensor) -> Tensor:
    """(N, J, 4): each joint's rotation relative to its parent; hinges turn about their axis."""
    n = qpos.shape[0]
    result = qpos.new_empty(n, len(layout.joint_names), 4)
    result[:, layout.ball_joints] = qpos[:, layout.ball_qpos.flatten()].view(n, -1, 4)
    half = 0.5 * qpos[:, layout.hinge_qpos].unsqueeze(-1)
    axes = layout.hinge_axes.to(qpos.dtype)
    result[:, layout.hinge_joints] = torch.cat([half.cos(), half.sin() * axes], dim=-1)
    return result


def kinematics(
    layout: CharacterLayout,
    *,
    qpos: Tensor,
    xpos: Tensor,
    xquat: Tensor,
    cvel: Tensor,
    subtree_com: Tensor,
) -> dict[str, Tensor]:
    """Derived state from MuJoCo's ``qpos`` (N, 43), ``xpos`` (N, bodies, 3) and so on.

    Returns
    -------
    com_position (N, 3), root_position (N, 3), root_rotation (N, 4), root_heading (N,) : world frame
    joint_rotations (N, J, 4) : relative to the parent
    link_positions (N, L, 3) : heading frame
    link_rotations (N, L, 6) : heading frame, the link's x and z axes
    link_linear_velocities, link_angular_velocities (N, L, 3) : along the heading frame's axes, of
        the link's origin, relative to the world; m/s and rad/s
    end_effector_positions (N, E, 3) : heading frame
    """
    links = layout.link_bodies
    root = links[:1]
    position, rotation = xpos[:, links], xquat[:, links]
    root_position, root_rotation = qpos[:, :3], qpos[:, 3:7]
    com = subtree_com[:, root].squeeze(1)
    yaw = rotations.heading(root_rotation)
    # cvel is [angular, linear], both along world axes, linear at the character's centre of mass.
    angular, linear = cvel[:, links].split(3, dim=-1)
    linear = linear + torch.linalg.cross(angular, position - com.unsqueeze(1))
    axes = rotations.tangent_normal(rotation).view(*rotation.shape[:2], 2, 3)
    vectors = torch.stack([position - root_position.unsqueeze(1), linear, angular], dim=2)
    # One product turns all of a world's vectors into its heading frame, (N, L, 5, 3).
    world = torch.cat([vectors, axes], dim=2)
    turn = rotations.to_matrix(rotations.from_heading(yaw))
    local = torch.bmm(world.view(len(world), -1, 3), turn).view_as(world)
    link_positions = local[:, :, 0]
    return {
        "com_position": com,
        "root_position": root_position,
        "root_rotation": root_rotation,
        "root_heading": yaw,
        "joint_rotations": joint_rotations(layout, qpos),
        "link_positions": link_positions,
        "link_rotations": local[:, :, 3:].flatten(2),
        "link_linear_velocities": local[:, :, 1],
        "link_angular_velocities": local[:, :, 2],
        "end_effector_positions": link_positions[:, layout.effector_links],
    }


def ground_clearance(layout: CharacterLayout, xpos: Tensor, xquat: Tensor) -> Tensor:
    """(N, L): height in m of each link's lowest point above z = 0, from ``xpos`` and ``xquat``."""
    links = layout.link_bodies
    position, matrix = xpos[:, links], rotations.to_matrix(xquat[:, links])
    up = matrix[..., 2, :]  # the world's z axis in the link's frame
    centre = position[..., 2] + (up * layout.geom_centres.to(up.dtype)).sum(-1)
    reach = (up.abs() * layout.geom_boxes.to(up.dtype)).sum(-1)
    return centre - reach - layout.geom_radii.to(up.dtype)

"""What the policy observes (thesis, section 4.4.1): the state in the world's frame, without a phase."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.task import Context, Encoder, Shape
from understudy_characters.layout import LINK_COLUMNS, XYZ, columns
from understudy_characters.scene import CharacterScene
from understudy_tensors import rotations


class GlobalState(Encoder):
    """Where the root is, the obstacle's height and width; and of each link its position relative to
    the root, rotation (two axes), linear and angular velocity, all along the world's axes.

    The axes are not the heading frame's, which jumps when the athlete faces up. With `takeoff`, the features that the
    episode began with are observed, too, for one policy of many take-offs.
    """

    @dataclass(frozen=True)
    class Options:
        #: whether the policy sees the features of the take-off that the episode began with
        takeoff: bool = False

    shape: Shape

    def __init__(self, options: Options, context: Context) -> None:
        scene = context.need_scene(CharacterScene, "encoder 'jumping/state'")
        layout = scene.layout
        self._links = layout.link_bodies.to(context.device)
        self._root = layout.root_body
        self.reads = (
            "xpos", "xquat", "cvel", "subtree_com", "obstacle_height", "obstacle_width",
        )  # fmt: skip
        if options.takeoff:
            self.reads += ("takeoff_features",)
        self.columns = [
            *(f"root_position/{axis}" for axis in XYZ),
            "obstacle_height",
            "obstacle_width",
        ]
        for field, parts in LINK_COLUMNS.items():
            self.columns += columns(field, layout.link_names, parts)
        if options.takeoff:
            self.columns += [f"takeoff_features/{k}" for k in range(5)]
        self.shape = (len(self.columns),)

    def encode(
        self,
        xpos: Tensor,
        xquat: Tensor,
        cvel: Tensor,
        subtree_com: Tensor,
        obstacle_height: Tensor,
        obstacle_width: Tensor,
        takeoff_features: Tensor | None = None,
    ) -> Tensor:
        position, root = xpos[:, self._links], xpos[:, self._root]
        angular, linear = cvel[:, self._links].split(3, dim=-1)
        centre = subtree_com[:, self._root].unsqueeze(1)
        # cvel's linear part is at the character's centre of mass
        linear = linear + torch.linalg.cross(angular, position - centre)
        parts = [
            root,
            torch.stack([obstacle_height, obstacle_width], dim=1),
            (position - root.unsqueeze(1)).flatten(1),
            rotations.tangent_normal(xquat[:, self._links]).flatten(1),
            linear.flatten(1),
            angular.flatten(1),
        ]
        return torch.cat(parts if takeoff_features is None else [*parts, takeoff_features], dim=1)

"""The athlete's body as G rounded segments: two ends and a radius each.

Spheres and capsules are what they are; a foot is a capsule along its length, and what joins the
trunk's spheres is one too, so that no bar passes between them.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import mujoco
import numpy as np
import torch
from torch import Tensor

from understudy.task import Context
from understudy_characters.scene import CharacterScene

#: Links, as :class:`Body` counts them, that tell one from another.
TRUNK, HEAD, FEET = ("root", "chest", "neck"), "neck", ("right_ankle", "left_ankle")
#: m: of what joins the spheres of the trunk.
_SPINE = 0.05


@dataclass(frozen=True)
class Body:
    """G geoms and the S >= G segments that they and the trunk are."""

    names: tuple[str, ...]  #: (G,) of the bodies that carry the geoms
    geoms: Tensor  #: (G,) ids
    #: (G, 3) m: from a geom's centre to one end, in its frame; the other is opposite
    offsets: Tensor
    radii: Tensor  #: (G,) m
    boxes: Tensor  #: (G, 3) m, half sizes; 0 where it is no box
    links: Tensor  #: (K, 2) rows of geoms whose centres a segment joins

    def ends(self, xpos: Tensor, xmat: Tensor) -> Tensor:
        """(N, S, 2, 3) m of both ends of all segments, world, from ``geom_xpos`` and ``geom_xmat``."""
        centre = xpos[:, self.geoms]
        matrix = xmat[:, self.geoms].reshape(*centre.shape[:2], 3, 3)
        reach = (matrix @ self.offsets.unsqueeze(-1)).squeeze(-1)
        own = torch.stack([centre - reach, centre + reach], dim=2)
        return torch.cat([own, centre[:, self.links]], dim=1)

    def lowest(self, xpos: Tensor, xmat: Tensor) -> Tensor:
        """(N, G) m: how high the lowest point of each geom is."""
        up = xmat[:, self.geoms].reshape(len(xpos), -1, 3, 3)[:, :, 2]
        along = (up * self.offsets).sum(-1).abs() + self.radii
        reach = torch.where(self.boxes[:, 0] > 0, (up.abs() * self.boxes).sum(-1), along)
        return xpos[:, self.geoms, 2] - reach

    @property
    def widths(self) -> Tensor:
        """(S,) m, the radii of all segments."""
        return torch.cat([self.radii, torch.full_like(self.radii[: len(self.links)], _SPINE)])

    def rows(self, *names: str) -> Tensor:
        """(G,) bool: the geoms of these bodies."""
        return torch.tensor([n in names for n in self.names], device=self.radii.device)


def body_of(context: Context, who: str) -> Body:
    """The body of the task's character, built once."""
    scene = context.need_scene(CharacterScene, who)
    return context.once("jumping/body", lambda: _body(scene, context.device))


def _body(scene: CharacterScene, device: torch.device) -> Body:
    model, types = scene.model, mujoco.mjtGeom
    ids = [geom.id for geom in scene.character.geoms]
    names = tuple(model.body(int(model.geom_bodyid[geom])).name for geom in ids)
    offsets, radii, boxes = np.zeros((len(ids), 3)), np.zeros(len(ids)), np.zeros((len(ids), 3))
    for row, geom in enumerate(ids):
        size = model.geom_size[geom]
        if model.geom_type[geom] == types.mjGEOM_BOX:
            boxes[row] = size
            longest = int(size.argmax())
            radii[row] = np.delete(size, longest).mean()
            offsets[row, longest] = size[longest] - radii[row]
        else:
            radii[row] = size[0]
            if model.geom_type[geom] == types.mjGEOM_CAPSULE:
                offsets[row, 2] = size[1]
    trunk = [names.index(name) for name in TRUNK if name in names]

    def constant(values: np.ndarray) -> Tensor:
        return torch.tensor(values, dtype=torch.float32, device=device)

    return Body(
        names,
        torch.tensor(ids, device=device),
        constant(offsets),
        constant(radii),
        constant(boxes),
        torch.tensor([*pairwise(trunk)], device=device).view(-1, 2),
    )


def lowest_surface(start: Tensor, end: Tensor, radius: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """(…,) m: the least height where `low` <= x <= `high` of straight lines from `start` to `end`
    (…, 2), each (x, z), that are rounded by `radius`; infinite where they do not come there."""
    turned = (end[..., :1] < start[..., :1]).expand_as(start)
    (x, z), last = (torch.where(turned, a, b).unbind(-1) for a, b in ((end, start), (start, end)))
    across, up = (last[0] - x).clamp(min=1e-9), last[1] - z
    # the lower side is convex, so it is least as near to the lower end as it may be
    at = torch.where(up > 0, x, last[0])
    at = torch.minimum(torch.maximum(at, low), high)
    # the point of the line whose rounding ends there
    along = ((at - x - radius * up / torch.hypot(across, up)) / across).clamp(0.0, 1.0)
    aside = at - (x + along * across)
    below = (radius.square() - aside.square()).clamp(min=0.0).sqrt()
    return torch.where(aside.abs() <= radius, z + along * up - below, torch.inf)

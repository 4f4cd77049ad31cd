"""Volume of the convex hull of points on the character (thesis, section 3.3.3)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.errors import ConfigError, suggestion
from understudy.task import Context, Fields, Shape
from understudy_characters.scene import CharacterScene

#: Points beyond which all triples are too many to look at in every world and step.
MOST = 18
#: m: how far points are moved, each its own way, so that no four of them lie in one plane.
SHIFT = 3e-4


class HullVolume(Fields):
    """``hull_volume`` (N,) m³ of the convex hull of the links' centres of mass, as :func:`hull_volume`."""

    reads = ("xipos",)
    provides: Mapping[str, Shape] = {"hull_volume": ()}

    @dataclass(frozen=True)
    class Options:
        links: tuple[str, ...] = ()  #: whose centres of mass are the points; empty takes all

    def __init__(self, options: Options, context: Context) -> None:
        who = "fields 'styles/volume'"
        layout = context.need_scene(CharacterScene, who).layout
        for name in options.links:
            if name not in layout.link_names:
                raise ConfigError(f"{who}: no link '{name}'.{suggestion(name, layout.link_names)}")
        names = options.links or layout.link_names
        if not 4 <= len(names) <= MOST:
            raise ConfigError(
                f"{who}: a hull of {len(names)} points is not possible: name 4 to {MOST} links "
                "(fields.volume.links=[…])."
            )
        rows = torch.tensor([layout.link_names.index(name) for name in names])
        self._bodies = layout.link_bodies[rows].to(context.device)
        self._triples = triples(len(names)).to(context.device)

    def compute(self, xipos: Tensor) -> Mapping[str, Tensor]:
        return {"hull_volume": hull_volume(xipos[:, self._bodies], self._triples)}


def triples(count: int) -> Tensor:
    """(C, 3): every three of `count` points."""
    return torch.tensor(list(itertools.combinations(range(count), 3)))


def hull_volume(points: Tensor, of: Tensor) -> Tensor:
    """(N,) m³ of the convex hull of `points` (N, P, 3), of which `of` are all :func:`triples`.

    A triple is a face of the hull if all other points lie on one side of its plane; the volume is
    that of the tetrahedra between the faces and the points' mean. It is exact but for :data:`SHIFT`,
    by which points are moved so that each face has three corners: on 0.1 m³ that is about 1 %.
    """
    count = points.shape[1]
    number = torch.arange(1, 3 * count + 1, device=points.device, dtype=points.dtype)
    shift = SHIFT * torch.sin(number * number * math.sqrt(2.0)).view(count, 3)
    points = points - points.mean(dim=1, keepdim=True) + shift
    first, second, third = (points[:, of[:, k]] for k in range(3))
    normal = torch.linalg.cross(second - first, third - first)  # (N, C, 3), twice the area long
    height = (normal * first).sum(2)  # (N, C), of the plane over the mean
    above = torch.bmm(normal, points.mT) - height.unsqueeze(2)  # (N, C, P)
    corner = torch.zeros(len(of), count, dtype=torch.bool, device=points.device)
    corner.scatter_(1, of, True)
    above = above.masked_fill(corner, 0.0)
    face = (above <= 0).all(dim=2) | (above >= 0).all(dim=2)
    return (face * height.abs()).sum(1) / 6.0

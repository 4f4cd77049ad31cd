"""Least distances between named groups of geoms, from where they are: no second pass of the physics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
import torch
from torch import Tensor

from understudy.errors import ConfigError, suggestion
from understudy.options import check_range
from understudy.task import Context, Fields, Shape
from understudy_mujoco.scene import MujocoScene
from understudy_tensors.segments import segment_distance

__all__ = ["Distances"]

_SPHERE, _CAPSULE = int(mujoco.mjtGeom.mjGEOM_SPHERE), int(mujoco.mjtGeom.mjGEOM_CAPSULE)


@dataclass(frozen=True)
class Pair:
    of: tuple[str, ...]  #: names of geoms: spheres and capsules
    to: tuple[str, ...]  #: names of the geoms of the other group


class Distances(Fields):
    """``distance_NAME`` () m of each of `between`: the least between a geom of one group and one of the other,
    negative where they are in one another, at most `most`. Sizes are the model's."""

    reads = ("geom_xpos", "geom_xmat")

    @dataclass(frozen=True)
    class Options:
        between: Mapping[str, Pair]  #: by name, the two groups
        most: float = 1.0  #: m: what is farther counts as so far

        def __post_init__(self) -> None:
            check_range(self, "most", above=0, most=1e3)
            if not self.between:
                raise ValueError("between={} is not possible: name two groups of geoms.")
            for name, pair in self.between.items():
                if not name.isidentifier():
                    raise ValueError(f"between names '{name}', which is no name of a field.")
                if not pair.of or not pair.to or set(pair.of) & set(pair.to):
                    raise ValueError(
                        f"between.{name} is not possible: give two groups, neither empty, that share no geom."
                    )

    def __init__(self, options: Options, context: Context) -> None:
        model = context.need_scene(MujocoScene, "fields 'mujoco/distances'").model
        self._most = options.most
        self.provides: Mapping[str, Shape] = {f"distance_{n}": () for n in options.between}
        names = list(dict.fromkeys(n for p in options.between.values() for n in (*p.of, *p.to)))
        geoms = np.array([_geom(model, name) for name in names])
        capsule = model.geom_type[geoms] == _CAPSULE
        device = context.device

        def on_device(values: np.ndarray) -> Tensor:
            return torch.tensor(values, dtype=torch.float32, device=device)

        self._geoms = torch.tensor(geoms, device=device)
        self._radii = on_device(model.geom_size[geoms, 0])
        self._half = on_device(np.where(capsule, model.geom_size[geoms, 1], 0.0))
        self._rows = {
            f"distance_{name}": tuple(
                torch.tensor([names.index(n) for n in group], device=device)
                for group in (pair.of, pair.to)
            )
            for name, pair in options.between.items()
        }

    def compute(self, geom_xpos: Tensor, geom_xmat: Tensor) -> dict[str, Tensor]:
        middle = geom_xpos.index_select(1, self._geoms)
        axis = geom_xmat.index_select(1, self._geoms).view(*middle.shape, 3)[..., 2]
        reach = self._half[:, None] * axis
        ends = torch.stack([middle - reach, middle + reach], dim=-2)
        found: dict[str, Tensor] = {}
        for name, (one, other) in self._rows.items():
            away = segment_distance(
                ends.index_select(1, one)[:, :, None], ends.index_select(1, other)[:, None]
            )
            away = away - self._radii[one][:, None] - self._radii[other]
            found[name] = away.flatten(1).amin(1).clamp(max=self._most)
        return found


def _geom(model: mujoco.MjModel, name: str) -> int:
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, name)
    if number < 0:
        known = [model.geom(k).name for k in range(model.ngeom) if model.geom(k).name]
        raise ConfigError(
            f"fields 'mujoco/distances' names the geom '{name}', which the scene has not got."
            f"{suggestion(name, known)}"
        )
    if model.geom_type[number] not in (_SPHERE, _CAPSULE):
        raise ConfigError(
            f"fields 'mujoco/distances' takes spheres and capsules, and '{name}' is neither. Leave it out, or "
            "put a capsule without contacts in its place."
        )
    return number

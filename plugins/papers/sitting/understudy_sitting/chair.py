"""The chair, parametric or a mesh, and the sensors that say who touches what.

The chair's frame stands on the floor under the middle of the seat; x points to where a sitter faces.
It is a mocap body, so worlds and episodes may have it anywhere (``mocap_pos/chair``,
``mocap_quat/chair``).
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import torch
from scipy.spatial import ConvexHull, QhullError
from torch import Tensor

from understudy.errors import ConfigError
from understudy.inputs import Inputs
from understudy.options import check_range
from understudy.setup.registry import Registry
from understudy_characters.meshes import convex_parts
from understudy_characters.staging import make_solid
from understudy_characters.surroundings import Surroundings

BODY, SEAT = "chair", "chair_seat"
#: Sensors of contacts between two bodies, or of a body with the seat.
FEET = ("left_foot", "right_foot")
SEATED = "seated"

_COLOUR = (0.72, 0.52, 0.34, 1.0)


@dataclass(frozen=True)
class ChairOptions:
    """Sizes in m. A chair of a mesh takes its seat from ``seat_height``, ``width`` and ``depth``."""

    seat_height: float = 0.45  #: m, height of the seat's surface above the floor
    width: float = 0.46  #: m, width of the seat, along y
    depth: float = 0.42  #: m, depth of the seat, along x
    back: float | None = 0.45  #: m, height of the back above the seat; null for none
    arms: float | None = None  #: m, height of the arm rests above the seat; null for none
    legs: bool = True  #: whether the chair has four legs; without them the seat floats
    #: path of an OBJ, STL, PLY or glTF file with z up, on the floor, facing x
    mesh: str | None = None
    mesh_scale: float = 1.0  #: factor of the mesh's lengths that makes them m
    friction: float = 1.0  #: coefficient of sliding friction, as MuJoCo's contacts have it
    pelvis: str = "root"  #: the figure's link that sits

    def __post_init__(self) -> None:
        check_range(self, "seat_height", least=0.2, most=1.0)
        check_range(self, "width", "depth", least=0.2, most=2.0)
        check_range(self, "back", "arms", above=0, most=1.5)
        check_range(self, "mesh_scale", "friction", above=0)


#: A length in m, or one for each world (N,).
Length = float | Tensor


@dataclass(frozen=True)
class Slab:
    """A box of the chair: its centre and half sizes in the chair's frame, m."""

    name: str
    centre: tuple[Length, Length, Length]
    half: tuple[Length, Length, Length]


#: m: of seat, back and arm rests; of legs.
THICKNESS, LEG = 0.05, 0.04


def slabs(
    options: ChairOptions,
    seat_height: Length | None = None,
    width: Length | None = None,
    depth: Length | None = None,
) -> Iterator[Slab]:
    """The boxes of a parametric chair, the seat first; the sizes given replace the options'."""
    x = 0.5 * (options.depth if depth is None else depth)
    y = 0.5 * (options.width if width is None else width)
    height = options.seat_height if seat_height is None else seat_height
    half = 0.5 * THICKNESS
    yield Slab(SEAT, (0.0, 0.0, height - half), (x, y, half))
    if options.back is not None:
        centre = (-x - half, 0.0, height - THICKNESS + 0.5 * (options.back + THICKNESS))
        yield Slab("chair_back", centre, (half, y, 0.5 * (options.back + THICKNESS)))
    if options.legs:
        long, leg = 0.5 * (height - THICKNESS), 0.5 * LEG
        for name, i, j in (("fl", 1, 1), ("fr", 1, -1), ("bl", -1, 1), ("br", -1, -1)):
            centre = (i * (x - leg), j * (y - leg), long)
            yield Slab(f"chair_leg_{name}", centre, (leg, leg, long))
    if options.arms is not None:
        for name, side in (("left", 1), ("right", -1)):
            centre = (0.0, side * (y + half), height - THICKNESS + 0.5 * (options.arms + THICKNESS))
            yield Slab(f"chair_arm_{name}", centre, (x, half, 0.5 * (options.arms + THICKNESS)))


#: m: lengths of a chair, and how far from the floor it may begin.
_LONG, _OFF = (0.2, 3.0), 0.05


def _check_size(path: Path, points: np.ndarray, scale: float) -> None:
    """Refuse a mesh, whose `points` (V, 3) m are at this `scale`, of no chair's size; warn of one that is not on the
    floor.

    Raises
    ------
    ConfigError
        it is longer or shorter than chairs are.
    """
    least, most = _LONG
    longest = float(np.ptp(points, axis=0).max())
    if not least <= longest <= most:
        better = [f"{s:g}" for s in (1.0, 0.01, 0.001, 0.0254) if 0.3 <= longest / scale * s <= 2.0]
        hint = f"chair.mesh_scale={better[0]}." if better else "another chair.mesh_scale."
        hint += f" Of inches it is {better[-1]}." if better[1:] else ""
        raise ConfigError(
            f"The mesh {path} is {longest:.3g} m long at chair.mesh_scale={scale:g}, and chairs are {least:g} to "
            f"{most:g} m. Give {hint}"
        )
    if abs(low := float(points[:, 2].min())) > _OFF:
        where = f"{abs(low):.2f} m {'above' if low > 0 else 'below'} the floor"
        warnings.warn(
            f"The mesh {path} begins {where}, so the figure meets it there. A chair's mesh has z up and stands on "
            "z = 0; glTF files often have y up.",
            stacklevel=2,
        )


#: m, that a mesh's surface may be from the seat's height.
_BESIDE = 0.05


def _check_seat(path: Path, parts: Sequence[np.ndarray], height: float) -> None:
    """Warn of a mesh whose `parts` (V, 3) m have no surface at this `height` in the middle, where the seat is: the
    figure would sit on something else, and count as one that does not sit."""
    tops = [top for part in parts if (top := _top(part)) is not None]
    if tops:
        top = max(tops)
        if abs(top - height) <= _BESIDE:
            return
        what = f"is {top:.2f} m high in its middle, as convex parts"
        better = (
            f"chair.seat_height={top:.2f}" if 0.2 <= top <= 1.0 else "another chair.seat_height"
        )
        then = f"Give {better}, or a mesh whose seat is a part of its own."
    else:
        what, then = "has nothing above x = y = 0", "Move it there, or the figure sits beside it."
    warnings.warn(
        f"The mesh {path} {what}, and chair.seat_height={height:g} says that one sits there. {then}",
        stacklevel=2,
    )


def _top(points: np.ndarray) -> float | None:
    """m, the height of the convex hull of `points` (V, 3) above x = y = 0; None where it is not there."""
    try:
        slopes = ConvexHull(points).equations  # n · x + d ≤ 0 inside
    except QhullError:  # it is flat
        return None
    upright, rest = slopes[:, 2], slopes[:, 3]
    level = np.abs(upright) < 1e-9
    bounds = -rest[~level] / upright[~level]
    up = upright[~level] > 0
    top, bottom = float(bounds[up].min()), float(bounds[~up].max())
    return top if top >= bottom and (rest[level] <= 1e-9).all() else None


class Chair(Surroundings):
    """A chair beside the character, and what senses feet on the floor and the pelvis on the seat."""

    def __init__(self, options: ChairOptions, registry: Registry, inputs: Inputs) -> None:
        self.options, self._inputs = options, inputs
        #: Parameters in which chairs of other sizes differ.
        self.sizes = tuple(
            f"{field}/{slab.name}" for slab in slabs(options) for field in ("geom_pos", "geom_size")
        )
        self.recorded = ("chair_position", "chair_rotation", *self.sizes)

    def add(self, spec: mujoco.MjSpec) -> None:
        body = spec.worldbody.add_body(name=BODY, mocap=True)
        boxes = list(slabs(self.options))
        if self.options.mesh is not None:
            path = Path(self.options.mesh)
            path = self._inputs.file(f"chair.mesh={path}", lambda: [path])
            parts = convex_parts(path, self.options.mesh_scale)
            _check_size(path, np.concatenate(parts), self.options.mesh_scale)
            _check_seat(path, parts, self.options.seat_height)
            for number, vertices in enumerate(parts):
                name = f"chair_part{number}"
                spec.add_mesh(name=name, uservert=vertices.flatten().tolist())
                self._paint(body.add_geom(
                    name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name
                ))  # fmt: skip
            boxes = boxes[:1]
        for slab in boxes:
            geom = body.add_geom(name=slab.name, type=mujoco.mjtGeom.mjGEOM_BOX)
            geom.pos, geom.size = slab.centre, slab.half
            self._paint(geom)
        sense(spec, SEATED, self.options.pelvis, SEAT)

    def _paint(self, geom: mujoco.MjsGeom) -> None:
        make_solid(geom)
        geom.mass = 0.0
        geom.rgba = _COLOUR
        geom.condim = 3
        geom.friction = [self.options.friction, 0.005, 0.0001]

    def place(
        self, model: mujoco.MjModel, data: mujoco.MjData, recorded: Mapping[str, np.ndarray]
    ) -> None:
        if "chair_position" in recorded:
            row = model.body(BODY).mocapid[0]
            data.mocap_pos[row] = recorded["chair_position"]
            data.mocap_quat[row] = recorded["chair_rotation"]
        for name in self.sizes:
            if name in recorded:
                field, _, geom = name.partition("/")
                getattr(model, field)[model.geom(geom).id] = recorded[name]

    def sized(self, seat_height: Tensor, width: Tensor, depth: Tensor) -> dict[str, Tensor]:
        """The parameters (N, 3) of chairs of these sizes (N,), by name."""

        def rows(lengths: tuple[Length, Length, Length]) -> Tensor:
            return torch.stack([torch.zeros_like(depth) + length for length in lengths], dim=1)

        found = {}
        for slab in slabs(self.options, seat_height, width, depth):
            found[f"geom_pos/{slab.name}"] = rows(slab.centre)
            found[f"geom_size/{slab.name}"] = rows(slab.half)
        return found


@dataclass(frozen=True)
class SolesOptions:
    """Which links are the figure's feet."""

    feet: tuple[str, str] = ("left_ankle", "right_ankle")  #: the figure's links, left and right


class Soles(Surroundings):
    """What senses the feet on the floor."""

    def __init__(self, options: SolesOptions, registry: Registry, inputs: Inputs) -> None:
        self.options = options

    def add(self, spec: mujoco.MjSpec) -> None:
        for name, foot in zip(FEET, self.options.feet, strict=True):
            sense(spec, name, foot, "floor")


def sense(spec: mujoco.MjSpec, name: str, body: str, place: str) -> None:
    """A sensor of how many contacts the link `body` has with the geom `place`."""
    sensor = spec.add_sensor(
        name=name, type=mujoco.mjtSensor.mjSENS_CONTACT,
        objtype=mujoco.mjtObj.mjOBJ_BODY, objname=body,
        reftype=mujoco.mjtObj.mjOBJ_GEOM, refname=place,
    )  # fmt: skip
    sensor.intprm[:3] = [1 << int(mujoco.mjtConDataField.mjCONDATA_FOUND), 0, 1]

"""Garments from parametric patterns: a T-shirt, and a jacket, which is open in front.

A front and a back are cut flat and sewn along sides, sleeves and shoulders: seams are shared vertices, and the
cut pieces are the rest shape. Side by side they begin a hand's breadth apart, as if something were between them.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import Delaunay, KDTree

from understudy.errors import ConfigError
from understudy.options import check_range
from understudy_cloth.garments import Garment, holes_of
from understudy_cloth.mesh import edges_of

__all__ = ["JACKET", "Shirt", "jacket", "t_shirt"]

#: m: so far from the plane of the seams are front and back at most, and at most so much of the distance from a seam.
_DEPTH, _RISE = 0.05, 0.35
#: Of an edge: inner points nearer to a line than this are left out.
_CLEAR = 0.6


@dataclass(frozen=True)
class Shirt:
    """Lengths in m, of the garment laid flat; y is the wearer's left, z up from the hem. Defaults are
    those of the 2018 code's T-shirt, measured: hem 1.28, collar 0.60, sleeves 0.53 to 0.49 round, 0.145 long,
    0.73 from collar to hem, 1.07 m², 2 671 vertices."""

    width: float = 0.64  #: of the body, half the hem
    height: float = 0.76  #: of the neck's highest point
    neck: float = 0.20  #: width of the collar
    neck_front: float = 0.14  #: how deep it is in front
    neck_back: float = 0.03  #: and behind
    slope: float = 0.06  #: from the neck down to where sleeves begin
    entrance: float = 0.265  #: width of a sleeve where it begins, half its perimeter
    end: float = 0.245  #: and where it ends
    sleeve: float = 0.145  #: length of a sleeve
    middle: float = 0.065  #: from a sleeve's entrance to its middle loop
    grip: float = 0.03  #: radius of the patches on the front hem
    grips: float = 0.075  #: how far their centres are from each other
    edge: float = 0.021  #: of triangles, about
    open_front: bool = False  #: whether the front is cut from collar to hem

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            if name not in ("open_front", "slope"):
                check_range(self, name, above=0)
        check_range(self, "slope", least=0)
        check_range(self, "edge", most=0.25 * min(self.neck, self.entrance, self.end, self.sleeve))
        check_range(self, "neck", most=self.width - 4 * self.edge)
        check_range(self, "middle", least=2 * self.edge, most=self.sleeve - 2 * self.edge)
        least = self.slope + self.entrance + 4 * self.edge
        check_range(self, "height", least=max(least, self.neck_front + self.neck_back + least / 4))
        check_range(self, "grips", least=2 * self.grip, most=self.width - 2 * self.grip)


#: The 2018 code's jacket: 0.7 m², sleeves 0.68 round, 0.12 long, 0.65 at the end, front and hem 2.75 in one.
JACKET = Shirt(
    width=0.48, height=0.52, neck=0.16, neck_front=0.07, neck_back=0.02, slope=0.03, entrance=0.34,
    end=0.32, sleeve=0.12, middle=0.06, open_front=True,
)  # fmt: skip


def t_shirt(shirt: Shirt | None = None) -> Garment:
    """Loops ``hem``, ``collar``, ``{left,right}_{entrance,middle,end}``; patches ``left_hem`` and
    ``right_hem`` on the front.

    Raises
    ------
    ConfigError
        if no triangles of that size fit the cut.
    """
    return _sewn("t_shirt", shirt or Shirt())


def jacket(shirt: Shirt = JACKET) -> Garment:
    """The same with ``border``, the edge around collar, front and hem, in place of hem and collar, and
    patches on the edges of the front."""
    return _sewn("jacket", shirt)


def _sewn(name: str, shirt: Shirt) -> Garment:
    front, back = (_cut(shirt, neck) for neck in (shirt.neck_front, shirt.neck_back))
    # seams are the same points of both cuts, and come first
    seams = len(_seams(shirt))
    flat = np.concatenate([front.points, back.points[seams:]])
    behind = np.where(back.faces < seams, back.faces, back.faces - seams + len(front.points))
    faces = np.concatenate([front.faces, behind[:, ::-1]])
    rest = flat[faces]
    far = KDTree(flat[:seams]).query(flat)[0]
    x = np.minimum(_RISE * far, _DEPTH)
    x[len(front.points) :] *= -1
    lines = {
        f"{side}_{part}": np.concatenate(
            [one, _behind(back.lines[side, part], seams, front)[-2:0:-1]]
        )
        for (side, part), one in front.lines.items()
    }
    if shirt.open_front:
        flat, faces = _opened(flat, faces, len(front.faces), front.middle)
        x = np.concatenate([x, x[front.middle]])
    positions = np.column_stack([x, flat])
    loops = {}
    for hole in holes_of(faces):
        y, z = flat[hole].mean(axis=0)
        side = "left" if y > 0 else "right"
        if abs(y) > 0.25 * shirt.width:
            loops[f"{side}_end"] = hole
        else:
            low = z < 0.5 * shirt.height
            loops["border" if shirt.open_front else "hem" if low else "collar"] = hole
    loops |= lines
    front_only = np.zeros(len(flat), bool)
    front_only[faces[: len(front.faces)]] = True
    patches = {}
    for side, sign in (("left", 1), ("right", -1)):
        centre = np.array([0.5 * sign * shirt.grips, 0.0])
        near = np.linalg.norm(flat - centre, axis=1) < shirt.grip
        patches[f"{side}_hem"] = np.flatnonzero(near & front_only)
    return Garment(name, positions, faces, loops, patches, rest)


@dataclass(frozen=True)
class _Piece:
    points: np.ndarray  #: (P, 2), those of seams first
    faces: np.ndarray  #: counter-clockwise
    lines: dict[tuple[str, str], np.ndarray]  #: by side and name: from below to above
    middle: np.ndarray  #: from the hem up to the collar


def _between(a: Sequence[float], b: Sequence[float], edge: float) -> np.ndarray:
    """From a to b, without b."""
    begin, way = np.asarray(a, float), np.asarray(b, float) - np.asarray(a, float)
    count = max(2, round(float(np.linalg.norm(way)) / edge))
    return begin + np.arange(count)[:, None] / count * way


def _corners(shirt: Shirt) -> dict[str, tuple[float, float]]:
    """Of the left half, from the hem around the sleeve to the neck."""
    s = shirt
    half, top = 0.5 * s.width, s.height - s.slope
    down = s.slope / max(half - 0.5 * s.neck, 1e-6)  # sleeves go on as shoulders do
    narrower = 0.5 * (s.entrance - s.end) / s.sleeve

    def across(along: float, upper: bool) -> tuple[float, float]:
        z = top - down * along - (narrower if upper else -narrower) * along
        return half + along, z if upper else z - s.entrance

    return {
        "hem": (half, 0.0),
        "entrance_below": across(0.0, False), "middle_below": across(s.middle, False),
        "end_below": across(s.sleeve, False), "end_above": across(s.sleeve, True),
        "middle_above": across(s.middle, True), "entrance_above": across(0.0, True),
        "neck": (0.5 * s.neck, s.height),
    }  # fmt: skip


def _seams(shirt: Shirt) -> np.ndarray:
    """(S, 2): the points that front and back share, left, then right."""
    c = _corners(shirt)
    ways = (("hem", "entrance_below", "middle_below", "end_below"), ("end_above", "middle_above", "entrance_above", "neck"))  # fmt: skip
    parts = []
    for way in ways:
        for one, other in itertools.pairwise(way):
            parts.append(_between(c[one], c[other], shirt.edge))
        parts.append(np.array([c[way[-1]]]))
    left = np.concatenate(parts)
    return np.concatenate([left, left * (-1, 1)])


def _cut(shirt: Shirt, depth: float) -> _Piece:
    """A piece whose neck is so deep."""
    s, c, edge = shirt, _corners(shirt), shirt.edge
    hem = _between((0.0, 0.0), c["hem"], edge)
    end = _between(c["end_below"], c["end_above"], edge)[1:]
    count = max(3, round(_quarter(0.5 * s.neck, depth) / edge))
    turn = np.linspace(0.0, 0.5 * np.pi, count + 1)[1:]
    collar = np.column_stack([0.5 * s.neck * np.cos(turn), s.height - depth * np.sin(turn)])
    middle = _between((0.0, 0.0), (0.0, s.height - depth), edge)[1:]
    both = (-1, 1)
    points = [
        _seams(shirt),
        hem,
        hem[1:] * both,
        end,
        end * both,
        collar,
        collar[:-1] * both,
        middle,
    ]
    inner = {}
    for part in ("entrance", "middle"):
        line = _between(c[f"{part}_below"], c[f"{part}_above"], edge)[1:]
        inner["left", part] = line
        inner["right", part] = line * both
        points += [line, line * both]
    fixed = np.concatenate(points)
    way = [c["hem"], c["entrance_below"], c["middle_below"], c["end_below"], c["end_above"], c["middle_above"], c["entrance_above"], c["neck"]]  # fmt: skip
    outline = np.concatenate([way, collar])
    outline = np.concatenate([outline, outline[:-1][::-1] * both])
    grid = _grid(outline, edge)
    grid = grid[_inside(grid, outline)]
    # nor near the middle between two neighbours on a line, or it would part them
    i, j = KDTree(fixed).query_pairs(1.6 * edge, output_type="ndarray").T
    taken = np.concatenate([fixed, 0.5 * (fixed[i] + fixed[j])])
    grid = grid[KDTree(taken).query(grid)[0] > _CLEAR * edge]
    cloud = np.concatenate([fixed, grid])
    faces = Delaunay(cloud).simplices
    faces = faces[_inside(cloud[faces].mean(axis=1), outline)]
    a, b, d = np.moveaxis(cloud[faces], 1, 0)
    double = (b - a)[:, 0] * (d - a)[:, 1] - (b - a)[:, 1] * (d - a)[:, 0]
    faces[double < 0] = faces[double < 0][:, ::-1]
    faces = faces[np.abs(double) > 1e-3 * edge**2]  # slivers along straight borders
    tree = KDTree(cloud)

    def numbers(line: np.ndarray) -> np.ndarray:
        return np.asarray(tree.query(line)[1])

    lines = {}
    for (side, part), line in inner.items():
        turned = both if side == "right" else (1, 1)
        whole = np.concatenate([[c[f"{part}_below"]] * np.array(turned), line, [c[f"{part}_above"]] * np.array(turned)])  # fmt: skip
        lines[side, part] = numbers(whole)
    centre = numbers(np.concatenate([[(0.0, 0.0)], middle, [(0.0, s.height - depth)]]))
    edges = set(map(tuple, edges_of(faces)[0].tolist()))
    for line in (*lines.values(), centre):
        for pair in zip(line[:-1].tolist(), line[1:].tolist(), strict=True):
            if tuple(sorted(pair)) not in edges:
                raise ConfigError(f"No triangles of {edge:g} m fit the cut: let edge be smaller.")
    if len(np.unique(faces)) < len(cloud):
        raise ConfigError(f"No triangles of {edge:g} m fit the cut: let edge be another.")
    return _Piece(cloud, faces, lines, centre)


def _quarter(a: float, b: float) -> float:
    """A quarter of an ellipse's perimeter (Ramanujan)."""
    return 0.25 * np.pi * (3 * (a + b) - float(np.sqrt((3 * a + b) * (a + 3 * b))))


def _grid(outline: np.ndarray, edge: float) -> np.ndarray:
    """Equal triangles' vertices around the outline, a point on the middle line."""
    low, high = outline.min(axis=0), outline.max(axis=0)
    rows = np.arange(low[1], high[1], edge * np.sqrt(0.75))
    columns = np.arange(0, high[0] + edge, edge)
    columns = np.concatenate([-columns[:0:-1], columns])
    return np.concatenate(
        [
            np.column_stack([columns + 0.5 * edge * (k % 2), np.full(len(columns), z)])
            for k, z in enumerate(rows)
        ]
    )


def _inside(points: np.ndarray, outline: np.ndarray) -> np.ndarray:
    """(P,) bool: within the closed outline, by the crossings of a ray along y."""
    result = np.zeros(len(points), bool)
    for a, b in _sides(outline):
        crosses = (a[1] > points[:, 1]) != (b[1] > points[:, 1])
        rise = b[1] - a[1] if b[1] != a[1] else 1.0
        result ^= crosses & (points[:, 0] < a[0] + (points[:, 1] - a[1]) / rise * (b[0] - a[0]))
    return result


def _sides(outline: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    yield from zip(outline, np.roll(outline, -1, axis=0), strict=True)


def _behind(line: np.ndarray, seams: int, front: _Piece) -> np.ndarray:
    """A line of the back in the whole garment's numbers."""
    return np.where(line < seams, line, line - seams + len(front.points))


def _opened(
    flat: np.ndarray, faces: np.ndarray, in_front: int, middle: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Cut along the front's middle line: the right side gets vertices of its own."""
    own = np.arange(len(flat))
    own[middle] = len(flat) + np.arange(len(middle))
    right = np.zeros(len(faces), bool)
    right[:in_front] = flat[faces[:in_front], 0].mean(axis=1) < 0
    faces = np.where(right[:, None], own[faces], faces)
    return np.concatenate([flat, flat[middle]]), faces

"""Garments from files: a mesh as OBJ, and a small YAML file beside it that names its loops and patches."""

from __future__ import annotations

import itertools
import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import yaml
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import KDTree

from understudy.errors import FileError, UnderstudyError
from understudy.folders import read
from understudy.options import check_range, make_options
from understudy_cloth.checking import check_mesh, pieces_of
from understudy_cloth.mesh import edges_of, face_areas

__all__ = ["Garment", "holes_of", "read_garment"]

#: Bytes of a mesh and of the file that names its loops; no garment comes near.
MOST_BYTES, MOST_NAMING_BYTES = 64 << 20, 1 << 20
#: Vertices of a garment; a shirt has some 3 000, and each one more makes every sub-step longer.
MOST_VERTICES = 30_000
#: Corners of a face: pieces of a pattern that are one polygon each have no vertices within to bend at.
MOST_CORNERS = 32
#: Of a triangle cut from a polygon, twice the area over the longest side squared, at least; 0.87 if all sides are equal.
_FLAT_EAR = 1e-4
#: Loops and patches of a garment, together; each one is looked for in the whole mesh.
MOST_NAMES = 100
#: Levels of the file that names them, which has three.
_DEEPEST = 8
#: m, across a garment the longest way.
SMALLEST, LARGEST = 0.15, 3.0
#: m: vertices nearer to each other are one that was not merged.
_SAME = 1e-6
#: Of a mesh turned inside out, the volume, holes closed, over the area to the 3/2; a sphere's is 0.094.
_INSIDE_OUT = -0.003


@dataclass(frozen=True)
class Hole:
    """A loop by a vertex on it: the whole border of that hole."""

    hole: int  #: a vertex on the border


@dataclass(frozen=True)
class Around:
    """A patch: the vertices that are near one along the cloth."""

    vertex: int
    radius: float  #: m

    def __post_init__(self) -> None:
        check_range(self, "radius", above=0)


@dataclass(frozen=True)
class Naming:
    """What the YAML file says. Vertices are counted from 0, in the order of the mesh's file."""

    mesh: str  #: the OBJ file, beside this one
    #: Closed loops along edges by name: the vertices in order, or a hole. Every hole needs a name.
    loops: dict[str, tuple[int, ...] | Hole]
    patches: dict[str, tuple[int, ...] | Around] = field(default_factory=dict)  #: where grips hold
    unit: float = 1.0  #: m, of 1 in the mesh's file
    up: Literal["y", "z"] = "y"  #: with y up the wearer looks along −z, as OBJ's writers have it
    source: str | None = None  #: where the mesh is from
    licence: str | None = None

    def __post_init__(self) -> None:
        check_range(self, "unit", above=0)
        if "" in {*self.loops, *self.patches}:
            raise ValueError("a loop or patch without a name is not possible: give it one.")
        if (count := len(self.loops) + len(self.patches)) > MOST_NAMES:
            raise ValueError(
                f"loops and patches are {count}, and a garment has at most {MOST_NAMES}."
            )


@dataclass(frozen=True)
class Garment:
    """A garment in metres, z up, its wearer facing x. V vertices, F triangles."""

    name: str
    positions: np.ndarray  #: (V, 3) m
    faces: np.ndarray  #: (F, 3), counter-clockwise seen from outside
    loops: Mapping[str, np.ndarray]  #: vertices of closed loops, in order
    patches: Mapping[str, np.ndarray]  #: vertices
    #: (F, 3, 2) m, triangles as cut, where they differ from `positions`.
    rest: np.ndarray | None = None
    source: str | None = None
    licence: str | None = None

    def perimeter(self, loop: str) -> float:
        """m, of the loop as it lies."""
        x = self.positions[self.loops[loop]]
        return float(np.linalg.norm(np.roll(x, -1, axis=0) - x, axis=1).sum())


def read_garment(path: Path) -> Garment:
    """The garment that the YAML file `path` names.

    Raises
    ------
    FileError
        if a file cannot be read, the mesh is no surface of one piece in metres, a loop is none, or a hole
        has no name.
    """
    naming = _naming(path)
    mesh = path.parent / naming.mesh
    try:
        inside = mesh.resolve().is_relative_to(path.parent.resolve())
    except ValueError:  # what no file can be named
        inside = False
    if not inside or mesh.suffix.lower() != ".obj":
        raise FileError(f"{path}: mesh={naming.mesh!r} is no OBJ file in the same folder.")
    positions, faces = read_obj(mesh)
    positions = positions * naming.unit
    if naming.up == "y":
        positions = np.stack([-positions[:, 2], -positions[:, 0], positions[:, 1]], axis=1)
    used = np.unique(faces)
    _check_size(positions, used, str(mesh))
    check_mesh(positions, faces, str(mesh), FileError, loose=True)
    pieces = pieces_of(np.searchsorted(used, faces), len(used))
    if pieces > 1:
        raise FileError(
            f"{mesh} has {pieces} pieces: a garment is one; sew them together, or remove all but one."
        )
    holes = holes_of(faces)
    if _volume(positions, faces, holes) < _INSIDE_OUT * face_areas(positions[faces]).sum() ** 1.5:
        raise FileError(f"{mesh} is inside out: turn all its triangles around.")
    loops = {
        name: _loop(loop, faces, holes, len(positions), f"{path}: loop '{name}'")
        for name, loop in naming.loops.items()
    }
    named = [frozenset(loop.tolist()) for loop in loops.values()]
    for hole in holes:
        if frozenset(hole.tolist()) not in named:
            x = positions[hole]
            around = np.linalg.norm(np.roll(x, -1, axis=0) - x, axis=1).sum()
            raise FileError(
                f"{mesh} has a hole, {around:.2f} m round, that no loop of {path.name} names: add one with "
                f"hole: {hole.min()}, or close it."
            )
    patches = {
        name: _patch(patch, positions, faces, f"{path}: patch '{name}'")
        for name, patch in naming.patches.items()
    }
    for name, patch in patches.items():
        if len(loose := np.setdiff1d(patch, used)):
            raise FileError(
                f"{path}: patch '{name}' has vertex {loose[0]}, which is in no triangle."
            )
    # programs write points of curves and of what they hid as vertices, too; loops and patches count those
    faces, *named = (
        np.searchsorted(used, of) for of in (faces, *loops.values(), *patches.values())
    )
    loops = dict(zip(loops, named, strict=False))
    patches = dict(zip(patches, named[len(loops) :], strict=True))
    return Garment(
        path.stem, positions[used], faces, loops, patches, None, naming.source, naming.licence
    )


def _naming(path: Path) -> Naming:
    text = _text(path, MOST_NAMING_BYTES)
    try:
        depth = 0
        for event in yaml.parse(text, _Loader):
            if isinstance(event, yaml.AliasEvent):  # it may stand for itself many times over
                raise FileError(f"{path} has aliases; write them out.")
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            if depth > _DEEPEST:  # each level takes as much longer as there are above it
                raise FileError(
                    f"{path} is no YAML of a garment: it is nested more than {_DEEPEST} deep."
                )
        root = yaml.compose(text, _Loader)
        names = [
            (key.value, key.start_mark.line + 1) for section in _sections(root) for key in section
        ]
        for scalar in _scalars(root):
            if scalar.style is None and scalar.tag in _NUMBERS and _OTHER.match(scalar.value):
                raise FileError(
                    f"{path}: {scalar.value} in line {scalar.start_mark.line + 1} is another number to YAML; write it in "
                    "decimals, without zeros before it."
                )
        raw = _Loader(text).get_single_data()
    except (ValueError, RecursionError, yaml.YAMLError) as error:
        reason = str(error).partition("\n")[0]
        raise FileError(f"{path} is no YAML: {reason}.") from error
    seen = set()
    for name, line in names:
        if name in seen:
            raise FileError(f"{path}: '{name}' is there twice, in line {line} again.")
        seen.add(name)
    if not isinstance(raw, dict):
        raise FileError(f"{path} names no garment: it takes mesh: FILE.obj and loops.")
    try:
        return make_options(Naming, raw, path.name)
    except UnderstudyError as error:
        raise FileError(str(error)) from error


class _Loader(yaml.SafeLoader):
    """Plain data, with numbers such as ``1e-2`` as all but the first YAML read them."""


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[+-]?\d+(\.\d*)?[eE][+-]?\d+$"), list("+-0123456789")
)


#: What YAML takes for a number to the base 8 or 60, and a reader for another one.
_OTHER = re.compile(r"[+-]?0[0-9_]|[^:]*:")
_NUMBERS = ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float")


def _scalars(node: Any) -> Iterator[yaml.ScalarNode]:
    """All values within a document without aliases, of a depth that was checked."""
    if isinstance(node, yaml.ScalarNode):
        yield node
    elif isinstance(node, yaml.CollectionNode):
        for item in node.value:
            for inner in item if isinstance(item, tuple) else (item,):
                yield from _scalars(inner)


def _sections(node: Any) -> Iterator[list[Any]]:
    """The keys of the whole file, and those of loops and patches, as the parser has them."""
    if isinstance(node, yaml.MappingNode):
        yield [key for key, _ in node.value]
        for key, value in node.value:
            if key.value in ("loops", "patches") and isinstance(value, yaml.MappingNode):
                yield [
                    _Key(f"{key.value}.{inner.value}", inner.start_mark) for inner, _ in value.value
                ]


@dataclass(frozen=True)
class _Key:
    value: str
    start_mark: Any


def _text(path: Path, most: int) -> str:
    """The text of a file: UTF-8, or what its mark or the zeros in it show (UTF-16 and 32), as editors save it."""
    try:
        content = read(path, most)
    except OSError as error:
        raise FileError(f"{path} cannot be read: {error.strerror}.") from error
    return content.decode(json.detect_encoding(content), errors="replace")


def _statements(text: str) -> Iterator[tuple[int, str]]:
    """The lines of an OBJ file by the number of the first, without comments; a backslash at the end of a vertex or face joins the
    next. That of a name may be of a path, ``mtllib C:\\shirts\\``."""
    begun, first = "", 0
    for number, line in enumerate(text.splitlines(), 1):
        line = line.partition("#")[0].rstrip()
        first = first if begun else number
        begun += line.removesuffix("\\") + " "
        if not line.endswith("\\") or begun.split(None, 1)[:1] not in (["v"], ["f"]):
            yield first, begun
            begun = ""
    if begun:
        yield first, begun


def read_obj(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) and triangles (F, 3) of an OBJ file, in its order: loops count its vertices. Libraries
    double those with two normals. What the file refers to is not followed; other polygons become triangles.

    Raises
    ------
    FileError
        if it cannot be read, or a line is no vertex or face.
    """
    vertices: list[list[float]] = []
    polygons: list[tuple[int, str, list[int]]] = []
    for number, line in _statements(_text(path, MOST_BYTES)):
        kind, *values = line.split() or ("",)
        try:
            if kind == "v":
                vertices.append([float(value) for value in values[:3]])
                if len(values) < 3:
                    raise ValueError
            elif kind == "f":
                corners = [int(value.partition("/")[0]) for value in values]
                if not 3 <= len(corners) <= MOST_CORNERS:
                    raise ValueError
                if 0 in corners or min(corners) < -len(vertices):
                    raise ValueError
                corners = [c - 1 if c > 0 else len(vertices) + c for c in corners]
                polygons.append((number, line, corners))
        except ValueError:
            raise _no_line(path, number, line, kind, len(values)) from None
        if max(len(vertices), len(polygons)) > 2 * MOST_VERTICES:
            break
    if not vertices or not polygons:
        raise FileError(f"{path} has no {'faces' if vertices else 'vertices'}: it is no mesh.")
    if len(vertices) <= MOST_VERTICES:
        faces = list(_cut(path, vertices, polygons))
        if len(faces) <= 2 * MOST_VERTICES:
            return np.array(vertices), np.array(faces)
    raise FileError(f"{path} has more than {MOST_VERTICES} vertices; make it coarser.")


def _no_line(path: Path, number: int, line: str, kind: str, values: int) -> FileError:
    most = f"three to {MOST_CORNERS} vertices"
    many = ": triangulate faces when you export the mesh" * (kind == "f" and values > MOST_CORNERS)
    what = "vertex" if kind == "v" else f"face of {most}"
    return FileError(f"{path}, line {number}: '{line[:60].strip()}' is no {what}{many}.")


def _cut(
    path: Path, positions: list[list[float]], polygons: Sequence[tuple[int, str, list[int]]]
) -> Iterator[list[int]]:
    """The triangles of polygons, each with its line in the file; a corner that is said again next to itself is one,
    as programs write a triangle where they have quadrilaterals alone."""
    for number, line, corners in polygons:
        if max(corners) >= len(positions):
            raise FileError(f"{path} has a face of vertices that do not exist, in line {number}.")
        once = [c for k, c in enumerate(corners) if k == 0 or c != corners[k - 1]]
        if once[-1] == once[0]:
            once.pop()
        if len(once) <= 3:
            yield once if len(once) == 3 else corners[:3]
            continue
        triangles = _ears([positions[c] for c in once]) if len(set(once)) == len(once) else None
        if triangles is None:
            raise FileError(
                f"{path}, line {number}: the face '{line[:60].strip()}' crosses or touches itself or has no area: triangulate "
                "faces when you export the mesh, or remove it."
            )
        yield from ([once[k] for k in triangle] for triangle in triangles)


def _ears(x: Sequence[Sequence[float]]) -> list[list[int]] | None:
    """Triangles of one simple polygon of corners `x` (n, 3), nearly flat, by cutting off ears, the fullest first; of
    a convex quadrilateral those on both sides of the diagonal from its first corner. None if it crosses itself, or
    has no area."""
    turns = [_across(x[0], x[k], x[k + 1]) for k in range(1, len(x) - 1)]
    normal = [sum(axis) for axis in zip(*turns, strict=True)]
    length = math.hypot(*normal)
    if length == 0:
        return None
    if not length < math.inf:  # coordinates that are not finite are said of the whole mesh
        return [[0, k, k + 1] for k in range(1, len(x) - 1)]

    def area(i: int, j: int, k: int) -> float:
        turn = _across(x[i], x[j], x[k])
        return sum(a * b for a, b in zip(turn, normal, strict=True)) / length

    left, found = list(range(len(x))), []
    while len(left) > 3:
        best, most = None, 0.0
        for at in [*range(1, len(left)), 0]:
            i, j, k = left[at - 1], left[at], left[(at + 1) % len(left)]
            longest = max(math.dist(x[i], x[j]), math.dist(x[j], x[k]), math.dist(x[k], x[i]))
            full = area(i, j, k) / longest**2 if longest else 0.0
            if full <= max(most, _FLAT_EAR) or any(
                min(area(i, j, m), area(j, k, m), area(k, i, m)) >= 0
                for m in left
                if m not in (i, j, k)
            ):
                continue
            if len(left) == 4 and area(k, left[(at + 2) % 4], i) <= 0:
                continue  # what it leaves faces the other way
            best, most = at, full
            if len(x) == 4:
                break
        if best is None:
            return None
        found.append([left[best - 1], left[best], left[(best + 1) % len(left)]])
        del left[best]
    return [*found, left]


def _across(a: Sequence[float], b: Sequence[float], c: Sequence[float]) -> tuple[float, ...]:
    """(b − a) × (c − a)."""
    (p, q, r), (u, v, w) = (tuple(e - f for e, f in zip(d, a, strict=True)) for d in (b, c))
    return q * w - r * v, r * u - p * w, p * v - q * u


def _check_size(positions: np.ndarray, used: np.ndarray, what: str) -> None:
    """Refuse vertices of a garment, those of numbers `used`, that are not as far apart as in metres."""
    positions = positions[used]
    if not np.isfinite(positions).all():
        raise FileError(f"{what} has coordinates that are not finite.")
    across = float((positions.max(axis=0) - positions.min(axis=0)).max())
    if not SMALLEST <= across <= LARGEST:
        guess, unit = "if that is not metres", "M"
        for name, by in (("centimetres", 0.01), ("millimetres", 0.001)):
            if SMALLEST <= by * across <= LARGEST:
                guess, unit = f"if these are {name}", f"{by:g}"
                break
        raise FileError(
            f"{what} is {across:.3g} m across, and garments are {SMALLEST:g} to {LARGEST:g} m; {guess}, say "
            f"unit: {unit} in the file that names its loops."
        )
    tree = KDTree(positions)
    # how many, and not which: those of a mesh all in one place take gigabytes
    near = tree.query_ball_point(positions, _SAME, return_length=True)
    if (near > 1).any():
        i, pairs = int(np.argmax(near > 1)), int((near - 1).sum()) // 2
        j = min(k for k in tree.query_ball_point(positions[i], _SAME) if k != i)
        raise FileError(
            f"{what} has {pairs} pair{'s' * (pairs > 1)} of vertices in one place, the first {used[i]} and {used[j]}: merge "
            "them, or the cloth is open there."
        )


def holes_of(faces: np.ndarray) -> list[np.ndarray]:
    """The borders of a manifold mesh of `faces` (F, 3), each (n,) vertices in order, along its triangles."""
    _, index = edges_of(faces)
    once = (np.bincount(index.ravel())[index] == 1).ravel()
    following = dict(
        zip(
            faces.ravel()[once].tolist(),
            np.roll(faces, -1, axis=1).ravel()[once].tolist(),
            strict=True,
        )
    )
    found = []
    while following:
        loop = [next(iter(following))]
        while (then := following.pop(loop[-1])) != loop[0]:
            loop.append(then)
        found.append(np.array(loop))
    return found


def _volume(positions: np.ndarray, faces: np.ndarray, holes: Sequence[np.ndarray]) -> float:
    """m³, of the mesh with a fan over each hole."""
    a, b, c = np.moveaxis(positions[faces], 1, 0)
    total = (a * np.cross(b, c)).sum()
    for hole in holes:
        x = positions[hole]
        total += (x.mean(axis=0) * np.cross(np.roll(x, -1, axis=0), x)).sum()
    return float(total / 6)


def _loop(
    loop: tuple[int, ...] | Hole,
    faces: np.ndarray,
    holes: Sequence[np.ndarray],
    count: int,
    what: str,
) -> np.ndarray:
    if isinstance(loop, Hole):
        for hole in holes:
            if loop.hole in hole:
                return np.roll(hole, -int(np.argmax(hole == loop.hole)))
        raise FileError(f"{what}: vertex {loop.hole} is on no hole's border.")
    if len(loop) < 3 or not all(0 <= i < count for i in loop):
        raise FileError(f"{what} takes three vertices or more, from 0 to {count - 1}.")
    if len(set(loop)) < len(loop):
        twice = next(i for k, i in enumerate(loop) if i in loop[:k])
        raise FileError(f"{what} crosses itself: it comes to vertex {twice} twice.")
    edges = set(map(tuple, edges_of(faces)[0].tolist()))
    for i, j in itertools.pairwise(loop):
        if (min(i, j), max(i, j)) not in edges:
            raise FileError(f"{what} leaves the mesh: no edge goes from vertex {i} to {j}.")
    if (min(loop[0], loop[-1]), max(loop[0], loop[-1])) not in edges:
        raise FileError(
            f"{what} is open: no edge goes from its last vertex {loop[-1]} to its first."
        )
    return np.array(loop)


def _patch(
    patch: tuple[int, ...] | Around, positions: np.ndarray, faces: np.ndarray, what: str
) -> np.ndarray:
    count = len(positions)
    if isinstance(patch, Around):
        if not 0 <= patch.vertex < count:
            raise FileError(f"{what} takes a vertex from 0 to {count - 1}.")
        edges, _ = edges_of(faces)
        length = np.linalg.norm(positions[edges[:, 0]] - positions[edges[:, 1]], axis=1)
        graph = csr_array((length, (edges[:, 0], edges[:, 1])), shape=(count, count))
        far = dijkstra(graph, directed=False, indices=patch.vertex, limit=patch.radius)
        return np.flatnonzero(np.isfinite(far))
    if not patch or not all(0 <= i < count for i in patch) or len(set(patch)) < len(patch):
        raise FileError(f"{what} takes vertices from 0 to {count - 1}, each once.")
    return np.array(patch)

"""Garments from files, and what is refused: one sentence that says what is wrong and where."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from sheets import run, sheet, simulator, tube
from worlds import little_memory

from understudy.command.cli import main
from understudy.errors import ConfigError, FileError
from understudy_cloth.garments import LARGEST, holes_of, read_garment
from understudy_cloth.mesh import face_areas
from understudy_cloth.scene import ClothModel

AROUND, ROWS = 12, 9
X, FACES = tube(AROUND, ROWS, 0.05)
#: The two ends by a vertex, and the ring in the middle.
LOOPS: dict[str, Any] = {
    "cuff": {"hole": 0},
    "entrance": {"hole": AROUND * ROWS - 1},
    "middle": list(range(4 * AROUND, 5 * AROUND)),
}
Change = Callable[[np.ndarray, np.ndarray, dict[str, Any]], tuple[Any, Any, Any]]


def write(folder: Path, x: np.ndarray, faces: np.ndarray, naming: dict[str, Any] | str) -> Path:
    lines = ["# a sleeve", "mtllib ../elsewhere.mtl", "o sleeve"]
    lines += ["v " + " ".join(map(repr, map(float, p))) for p in x]
    lines += ["f " + " ".join(f"{i + 1}//{i + 1}" for i in f) for f in faces]
    (folder / "sleeve.obj").write_text("\n".join(lines) + "\n")
    path = folder / "sleeve.yaml"
    path.write_text(naming if isinstance(naming, str) else yaml.safe_dump(naming))
    return path


def naming(**changes: Any) -> dict[str, Any]:
    return {"mesh": "sleeve.obj", "loops": LOOPS, "up": "z", **changes}


def test_a_sleeve_is_read(tmp_path: Path) -> None:
    patches = {"grip": [0, 1, 2], "elbow": {"vertex": 50, "radius": 0.03}}
    path = write(tmp_path, X, FACES, naming(patches=patches, licence="CC0"))
    found = read_garment(path)
    assert found.name == "sleeve"
    assert found.licence == "CC0"
    assert np.allclose(found.positions, X)
    assert np.array_equal(found.faces, FACES)
    assert set(found.loops["cuff"].tolist()) == set(range(AROUND))
    assert found.loops["middle"].tolist() == LOOPS["middle"]
    chord = 2 * 0.05 * np.sin(np.pi / AROUND) * AROUND
    for loop in LOOPS:
        assert found.perimeter(loop) == pytest.approx(chord)
    assert found.patches["grip"].tolist() == [0, 1, 2]
    near = np.linalg.norm(X[found.patches["elbow"]] - X[50], axis=1)
    assert 4 < len(near) < 12
    assert near.max() < 0.03
    run(simulator(ClothModel(found.positions, found.faces, pinned=found.loops["cuff"])), 2)


def test_units_and_axes_are_turned_into_metres_z_up_facing_x(tmp_path: Path) -> None:
    """In the file y is up, the wearer looks along −z, its left is x, and all is in centimetres."""
    file = 100 * np.stack([-X[:, 1], X[:, 2], -X[:, 0]], axis=1)
    found = read_garment(write(tmp_path, file, FACES, naming(unit=0.01, up="y")))
    assert np.allclose(found.positions, X)


def test_quadrilaterals_and_relative_numbers(tmp_path: Path) -> None:
    path = write(tmp_path, X, FACES, naming())
    lines = [line for line in (tmp_path / "sleeve.obj").read_text().splitlines() if line[0] != "f"]
    for r in range(ROWS - 1):
        for k in range(AROUND):
            p, q = r * AROUND + k, r * AROUND + (k + 1) % AROUND
            quad = (p, q, q + AROUND, p + AROUND)
            lines.append("f " + " ".join(f"{i - len(X)}/1/2" for i in quad))
    (tmp_path / "sleeve.obj").write_text("\n".join(lines))
    found = read_garment(path)
    assert len(found.faces) == 2 * (ROWS - 1) * AROUND
    assert face_areas(X[found.faces]).sum() == pytest.approx(face_areas(X[FACES]).sum(), rel=0.05)


def appended(x: np.ndarray, *more: Any) -> np.ndarray:
    return np.concatenate([x, np.array(more, float).reshape(-1, 3)])


def another_piece(x: np.ndarray, f: np.ndarray, n: Any) -> Any:
    y, g = sheet(4, 4)
    return appended(x, y + 0.1), np.concatenate([f, g + len(x)]), n


def unmerged(x: np.ndarray, f: np.ndarray, n: Any) -> Any:
    """The seam of the tube doubled, as exporters leave it."""
    f = f.copy()
    seam = {i: len(x) + k for k, i in enumerate(range(0, len(x), AROUND))}
    last = (f % AROUND == AROUND - 1).any(axis=1)
    for i, j in seam.items():
        f[last] = np.where(f[last] == i, j, f[last])
    return appended(x, x[list(seam)]), f, n


def flipped(*which: int) -> Change:
    def change(x: np.ndarray, f: np.ndarray, n: Any) -> Any:
        f = f.copy()
        f[list(which)] = f[list(which)][:, ::-1]
        return x, f, n

    return change


def with_loop(loop: Any) -> Change:
    return lambda x, f, n: (x, f, {**n, "loops": {**LOOPS, "other": loop}})


def pinched(x: np.ndarray, f: np.ndarray, n: Any) -> Any:
    y = appended(x, x[40] + (0, 0.03, 0.05), x[40] + (0.03, 0.03, 0.05))
    return y, np.concatenate([f, [(40, len(x), len(x) + 1)]]), n


#: By kind: what is wrong with the sleeve, and what is said.
BAD: dict[str, tuple[Change, str]] = {
    "an edge of three triangles": (
        lambda x, f, n: (appended(x, x[40] * 2), np.concatenate([f, [(*f[40][:2], len(x))]]), n),
        "not manifold: 1 edge",
    ),
    "parts that touch in a point": (pinched, "not manifold: 1 vertex"),
    "a flipped face": (flipped(40), "face opposite ways"),
    "half the faces flipped": (flipped(*range(90)), "face opposite ways"),
    "all faces flipped": (flipped(*range(len(FACES))), "inside out"),
    "a face twice": (lambda x, f, n: (x, np.concatenate([f, f[7:8]]), n), "more than once"),
    "a face twice, begun elsewhere": (
        lambda x, f, n: (x, np.concatenate([f, np.roll(f[7:8], 1, axis=1)]), n), "more than once",
    ),
    "a face twice, flipped": (
        lambda x, f, n: (x, np.concatenate([f, f[7:8, ::-1]]), n), "more than once",
    ),
    "two pieces": (another_piece, "2 pieces"),
    "a seam that is not merged": (unmerged, "9 pairs of vertices in one place, the first 0"),
    "one vertex that is not merged": (
        lambda x, f, n: (np.vstack([x, x[:1]]), np.where((f == 0) & (np.cumsum(f == 0).reshape(f.shape) == 1), len(x), f), n),
        "1 pair of vertices in one place",
    ),
    "a face with a vertex twice": (
        lambda x, f, n: (x, np.concatenate([f, [(3, 3, 4)]]), n), "1 triangle without area",
    ),
    "a sliver": (
        lambda x, f, n: (
            appended(x, 0.5 * (x[0] + x[1]) + (1e-7, 0, 0)), np.concatenate([f, [(0, 1, len(x))]]), n,
        ), "without area",
    ),
    "a loop over a vertex of no face": (
        lambda x, f, n: with_loop([48, 49, len(x)])(appended(x, (0.1, 0.1, 0.1)), f, n), "leaves the mesh",
    ),
    "a patch with a vertex of no face": (
        lambda x, f, n: (appended(x, (0.1, 0.1, 0.1)), f, {**n, "patches": {"p": [0, len(x)]}}),
        "patch 'p' has vertex 108, which is in no triangle",
    ),
    "a patch around a vertex of no face": (
        lambda x, f, n: (appended(x, (0.1, 0.1, 0.1)), f, {**n, "patches": {"p": {"vertex": len(x), "radius": 0.1}}}),
        "patch 'p' has vertex 108, which is in no triangle",
    ),
    "centimetres": (lambda x, f, n: (100 * x, f, n), "centimetres, say unit: 0.01 "),
    "millimetres": (lambda x, f, n: (5000 * x, f, n), "millimetres, say unit: 0.001 "),
    "feet": (lambda x, f, n: (60 * x, f, n), "not metres, say unit: M"),
    "a doll's": (lambda x, f, n: (0.1 * x, f, n), "m across, and garments are"),
    "a wrong unit": (lambda x, f, n: (x, f, {**n, "unit": 0.01}), "m across, and garments are"),
    "not a number": (
        lambda x, f, n: (np.where(np.arange(len(x))[:, None] == 9, np.nan, x), f, n), "not finite",
    ),
    "infinite": (
        lambda x, f, n: (np.where(np.arange(len(x))[:, None] == 9, np.inf, x), f, n), "not finite",
    ),
    "a face beyond the vertices": (
        lambda x, f, n: (x, np.concatenate([f, [(3, 4, 500)]]), n), "do not exist",
    ),
    "a face of vertex 0": (
        lambda x, f, n: (x, np.concatenate([f, [(3, 4, -1)]]), n), "line 30[0-9]: 'f 4//4 5//5 0//0'",
    ),
    "no faces": (lambda x, f, n: (x, f[:0], n), "no faces"),
    "nothing": (lambda x, f, n: (x[:0], f[:0], n), "no vertices"),
    "a hole without a name": (
        lambda x, f, n: (x, f, {**n, "loops": {"cuff": {"hole": 0}}}),
        "a hole, 0.31 m round, that no loop of sleeve.yaml names: add one with hole: 96",
    ),
    "a small hole without a name": (lambda x, f, n: (x, np.delete(f, 90, axis=0), n), "a hole, 0.0"),
    "a border named in part": (
        lambda x, f, n: (x, f, {**n, "loops": {"cuff": {"hole": 0}, "other": LOOPS["middle"]}}),
        "that no loop",
    ),
    "an open loop": (with_loop(list(range(48, 58))), "open: no edge goes from its last vertex 57"),
    "a loop that crosses itself": (
        with_loop([48, 49, 50, 62, 61, 49, 37]), "crosses itself: it comes to vertex 49 twice",
    ),
    "a loop that closes twice": (with_loop([*LOOPS["middle"], 48]), "vertex 48 twice"),
    "a loop off the edges": (with_loop([48, 49, 75]), "leaves the mesh: no edge goes from vertex 49"),
    "a loop of two": (with_loop([48, 49]), "three vertices"),
    "a loop of nothing": (with_loop([]), "three vertices"),
    "a loop beyond": (with_loop([48, 49, 5000]), "from 0 to 107"),
    "a loop below": (with_loop([48, 49, -1]), "from 0 to 107"),
    "a hole where none is": (with_loop({"hole": 50}), "on no hole's border"),
    "a hole beyond": (with_loop({"hole": 5000}), "on no hole's border"),
    "a loop in words": (with_loop("cuff"), "loops.other"),
    "a loop of halves": (with_loop([48.5, 49, 50]), "loops.other"),
    "no loops": (lambda x, f, n: (x, f, {"mesh": "sleeve.obj"}), "loops is not set"),
    "an unknown key": (lambda x, f, n: (x, f, {**n, "lops": {}}), "no option 'lops'"),
    "no unit": (lambda x, f, n: (x, f, {**n, "unit": 0}), "unit=0"),
    "a unit that is no number": (lambda x, f, n: (x, f, {**n, "unit": float("nan")}), "unit=nan"),
    "another axis": (lambda x, f, n: (x, f, {**n, "up": "x"}), "up='x'"),
    "a patch beyond": (lambda x, f, n: (x, f, {**n, "patches": {"p": [1, 500]}}), "patch 'p'"),
    "a patch without vertices": (lambda x, f, n: (x, f, {**n, "patches": {"p": []}}), "patch 'p'"),
    "a patch around nothing": (
        lambda x, f, n: (x, f, {**n, "patches": {"p": {"vertex": 500, "radius": 0.1}}}), "patch 'p'",
    ),
    "a patch of no size": (
        lambda x, f, n: (x, f, {**n, "patches": {"p": {"vertex": 5, "radius": 0}}}), "radius=0",
    ),
    "a mesh elsewhere": (lambda x, f, n: (x, f, {**n, "mesh": "../sleeve.obj"}), "same folder"),
    "a mesh that is absolute": (lambda x, f, n: (x, f, {**n, "mesh": "/etc/passwd"}), "same folder"),
    "a mesh of no name": (lambda x, f, n: (x, f, {**n, "mesh": "a\0.obj"}), "same folder"),
    "loops without end": (
        lambda x, f, n: (x, f, {**n, "loops": {str(k): {"hole": 0} for k in range(101)}}), "at most 100",
    ),
    "a loop without a name": (
        lambda x, f, n: (x, f, {**n, "loops": {**n["loops"], "": {"hole": 0}}}), "without a name",
    ),
    "a patch without a name": (
        lambda x, f, n: (x, f, {**n, "patches": {"": [1]}}), "without a name",
    ),
    "patches without end": (
        lambda x, f, n: (x, f, {**n, "patches": {str(k): [1] for k in range(98)}}), "at most 100",
    ),
    "a mesh of another kind": (lambda x, f, n: (x, f, {**n, "mesh": "sleeve.yaml"}), "no OBJ"),
    "a mesh that is not there": (lambda x, f, n: (x, f, {**n, "mesh": "shirt.obj"}), "cannot be read"),
    "no YAML": (lambda x, f, n: (x, f, "mesh: ["), "no YAML"),
    "very deep YAML": (lambda x, f, n: (x, f, "[" * 5000), "more than 8 deep"),
    "a list": (lambda x, f, n: (x, f, "[1, 2]"), "names no garment"),
    "an empty file": (lambda x, f, n: (x, f, ""), "names no garment"),
    "aliases": (
        lambda x, f, n: (x, f, "mesh: s.obj\nloops: {a: &a [1, 2, 3], b: *a}"), "has aliases",
    ),
    "a name twice": (
        lambda x, f, n: (x, f, "mesh: s.obj\nloops:\n  a: [1, 2, 3]\n  a: {hole: 3}"),
        "'loops.a' is there twice, in line 4",
    ),
    "a vertex to the base 8": (
        lambda x, f, n: (x, f, "mesh: s.obj\nloops:\n  a: [1, 012, 3]"), "012 in line 3 is another number",
    ),
    "a unit to the base 60": (
        lambda x, f, n: (x, f, "mesh: s.obj\nunit: 1:30\nloops: {a: [1, 2, 3]}"), "1:30 in line 2 is another",
    ),
    "code": (lambda x, f, n: (x, f, "mesh: !!python/object/apply:os.getcwd []"), "no YAML"),
}  # fmt: skip


@pytest.mark.parametrize("kind", BAD)
def test_what_is_no_garment_is_refused_in_one_sentence(kind: str, tmp_path: Path) -> None:
    change, says = BAD[kind]
    path = write(tmp_path, *change(X, FACES, naming()))
    with pytest.raises(FileError, match=says) as refused:
        read_garment(path)
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 400 + len(str(tmp_path))


@pytest.mark.parametrize("line", ["v 1 2", "v 1 2 x", "f 1 2", "f 1 2 x", "f 1 2 -900"])
def test_a_line_that_is_none_is_named(line: str, tmp_path: Path) -> None:
    path = write(tmp_path, X, FACES, naming())
    with (tmp_path / "sleeve.obj").open("a") as file:
        file.write(line + "\n")
    number = 3 + len(X) + len(FACES) + 1
    with pytest.raises(FileError, match=f"line {number}: '{line}'"):
        read_garment(path)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "utf-32"])
def test_files_may_be_in_what_editors_save(encoding: str, tmp_path: Path) -> None:
    path = write(tmp_path, X, FACES, naming())
    for file in (path, tmp_path / "sleeve.obj"):
        text = file.read_text()
        file.write_bytes(
            text.partition("# a sleeve\n")[2].encode(encoding)
            if file != path
            else text.encode(encoding)
        )
    assert np.allclose(read_garment(path).positions, X)


@pytest.mark.parametrize("line", ["mtllib C:\\shirts\\", "usemtl red\\", "o C:\\sleeve\\"])
def test_a_path_that_ends_in_a_backslash_takes_no_vertex_along(line: str, tmp_path: Path) -> None:
    """All vertices would have the place of the next one, if there is one more than are used."""
    path = write(tmp_path, X, FACES, naming())
    mesh = tmp_path / "sleeve.obj"
    text = mesh.read_text()
    at = text.index("v ")
    mesh.write_text(f"{text[:at]}{line}\n{text[at:]}v 0 0 0\n")
    assert np.allclose(read_garment(path).positions, X)


def test_comments_behind_a_line_and_lines_that_go_on(tmp_path: Path) -> None:
    path = write(tmp_path, X, FACES, naming())
    mesh = tmp_path / "sleeve.obj"
    lines = [f"{line} # from {i}" for i, line in enumerate(mesh.read_text().splitlines(), 1)]
    joined = [line.replace(" ", " \\\n", 1) if line[0] in "vf" else line for line in lines]
    mesh.write_text("\n".join(joined))
    found = read_garment(path)
    assert np.array_equal(found.positions, X)
    assert np.array_equal(found.faces, FACES)
    mesh.write_text(mesh.read_text() + "\nf 1 \\\n 2")
    number = len(lines) + len(X) + len(FACES) + 1
    with pytest.raises(FileError, match=f"line {number}: 'f 1 +2' is no face"):
        read_garment(path)


def rewritten(folder: Path, faces: list[tuple[int, ...]], x: np.ndarray = X, **names: Any) -> Path:
    """A garment whose mesh has polygons of any number of corners."""
    path = write(folder, x, FACES, naming(**names))
    mesh = folder / "sleeve.obj"
    lines = [line for line in mesh.read_text().splitlines() if line[0] != "f"]
    lines += ["f " + " ".join(str(i + 1) for i in face) for face in faces]
    mesh.write_text("\n".join(lines))
    return path


def test_a_face_of_too_many_vertices_says_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="triangulate faces when you export"):
        read_garment(rewritten(tmp_path, [tuple(range(33))]))


def outline(*corners: tuple[float, float]) -> np.ndarray:
    return np.array([(0.0, y, z) for y, z in corners])


#: Polygons, each alone a garment of one hole, counter-clockwise, in m, and whether its corners all point outwards.
POLYGONS = {
    "a pentagon": outline((0, 0), (0.5, 0), (0.7, 0.3), (0.3, 0.6), (-0.1, 0.3)),
    "a dart": outline((0, 0), (0.6, 0.4), (0, 0.8), (0.2, 0.4)),
    "an L": outline((0, 0), (0.6, 0), (0.6, 0.3), (0.3, 0.3), (0.3, 0.6), (0, 0.6)),
    "corners in a row": outline((0, 0), (0.3, 0), (0.6, 0), (0.6, 0.5), (0.3, 0.5), (0, 0.5)),
}


@pytest.mark.parametrize("begin", range(6))
@pytest.mark.parametrize("kind", POLYGONS)
def test_polygons_are_cut_within_their_outline(kind: str, begin: int, tmp_path: Path) -> None:
    x = np.roll(POLYGONS[kind], begin, axis=0)
    loops = {"edge": {"hole": 0}}
    found = read_garment(rewritten(tmp_path, [tuple(range(len(x)))], x, loops=loops))
    y, z = x[:, 1], x[:, 2]
    shoelace = 0.5 * float((y * np.roll(z, -1) - z * np.roll(y, -1)).sum())
    a, b, c = np.moveaxis(found.positions[found.faces], 1, 0)
    ahead = np.cross(b - a, c - a)[:, 0] / 2
    assert len(found.faces) == len(x) - 2
    assert ahead.min() > 0, "no triangle is turned over"
    assert ahead.sum() == pytest.approx(shoelace)


@pytest.mark.parametrize(
    "corners",
    [
        ((0, 0), (0.5, 0.5), (0.5, 0), (0, 0.5)),
        ((0, 0), (0.5, 0.5), (0.4, 0), (0, 0.5), (-0.3, 0.2)),
    ],
)
def test_a_face_that_crosses_itself_is_named(
    corners: tuple[tuple[float, float], ...], tmp_path: Path
) -> None:
    x = outline(*corners)
    with pytest.raises(FileError, match=r"line \d+: the face 'f 1 2 3 4.*' crosses"):
        read_garment(rewritten(tmp_path, [tuple(range(len(x)))], x, loops={"edge": {"hole": 0}}))


def test_triangles_that_are_said_with_a_corner_twice(tmp_path: Path) -> None:
    """Programs that know quadrilaterals alone, and those that close each face, write triangles so."""
    faces = FACES.tolist()
    for twice in (
        [f"{a} {b} {c} {c}" for a, b, c in faces],
        [f"{a} {b} {c} {a}" for a, b, c in faces],
    ):
        path = rewritten(tmp_path, [tuple(map(int, face.split())) for face in twice])
        assert np.array_equal(read_garment(path).faces, FACES)


def test_vertices_of_no_face_are_left_out_and_counted(tmp_path: Path) -> None:
    """Loops and patches count the mesh's vertices as its file has them."""
    x = np.insert(X, [0, 30, len(X)], [(0.0, 0.0, 9.0), X[3], X[4]], axis=0)
    kept = np.setdiff1d(np.arange(len(x)), [0, 31, len(x) - 1])
    loops = {
        "cuff": {"hole": int(kept[0])},
        "entrance": {"hole": int(kept[-1])},
        "middle": kept[LOOPS["middle"]].tolist(),
    }
    patches = {"grip": kept[[50, 51]].tolist(), "elbow": {"vertex": int(kept[50]), "radius": 0.03}}
    found = read_garment(write(tmp_path, x, kept[FACES], naming(loops=loops, patches=patches)))
    assert np.array_equal(found.positions, X)
    assert np.array_equal(found.faces, FACES)
    plain = read_garment(
        write(tmp_path, X, FACES, naming(patches={"elbow": {"vertex": 50, "radius": 0.03}}))
    )
    for name, loop in plain.loops.items():
        assert np.array_equal(found.loops[name], loop)
    assert found.patches["grip"].tolist() == [50, 51]
    assert np.array_equal(found.patches["elbow"], plain.patches["elbow"])


@pytest.mark.parametrize("written", ["1e-2", "1E-2", "+1e-02", "1.e-2", ".01"])
def test_a_unit_may_be_written_with_an_exponent(written: str, tmp_path: Path) -> None:
    path = write(tmp_path, 100 * X, FACES, naming())
    path.write_text(path.read_text() + f"unit: {written}\n")
    assert np.allclose(read_garment(path).positions, X)


def test_bytes_that_are_no_text_are_no_mesh(tmp_path: Path) -> None:
    path = write(tmp_path, X, FACES, naming())
    (tmp_path / "sleeve.obj").write_bytes(os.urandom(4096).replace(b"\n", b" "))
    with pytest.raises(FileError):
        read_garment(path)


def test_a_link_out_of_the_folder_is_not_followed(tmp_path: Path) -> None:
    inside = tmp_path / "inside"
    inside.mkdir()
    path = write(inside, X, FACES, naming())
    (inside / "sleeve.obj").rename(tmp_path / "sleeve.obj")
    (inside / "sleeve.obj").symlink_to(tmp_path / "sleeve.obj")
    with pytest.raises(FileError, match="same folder"):
        read_garment(path)


def test_a_mesh_that_is_too_fine_is_refused_before_it_is_looked_at(tmp_path: Path) -> None:
    x, faces = sheet(181, 181, LARGEST / 200)
    with pytest.raises(FileError, match="coarser"):
        read_garment(write(tmp_path, x, faces, naming()))


@pytest.mark.timeout(20)
@pytest.mark.parametrize("name", ["sleeve.yaml", "sleeve.obj"])
def test_a_pipe_is_not_waited_for(name: str, tmp_path: Path) -> None:
    path = write(tmp_path, X, FACES, naming())
    (tmp_path / name).unlink()
    os.mkfifo(tmp_path / name)
    with pytest.raises(FileError, match=f"{name} cannot be read"):
        read_garment(path)


def test_many_vertices_in_one_place_take_no_memory(tmp_path: Path) -> None:
    """They are some 200 million pairs."""
    x = appended(X, *np.zeros((20_000, 3)))
    more = np.arange(len(X), len(x) - 2)[:, None] + (0, 1, 2)
    path = write(tmp_path, x, np.concatenate([FACES, more]), naming())
    with (
        little_memory(),
        pytest.raises(
            FileError, match="199990000 pairs of vertices in one place, the first 108 and 109"
        ),
    ):
        read_garment(path)


@pytest.mark.parametrize("kind", ["an edge of three triangles", "a flipped face", "a face twice"])
def test_a_scenes_own_mesh_is_held_to_the_same(kind: str) -> None:
    x, faces, _ = BAD[kind][0](X, FACES, naming())
    with pytest.raises(ConfigError, match=BAD[kind][1]):
        simulator(ClothModel(x, faces))


def test_the_command_says_what_a_garment_holds(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write(tmp_path, X, FACES, naming(patches={"grip": [0, 1]}))
    assert main(["garment", "check", str(path)]) == 0
    said = capsys.readouterr().out
    assert "108 vertices, 192 triangles" in said
    assert "loop cuff: 12 vertices, 0.31 m" in said
    assert "patch grip: 2 vertices" in said


@pytest.mark.parametrize("kind", ["two pieces", "a hole without a name", "very deep YAML"])
def test_the_command_ends_with_2_and_one_line(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    change, _ = BAD[kind]
    path = write(tmp_path, *change(X, FACES, naming()))
    before = sorted(tmp_path.iterdir())
    assert main(["garment", "check", str(path)]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert len(said.err.strip().splitlines()) == 1
    assert sorted(tmp_path.iterdir()) == before


GOWN = Path(os.environ.get("UNDERSTUDY_DATA", "nowhere")) / "garments" / "hospitalgown_reduced.obj"
GOWN_LOOPS = {"outline": {"hole": 0}, "left_sleeve": {"hole": 293}, "right_sleeve": {"hole": 258}}


@pytest.fixture
def gown(tmp_path: Path) -> Path:
    if not GOWN.is_file():
        pytest.skip("no gown: UNDERSTUDY_DATA is not set, or has no garments")
    (tmp_path / "gown.obj").write_bytes(GOWN.read_bytes())
    path = tmp_path / "gown.yaml"
    patches = {"grip": {"vertex": 293, "radius": 0.05}}
    path.write_text(yaml.safe_dump({"mesh": "gown.obj", "loops": GOWN_LOOPS, "patches": patches}))
    return path


def test_a_gown_from_elsewhere(gown: Path) -> None:
    found = read_garment(gown)
    assert found.positions.shape == (3966, 3)
    assert found.faces.shape == (7673, 3)
    assert found.perimeter("left_sleeve") == pytest.approx(0.28, abs=0.01)
    left, right = (
        found.positions[found.loops[f"{side}_sleeve"]].mean(0) for side in ("left", "right")
    )
    assert abs(left[1] - right[1]) > 0.3
    assert np.ptp(found.positions[:, 2]) == pytest.approx(0.65, abs=0.01)
    assert len(holes_of(found.faces)) == 3


def test_the_gown_hangs_by_its_sleeve(gown: Path) -> None:
    found = read_garment(gown)
    model = ClothModel(found.positions, found.faces, pinned=found.patches["grip"])
    hung = simulator(model)
    x = run(hung, 15)
    assert not hung.failed().any()
    assert x[:, 2].min() < found.positions[:, 2].min() - 0.02

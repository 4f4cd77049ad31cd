"""A sleeve that a gripper holds along its top, and distances along it."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np
import torch

from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.task import Context
from understudy_cloth.scene import ClothModel, Fabric, Grip
from understudy_cloth.simulator import ClothSimulator
from understudy_cloth.weight import sub_steps_needed
from understudy_dressing.body import Side, tools
from understudy_dressing.garment import Alone, GarmentScene
from understudy_warp_torch.tools import Tool

#: The most vertices of a sleeve: as many as a shirt has.
_MOST = 10_000


def tube_faces(rows: int, around: int) -> np.ndarray:
    """(F, 3): triangles of a tube that is open at both ends, whose vertices come in rows of `around`."""
    r, k = (i.ravel() for i in np.meshgrid(np.arange(rows - 1), np.arange(around), indexing="ij"))
    p, q = r * around + k, r * around + (k + 1) % around
    s, t = p + around, q + around
    return np.stack([np.stack([p, s, q], 1), np.stack([q, s, t], 1)], 1).reshape(-1, 3)


class HangingScene(GarmentScene):
    """What hangs from a gripper, the last of the tools, which is at the origin where it is laid out."""

    @abstractmethod
    def hanging(self, bodies: tuple[Tool, ...]) -> ClothModel:
        """With the `bodies` that it meets, of which the last holds it."""

    def model(self) -> ClothModel:
        return self.hanging(tools())

    def settled(self, seconds: float = 1.0) -> np.ndarray:
        """(V, 3) m: as it hangs from a gripper at the origin after so many seconds (paper: 1), alone."""
        model, period = self.hanging((Tool(()),)), 0.01
        substeps = max(10, math.ceil(period * sub_steps_needed(model)))
        context = Context(
            seed=0, device=torch.device("cpu"), num_worlds=1, control_dt=period, substeps=substeps, scene=Alone(model),
        )  # fmt: skip
        options = ClothSimulator.Options(self_contact=False)
        simulator = ClothSimulator(options, context)
        closed = torch.zeros(1, simulator.control_size)
        closed[:, -1] = 1.0
        for _ in range(round(seconds / context.control_dt)):
            simulator.step(closed)
        if bool(simulator.failed().any()):
            raise ConfigError("The garment flies apart where it hangs: choose another fabric.")
        return simulator.read("cloth_position")[0].numpy().astype(np.float64)


class SleeveScene(HangingScene):
    """A tube of cloth along x, open at both ends, around the axis that lies its radius below the gripper;
    the person puts a hand in at x = 0. The gripper holds a strip along the top, as if it hung from a rail; and as
    much of the entrance as is asked for, which is then a stiff hoop that cannot be drawn over the shoulder."""

    @dataclass(frozen=True)
    class Options:
        around: float = 0.46  #: m, perimeter of the sleeve (the 2018 code's gown: 0.46)
        length: float = 0.30  #: m, length of the sleeve along the arm
        edge: float = 0.012  #: m, edge of a triangle, about
        #: m, from the entrance to the loop that is observed (facts of the shirt)
        middle: float = 0.06
        held: float = 20.0  #: degrees to either side of the top within which the entrance is held
        #: degrees to either side of the top within which the sleeve is held all along
        strip: float = 20.0
        #: fabric that the sleeve is made of; without bending the hinges cost nothing
        fabric: Fabric = field(default_factory=Fabric)

        def __post_init__(self) -> None:
            check_range(self, "around", "length", "edge", "middle", above=0, most=3)
            check_range(self, "held", "strip", least=0, most=180)
            check_range(self, "edge", most=min(self.around / 6, self.length / 4))
            check_range(self, "middle", most=self.length)
            if self.around * self.length / self.edge**2 > _MOST:
                raise ValueError(f"edge={self.edge} gives more than {_MOST} vertices: enlarge it.")

    def __init__(self, options: Options, context: Context | None = None) -> None:
        self.options = options
        self._count = max(6, round(options.around / options.edge))
        self._rows = max(4, 1 + round(options.length / options.edge))

    @cached_property
    def mesh(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Vertices (V, 3), triangles (F, 3) facing out, and the angle of each vertex from the top (V,) rad."""
        around, rows = self._count, self._rows
        angle = 2 * np.pi * np.arange(around) / around
        radius = self.options.around / (2 * np.pi)
        x, a = np.meshgrid(np.linspace(0, self.options.length, rows), angle, indexing="ij")
        points = np.stack([x, radius * np.sin(a), radius * (np.cos(a) - 1)], -1).reshape(-1, 3)
        faces = tube_faces(rows, around)
        apart = np.abs((a.ravel() + np.pi) % (2 * np.pi) - np.pi)
        return points, faces, apart

    @property
    def laid_out(self) -> np.ndarray:
        return self.mesh[0]

    @property
    def faces(self) -> np.ndarray:
        return self.mesh[1]

    @property
    def corners(self) -> np.ndarray:
        return self.mesh[0][self.mesh[1]]

    def sleeve(self, side: Side) -> Mapping[str, np.ndarray]:
        return self.loops

    @cached_property
    def loops(self) -> dict[str, np.ndarray]:
        """Vertices in order, turning so that by the right hand the thumb points into the sleeve."""
        along = self.options.middle / self.options.length * (self._rows - 1)
        rows = {"entrance": 0, "middle": max(1, round(along)), "end": self._rows - 1}
        ring = np.arange(self._count)[::-1]
        return {name: row * self._count + ring for name, row in rows.items()}

    def hanging(self, bodies: tuple[Tool, ...]) -> ClothModel:
        points, faces, apart = self.mesh
        first = np.arange(len(points)) < 2 * self._count
        held = (apart <= math.radians(self.options.strip) + 1e-9) | (
            first & (apart <= math.radians(self.options.held) + 1e-9)
        )
        grip = Grip(len(bodies) - 1, np.flatnonzero(held))
        return ClothModel(points, faces, self.options.fabric, tools=bodies, grips=(grip,))

    def settled(self, seconds: float = 1.0) -> np.ndarray:
        return _settled(type(self), self.options, seconds)


@lru_cache(maxsize=8)  # training and evaluation ask for it
def _settled(kind: type[SleeveScene], options: SleeveScene.Options, seconds: float) -> np.ndarray:
    """:meth:`SleeveScene.settled` of such a sleeve, not to be written to."""
    found = HangingScene.settled(kind(options), seconds)
    found.setflags(write=False)
    return found


@dataclass(frozen=True)
class Geodesic:
    """Distances on both sides of a mesh, joined at its open edges, to a loop on the inside. V vertices; side 0
    is the outside, 1 the inside."""

    distance: np.ndarray  #: (2, V), of the largest
    towards: np.ndarray  #: (2, V), the neighbour to which the distance falls most steeply


def geodesic(positions: np.ndarray, faces: np.ndarray, loop: np.ndarray) -> Geodesic:
    """By the heat method (potpourri3d) on the mesh's double cover.

    Raises
    ------
    ImportError
        if potpourri3d is not installed.
    """
    try:
        import potpourri3d
    except ImportError as error:
        raise ImportError(
            f"distances along a garment need potpourri3d ({error}): pip install 'understudy[dressing]'"
        ) from error
    count = len(positions)
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    unique, times = np.unique(edges, axis=0, return_counts=True)
    inner = np.arange(count) + count
    border = np.unique(unique[times == 1])
    inner[border] = border  # where the sides are one
    used, compact = np.unique(np.concatenate([np.arange(count), inner]), return_inverse=True)
    node = compact.reshape(2, count)
    cover = np.concatenate([node[0][faces], node[1][faces][:, ::-1]])
    points = np.concatenate([positions, positions])[used]
    solver = potpourri3d.MeshHeatMethodDistanceSolver(points, cover)
    found = np.asarray(solver.compute_distance_multisource(node[1][loop].tolist()))
    found = np.maximum(found - found[node[1][loop]].min(), 0.0)
    distance = found[node] / found.max()
    both = np.concatenate([unique, unique[:, ::-1]])
    length = np.linalg.norm(positions[both[:, 0]] - positions[both[:, 1]], axis=1)
    towards = np.tile(np.arange(count), (2, 1))
    for side in (0, 1):
        slope = (distance[side][both[:, 0]] - distance[side][both[:, 1]]) / length
        order = np.lexsort((-slope, both[:, 0]))
        vertex, first = np.unique(both[order, 0], return_index=True)
        towards[side, vertex] = both[order[first], 1]
    return Geodesic(distance, towards)

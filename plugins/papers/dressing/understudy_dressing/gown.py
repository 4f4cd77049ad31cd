"""A gown from a file, held at a patch beside one of its sleeves (section 8.3)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.task import Context
from understudy_cloth.garments import Garment, holes_of, read_garment
from understudy_cloth.mesh import edges_of
from understudy_cloth.scene import ClothModel, Fabric, Grip
from understudy_dressing.body import Side
from understudy_dressing.sleeve import HangingScene
from understudy_warp_torch.tools import Tool

#: m, the patch's radius: some 14 vertices of edges of 25 mm (2018 code).
_RADIUS = 0.03
#: Of the way from one sleeve's end to the other's, so much is to the wearer's side at least.
_BESIDE = 0.5


class GownScene(HangingScene):
    """A garment from a file, the open back towards the person, held at a patch above the entrance of one sleeve. One loop of
    each sleeve is its entrance, the loop that is observed, and its end, as the 2018 code's is."""

    @dataclass(frozen=True)
    class Options:
        file: str  #: YAML that names mesh and loops, among them ``left_sleeve`` and ``right_sleeve``, where the sleeves end
        side: Side = "right"  #: the arm that goes in, whose sleeve is held
        #: degrees by which the gown is turned about the vertical, until its wearer faces as the
        #: person does
        turn: float = 0.0
        #: m along the cloth from where the sleeve ends to the loop (assistive-gym's gown at a unit of 1.3: 0.46 m round there, as
        #: the 2018 code's loop)
        loop: float = 0.09
        grip: float = 0.0975  #: m along the cloth from the loop to the patch's middle (2018 code: 0.085 to 0.11)
        #: on which side of the loop: the ``sleeve``, towards where it ends, or the ``body``
        grip_on: Literal["sleeve", "body"] = "sleeve"
        fabric: Fabric = field(default_factory=Fabric)  #: fabric that the gown is made of

        def __post_init__(self) -> None:
            check_range(self, "turn", least=-360, most=360)
            check_range(self, "loop", "grip", above=0, most=1)

    def __init__(self, options: Options, context: Context | None = None) -> None:
        self.options = options
        path = Path(options.file)
        if context is not None:
            context.inputs.file(f"garment {path}", lambda: [path])
        self._garment: Garment = read_garment(path)
        self.held: Side | None = options.side
        self._borders = borders = [
            frozenset(hole.tolist()) for hole in holes_of(self._garment.faces)
        ]
        ends = set()
        for name in ("left_sleeve", "right_sleeve"):
            if name not in self._garment.loops:
                raise ConfigError(
                    f"scenes.cloth.file={path} names no loop '{name}': a gown has left_sleeve and right_sleeve, where its sleeves "
                    "end."
                )
            ends.add(frozenset(self._garment.loops[name].tolist()))
            if not ends <= set(borders):
                raise ConfigError(
                    f"scenes.cloth.file={path}: '{name}' is not the border of a hole, and a sleeve must end in one; name the border by hole: VERTEX."
                )
        if len(ends) < 2:
            raise ConfigError(
                f"scenes.cloth.file={path}: left_sleeve and right_sleeve are one loop; name where each ends."
            )
        one, other = (
            self._turned[self._garment.loops[f"{name}_sleeve"]].mean(axis=0)
            for name in ("left", "right")
        )
        away = one - other
        if abs(away[1]) < _BESIDE * np.linalg.norm(away):
            forward, left, up = (f"{abs(part):.2f}" for part in away)
            raise ConfigError(
                f"scenes.cloth.file={path}: the sleeves' ends are not to the left and right of the wearer, but {forward} m forward, {left} "
                f"to the side and {up} up from each other. Turn the garment about the vertical (scenes.cloth.turn), or correct `up` in that "
                "file."
            )

    @cached_property
    def _turned(self) -> np.ndarray:
        angle = np.radians(self.options.turn)
        turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])  # fmt: skip
        return self._garment.positions @ turn.T

    @cached_property
    def _x(self) -> np.ndarray:
        return self._turned - self._turned[self.patch_of(self._turned)].mean(axis=0)

    @property
    def laid_out(self) -> np.ndarray:
        return self._x

    @property
    def faces(self) -> np.ndarray:
        return self._garment.faces

    @property
    def corners(self) -> np.ndarray:
        return self._garment.positions[self._garment.faces]

    def _along(self, start: np.ndarray) -> np.ndarray:
        """(V,) m, along edges from the nearest of those vertices."""
        x, (edges, _) = self._garment.positions, edges_of(self.faces)
        length = np.linalg.norm(x[edges[:, 0]] - x[edges[:, 1]], axis=1)
        graph = csr_array((length, (edges[:, 0], edges[:, 1])), shape=(len(x),) * 2)
        return dijkstra(graph, directed=False, indices=start, min_only=True)

    def _end(self, side: Side, x: np.ndarray) -> np.ndarray:
        """The border of the sleeve that is on that side of the wearer, whatever the file calls it."""
        ends = [self._garment.loops[f"{name}_sleeve"] for name in ("left", "right")]
        return max(ends, key=lambda end: x[end, 1].mean() * (1 if side == "left" else -1))

    def _loop(self, side: Side, x: np.ndarray) -> np.ndarray:
        """The border of what is nearer to the sleeve's end than the loop, its end excepted."""
        end = self._end(side, x)
        near = self._along(end) <= self.options.loop
        found = [
            hole for hole in holes_of(self.faces[near[self.faces].all(axis=1)])
            if not np.isin(hole, end).all()
        ]  # fmt: skip
        if len(found) != 1 or frozenset(found[0].tolist()) in self._borders:
            raise ConfigError(
                f"scenes.cloth.loop={self.options.loop:g}: this far from the end of the {side} sleeve, "
                + ("the garment is no tube; give less." if found else "there is no ring of edges yet; give more.")
            )  # fmt: skip
        middle = x[found[0]].mean(axis=0)
        ring = x[found[0]] - middle
        area = np.cross(ring, np.roll(ring, -1, axis=0)).sum(axis=0)
        goes = x[end].mean(axis=0) - middle  # the way that the hand goes
        return found[0] if area @ goes > 0 else found[0][::-1].copy()

    def patch_of(self, x: np.ndarray) -> np.ndarray:
        """Vertices that the gripper holds, of the garment as it lies at `x` (V, 3) m."""
        loop = self._loop(self.options.side, x)
        inner, beyond = self._along(loop), self._along(self._end(self.options.side, x))
        away = np.abs(inner - self.options.grip)
        on_body = beyond > self.options.loop
        ring = np.flatnonzero((away < _RADIUS / 2) & (on_body == (self.options.grip_on == "body")))
        if not len(ring):
            raise ConfigError(
                f"scenes.cloth.grip={self.options.grip:g}: the garment has no cloth this far from the loop; give less."
            )
        top = ring[x[ring, 2].argmax()]
        return np.flatnonzero(self._along(np.array([top])) <= _RADIUS)

    def sleeve(self, side: Side) -> Mapping[str, np.ndarray]:
        loop = self._loop(side, self._x)
        return {"entrance": loop, "middle": loop, "end": loop}

    def hanging(self, bodies: tuple[Tool, ...]) -> ClothModel:
        grip = Grip(len(bodies) - 1, self.patch_of(self._x))
        return ClothModel(self._x, self.faces, self.options.fabric, tools=bodies, grips=(grip,))

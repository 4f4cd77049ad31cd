"""What is simulated: one garment, the kinematic bodies that it touches, and grips on it."""

from __future__ import annotations

import hashlib
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from understudy.options import check_range
from understudy.task import Scene
from understudy_warp_torch.tools import Box, Capsule, Grid, Shape, TaperedCapsule, Tool

__all__ = [
    "Box", "Capsule", "ClothModel", "ClothScene", "Fabric", "Grid", "Grip", "Shape", "TaperedCapsule", "Tool",
]  # fmt: skip


@dataclass(frozen=True)
class Fabric:
    """What a garment is made of, whatever the mesh. It is flat at rest."""

    density: float = 0.2  #: kg/m²; cotton jersey has 0.15 to 0.2
    stretch: float = 1e4  #: N/m, along edges; above some thousand the sub-steps limit, not this
    shear: float = 1e4  #: N/m, along edges that are the diagonal of a quadrilateral
    bending: float = 1e-5  #: N m, flexural rigidity; 5e-6 to 2e-5 is usual for shirts' cotton
    damping: float = 1.0  #: 1/s, drag of the air
    #: on itself; on a body the mean with the body's (0.5 of 1: the 2018 code)
    friction: float = 0.5
    thickness: float | None = None  #: m between layers; null: 0.9 of the mean edge
    gap: float = 0.003  #: m between the cloth's middle and a body's surface

    def __post_init__(self) -> None:
        check_range(self, "density", most=100)
        check_range(self, "stretch", "shear", most=1e8)
        check_range(self, "bending", most=1e5)
        check_range(self, "damping", most=1e4)
        check_range(self, "gap", most=0.05)
        check_range(self, "density", "stretch", "shear", above=0)
        check_range(self, "bending", "damping", "friction", "gap", least=0)
        check_range(self, "thickness", above=0, most=0.2)


@dataclass(frozen=True)
class Grip:
    """Vertices that a tool's frame holds rigidly while the grip is closed, from where they are when it
    closes. Of closed grips that share a vertex, the one that holds it keeps it."""

    tool: int  #: index of the tool
    vertices: Sequence[int] | np.ndarray


@dataclass(frozen=True)
class ClothModel:
    """Everything that the simulator needs to know of a scene: V vertices, F triangles."""

    positions: np.ndarray  #: (V, 3), m: where vertices are at first
    faces: np.ndarray  #: (F, 3), counter-clockwise seen from outside
    fabric: Fabric = field(default_factory=Fabric)
    #: The shape in which nothing pulls: (V, 3), or, of cut pieces, (F, 3, 2) of each triangle's corners,
    #: m. None: `positions`.
    rest: np.ndarray | None = None
    pinned: Sequence[int] | np.ndarray = ()  #: vertices that never move
    tools: tuple[Tool, ...] = ()  #: T bodies
    grips: tuple[Grip, ...] = ()  #: G
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)  #: m/s²


class ClothScene(Scene):
    """A scene with one garment. All N worlds have the same mesh and bodies."""

    recorded = ("cloth_position", "tool_position", "tool_orientation")
    #: m: how high the floor is that pictures have; None: there is none.
    floor: float | None = None
    #: What gives it shorter sub-steps, for messages.
    finer: str = "control.substeps or control.frequency; of a composite's member scene.steps.MEMBER"

    @abstractmethod
    def model(self) -> ClothModel:
        """The scene, the same at each call."""

    def draw(
        self, tracks: Mapping[str, np.ndarray], width: int = 960, height: int = 540
    ) -> Iterator[np.ndarray]:
        """The garment and the bodies that it meets."""
        from understudy_cloth.drawing import draw

        marks = self.marks(tracks)
        yield from draw(self.model(), tracks, width, height, self.azimuth, marks, self.floor)

    def marks(self, tracks: Mapping[str, np.ndarray]) -> Callable[[int, Any], None] | None:
        """What is told each frame's number and its MuJoCo scene, and adds shapes to the picture; or nothing."""
        return None

    def describe(self) -> dict[str, Any]:
        model = self.model()
        return {
            "vertices": len(model.positions),
            "triangles": len(model.faces),
            "tools": len(model.tools),
            "grips": len(model.grips),
        }

    def identity(self) -> Mapping[str, str]:
        """The garment's: which vertices its triangles have, and how long their sides are at rest, to 1 µm."""
        model = self.model()
        rest = np.asarray(model.positions if model.rest is None else model.rest, float)
        corners = rest[model.faces] if rest.ndim == 2 else rest
        sides = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        found = hashlib.sha256(np.ascontiguousarray(model.faces, "<i8").tobytes())
        found.update(np.rint(sides * 1e6).astype("<i8").tobytes())
        vertices, triangles = len(model.positions), len(model.faces)
        what = f"a garment of {vertices} vertices and {triangles} triangles"
        return {"cloth_position": f"{what} ({found.hexdigest()[:12]})"}

"""A jacket that hangs from a hand, before the other arm goes in."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import mujoco
import numpy as np

from understudy.options import check_range
from understudy.task import Context
from understudy_cloth.garments import Garment
from understudy_cloth.patterns import JACKET, jacket
from understudy_cloth.scene import ClothModel, Fabric, Grip
from understudy_dressing.body import TIP, tool_bodies, tools
from understudy_dressing.garment import CutGarment
from understudy_dressing.moves import Moves
from understudy_dressing.person import PersonScene, neutral_pose

#: 2018 code: rad, of the elbow of the hand that holds it; m, of the patch on the edge of the front from the right sleeve's
#: entrance.
_ELBOW, _FROM_ENTRANCE = 1.9, 0.145
#: m: the patch's radius; so far before the fingertip it is, and of the cut's depth so much, so that no cloth begins in the hand.
_RADIUS, _BEFORE, _FLAT = 0.05, 0.06, 0.5
#: s, until it hangs.
_HANGS = 2.0


class JacketScene(CutGarment):
    """A jacket of cut pieces, open in front, the size of the 2018 code's. One grip: the left hand's, on the edge of the
    front beside the right sleeve."""

    @dataclass(frozen=True)
    class Options:
        edge: float = 0.024  #: m, edge of a triangle, about (2018 code: 24 mm)
        fabric: Fabric = field(default_factory=Fabric)  #: fabric that the jacket is made of

        def __post_init__(self) -> None:
            check_range(self, "edge", least=0.015, most=0.03)

    def __init__(self, options: Options, context: Context | None = None) -> None:
        self.options = options

    @cached_property
    def garment(self) -> Garment:
        return jacket(replace(JACKET, edge=self.options.edge))

    @cached_property
    def pose(self) -> np.ndarray:
        """(22,) rad: neutral, but for the elbow of the hand that holds it."""
        person = PersonScene(PersonScene.Options())
        pose = neutral_pose(person).numpy()
        pose[[hinge.name for hinge in person.hinges].index("left_elbow")] = _ELBOW
        return pose

    @cached_property
    def patch(self) -> np.ndarray:
        """Vertices that the hand holds."""
        x, loops = self.garment.positions, self.garment.loops
        border = x[loops["border"]]
        entrance = x[loops["right_entrance"]]
        far = np.linalg.norm(border[:, None] - entrance, axis=2).min(axis=1)
        right = (border[:, 0] > 0) & (border[:, 1] < 0) & (border[:, 2] > entrance[:, 2].mean())
        middle = border[right][np.abs(far[right] - _FROM_ENTRANCE).argmin()]
        return np.flatnonzero((np.linalg.norm(x - middle, axis=1) < _RADIUS) & (x[:, 0] > 0))

    @cached_property
    def begins(self) -> np.ndarray:
        model = PersonScene(PersonScene.Options()).spec().compile()
        data = mujoco.MjData(model)
        data.qpos[: len(self.pose)] = self.pose
        mujoco.mj_kinematics(model, data)
        hand = model.body("left_hand").id
        tip = data.xpos[hand] + data.xmat[hand].reshape(3, 3) @ np.array(TIP)
        x = self.garment.positions * (_FLAT, 1.0, 1.0)
        tip[0] += _BEFORE
        return x + (tip - x[self.patch].mean(axis=0))

    def model(self) -> ClothModel:
        grip = Grip(tool_bodies().index("left_hand"), self.patch)
        return ClothModel(
            self.begins, self.faces, self.options.fabric, rest=self.corners, tools=tools(), grips=(grip,)
        )  # fmt: skip

    def hung(self) -> tuple[np.ndarray, np.ndarray]:
        """Pose (22,) rad and vertices (V, 3) m once it hangs still.

        Raises
        ------
        ConfigError
            if the cloth flies apart.
        """
        return _hung(type(self), self.options)


@lru_cache(maxsize=8)  # takes seconds, and training and evaluation ask for it
def _hung(kind: type[JacketScene], options: JacketScene.Options) -> tuple[np.ndarray, np.ndarray]:
    """:meth:`JacketScene.hung` of such a jacket, not to be written to."""
    scene = kind(options)
    moves = Moves(scene, scene.pose)
    moves.hold(_HANGS, closed=(True,))
    found = moves.found()
    for array in found:
        array.setflags(write=False)
    return found

"""A T-shirt on a person: how it hangs on the shoulders, and how a hand holds its hem."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np
from scipy.sparse import csr_array

from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.task import Context
from understudy_cloth.garments import Garment
from understudy_cloth.mesh import edges_of
from understudy_cloth.patterns import Shirt, t_shirt
from understudy_cloth.scene import ClothModel, Fabric, Grip
from understudy_dressing.body import Side, tool_bodies, tools
from understudy_dressing.garment import CutGarment
from understudy_dressing.moves import Moves, State
from understudy_dressing.person import PersonScene, depth_in, neutral_pose
from understudy_dressing.waypoints import DRESSED, HELD_AT, IN_SLEEVE, RAISED_AT, TUCKED_AT

#: How far the shirt is worn: on the shoulders; its hem held in front by the other hand; and this arm under it; and raised until
#: the hand is before the chin; or its hand in the sleeve's mouth; or the arm out in its sleeve.
Worn = Literal["on_shoulders", "held", "tucked", "raised", "in_sleeve", "dressed"]
#: m: so high is the neck's highest point of the pattern above the base of the neck, and so far the cloth from skin.
_NECK, _CLEAR = 0.115, 0.012
#: s: until the shirt hangs; a hand on its way; until it hangs again.
_SETTLES, _GOES, _HANGS = 0.8, 0.6, 0.4


class ShirtScene(CutGarment):
    """A T-shirt of cut pieces, the size of the 2018 code's. Grips: the right hand's on the right patch of the front
    hem, then the left hand's on the left one."""

    @dataclass(frozen=True)
    class Options:
        edge: float = 0.021  #: m, edge of a triangle, about (2018 code: 22 mm)
        collar: float = 0.20  #: m, width of the collar
        width: float = 0.64  #: m, width of the body laid flat, half the hem
        height: float = 0.76  #: m, height from the hem to the neck's highest point
        entrance: float = 0.265  #: m, width of a sleeve laid flat where it begins
        end: float = 0.245  #: m, width of a sleeve laid flat where it ends
        #: sub-steps of 10 ms in which it is put on, held and led before an episode; a task's own are `scene.steps.cloth`
        substeps: int = 10
        fabric: Fabric = field(default_factory=Fabric)  #: fabric that the shirt is made of

        def __post_init__(self) -> None:
            check_range(self, "edge", least=0.015, most=0.032)
            check_range(self, "collar", least=0.18, most=0.30)
            check_range(self, "width", least=0.56, most=0.90)
            check_range(self, "height", least=0.66, most=1.0)
            check_range(self, "entrance", "end", least=0.20, most=0.40)
            check_range(self, "substeps", least=1, most=200)

    def __init__(self, options: Options, context: Context | None = None) -> None:
        self.options = options

    @cached_property
    def garment(self) -> Garment:
        return _cut(self.options)

    @property
    def substeps(self) -> int:
        return self.options.substeps

    @property
    def collar(self) -> np.ndarray:
        """Vertices in order, turning so that the head goes through along the thumb."""
        return self.turned(self.garment.loops["collar"], (0.0, 0.0, 1.0))

    def hem(self, hand: Side) -> tuple[np.ndarray, np.ndarray]:
        """Vertices (P,) of the patch of the front hem that this hand grips, and the faces (F, 3) that have one of them."""
        patch = self.garment.patches[f"{hand}_hem"]
        return patch, self.faces[np.isin(self.faces, patch).any(axis=1)]

    @cached_property
    def begins(self) -> np.ndarray:
        """(V, 3) m: around the neutral person."""
        return _around_neutral(type(self), self.options)

    def _drawn_over(self, pose: np.ndarray) -> np.ndarray:
        """(V, 3) m: around the person in that pose (22,) rad, drawn over it as little as front and back have to be."""
        x = self.garment.positions.copy()
        x[:, 2] += _NECK - x[:, 2].max()
        front = np.sign(self.garment.positions[:, 0])
        depth = depth_in(PersonScene(PersonScene.Options()), pose)
        needed = np.zeros(len(x))
        for away in np.arange(0.0, 0.30, 0.005):
            at = np.column_stack([front * away, x[:, 1:]])
            needed[(depth(at, near=_CLEAR) > -_CLEAR) & (front != 0)] = away + 0.005
        edges, _ = edges_of(self.faces)
        both = np.concatenate([edges, edges[:, ::-1]])
        near = csr_array((np.ones(len(both)), both.T), shape=(len(x), len(x)))
        count = near.sum(axis=1)
        height = needed.copy()  # over the plane of the seams, as a membrane over obstacles
        for _ in range(400):
            height = np.maximum(needed, (near @ height) / count) * (front != 0)
        x[:, 0] = front * height
        return x

    def model(self) -> ClothModel:
        bodies = tool_bodies()
        grips = tuple(
            Grip(bodies.index(f"{side}_hand"), self.garment.patches[f"{side}_hem"])
            for side in HOLDERS
        )
        return ClothModel(
            self.begins, self.faces, self.options.fabric, rest=self.corners, tools=tools(), grips=grips
        )  # fmt: skip

    def settled(
        self,
        worn: Worn,
        side: Side,
        arm: tuple[float, ...] = IN_SLEEVE[0],
        other_dressed: bool = False,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Pose (22,) rad of the whole person and vertices (V, 3) m: the shirt, as it hangs after it was put on, a hand
        took its hem to the front, and the arm of `side` went under it, as far as `worn` says; `in_sleeve` it was put on
        with that arm bent like `arm` (8,) rad, `dressed` with it in its sleeve, as the other one is if `other_dressed`.

        Raises
        ------
        ConfigError
            if the cloth flies apart, or an arm goes through it in the end.
        """
        return _settled(type(self), self.options, worn, side, arm, other_dressed)


#: Which way of wearing it each begins from, and the places, m, that a hand goes to from there: the one that holds it, and then the
#: other one, up between body and hem, not around the hem.
_FROM: dict[Worn, tuple[Worn, tuple[tuple[float, float, float], ...]]] = {
    "held": ("on_shoulders", (HELD_AT,)),
    "tucked": ("held", TUCKED_AT),
    "raised": ("tucked", RAISED_AT),
}
#: Whose hand each grip is, in the model's order.
HOLDERS: tuple[Side, Side] = ("right", "left")


# both take a good part of a second, and every scene of such a shirt asks for them
@lru_cache(maxsize=8)
def _cut(o: ShirtScene.Options) -> Garment:
    """Of such a shirt, not to be written to."""
    return t_shirt(Shirt(
        edge=o.edge, neck=o.collar, width=o.width, height=o.height, entrance=o.entrance, end=o.end,
    ))  # fmt: skip


@lru_cache(maxsize=8)
def _around_neutral(kind: type[ShirtScene], options: ShirtScene.Options) -> np.ndarray:
    """:attr:`ShirtScene.begins` of such a shirt, not to be written to."""
    pose = neutral_pose(PersonScene(PersonScene.Options())).numpy()
    begins = kind(options)._drawn_over(pose)
    begins.setflags(write=False)
    return begins


# takes seconds, and training, evaluation and each stage of a sequence ask for it
@lru_cache(maxsize=16)
def _settled(
    kind: type[ShirtScene], options: ShirtScene.Options, worn: Worn, side: Side, arm: tuple[float, ...], other_dressed: bool
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """:meth:`ShirtScene.settled` of such a shirt, not to be written to."""
    holder: Side = "left" if side == "right" else "right"
    arms = {"in_sleeve": {side: arm}, "dressed": {side: DRESSED}}.get(worn, {})
    if other_dressed:
        arms = {**arms, holder: DRESSED}
    how: Worn = "held" if worn in ("in_sleeve", "dressed") else worn  # the arms apart
    moves = Moves(kind(options))
    moves.go_on(_put_on(kind, options, how, _holder(how, holder), tuple(sorted(arms.items()))))
    if how != "on_shoulders":
        moves.hold(_HANGS, _closed(holder))
    found = moves.found()
    for name in HOLDERS:
        if moves.through(name):
            raise ConfigError(
                f"A shirt of these sizes cannot be worn {worn}: the {name} arm goes through its cloth. Choose other sizes "
                "of scenes.cloth, more of its substeps, or begin elsewhere (initial_states.worn)."
            )
    for array in found:
        array.setflags(write=False)
    return found


# most ways to wear it go on from another one
@lru_cache(maxsize=16)
def _put_on(
    kind: type[ShirtScene], options: ShirtScene.Options, worn: Worn, holder: Side | None, arms: tuple[tuple[Side, tuple[float, ...]], ...]
) -> State:  # fmt: skip
    """Who wears such a shirt so far, with `arms` bent as it was put on, and its hem in that hand; not to be written to."""
    scene = kind(options)
    moves = Moves(scene)
    if worn == "on_shoulders":
        if arms:
            pose = moves.bent(dict(arms))
            moves = Moves(scene, pose, scene._drawn_over(pose))
        moves.hold(_SETTLES, closed=(False, False))
        return moves.state()
    assert holder is not None
    before, places = _FROM[worn]
    moves.go_on(_put_on(kind, options, before, _holder(before, holder), arms))
    mirrored = np.array([1.0, -1.0 if holder == "left" else 1.0, 1.0])
    hand = holder
    if worn == "held":
        moves.reach(hand, moves.patch(hand), _GOES, (False, False))
    else:
        hand = "left" if holder == "right" else "right"
    for place in places:
        moves.reach(hand, mirrored * place, _GOES, _closed(holder))
    return moves.state()


def _holder(worn: Worn, holder: Side) -> Side | None:
    """`holder`, if a hand holds what is worn so."""
    return None if worn == "on_shoulders" else holder


def _closed(holder: Side) -> tuple[bool, ...]:
    return tuple(name == holder for name in HOLDERS)

"""A T-shirt on a person: how it hangs on the shoulders, and how a hand holds its hem."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Literal

import mujoco
import numpy as np
import torch
from scipy.optimize import least_squares
from scipy.sparse import csr_array

from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.task import Context
from understudy_cloth.garments import Garment
from understudy_cloth.mesh import edges_of
from understudy_cloth.patterns import Shirt, t_shirt
from understudy_cloth.scene import ClothModel, Fabric, Grip
from understudy_cloth.simulator import ClothSimulator
from understudy_dressing.garment import Alone, CutGarment
from understudy_dressing.person import (
    TIP,
    PersonScene,
    Side,
    depth_in,
    limb,
    neutral_pose,
    tool_bodies,
    tools,
)
from understudy_dressing.state import pierces
from understudy_tensors import rotations

#: How far the shirt is worn: on the shoulders; its hem held in front by the other hand; and this arm under it; and raised until
#: the hand is before the chin; or its hand in the sleeve's mouth; or the arm out in its sleeve.
Worn = Literal["on_shoulders", "held", "tucked", "raised", "in_sleeve", "dressed"]
#: m: so high is the neck's highest point of the pattern above the base of the neck, and so far the cloth from skin.
_NECK, _CLEAR = 0.115, 0.012
#: m, of the right hand's mirror: where a hand holds the hem, and where the other goes under it: in front of the body, so
#: that no elbow is driven into the shirt's back.
_HELD_AT = (0.38, -0.02, -0.35)
_TUCKED_AT = ((0.20, 0.05, -0.66), (0.26, 0.03, -0.50), (0.29, 0.03, -0.40))
#: m, where fingertips go from there so that nothing tears: beyond the triangle of hand and shoulders; then the hand that holds
#: lowers the hem, and the other goes back to the chest and to its own shoulder.
_BEYOND_AT = ((0.31, 0.0, -0.27), (0.31, -0.01, -0.20))
_LOWERED_AT, _BACK_AT = (
    (0.36, -0.02, -0.45),
    ((0.22, 0.05, -0.14), (0.14, 0.14, -0.02), (0.11, 0.24, -0.04)),
)
_RAISED_AT = ((0.31, 0.0, -0.27), (0.31, -0.01, -0.20), (0.30, 0.0, -0.02), (0.28, 0.0, 0.12))
#: rad, from clavicle to wrist of the left arm: the elbow bent before the chest, the hand at its own shoulder, by a fifth of the
#: limb in a sleeve that is drawn over it. Straighter arms tear it as it settles, and so may finer cloth.
IN_SLEEVE = (
    (0.25, -0.12, 0.36, -0.87, 1.00, 2.61, -0.60, 0.60),
    (0.25, -0.25, 0.25, -0.77, 1.00, 2.72, -0.60, 0.60),
    (0.25, -0.24, 0.36, -0.91, 1.00, 2.73, -0.60, 0.60),
)
#: rad, the same of an arm that is out to its side, in its sleeve.
DRESSED = (0.0, 0.0, -1.2, 0.0, 0.0, 0.25, 0.0, 0.0)
#: m: so far do links stay apart that no joint connects, where there is room; it weighs so many times a fingertip's error.
_APART, _WEIGHT = 0.003, 3.0
#: s: until the shirt hangs; a hand on its way; until it hangs again.
_SETTLES, _GOES, _HANGS = 0.8, 0.6, 0.4
PERIOD = 0.01
TRUNK = 3  #: hinges, which come first: those of a pose that are the trunk's


class ShirtScene(CutGarment):
    """A T-shirt of cut pieces, the size of the 2018 code's. Grips: the right hand's on the right patch of the front
    hem, then the left hand's on the left one."""

    @dataclass(frozen=True)
    class Options:
        edge: float = 0.021  #: m, of triangles, about (2018 code: 22 mm)
        collar: float = 0.20  #: m, width of the collar
        width: float = 0.64  #: m, of the body laid flat, half the hem
        height: float = 0.76  #: m, from the hem to the neck's highest point
        entrance: float = 0.265  #: m, width of a sleeve laid flat where it begins
        end: float = 0.245  #: m, and where it ends
        #: sub-steps of 10 ms in which it is put on, held and led before an episode; a task's own are `scene.steps.cloth`
        substeps: int = 10
        fabric: Fabric = field(default_factory=Fabric)  #: what it is made of

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
            needed[(depth(at) > -_CLEAR) & (front != 0)] = away + 0.005
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
    scene = kind(options)
    moves = Moves(scene)
    holder: Side = "left" if side == "right" else "right"
    arms = {"in_sleeve": {side: arm}, "dressed": {side: DRESSED}}.get(worn, {})
    if other_dressed:
        arms = {**arms, holder: DRESSED}
    if arms:
        pose = moves.bent(arms)
        moves = Moves(scene, pose, scene._drawn_over(pose))
    moves.hold(_SETTLES, closed=(False, False))
    closed = tuple(name == holder for name in HOLDERS)
    mirrored = np.array([1.0, -1.0 if holder == "left" else 1.0, 1.0])
    if worn != "on_shoulders":
        moves.reach(holder, moves.patch(holder), _GOES, (False, False))
        moves.reach(holder, mirrored * _HELD_AT, _GOES, closed)
    if worn in ("tucked", "raised"):  # up between body and hem, not around the hem
        for place in _TUCKED_AT + (_RAISED_AT if worn == "raised" else ()):
            moves.reach(side, mirrored * place, _GOES, closed)
    if worn != "on_shoulders":
        moves.hold(_HANGS, closed)
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


class Moves:
    """One world of the garment on the CPU, `begins` (V, 3) m as it was put on, on a person that is led from `pose` (22,) rad,
    neutral unless given, and whose links keep apart as the subtasks' do: those that begin in each other would be thrown
    out by the first step."""

    def __init__(
        self, scene: CutGarment, pose: np.ndarray | None = None, begins: np.ndarray | None = None
    ) -> None:
        person = PersonScene(PersonScene.Options(self_collision=True))
        self._body = person.spec().compile()
        self._body.geom_margin[:] = _APART
        self._data = mujoco.MjData(self._body)
        self._neutral = neutral_pose(person).numpy().astype(float)
        self._pose = self._neutral.copy() if pose is None else pose.astype(float)
        self._ids = [self._body.body(name).id for name in tool_bodies()]
        self._garment = scene.garment
        model = scene.model()
        fabric = replace(model.fabric, damping=max(model.fabric.damping, 3.0))
        self._place(self._pose)
        at = tuple(
            replace(
                tool, position=tuple(self._data.xpos[i]), orientation=tuple(self._data.xquat[i])
            )
            for tool, i in zip(model.tools, self._ids, strict=True)
        )
        positions = model.positions if begins is None else begins
        alone = Alone(replace(model, positions=positions, fabric=fabric, tools=at))
        context = Context(
            seed=0, device=torch.device("cpu"), num_worlds=1, control_dt=PERIOD, substeps=scene.substeps, scene=alone,
        )  # fmt: skip
        self._cloth = ClothSimulator(ClothSimulator.Options(), context)

    def _place(self, pose: np.ndarray) -> None:
        self._data.qpos[:] = 0.0
        self._data.qpos[: len(pose)] = pose
        mujoco.mj_kinematics(self._body, self._data)

    def _step(self, pose: np.ndarray, closed: tuple[bool, ...]) -> None:
        self._place(pose)
        q = torch.tensor(self._data.xquat[self._ids], dtype=torch.float32)
        at = torch.tensor(self._data.xpos[self._ids], dtype=torch.float32)
        control = torch.cat([at, rotations.to_exponential_map(q)], dim=1).flatten()
        grips = torch.tensor(closed, dtype=torch.float32)
        self._cloth.step(torch.cat([control, grips])[None])

    def hold(self, seconds: float, closed: tuple[bool, ...]) -> None:
        for _ in range(round(seconds / PERIOD)):
            self._step(self._pose, closed)

    def patch(self, side: Side) -> np.ndarray:
        """(3,) m: the middle of a patch of the hem."""
        x = self._cloth.read("cloth_position")[0].double().numpy()
        return x[self._garment.patches[f"{side}_hem"]].mean(axis=0)

    def bones(self, side: Side) -> np.ndarray:
        """(6, 3) m, as :func:`limb`, of the arm of `side`."""
        return np.array([
            self._data.body(name).xpos + self._data.body(name).xmat.reshape(3, 3) @ np.array(at)
            for name, at in limb(side)
        ])  # fmt: skip

    def through(self, side: Side) -> bool:
        """Whether that arm goes through the cloth."""
        pose, x = self.found()
        self._place(pose)
        faces = torch.tensor(x[self._garment.faces])
        return bool(pierces(torch.tensor(self.bones(side))[None], faces[None]))

    def _arm(self, side: Side) -> list[int]:
        """Numbers of that arm's hinges, from the clavicle on."""
        return [i for i in range(len(self._pose)) if self._body.joint(i).name.startswith(side)]

    def bent(self, arms: Mapping[Side, tuple[float, ...]]) -> np.ndarray:
        """The pose (22,) rad with the hinges of these arms, given for the left one or their mirror image (8,) rad."""
        pose = self._pose.copy()
        for side, arm in arms.items():
            mine = self._arm(side)
            twists = np.array([self._body.joint(i).name.endswith("twist") for i in mine])
            pose[mine] = np.where(twists & (side == "right"), -np.array(arm), arm)
        return pose

    def reach(
        self, side: Side, target: np.ndarray, seconds: float, closed: tuple[bool, ...]
    ) -> None:
        """Leads the fingertip of that arm to a place, m, and the cloth with it."""
        begin, end = self._pose.copy(), self.reached(side, target)
        count = round(seconds / PERIOD)
        for k in range(count):
            share = (k + 1) / count
            self._step(begin + share * share * (3 - 2 * share) * (end - begin), closed)
        self._pose = end

    def reached(self, side: Side, target: np.ndarray, upright: bool = False) -> np.ndarray:
        """The pose (22,) rad whose fingertip of that arm is as near to a place, m, as can be; with the trunk as it is, or neutral
        where it is to be `upright`."""
        mine = self._arm(side)
        ranges = self._body.jnt_range[mine]
        free = ~self._body.jnt_limited[mine].astype(bool)
        low, high = (np.where(free, sign * 2.0, ranges[:, k]) for k, sign in enumerate((-1, 1)))
        hand = self._body.body(f"{side}_hand").id

        end = self._pose.copy()
        if upright:
            end[:TRUNK] = self._neutral[:TRUNK]

        def off(q: np.ndarray) -> np.ndarray:
            pose = end.copy()
            pose[mine] = q
            self._place(pose)
            tip = self._data.xpos[hand] + self._data.xmat[hand].reshape(3, 3) @ np.array(TIP)
            mujoco.mj_collision(self._body, self._data)
            near = sum(np.maximum(0.0, _APART - self._data.contact.dist).tolist())
            return np.concatenate(
                [tip - target, 0.01 * (q - self._neutral[mine]), [_WEIGHT * near]]
            )

        inside = np.clip(end[mine], low + 1e-3, high - 1e-3)
        end[mine] = least_squares(off, inside, bounds=(low, high), diff_step=1e-4).x
        return end

    def found(self) -> tuple[np.ndarray, np.ndarray]:
        if bool(self._cloth.failed().any()):
            raise ConfigError("The garment flies apart as it settles: choose another fabric.")
        return self._pose, self._cloth.read("cloth_position")[0].numpy().astype(np.float64)

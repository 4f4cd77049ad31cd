"""A garment on a person who is led through poses, simulated on the CPU."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import mujoco
import numpy as np
import torch
from scipy.optimize import least_squares

from understudy.errors import ConfigError
from understudy.task import Context
from understudy_cloth.simulator import ClothSimulator
from understudy_dressing.body import TIP, Side, limb, tool_bodies
from understudy_dressing.garment import Alone, CutGarment
from understudy_dressing.person import PersonScene, neutral_pose
from understudy_dressing.state import pierces
from understudy_tensors import rotations

PERIOD = 0.01  #: s, of a step
TRUNK = 3  #: hinges of the trunk, which come first in a pose
#: m: how far apart links stay that no joint connects, where there is room.
APART = 0.003
_WEIGHT = 3.0  #: of that, where a fingertip's error weighs 1
#: A person's pose and what its cloth remembers.
State = tuple[np.ndarray, Mapping[str, torch.Tensor]]


class Moves:
    """One world of the garment on the CPU, `begins` (V, 3) m as it was put on, on a person that is led from `pose` (22,) rad,
    neutral unless given, and whose links keep apart as the subtasks' do: those that begin in each other would be thrown
    out by the first step."""

    def __init__(
        self, scene: CutGarment, pose: np.ndarray | None = None, begins: np.ndarray | None = None
    ) -> None:
        person = PersonScene(PersonScene.Options(self_collision=True))
        self._body = person.spec().compile()
        self._body.geom_margin[:] = APART
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

    def state(self) -> State:
        """The pose (22,) rad and all of the cloth, a copy.

        Raises
        ------
        ConfigError
            if the cloth flies apart.
        """
        pose, _ = self.found()
        return pose.copy(), self._cloth.snapshot()

    def go_on(self, state: State) -> None:
        """Go on from there, as whoever came there would."""
        pose, cloth = state
        self._pose = pose.copy()
        self._place(self._pose)
        self._cloth.restore(cloth)

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
            near = sum(np.maximum(0.0, APART - self._data.contact.dist).tolist())
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

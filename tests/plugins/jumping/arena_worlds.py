"""An athlete in an arena, for tests of single parts."""

from __future__ import annotations

import mujoco
import torch
from torch import Tensor

from understudy.task import Context
from understudy_characters.scene import CharacterScene
from understudy_jumping.arena import Arena, ArenaOptions
from understudy_jumping.initial_states import obstacle_at


def arena_context(num_worlds: int = 1, **arena: object) -> Context:
    """A context with the jumper in an arena of these options."""
    context = Context(
        seed=0,
        device=torch.device("cpu"),
        num_worlds=num_worlds,
        control_dt=1 / 60,
        substeps=5,
        sections={"arena": Arena(ArenaOptions(**arena))},  # type: ignore[arg-type]
    )
    context.scene = CharacterScene(CharacterScene.Options("jumper"), context)
    return context


def fields_at(context: Context, qpos: Tensor, difficulty: float = 0.0) -> dict[str, Tensor]:
    """What an attempt reads, of the poses `qpos` (N, nq)."""
    scene, arena = context.scene, context.sections["arena"]
    assert isinstance(scene, CharacterScene)
    data = mujoco.MjData(scene.model)
    xpos, xmat = [], []
    for row in qpos.double().numpy():
        data.qpos[:] = row
        mujoco.mj_kinematics(scene.model, data)
        xpos.append(torch.from_numpy(data.geom_xpos.copy()))
        xmat.append(torch.from_numpy(data.geom_xmat.copy()))
    obstacle = obstacle_at(arena, torch.full((len(qpos),), difficulty))
    return {
        "geom_xpos": torch.stack(xpos).float(),
        "geom_xmat": torch.stack(xmat).float(),
        **{name: value for name, value in obstacle.items() if "/" not in name},
    }

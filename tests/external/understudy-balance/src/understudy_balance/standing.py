"""Episodes that begin standing."""

from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.interfaces import Context, InitialStates
from understudy.random import WorldStreams
from understudy_mujoco.scene import MujocoScene


class Standing(InitialStates):
    """The scene's default pose, with velocities up to `noise` m/s and rad/s."""

    @dataclass(frozen=True)
    class Options:
        noise: float = 0.1

    def __init__(self, options: Options, context: Context) -> None:
        model = (
            context.need_scene(MujocoScene, "initial_states 'balance.standing'").spec().compile()
        )
        self._qpos = torch.tensor(model.qpos0, dtype=torch.float32, device=context.device)
        self._num_velocities = int(model.nv)
        self._noise = options.noise
        self._num_worlds = context.num_worlds

    def sample(self, streams: WorldStreams) -> dict[str, Tensor]:
        velocity = self._noise * (2 * streams.uniform(self._num_velocities) - 1)
        return {"qpos": self._qpos.repeat(self._num_worlds, 1), "qvel": velocity}

"""Episodes that begin standing, with a push."""

from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.options import check_range
from understudy.random import WorldStreams
from understudy.task import Context, InitialStates
from understudy_characters.scene import CharacterScene


class Standing(InitialStates):
    """The character's zero pose, with random velocities that grow with the difficulty."""

    reads = ("difficulty",)

    @dataclass(frozen=True)
    class Options:
        push: float = 0.5  #: largest velocity of each degree of freedom, m/s or rad/s

        def __post_init__(self) -> None:
            check_range(self, "push", least=0)

    def __init__(self, options: Options, context: Context) -> None:
        model = context.need_scene(CharacterScene, "initial_states 'balance/standing'").model
        pose = torch.tensor(model.qpos0, dtype=torch.float32, device=context.device)
        self._qpos = pose.repeat(context.num_worlds, 1)
        self._nv, self._push = model.nv, options.push

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        push = self._push * fields["difficulty"].unsqueeze(1)
        return {"qpos": self._qpos, "qvel": push * (2 * streams.uniform(self._nv) - 1)}

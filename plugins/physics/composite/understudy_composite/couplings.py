"""What one member of a composite does to another."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import torch
from torch import Tensor

from understudy.errors import ConfigError, suggestion
from understudy.task import Context, Simulator
from understudy_mujoco.scene import MujocoScene
from understudy_tensors import rotations

__all__ = ["Coupling", "ToolsFollow"]


class Coupling(ABC):
    """Drives some controls of the member `target` from fields of the member `source`. Pure functions:
    nothing is kept."""

    source: str
    target: str
    #: Fields of the source that :meth:`control` and :meth:`state` take, by keyword.
    reads: tuple[str, ...]
    #: Columns of the target's control that it drives, C of them.
    columns: Sequence[int]
    #: State fields of the target that follow from the source, so that nobody else sets them.
    sets: tuple[str, ...] = ()

    @abstractmethod
    def control(self, *args: Any, **fields: Any) -> Tensor:
        """(N, C), before each of the target's steps."""

    def state(self, *args: Any, **fields: Any) -> Mapping[str, Tensor]:
        """The fields of ``sets``, each (N, …), where an episode begins."""
        return {}


class ToolsFollow(Coupling):
    """The tools of a scene of particles or cloth go where bodies of a MuJoCo scene go. Bodies feel nothing.

    A body that has moved is where its tool is at the end of the same step.
    """

    @dataclass(frozen=True)
    class Options:
        source: str  #: the member with the bodies
        target: str  #: the member with the tools
        bodies: tuple[str, ...]  #: the body that each tool follows, in the tools' order

    reads = ("xpos", "xquat")

    def __init__(
        self, options: Options, context: Context, simulators: Mapping[str, Simulator]
    ) -> None:
        self.source, self.target = options.source, options.target
        scene = context.scene.members[self.source] if context.scene else None
        if not isinstance(scene, MujocoScene):
            raise ConfigError(
                f"coupling 'composite/tools' takes bodies of a MuJoCo scene, and member '{self.source}' is a "
                f"{type(scene).__name__}."
            )
        model = scene.compiled(context)
        names = [model.body(i).name for i in range(model.nbody)]
        for name in options.bodies:
            if name not in names:
                raise ConfigError(
                    f"Member '{self.source}' has no body '{name}' for a tool to follow."
                    f"{suggestion(name, [n for n in names if n])}"
                )
        ids = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, n) for n in options.bodies]
        self._bodies = torch.tensor(ids, device=context.device)
        shape = simulators[self.target].fields.get("tool_position", (0, 3))
        self._lead = tuple(shape[:-1])  # a single tool has none
        tools = self._lead[0] if self._lead else 1
        if tools != len(ids):
            raise ConfigError(
                f"coupling 'composite/tools' names {len(ids)} bodies, and member '{self.target}' has {tools} "
                "tools: name one for each."
            )
        self.columns = range(6 * tools)
        self.sets = ("tool_position", "tool_orientation")

    def control(self, xpos: Tensor, xquat: Tensor) -> Tensor:
        at, turn = xpos[:, self._bodies], rotations.to_exponential_map(xquat[:, self._bodies])
        return torch.cat([at, turn], dim=2).flatten(1)

    def state(self, xpos: Tensor, xquat: Tensor) -> Mapping[str, Tensor]:
        n = len(xpos)
        return {
            "tool_position": xpos[:, self._bodies].view(n, *self._lead, 3),
            "tool_orientation": xquat[:, self._bodies].view(n, *self._lead, 4),
        }

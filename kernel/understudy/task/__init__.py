"""What a task consists of: the interfaces of its parts, and what these are given.

Shapes: N worlds, T steps, D observation size, A action size, U control size. All tensors of a task
are on one device, and float32 unless noted otherwise. Interfaces are abstract, implementations
final: to change a part, wrap or replace it.

A component's class takes ``(options, context)``: an instance of its nested ``Options`` dataclass
and the :class:`Context` of what is being built. Terms (rewards, terminations, measures) are plain
functions: their positional parameters name the state fields that they read (those with a default,
only if the task has them), and their keyword-only parameters are options.
"""

from understudy.task.actions import ActionSpace, Box, Choice, box
from understudy.task.base import Context, Shape, State
from understudy.task.parts import Actuation, Curriculum, Encoder, Fields, InitialStates, Memory
from understudy.task.physics import Scene, Simulator
from understudy.task.rollout import Rollout

__all__ = [
    "ActionSpace",
    "Actuation",
    "Box",
    "Choice",
    "Context",
    "Curriculum",
    "Encoder",
    "Fields",
    "InitialStates",
    "Memory",
    "Rollout",
    "Scene",
    "Shape",
    "Simulator",
    "State",
    "box",
]

"""What every part is given: the context of the task that it is built for."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeVar

from understudy.errors import ConfigError
from understudy.inputs import Inputs

if TYPE_CHECKING:
    import torch

    from understudy.running.promises import Parts
    from understudy.setup.config import Chosen
    from understudy.setup.registry import Registry
    from understudy.task.actions import ActionSpace
    from understudy.task.physics import Scene, Simulator

State = Mapping[str, Any]
"""What ``state_dict`` returns: nested mappings of tensors, numbers, strings and lists thereof."""

Shape = tuple[int, ...]
"""A field's shape without its leading N: () for one number a world, (3,) for a vector."""

T = TypeVar("T")


@dataclass
class Context:
    """What a component can know about the task that it is built for.

    It is filled in the order of building: sections, scene, simulator, then everything else. The
    action space, ``observation_shapes`` and ``parts`` are known when policy and learner are built.
    """

    seed: int
    device: torch.device
    num_worlds: int
    control_dt: float  #: seconds of one control period
    substeps: int  #: physics steps of one control period
    decision: int = 1  #: control periods of one decision, unless a curriculum says otherwise
    difficulty: float = 1.0  #: in [0, 1]: of evaluations, and what trainings lead to
    evaluating: bool = False  #: whether this is an evaluation's environment
    #: The task's own ``substeps``: trainings may begin with fewer, and results are tried with more.
    own_substeps: int | None = None
    registry: Registry | None = None  #: for parts that are made of other runs' parts
    sections: Mapping[str, Any] = field(default_factory=dict)
    #: What the configuration chooses, by slot; for the slots of plugins.
    chosen: Mapping[str, tuple[Chosen, ...]] = field(default_factory=dict)
    inputs: Inputs = field(default_factory=Inputs)  #: through which parts read files
    scene: Scene | None = None
    simulator: Simulator | None = None
    action_space: ActionSpace | None = None
    observation_shapes: Mapping[str, Shape] = field(default_factory=dict)
    parts: Parts | None = None  #: of the task, for learners that evaluate its terms themselves

    _shared: dict[str, Any] = field(default_factory=dict, repr=False)

    @property
    def action_size(self) -> int:
        """A, the number of columns of an action."""
        return self.action_space.size if self.action_space is not None else 0

    def once(self, key: str, build: Callable[[], T]) -> T:
        """The object `key` that several parts share; the first to ask builds it."""
        if key not in self._shared:
            self._shared[key] = build()
        return self._shared[key]

    def need_scene(self, kind: type[T], who: str) -> T:
        """The scene, or its one member, that is a `kind`; else a ConfigError that `who` needs it."""
        scenes = [self.scene, *(self.scene.members.values() if self.scene else ())]
        if len(found := [scene for scene in scenes if isinstance(scene, kind)]) != 1:
            have = ", ".join(type(s).__name__ for s in found or scenes if s) or "no scene"
            raise ConfigError(
                f"{who} needs {'one' if found else 'a'} scene of type {kind.__name__}, but the task has "
                f"{have}. Choose a scene and a simulator that belong together (scene=…, simulator=…)."
            )
        return found[0]

    def need_section(self, name: str, kind: type[T], who: str) -> T:
        """The object built from the section `name`; else a ConfigError that `who` needs it."""
        if not isinstance(value := self.sections.get(name), kind):
            raise ConfigError(
                f"{who} needs the config section '{name}', which this task does not set. "
                f"Add it (for example {name}.name=…) or choose another part."
            )
        return value

"""A scene of several scenes, and how fast each of them runs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from understudy.errors import ConfigError, suggestion
from understudy.task import Context, Scene

#: The most steps that a member makes while the composite makes one.
_STEPS = 1000


class CompositeScene(Scene):
    """The scenes that ``scenes`` names, in that order. Parts that need a scene of a certain type find it
    among them.

    A step of physics of the task (``control.substeps``) is one in which all members move on, one after
    the other; each divides it into `steps` of its own.
    """

    @dataclass(frozen=True)
    class Options:
        #: By member: how many steps of its own it makes in one of the task's; 1 where it is not named.
        steps: dict[str, int] = field(default_factory=dict)
        shown: str | None = None  #: the member that is drawn; null is the first

        def __post_init__(self) -> None:
            for name in self.steps:
                if not 1 <= self.steps[name] <= _STEPS:
                    raise ValueError(
                        f"steps.{name}={self.steps[name]} is not possible: give 1 to {_STEPS}."
                    )

    def __init__(self, options: Options, context: Context) -> None:
        chosen = context.chosen.get("scenes", ())
        if not chosen:
            raise ConfigError(
                "scene 'composite' has no members. Name them: scenes={MEMBER: {name: SCENE, …}, …}."
            )
        names = [one.name for one in chosen]
        for one in chosen:
            if isinstance(one.options, CompositeScene.Options):
                raise ConfigError(
                    f"scenes.{one.name} is a composite within the composite: name all members in scenes themselves."
                )
        for name in (*options.steps, *([options.shown] if options.shown else ())):
            if name not in names:
                raise ConfigError(
                    f"scene 'composite' has no member '{name}'.{suggestion(name, names)}"
                )
        self._steps = {name: options.steps.get(name, 1) for name in names}
        self.members = {one.name: one.build(self.context(context, one.name)) for one in chosen}
        self._shown = self.members[options.shown or names[0]]
        recorded = (name for scene in self.members.values() for name in scene.recorded)
        self.recorded = tuple(dict.fromkeys(recorded))

    def context(self, context: Context, member: str) -> Context:
        """What a `member` knows of the task: its scene, and the task's step of physics as a control
        period of its own steps."""
        steps = self._steps[member]
        own = context.own_substeps
        return replace(
            context,
            control_dt=context.control_dt / context.substeps,
            substeps=steps,
            own_substeps=None if own is None else max(1, round(steps * own / context.substeps)),
            scene=getattr(self, "members", {}).get(member),
            simulator=None,
        )

    def describe(self) -> dict[str, Any]:
        return {
            name: {**scene.describe(), "steps": self._steps[name]}
            for name, scene in self.members.items()
        }

    def identity(self) -> Mapping[str, str]:
        return {k: v for scene in self.members.values() for k, v in scene.identity().items()}

    def draw(
        self, tracks: Mapping[str, np.ndarray], width: int = 640, height: int = 360
    ) -> Iterator[np.ndarray]:
        self._shown.azimuth = self.azimuth
        yield from self._shown.draw(tracks, width, height)

    def outlines(
        self, tracks: Mapping[str, np.ndarray]
    ) -> tuple[np.ndarray | None, np.ndarray | None]:
        return self._shown.outlines(tracks)

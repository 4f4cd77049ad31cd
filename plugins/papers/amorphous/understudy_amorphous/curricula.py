"""The clusters curriculum, and episodes of different lengths."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.random import WorldStreams
from understudy.task import Context, Curriculum, Rollout, Shape, State
from understudy_amorphous.scene import AmorphousScene
from understudy_curricula.episodes import Judged, number_in


@dataclass(frozen=True)
class Between:
    """Seconds after which a training episode is cut, drawn evenly between these for each one. Worlds then
    do not all begin at once, and a short rollout of many worlds has all phases of an episode."""

    least: float  #: s, above 0: length of the shortest
    most: float  #: s, at least `least`: length of the longest

    def __post_init__(self) -> None:
        check_range(self, "least", above=0)
        check_range(self, "most", least=self.least)

    def draw(self, streams: WorldStreams) -> Tensor:
        """(N,) s"""
        return self.least + (self.most - self.least) * streams.uniform(1).squeeze(1)


class Lengths(Curriculum):
    """Episodes of different lengths, and nothing that changes. Evaluations have their own length."""

    provides: Mapping[str, Shape] = {"episode_limit": ()}

    @dataclass(frozen=True)
    class Options:
        seconds: Between  #: s, how long training episodes are

    def __init__(self, options: Options, context: Context) -> None:
        self.options = options

    def begin(self, streams: WorldStreams) -> dict[str, Tensor]:
        return {"episode_limit": self.options.seconds.draw(streams)}

    def update(self, rollout: Rollout) -> dict[str, float]:
        return {}

    def stage(self) -> str:
        return ""

    def state_dict(self) -> State:
        return {}

    def load_state_dict(self, state: State) -> None:
        pass


class Clusters(Curriculum):
    """How many clusters episodes begin with, from ``start`` to ``most`` (section 4.1).

    Episodes that end are judged together, ``episodes`` or more at a time, by their mean return, or by
    the share of them whose last decision began with the farthest particle ``within`` (m) of the goal.
    Where that reaches ``threshold``, there is one cluster more, and then only episodes that began with it
    count. The paper judges single rollouts by a total reward that it does not give; of thousands of
    worlds, a lucky one would always be above it. An evaluation has ``most`` clusters.
    """

    provides: Mapping[str, Shape] = {"clusters": (), "episode_limit": ()}
    rollout_fields = ("farthest_distance", "clusters")

    @dataclass(frozen=True)
    class Options:
        seconds: Between  #: s, how long training episodes are
        start: int = 1  #: how many clusters there are at first, from 1
        #: how many clusters there are in the end (section 4.1 has 4); at most ``scene.blocks``
        most: int = 4
        #: what is judged: the share of episodes that end near the goal, or the mean return
        by: Literal["distance", "return"] = "distance"
        #: share of episodes, or mean return, from which on there is one cluster more
        threshold: float = 0.5
        #: m, greatest distance from the goal that counts as near; Table 3 reports 1.06 m on average
        within: float = 1.5
        episodes: int = 256  #: how many ended episodes are judged together at least

        def __post_init__(self) -> None:
            check_range(self, "start", "most", "episodes", least=1)
            check_range(self, "within", above=0, most=1e3)
            if self.most < self.start:
                raise ValueError(f"most={self.most} is not possible: start is {self.start}.")

    def __init__(self, options: Options, context: Context) -> None:
        self.options = options
        scene = context.need_scene(AmorphousScene, "curriculum 'amorphous/clusters'")
        if options.most > scene.options.blocks:
            raise ConfigError(
                f"curriculum.most={options.most} is not possible: there are {scene.options.blocks} "
                f"clusters (scene.blocks). Give curriculum.most={scene.options.blocks}, or more blocks."
            )
        self._on_device = torch.zeros(context.num_worlds, device=context.device)
        self._judged = Judged(options.episodes, options.by, options.threshold)
        self._move(options.most if context.evaluating else options.start)

    def _move(self, clusters: int) -> None:
        self.clusters = clusters
        self._on_device.fill_(clusters)

    def begin(self, streams: WorldStreams) -> dict[str, Tensor]:
        return {
            "clusters": self._on_device, "episode_limit": self.options.seconds.draw(streams)
        }  # fmt: skip

    def update(self, rollout: Rollout) -> dict[str, float]:
        options = self.options
        of_this_stage = rollout.fields["clusters"] == self.clusters
        ended = rollout.ended & of_this_stage
        near = (rollout.fields["farthest_distance"] <= options.within).float()
        score = near if options.by == "distance" else rollout.episode_returns
        metrics, passed = self._judged.digest(ended, score)
        found: dict[str, float] = {"clusters": self.clusters, **metrics}
        if passed and self.clusters < options.most:
            self._move(self.clusters + 1)
            found |= {"clusters": self.clusters, f"mark/{self.stage()}": 1.0}
        return found

    def stage(self) -> str:
        return f"{self.clusters} cluster{'s' if self.clusters > 1 else ''}"

    def state_dict(self) -> State:
        return {"clusters": self.clusters, **self._judged.state_dict()}

    def load_state_dict(self, state: State) -> None:
        self._judged.load_state_dict(state)
        self._move(min(number_in(state, "clusters", least=1), self.options.most))

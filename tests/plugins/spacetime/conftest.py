"""The humanoid and its generated walk, as parts of a task see them."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch

from understudy.inputs import Inputs
from understudy.setup.plugins import Plugins
from understudy.task import Context, Rollout, box
from understudy_characters.scene import CharacterScene
from understudy_motion.section import Motion, MotionOptions

MakeContext = Callable[[], Context]


@pytest.fixture(scope="session")
def make_context(plugins: Plugins) -> MakeContext:
    """Makes the context of a walking task of 28 actions, 16 worlds; scene and clip are shared."""
    scene = CharacterScene(CharacterScene.Options("humanoid"))
    motion = Motion(MotionOptions(), plugins.registry, Inputs())

    def make() -> Context:
        return Context(
            seed=3,
            device=torch.device("cpu"),
            num_worlds=16,
            control_dt=1 / 30,
            substeps=20,
            sections={"motion": motion},
            scene=scene,
            action_space=box(28),
            observation_shapes={"state": (5,), "feedforward": (28,)},
        )

    return make


@pytest.fixture
def context(make_context: MakeContext) -> Context:
    return make_context()


def rollout_of(fields: dict[str, torch.Tensor], returns: torch.Tensor) -> Rollout:
    """A rollout with these fields (T, N, …) and returns (T, N), and nothing else of interest."""
    none = torch.zeros_like(returns)
    return Rollout(
        observations={},
        last_observations={},
        actions=none,
        log_probs=none,
        rewards=none,
        terminated=none.bool(),
        truncated=none.bool(),
        failed=none.bool(),
        episode_returns=none,
        final_values=none,
        fields=fields,
        values=none,
        returns=returns,
    )


@pytest.fixture
def make_rollout() -> Callable[[dict[str, torch.Tensor], torch.Tensor], Rollout]:
    return rollout_of

"""A gripper beside a person whose policy is frozen, and how figure 9 is read."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from understudy.command.cli import main
from understudy.errors import ConfigError
from understudy.running.environment import Environment
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy_dressing.terms import on_the_way

pytest.importorskip("potpourri3d", reason="potpourri3d is not installed")
#: A coarse sleeve on a CPU.
SMALL = ["device=cpu", "simulators.person.name=mujoco", "num_worlds=2", "scene.steps.cloth=3",
         "scenes.cloth.edge=0.06", "simulators.cloth.self_contact=false"]  # fmt: skip


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("person") / "run"
    given = ["experiment=dressing/sleeve", *SMALL, "learner.rollout_steps=2", "learner.minibatches=1",
             "learner.epochs=1", "budget.samples=4", "evaluation.final_episodes=1", "evaluation.episodes=1",
             "evaluation.seconds=0.2", "run.video_seconds=0"]  # fmt: skip
    assert main(["train", *given, f"run.dir={folder}"]) == 0
    return folder


@pytest.fixture(scope="module")
def environment(run: Path) -> Iterator[Environment]:
    given = ["experiment=dressing/gripper", f"actuation.run={run}", *SMALL]
    built = build_environment(load_experiment(given))
    yield built.environment
    built.environment.close()


def test_it_goes_where_it_is_driven_and_the_sleeve_with_it(environment: Environment) -> None:
    environment.reset(seed=1)
    assert environment.action_size == 6
    table = environment.table
    assert environment.observation_shapes["state"] == (78,)
    before, cloth = table["qpos"].clone(), table["cloth_position"].mean(1).clone()
    assert (table["qvel"][:, -6:] == 0).all(), "it begins at rest"
    action = torch.tensor([[-1.0, 0, 0, 0, 0, 0], [0, 1.0, 0, 0, 0, 0.2]])
    for _ in range(6):
        environment.advance(action)
    moved = table["qpos"][:, -6:] - before[:, -6:]
    # 2 N on 1 kg for 0.3 s, damped by 1 N s/m: 8 cm
    assert moved[0, 0] == pytest.approx(-0.08, abs=0.01)
    assert moved[1, 1] == pytest.approx(0.08, abs=0.01)
    assert moved[0, 1:].abs().max() < 1e-3
    assert moved[1, 5] > 0.05, "it turns"
    follows = table["cloth_position"].mean(1) - cloth
    assert follows[0, 0] < -0.04
    assert follows[1, 1] > 0.04


def test_the_person_acts_as_its_policy_decides(environment: Environment) -> None:
    environment.reset(seed=2)
    first = environment.table["qpos"].clone()
    environment.advance(torch.zeros(2, 6))
    own = environment.table["person_action"]
    assert own.shape == (2, 22)
    assert own.abs().max() > 0
    assert (environment.table["qpos"][:, :22] - first[:, :22]).abs().max() > 1e-5
    assert (environment.table["person_age"] == 5).all(), (
        "one decision of its own in one of the gripper's"
    )


def test_a_gripper_that_is_not_driven_is_refused(run: Path) -> None:
    given = [
        "experiment=dressing/gripper",
        f"actuation.run={run}",
        *SMALL,
        "scenes.person.driven=false",
    ]
    with pytest.raises(ConfigError, match="driven=true"):
        build_environment(load_experiment(given))


def test_decisions_on_the_way_end_where_enough_was_reached_first() -> None:
    most = torch.tensor([-0.2, 0.5, 0.76, 0.76])  # and less again
    assert on_the_way(most).tolist() == [1, 1, 0, 0]
    assert on_the_way(most, enough=0.5).tolist() == [1, 0, 0, 0]

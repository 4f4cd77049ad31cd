"""The walk within spacetime bounds, for characters that the plugin has never heard of."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import pytest
import torch
from robots import robot_file

from understudy.errors import ConfigError
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import Plugins
from understudy.testing import check_environment
from understudy_characters.character import load_character
from understudy_motion.clip import Clip
from understudy_motion.writing import write_clip
from understudy_networks.nn import DiagonalGaussian
from understudy_reinforcement.evaluator import Evaluator
from understudy_reinforcement.policy import Policy
from understudy_retarget.retarget import retarget

WALK = ("experiment=spacetime/walk", "num_worlds=4")


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory, plugins: Plugins) -> tuple[str, ...]:
    """The overrides for a robot with hips and shoulders of three hinges, and the walk on it."""
    folder = tmp_path_factory.mktemp("robot")
    file = robot_file(folder)
    walk: Clip = plugins.registry.find("clip", "walk").factory()
    clip, _ = retarget(walk, load_character(str(file), plugins.registry))
    motion = folder / "walk.npz"
    write_clip(clip, motion, plugins.registry)
    return (f"scene.character={file}", f"motion.file={motion}")


def test_scenes_of_other_plugins_can_be_chosen() -> None:
    chosen = {
        override: load_experiment([*WALK, override]).need("scene").options.character
        for override in ("scene=humanoid", "scene.character=jumper", "seed=1")
    }
    assert list(chosen.values()) == ["humanoid", "jumper", "humanoid"]
    other = load_experiment([*WALK, "scene=character", "scene.character=jumper"])
    assert other.need("scene").options.character == "jumper"


def test_the_jumper_walks_within_bounds() -> None:
    environment = build_environment(load_experiment([*WALK, "scene.character=jumper"])).environment
    check_environment(environment, steps=12)


def test_a_robot_of_hinges_walks_within_bounds(robot: tuple[str, ...]) -> None:
    built = build_environment(load_experiment([*WALK, *robot]))
    check_environment(built.environment, steps=12)
    assert built.environment.action_size == 21


def test_a_robot_follows_its_reference_for_a_while(robot: tuple[str, ...]) -> None:
    """Open loop, as every gait falls soon; servos that are weak or shake end it at once."""
    built = build_environment(load_experiment([*WALK, *robot, "num_worlds=32"]))
    environment = built.environment
    environment.reset(0)
    lasted = torch.zeros(32)
    running = torch.ones(32, dtype=torch.bool)
    for _ in range(60):
        lasted += running
        step = environment.step(environment.table["reference_joint_targets"])
        running &= ~(step.terminated | step.truncated)
    assert (lasted / 30).mean() > 0.4


def test_a_clip_that_does_not_loop_ends_the_episode(robot: tuple[str, ...]) -> None:
    overrides = [*WALK, *robot, "motion.loop=false", "num_worlds=16"]
    overrides += [f"~termination.terms.{name}" for name in ("com", "root", "joints", "fall")]
    overrides += ["~termination.terms.end_effectors", "evaluation.failures=[]"]
    overrides += [
        "evaluation.episodes=8",
        "evaluation.success=null",
        "initial_states=spacetime/uniform",
    ]
    experiment = load_experiment(overrides)
    built = build_environment(experiment)
    environment, duration = built.environment, built.context.sections["motion"].clip.duration
    environment.reset(0)
    for _ in range(45):
        before = environment.table["motion_time"].clone()
        step = environment.step(environment.table["reference_joint_targets"])
        assert torch.equal(step.truncated, before + 1 / 30 >= duration - 1e-4)
        assert not step.terminated.any()

    evaluator = Evaluator(experiment)
    result = evaluator.run(_Still(evaluator.built.environment.action_size), "test", 16)
    evaluator.close()
    assert result.mean_episode_seconds < duration
    assert result.success_rate is None, "nothing is a failure, and nothing a success"


class _Still(Policy):
    """Every target zero."""

    def __init__(self, size: int) -> None:
        super().__init__()
        self._size = size

    def distribution(self, observations: Mapping[str, torch.Tensor]) -> DiagonalGaussian:
        mean = torch.zeros(len(observations["state"]), self._size)
        return DiagonalGaussian(mean, torch.ones(self._size))

    def value(self, observations: Mapping[str, torch.Tensor]) -> torch.Tensor:
        return torch.zeros(len(observations["state"]))

    def actor_parameters(self) -> Iterator[torch.nn.Parameter]:
        return iter(())

    def critic_parameters(self) -> Iterator[torch.nn.Parameter]:
        return iter(())


def test_a_robot_without_its_clip_is_told_to_retarget(robot: tuple[str, ...]) -> None:
    with pytest.raises(Exception, match="understudy motion retarget"):
        build_environment(load_experiment([*WALK, robot[0]]))


def test_a_bad_size_is_refused_before_the_first_step() -> None:
    sizes = "termination.terms.root.size=[[0, 0.4], [0.5]]"
    with pytest.raises(ConfigError, match=r"spacetime/root_bound: size="):
        build_environment(load_experiment([*WALK, sizes]))

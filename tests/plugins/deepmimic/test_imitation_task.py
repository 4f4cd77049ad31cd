"""The task as a whole: conformance, what is observed, the objective, the settings of tables 6.2, 6.3."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import pytest
import torch
from torch import Tensor
from worlds import make_training

from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import Plugins
from understudy.task import Context
from understudy.testing import check_environment, check_plugin
from understudy_deepmimic.encoders import StateEncoder
from understudy_deepmimic.horizon import Horizon, NormalisedReturn, horizon
from understudy_networks.nn import DiagonalGaussian
from understudy_ppo.learner import PPO
from understudy_reinforcement.evaluation import Evaluation
from understudy_reinforcement.evaluator import Evaluator
from understudy_reinforcement.policy import Policy
from understudy_tensors import rotations

WALK = ("experiment=deepmimic/walk", "num_worlds=4")


def test_plugin_conforms(plugins: Plugins) -> None:
    check_plugin("deepmimic", plugins)


@pytest.mark.parametrize("skill", ["backflip", "run", "cartwheel"])
def test_other_skills(skill: str) -> None:
    """With generated clips of the same name, since the recorded ones need not be here."""
    overrides = [f"experiment=deepmimic/{skill}", f"motion.name={skill}", "num_worlds=4"]
    check_environment(build_environment(load_experiment(overrides)).environment, steps=6)


def test_another_character() -> None:
    overrides = [*WALK, "scene.character=jumper"]
    check_environment(build_environment(load_experiment(overrides)).environment, steps=6)


# ---------------------------------------------------------------------- how long, how well


def context(decision: int = 1) -> Context:
    return Context(
        0, torch.device("cpu"), 2, control_dt=1 / 30, substeps=20, decision=decision
    )  # fmt: skip


def test_the_horizon_is_30_and_570_z_control_steps() -> None:
    for z in (0.0, 0.25, 0.5, 1.0):
        assert horizon(z) * 30 == pytest.approx(30 + 570 * z)
    reached = Horizon(None, context())
    steps = torch.tensor([29.0, 30.0, 599.0, 600.0])
    assert reached(steps / 30, torch.tensor([0.0, 0.0, 1.0, 1.0])).tolist() == [
        False, True, False, True
    ]  # fmt: skip


def test_the_normalised_return_of_a_known_episode() -> None:
    """60 decisions of reward 0.8, then a fall: 48 / T; with T = 600, 315 and 30."""
    for z, longest in ((1.0, 600), (0.5, 315), (0.0, 30)):
        measure = NormalisedReturn(None, context())
        value = measure(torch.full((2,), 0.8), torch.full((2,), z))
        assert 60 * value.tolist()[0] == pytest.approx(48 / longest)
    half = NormalisedReturn(None, context(decision=2))(torch.ones(2), torch.ones(2))
    assert 300 * half.tolist()[0] == pytest.approx(1.0)


class Still(Policy):
    """Every target zero."""

    def distribution(self, observations: Mapping[str, Tensor]) -> DiagonalGaussian:
        mean = torch.zeros(len(observations["state"]), 28)
        return DiagonalGaussian(mean, torch.ones(28))

    def value(self, observations: Mapping[str, Tensor]) -> Tensor:
        return torch.zeros(len(observations["state"]))

    def actor_parameters(self) -> Iterator[torch.nn.Parameter]:
        return iter(())

    def critic_parameters(self) -> Iterator[torch.nn.Parameter]:
        return iter(())


def evaluated(*overrides: str) -> Evaluation:
    evaluator = Evaluator(load_experiment([*WALK, "evaluation.episodes=8", *overrides]))
    found = evaluator.run(Still(), "test", 8)
    evaluator.close()
    return found


def test_what_an_evaluation_finds() -> None:
    """A figure that stands still falls soon; the objective is its return over T(z)."""
    easy, hard = evaluated("difficulty=0"), evaluated("difficulty=1")
    for found, longest in ((easy, 30), (hard, 600)):
        assert found.objective == "normalised_return"
        measured = found.measures["normalised_return"].mean
        assert found.objective_value == measured
        assert measured == pytest.approx(found.measures["return"].mean / longest, rel=1e-5)
        assert found.success_rate == 0
    assert easy.mean_episode_seconds is not None
    assert hard.mean_episode_seconds is not None
    assert easy.mean_episode_seconds <= 1.0 < hard.mean_episode_seconds < 5.0
    assert hard.violated["fall"] == 1


# ---------------------------------------------------------------------- what is observed


def observed(
    angle: float = 0.0, shift: tuple[float, float] = (0.0, 0.0), **options: bool
) -> Tensor:
    """Observations of walking worlds, after the character was turned and moved in its place."""
    built = build_environment(load_experiment([*WALK]))
    environment = built.environment
    environment.reset(seed=4)
    table, simulator = environment.table, environment.parts.simulator
    states = {name: simulator.read(name).clone() for name in simulator.state_fields}
    root = states["qpos"][:, :7]
    turn = rotations.from_heading(torch.tensor(angle))
    root[:, :3] = rotations.rotate(turn, root[:, :3]) + torch.tensor([*shift, 0.0])
    root[:, 3:] = rotations.multiply(turn, root[:, 3:])
    states["qvel"][:, :3] = rotations.rotate(turn, states["qvel"][:, :3])
    simulator.set_state(torch.ones(4, dtype=torch.bool), states)
    environment.refresh()
    made = StateEncoder(StateEncoder.Options(**options), built.context)
    found = made.encode(**table.pick({name: name for name in made.reads}))
    assert found.shape[1:] == made.shape
    return found


def test_without_its_deviation_a_character_knows_no_place() -> None:
    here, there = observed(deviation=False), observed(0.7, (3.0, -2.0), deviation=False)
    torch.testing.assert_close(here, there, atol=1e-4, rtol=0)


def test_the_deviation_is_seen_from_the_reference() -> None:
    here, there = observed(), observed(0.0, (0.3, 0.4))
    torch.testing.assert_close(here[:, :-4], there[:, :-4], atol=1e-4, rtol=0)
    torch.testing.assert_close(here[:, -4:-2], torch.zeros(4, 2), atol=1e-4, rtol=0)
    assert there[:, -4:-2].norm(dim=1).tolist() == pytest.approx([0.5] * 4, abs=1e-4)
    turned = observed(0.7)
    torch.testing.assert_close(
        torch.atan2(turned[:, -2], turned[:, -1]), torch.full((4,), 0.7), atol=1e-4, rtol=0
    )


# ---------------------------------------------------------------------- settings


def learner(name: str) -> PPO.Options:
    return load_experiment([*WALK, f"learner=deepmimic/{name}"]).need("learner").options


def test_the_settings_of_the_tables() -> None:
    tabled = (
        "batch_size", "epochs", "actor_learning_rate", "critic_learning_rate", "weight_decay",
        "clip", "max_gradient_norm",
    )  # fmt: skip
    expected = {
        "released": (256, 1, 2.5e-6, 1e-2, 5e-4, 0.2, 100),
        "optimised_walk": (172, 8, 1.68e-5, 2e-3, 5e-4, 0.18, 47.36),
        "optimised_backflip": (48, 10, 4.6e-5, 1e-2, 5e-4, 0.02, 12.3),
    }
    for name, values in expected.items():
        options = learner(name)
        assert tuple(getattr(options, option) for option in tabled) == pytest.approx(values)
        assert (options.optimiser, options.momentum, options.gamma) == ("sgd", 0.9, 0.95)
        assert (options.gae_lambda, options.td_lambda, options.advantage_clip) == (0.95, 0.95, 4)
    experiment = load_experiment(["experiment=deepmimic/walk"])
    assert experiment.root.num_worlds * learner("released").rollout_steps == 4096


@pytest.mark.parametrize("name", ["released", "optimised_walk", "optimised_backflip"])
def test_on_a_gpu_all_is_four_times_the_samples(name: str) -> None:
    pytest.importorskip("mujoco_warp", reason="MuJoCo Warp is not installed")
    small, large = learner(name), learner(f"{name}_gpu")
    assert small.batch_size is not None
    assert large == replace(small, batch_size=4 * small.batch_size, rollout_steps=4)
    for skill in ("walk", "backflip"):
        root = load_experiment([f"experiment=deepmimic/{skill}_gpu"]).root
        assert root.num_worlds * large.rollout_steps == 4 * 4096


def test_the_sweep_of_settings_composes() -> None:
    pytest.importorskip("mujoco_warp", reason="MuJoCo Warp is not installed")
    experiment = load_experiment(["ablation=deepmimic/settings"])
    for overrides in experiment.need("outer_loop").options.variants.values():
        load_experiment(["experiment=deepmimic/walk_gpu", *overrides])


@pytest.mark.parametrize(
    "corner", [(32, 10, 2.5e-4, 1e-2, 5e-2, 0.02, 1), (1024, 1, 2.5e-6, 1e-4, 5e-4, 0.2, 100)]
)
def test_corners_of_table_6_2_learn_without_numbers_that_go_wrong(
    corner: tuple[float, ...], plugins: Plugins
) -> None:
    batch, epochs, actor, critic, decay, clip, norm = corner
    training = make_training(plugins, [
        *WALK, "num_worlds=64", "policy.hidden=[32]", f"learner.batch_size={batch}",
        f"learner.epochs={epochs}", f"learner.actor_learning_rate={actor}",
        f"learner.critic_learning_rate={critic}", f"learner.weight_decay={decay}",
        f"learner.clip={clip}", f"learner.max_gradient_norm={norm}",
    ])  # fmt: skip
    for _ in range(2):
        row = training.iterate()
        assert row["skipped_steps"] == 0
        assert 0 < row["reward"] < 1
    training.close()

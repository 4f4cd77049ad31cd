from __future__ import annotations

import dataclasses
from typing import Any

import pytest
import torch
from worlds import PADDLE_TASK, assert_same_state

from understudy.errors import ConfigError, TrainingError
from understudy.running.environment import Environment, Step
from understudy.running.statistics import refuse_hopeless
from understudy.setup.building import build_environment
from understudy.setup.config import load_experiment
from understudy.setup.plugins import Plugins
from understudy.testing import check_environment, check_simulator
from understudy.testing.fake import FAKE_TASK

TASK = (
    *FAKE_TASK,
    "num_worlds=4",
    "control.frequency=10",
    "control.substeps=1",
    "episode.seconds=1.0",
)


def made(plugins: Plugins, *more: str, **arguments: Any) -> Environment:
    return build_environment(load_experiment([*TASK, *more], plugins), **arguments).environment


def place(env: Environment, qpos: list[float]) -> None:
    state = {"qpos": torch.tensor(qpos).unsqueeze(1), "qvel": torch.zeros(len(qpos), 1)}
    env.parts.simulator.set_state(torch.ones(len(qpos), dtype=torch.bool), state)
    env.refresh()


def still(env: Environment) -> Step:
    return env.step(torch.zeros(env.num_worlds, 1))


@pytest.mark.parametrize("task", [TASK, (*PADDLE_TASK, "num_worlds=4")], ids=["fake", "contacts"])
def test_conformance(plugins: Plugins, task: tuple[str, ...]) -> None:
    built = build_environment(load_experiment([*task], plugins))
    check_environment(built.environment)
    check_simulator(built.environment.parts.simulator, 4)


def test_only_ended_worlds_begin_anew(plugins: Plugins) -> None:
    env = made(plugins)
    env.reset()
    place(env, [0.5, 9.0, -9.0, -0.5])
    step = still(env)
    assert step.terminated.tolist() == step.failed.tolist() == [False, True, True, False]
    assert not step.truncated.any()
    assert step.endings["far"].tolist() == [False, True, True, False]
    assert env.episode_step.tolist() == [1, 0, 0, 1]
    seen = step.observations["state"][:, 0]
    assert seen[[0, 3]].tolist() == [0.5, -0.5]
    assert (seen[[1, 2]].abs() <= 1).all()
    assert step.final_observations is not None
    assert step.final_observations["state"][:, 0].tolist() == [0.5, 9.0, -9.0, -0.5]
    expected = torch.exp(-torch.tensor([0.5, 9.0, 9.0, 0.5]))
    assert torch.allclose(step.rewards, expected), "the reward is that of the state reached"


def test_truncation_at_the_episode_length(plugins: Plugins) -> None:
    env = made(plugins)
    env.reset()
    steps = [still(env) for _ in range(10)]
    assert not any(s.truncated.any() or s.final_observations for s in steps[:9])
    assert steps[9].truncated.all()
    assert not steps[9].terminated.any()
    assert torch.equal(steps[9].final_observations["state"], steps[8].observations["state"])  # type: ignore[index]
    assert not torch.equal(steps[9].observations["state"], steps[8].observations["state"])


def test_a_failure_wins_over_truncation(plugins: Plugins) -> None:
    env = made(plugins)
    env.reset()
    for _ in range(9):
        still(env)
    place(env, [9.0, 0.0, 0.0, 0.0])
    step = still(env)
    assert step.terminated.tolist() == [True, False, False, False]
    assert step.truncated.tolist() == [False, True, True, True]


@pytest.mark.parametrize("outcome", ["failure", "success", "truncation", "report"])
def test_outcomes(plugins: Plugins, outcome: str) -> None:
    env = made(plugins, f"+termination.terms.far.outcome={outcome}")
    env.reset()
    place(env, [9.0, 0.0, 0.0, 0.0])
    step = still(env)
    assert step.endings["far"][0]
    assert bool(step.failed[0]) == (outcome == "failure")
    assert bool(step.terminated[0]) == (outcome in ("failure", "success"))
    assert bool(step.truncated[0]) == (outcome == "truncation")


def test_ending_restricts_who_ends(plugins: Plugins) -> None:
    env = made(plugins, ending=())
    env.reset()
    place(env, [9.0, 0.0, 0.0, 0.0])
    step = still(env)
    assert step.endings["far"][0]
    assert not step.terminated.any()


def test_reward_combinations(plugins: Plugins) -> None:
    more = ["+reward.terms.more={name: fake.near_origin, scale: 2.0, weight: 3}"]
    for combine, expected in (("sum", lambda a, b: a + 3 * b), ("product", lambda a, b: a * b**3)):
        env = made(plugins, *more, f"reward.combine={combine}")
        env.reset()
        place(env, [0.5, 0.1, 0.0, -1.0])
        x = torch.tensor([0.5, 0.1, 0.0, 1.0])
        assert torch.allclose(still(env).rewards, expected(torch.exp(-x), torch.exp(-x / 2)))


def test_rewards_see_who_failed(plugins: Plugins) -> None:
    env = made(plugins)

    def alive(failed: torch.Tensor) -> torch.Tensor:
        return (~failed).float()

    env.parts.rewards = [Term("alive", alive)]
    env.reset()
    place(env, [9.0, 0.0, 0.0, 0.0])
    assert still(env).rewards.tolist() == [0, 1, 1, 1]


def test_statistics(plugins: Plugins) -> None:
    env = made(plugins)
    env.reset()
    place(env, [0.0, 0.0, 0.0, 0.0])
    for _ in range(3):
        still(env)
    assert env.statistics.collect() == {"episodes": 0, "unsound": 0}
    place(env, [9.0, 0.0, 0.0, 0.0])
    still(env)
    row = env.statistics.collect()
    assert row["episodes"] == 1
    assert row["episode_seconds"] == pytest.approx(0.4)
    assert row["return"] == pytest.approx(3.0, abs=1e-3)
    assert (row["truncated"], row["ended_by/far"]) == (0, 1)
    for _ in range(6):
        still(env)
    row = env.statistics.collect()
    assert (row["episodes"], row["truncated"], row["ended_by/far"]) == (3, 1, 0)
    assert row["return"] == pytest.approx(10.0, abs=1e-3)


def test_state_round_trip(plugins: Plugins) -> None:
    env, other = made(plugins), made(plugins)
    env.reset()
    other.reset()
    still(other)
    for _ in range(5):
        still(env)
    other.load_state_dict(env.state_dict())
    for _ in range(12):
        assert_same_state(vars(still(env)), vars(still(other)))
    assert_same_state(env.state_dict(), other.state_dict())


def test_reset_with_a_seed_repeats(plugins: Plugins) -> None:
    env = made(plugins)
    first = env.reset(seed=3)["state"].clone()
    assert not torch.equal(env.reset()["state"], first)
    assert torch.equal(env.reset(seed=3)["state"], first)


@pytest.mark.parametrize("kind", ["reward", "termination"])
def test_missing_field(plugins: Plugins, kind: str) -> None:
    """The error names term, field, and who would provide it."""
    env = made(plugins)

    def lost(qpos: Any, xpos: Any) -> Any: ...

    parts = dataclasses.replace(env.parts, **{f"{kind}s": [Term("lost", lost)]})
    with pytest.raises(ConfigError, match=rf"^{kind}\.terms\.lost needs the state field 'xpos', which nothing in this task "
                       r"provides\. It would come from fields 'somebody'\."):  # fmt: skip
        Environment(
            parts, num_worlds=4, device=env.device, seed=0, control_dt=0.1, episode_seconds=1,
            known_fields=lambda name: ["fields 'somebody'"] if name == "xpos" else [],
        )  # fmt: skip


@pytest.mark.parametrize(
    ("kind", "result", "message"),
    [
        ("reward", torch.zeros(4, 1), r"^reward\.terms\.odd has shape \(4, 1\); it must be \(4,\)"),
        ("reward", torch.zeros(3), r"^reward\.terms\.odd has shape \(3,\)"),
        (
            "termination",
            torch.zeros(4),
            r"^termination\.terms\.odd returns torch\.float32; it must return bool",
        ),
    ],
)
def test_wrong_shapes(plugins: Plugins, kind: str, result: torch.Tensor, message: str) -> None:
    env = made(plugins)
    setattr(env.parts, f"{kind}s", [Term("odd", lambda: result)])
    with pytest.raises(ConfigError, match=message):
        env.reset()


def test_refuse_hopeless() -> None:
    refuse_hopeless(25, 10, 10)
    with pytest.raises(TrainingError, match=r"^26% of all steps"):
        refuse_hopeless(26, 10, 10)


def test_physics_is_computed_in_full_precision(
    plugins: Plugins, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A learner's choice of TF32 does not reach the environment, which gives it back."""
    products = torch.backends.cuda.matmul
    env = made(plugins)
    seen = []
    reward = env._reward

    def look() -> torch.Tensor:
        seen.append(products.allow_tf32)
        return reward()

    monkeypatch.setattr(env, "_reward", look)
    products.allow_tf32 = True
    try:
        env.reset()
        still(env)
        assert seen
        assert not any(seen)
        assert products.allow_tf32
    finally:
        products.allow_tf32 = False

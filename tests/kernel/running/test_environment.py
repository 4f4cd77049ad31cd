from __future__ import annotations

import dataclasses
import math
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from counted_task import LINE_TASK, Line, Push, Starts, Where, line, line_plugins, push, term
from torch import Tensor
from worlds import PADDLE_TASK, assert_same_state

from understudy.errors import ConfigError, TrainingError
from understudy.running.environment import Environment
from understudy.running.step import Step
from understudy.running.training import Training
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import Plugins
from understudy.task.terms import ranges
from understudy.testing import check_environment, check_simulator
from understudy.testing.fake import FAKE_TASK
from understudy_reinforcement.hopeless import Hopeless, refuse_negative

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


def test_a_step_brings_the_states_that_it_reached(plugins: Plugins) -> None:
    """Of worlds that ended where they ended, not where they began anew; of unsound ones nothing."""
    env = made(plugins)
    env.reset()
    assert still(env).next_fields == {}
    env.next_fields = ("qpos", "episode_time")
    place(env, [0.5, 9.0, torch.nan, -0.5])
    step = still(env)
    assert step.ended.tolist() == [False, True, True, False]
    assert step.next_fields["qpos"].flatten().tolist() == pytest.approx(
        [0.5, 9.0, 0.0, -0.5], abs=0.1
    )
    assert float(env.table["qpos"].abs().max()) < 5.0
    assert (step.next_fields["episode_time"] > 0).all()
    kept = step.next_fields["qpos"].clone()
    still(env)
    assert torch.equal(step.next_fields["qpos"], kept)


@pytest.mark.parametrize("how", ["step", "advance"])
@pytest.mark.parametrize("shape", [(), (1,), (1, 1), (4,), (3, 1), (4, 2)])
def test_actions_of_another_shape_are_not_spread_over_worlds(
    plugins: Plugins, how: str, shape: tuple[int, ...]
) -> None:
    """One action for all worlds would be copied to each of them in silence."""
    env = made(plugins)
    env.reset(0)
    before = env.table["qpos"].clone()
    with pytest.raises(ConfigError, match=r"Give actions of shape \(4, 1\) after a reset"):
        getattr(env, how)(torch.ones(shape))
    env.refresh()
    assert torch.equal(env.table["qpos"], before)


@pytest.mark.parametrize("how", ["step", "advance"])
def test_no_step_comes_before_a_reset(plugins: Plugins, how: str) -> None:
    """It would judge states where no episode has begun, and call each of them ended."""
    env = made(plugins)
    with pytest.raises(ConfigError, match=r"after a reset\(\)"):
        getattr(env, how)(torch.zeros(4, 1))
    env.reset(0)
    assert not still(env).ended.any()


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


def test_reward_combinations(plugins: Plugins) -> None:
    more = ["+reward.terms.more={name: fake/near_origin, scale: 2.0, weight: 3}"]
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

    env.parts.rewards = [term(alive)]
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

    parts = dataclasses.replace(env.parts, **{f"{kind}s": [term(lost, where=f"{kind}.terms.lost")]})
    with pytest.raises(ConfigError, match=rf"^{kind}\.terms\.lost needs the state field 'xpos', which nothing in this task "
                       r"provides\. It would come from fields 'somebody'\."):  # fmt: skip
        Environment(
            parts, env._context, episode_seconds=1,
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
    odd = term(lambda: result, "odd", where=f"{kind}.terms.odd")
    setattr(env.parts, f"{kind}s", [odd])
    with pytest.raises(ConfigError, match=message):
        env.reset()


def test_refuse_hopeless() -> None:
    def after(*iterations: tuple[float, float], worlds: int = 10) -> None:
        hopeless = Hopeless(worlds)
        for unsound, episodes in iterations:
            hopeless.refuse({"unsound": unsound, "episodes": episodes}, 10, lambda: "x")

    after((25, 100))
    with pytest.raises(TrainingError, match=r"^26% of all steps .* by the numbers of x\."):
        after((26, 100))
    after((16, 32), (5, 5), (5, 5), (5, 5), (5, 5), (5, 5), (5, 5))  # of 30, which are few
    with pytest.raises(TrainingError, match=r"^53% of all episodes"):
        after((17, 32))
    with pytest.raises(TrainingError, match=r"^100% of all episodes"):
        after(*[(8, 8)] * 4)
    after(*[(8, 8)] * 4, worlds=50)


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


# ---------------------------------------------------------------------- advance and begin


def test_advance_and_begin_are_a_step(plugins: Plugins) -> None:
    whole, split = made(plugins, "episode.seconds=0.3"), made(plugins, "episode.seconds=0.3")
    whole.reset(), split.reset()
    for _ in range(8):
        one, two = still(whole), split.advance(torch.zeros(4, 1))
        reached = {k: v.clone() for k, v in two.observations.items()}
        if two.ended.any():
            assert one.final_observations is not None
            assert_same_state(one.final_observations, reached)
        begun = split.begin(two.ended)
        assert_same_state(one.observations, begun)
        for name in ("rewards", "terminated", "truncated", "failed", "unsound", "returns"):
            assert torch.equal(getattr(one, name), getattr(two, name)), name
    assert_same_state(whole.state_dict(), split.state_dict())


def test_ended_worlds_can_be_read_until_they_begin() -> None:
    env = line(terminations=[term(lambda x: x[:, 0] >= 3, "far", outcome="success")])
    env.reset()
    step = env.advance(torch.tensor([[1.0], [3.0], [4.0], [2.0]]))
    assert step.ended.tolist() == [False, True, True, False]
    assert env.table["x"][:, 0].tolist() == [1, 3, 4, 2]
    assert env.table["succeeded"].tolist() == [False, True, True, False]
    assert env.begin(step.ended)["state"][:, 0].tolist() == [1, 0, 0, 2]
    assert env.table["x"][:, 0].tolist() == [1, 0, 0, 2]
    assert not env.table["succeeded"].any()
    assert env.table["episode_time"].tolist() == [1, 0, 0, 1]


@pytest.mark.parametrize("ending", ["truncation", "success"])
def test_final_observations_are_of_the_ended_episode(ending: str) -> None:
    """Although the encoder hands on the simulator's memory, where the next episode begins."""
    env = line(terminations=[term(lambda x: x[:, 0] >= 7, "far", outcome=ending)])
    env.reset()
    step = push(env, 1, 7, 8, 2)
    assert step.observations["state"][:, 0].tolist() == [1, 0, 0, 2]
    assert step.final_observations is not None
    assert step.final_observations["state"][:, 0].tolist() == [1, 7, 8, 2]


def test_returns_of_episodes_are_up_to_and_with_the_step() -> None:
    env = line(seconds=3)
    env.reset()
    found = [push(env, 1, 2, 0, -1).returns.tolist() for _ in range(4)]
    assert found == [[1, 2, 0, -1], [3, 6, 0, -3], [6, 12, 0, -6], [1, 2, 0, -1]]


def test_only_terms_that_end_count_as_endings() -> None:
    env = line(
        seconds=1,
        terminations=[
            term(lambda x: x[:, 0] >= 1, "reported", outcome="report"),
            term(lambda x: x[:, 0] >= 2, "fatal"),
        ],
    )
    env.reset()
    step = push(env, 0, 1, 2, 3)
    assert step.endings["reported"].tolist() == [False, True, True, True]
    assert step.failed.tolist() == [False, False, True, True]
    row = env.statistics.collect()
    assert row["ended_by/fatal"] == 0.5
    assert "ended_by/reported" not in row


def test_who_failed_succeeded_or_violated() -> None:
    """``violated`` has those that only report; a failure is no success."""
    seen = {}

    def watch(
        failed: torch.Tensor, succeeded: torch.Tensor, violated: torch.Tensor
    ) -> torch.Tensor:
        seen.update(
            failed=failed.tolist(), succeeded=succeeded.tolist(), violated=violated.tolist()
        )
        return failed.float()

    env = line(
        rewards=[term(watch)],
        terminations=[
            term(lambda x: x[:, 0] == 1, "reported", outcome="report"),
            term(lambda x: x[:, 0] >= 2, "won", outcome="success"),
            term(lambda x: x[:, 0] >= 3, "lost"),
        ],
    )
    env.reset()
    step = push(env, 0, 1, 2, 3)
    assert seen["failed"] == step.failed.tolist() == [False, False, False, True]
    assert seen["succeeded"] == [False, False, True, False]
    assert seen["violated"] == [False, True, False, True]
    assert step.terminated.tolist() == [False, False, True, True]


# ---------------------------------------------------------------------- where episodes begin


class Given(Starts):
    """Returns what it is told to."""

    episode_fields = {"label": (2,)}

    def __init__(self, given: dict[str, torch.Tensor]) -> None:
        super().__init__()
        self.given = given

    def sample(self, streams: Any, **fields: torch.Tensor) -> dict[str, torch.Tensor]:
        return self.given


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"label": (4, 2)}, r"^initial_states promises 'x' and does not return it\.$"),
        ({"x": (4, 1)}, r"^initial_states promises 'label' and does not return it\.$"),
        (
            {"x": (4, 1), "label": (4, 2), "gain": (4,)},
            r"^initial_states returns 'gain', which is no state of this simulator and not among its "
            r"episode_fields\. It takes: label, x\.$",
        ),
        ({"x": (4,), "label": (4, 2)}, r"^'x' of initial_states has shape \(4,\); it must be"),
        ({"x": (1, 1), "label": (4, 2)}, r"^'x' of initial_states has shape \(1, 1\)"),
        ({"x": (4, 1), "label": (4, 3)}, r"^'label' of initial_states has shape \(4, 3\)"),
    ],
)
def test_initial_states_keep_their_promise(given: dict[str, tuple], message: str) -> None:
    env = line(initial_states=Given({name: torch.zeros(shape) for name, shape in given.items()}))
    with pytest.raises(ConfigError, match=message):
        env.reset()


def test_episode_fields_are_constant_until_the_next_episode() -> None:
    initial = Given({"x": torch.zeros(4, 1), "label": torch.ones(4, 2)})
    env = line(initial_states=initial, seconds=2, measures=[term(lambda label: label[:, 0], "l")])
    env.reset()
    env.episode_step[:2] = 1  # worlds 0 and 1 end at the next step
    initial.given["label"] = torch.full((4, 2), 5.0)
    push(env)
    assert env.measure()["l"].tolist() == [5, 5, 1, 1]
    push(env)
    assert env.measure()["l"].tolist() == [5, 5, 5, 5]


class Settling(Starts):
    settle = 3


class Falling(Line):
    """Moves by one in each step beside what the control does."""

    def step(self, control: torch.Tensor, substeps: int | None = None) -> None:
        super().step(control + 1.0, substeps)


def test_settling_leaves_the_others_as_they_were() -> None:
    env = line(
        simulator=Falling(None, SimpleNamespace(num_worlds=4, substeps=1)),
        initial_states=Settling(),
        terminations=[term(lambda x: x[:, 0] >= 10, "far")],
    )
    assert env.reset()["state"][:, 0].tolist() == [3, 3, 3, 3]
    assert env.episode_step.tolist() == [0, 0, 0, 0]
    step = push(env, 0, 6, 9, 1)
    assert step.terminated.tolist() == [False, True, True, False]
    assert step.observations["state"][:, 0].tolist() == [4, 3, 3, 5]
    assert env.episode_step.tolist() == [1, 0, 0, 1]


class Gains(Starts):
    """World i has the gain i + 1 in its first episode, ten more in each one after it."""

    varies = ("gain",)

    def sample(self, streams: Any, **fields: torch.Tensor) -> dict[str, torch.Tensor]:
        given = super().sample(streams)
        return {**given, "gain": torch.arange(1.0, 5.0) + 10 * (len(self.taken) - 1)}


def test_simulator_parameters_vary_with_the_episode() -> None:
    env = line(
        initial_states=Gains(),
        terminations=[term(lambda x: x[:, 0] >= 3, "far")],
        measures=[term(lambda gain: gain, "gain")],
    )
    env.reset()
    step = env.advance(torch.ones(4, 1))
    assert env.table["x"][:, 0].tolist() == [1, 2, 3, 4]
    assert env.measure()["gain"].tolist() == [1, 2, 3, 4]
    env.begin(step.ended)
    assert step.failed.tolist() == [False, False, True, True]
    assert env.table["gain"].tolist() == [1, 2, 13, 14]
    env.advance(torch.ones(4, 1))
    assert env.table["x"][:, 0].tolist() == [2, 4, 13, 14]


def test_starts_that_vary_less_have_the_models_values() -> None:
    """As an evaluation's may, in the environment of a task that varies more."""
    env = line(initial_states=Gains(), measures=[term(lambda gain: gain, "gain")])
    env.reset()
    assert env.measure()["gain"].tolist() == [1, 2, 3, 4]
    env.parts.initial_states = Starts()
    env.reset()
    assert env.measure()["gain"].tolist() == [1, 1, 1, 1]


def test_starts_that_leave_out_what_they_vary_are_refused() -> None:
    class Forgetful(Starts):
        varies = ("gain",)

    env = line(initial_states=Forgetful())
    with pytest.raises(ConfigError, match=r"initial_states promises 'gain' and does not return it"):
        env.reset()


def test_a_parameter_that_the_simulator_does_not_know() -> None:
    class Masses(Starts):
        varies = ("gian",)

    with pytest.raises(ConfigError, match=r"no parameter 'gian' in which .*Did you mean 'gain'\?"):
        line(initial_states=Masses())


# ---------------------------------------------------------------------- state


def test_state_of_everything_that_lasts(plugins: Plugins) -> None:
    """What varies, what is constant in an episode and what is previous continues exactly."""

    def still_there(
        x: torch.Tensor, previous_x: torch.Tensor, action: torch.Tensor
    ) -> torch.Tensor:
        return (x + 2 * previous_x + 4 * action)[:, 0]

    def fresh() -> Any:
        return line(initial_states=Gains(), rewards=[term(still_there)], seconds=3)

    env, other = fresh(), fresh()
    env.reset(), other.reset()
    for force in (1, 2):
        push(env, force)
    push(other, 7)
    other.load_state_dict(env.state_dict())
    other.parts.initial_states.taken = [*env.parts.initial_states.taken]  # its own state
    for force in (3, 4, 5):
        assert_same_state(vars(push(env, force)), vars(push(other, force)))
    assert_same_state(env.state_dict(), other.state_dict())


def test_the_task_ends_with_as_many_numbers_as_it_says() -> None:
    class Two(Push):
        def control(self, action: torch.Tensor) -> torch.Tensor:
            return action.repeat(1, 2)

    class Wide(Where):
        shape = (2,)

    with pytest.raises(ConfigError, match=r"^the control of actuation has shape \(4, 2\)"):
        line(actuation=Two()).reset()
    with pytest.raises(ConfigError, match=r"^encoder\.state has shape \(4, 1\)"):
        line(encoders={"state": Wide()}).reset()


def test_the_weight_in_a_product_is_an_exponent() -> None:
    def three(x: Tensor) -> Tensor:
        return torch.full_like(x[:, 0], 3.0)

    terms = [term(three, "one", weight=2.0), term(three, "two", weight=0.5)]
    product = line(rewards=terms, combine="product")
    total = line(rewards=terms, combine="sum")
    for environment in (product, total):
        environment.reset()
    assert push(product).rewards.tolist() == pytest.approx([3.0**2.5] * 4)
    assert push(total).rewards.tolist() == pytest.approx([7.5] * 4)
    refuse_negative(product)


@pytest.mark.parametrize(
    ("combine", "weight", "refused"),
    [("product", 0.5, True), ("product", 2.0, True), ("product", 1.0, False), ("sum", 0.5, False)],
)
def test_a_negative_reward_with_an_exponent_is_named_with_world_and_value(
    combine: str, weight: float, refused: bool
) -> None:
    def lean(x: Tensor) -> Tensor:
        return x[:, 0]

    environment = line(
        rewards=[term(lean, weight=weight, where="reward.terms.lean")], combine=combine
    )  # type: ignore[arg-type]
    environment.reset()
    low = environment.table["x"][:, 0].min().item()
    push(environment, 1.0, 1.0, -7.0 - low, 1.0)
    push(environment, 9.0, 9.0, 9.0, 9.0)  # what has been is not forgotten
    if not refused:
        refuse_negative(environment)
        return
    with pytest.raises(TrainingError) as error:
        refuse_negative(environment)
    value = float(environment.rewards.least["reward.terms.lean"][2])
    assert value < 0
    for part in ("reward.terms.lean", f"{value:g}", "world 2", "reward.combine=sum"):
        assert part in str(error.value)


def test_a_training_stops_at_a_negative_reward_with_an_exponent() -> None:
    @ranges(-math.inf, math.inf)
    def declared(x: Tensor) -> Tensor:
        return x[:, 0]

    def silent(x: Tensor) -> Tensor:
        return x[:, 0] - 5.0

    plugins = line_plugins(reward={"declared": declared, "silent": silent})
    task = [*LINE_TASK, "reward.combine=product"]
    with pytest.raises(ConfigError) as refused:
        load_experiment([*task, "+reward.terms.y={name: declared}"], plugins)
    assert "reward.terms.y" in str(refused.value)
    assert "reward.combine=sum" in str(refused.value)
    load_experiment([*LINE_TASK, "reward.combine=sum", "+reward.terms.y={name: declared}"], plugins)
    overrides = [*task, "+reward.terms.z={name: silent, weight: 0.5}"]
    job = Training(load_experiment(overrides, plugins)).prepare().job
    with pytest.raises(TrainingError, match=r"reward\.terms\.z was -\d"):
        job.iterate(0)

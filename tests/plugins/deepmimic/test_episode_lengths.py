"""Episodes that get longer: how fast, how far, and when a training ends."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
import torch
from worlds import assert_same_state, make_training, resumed

from understudy.errors import ConfigError
from understudy.random import WorldStreams
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import Plugins
from understudy.task import Context, Curriculum, Rollout
from understudy_deepmimic.curricula import Adaptive, Annealed, Episodes, Recent

STREAMS = WorldStreams(0, "test", 4, "cpu")


def context(difficulty: float = 1.0, decision: int = 1) -> Context:
    return Context(
        0,
        torch.device("cpu"),
        4,
        control_dt=1 / 30,
        substeps=20,
        decision=decision,
        difficulty=difficulty,
    )


def rollout(ended: int = 10, failed: int = 0, returns: float = 12.0) -> Rollout:
    """Of 4 worlds × 5 decisions; in the first `ended` an episode ended, `failed` of them failed."""
    number = torch.arange(20).view(5, 4)
    none = torch.zeros(5, 4)
    return Rollout(
        observations={},
        last_observations={},
        actions=none,
        log_probs=none,
        rewards=none,
        terminated=number < failed,
        truncated=(number >= failed) & (number < ended),
        failed=number < failed,
        final_values=none,
        episode_returns=none + returns,
        fields={},
    )


def limit(curriculum: Curriculum) -> float:
    given = curriculum.begin(STREAMS)["episode_limit"]
    assert given.shape == (4,)
    assert (given == given[0]).all()
    return given[0].item()


def test_half_a_second_more_while_less_than_a_fifth_fails() -> None:
    curriculum = Adaptive(Adaptive.Options(), context())
    limits = [limit(curriculum)]
    for ended, failed in ((0, 0), (10, 0), (10, 1), (10, 3), (10, 9), (0, 0), (20, 3)):
        curriculum.update(rollout(ended, failed))
        limits.append(limit(curriculum))
    assert limits == [1.0, 1.0, 1.5, 2.0, 2.0, 2.0, 2.0, 2.5]
    assert curriculum.stage() == "episodes of 2.5 s"


def test_worlds_that_began_together() -> None:
    """Of 20, ten fail two at a time, and the others reach the limit at once: half, not none."""
    recent = Recent(20)

    def rate(ended: int, failed: int) -> float:
        return recent.digest(Episodes.ended_in(rollout(ended, failed))).fail_rate

    assert [rate(2, 2) for _ in range(5)] == [1.0] * 5
    assert rate(10, 0) == 0.5
    assert rate(0, 0) == 0.5
    assert [rate(10, 1) for _ in range(3)] == [1 / 20, 2 / 20, 2 / 20]


@pytest.mark.parametrize(("difficulty", "longest"), [(0.0, 1.0), (0.1, 2.9), (1.0, 20.0)])
def test_until_the_horizon_of_the_difficulty(difficulty: float, longest: float) -> None:
    curriculum = Adaptive(Adaptive.Options(), context(difficulty))
    marks = [m for _ in range(60) for m in curriculum.update(rollout()) if m.startswith("mark/")]
    assert limit(curriculum) == pytest.approx(longest)
    assert marks == ([f"mark/episodes of {longest:.1f} s"] if difficulty else [])


@pytest.mark.parametrize("kind", [Adaptive, Annealed])
def test_the_first_are_no_longer_than_the_longest(kind: Any) -> None:
    assert limit(kind(kind.Options(start=2.9), context(0.1))) == pytest.approx(2.9)
    with pytest.raises(
        ConfigError,
        match=r"start=3 is not possible: episodes last 2\.9 s at most with difficulty=0\.1",
    ):
        kind(kind.Options(start=3.0), context(0.1))


def test_the_tensor_stays_the_same() -> None:
    """A captured step reads it."""
    for curriculum in (
        Adaptive(Adaptive.Options(), context()),
        Annealed(Annealed.Options(samples=40), context()),
    ):
        before = curriculum.begin(STREAMS)["episode_limit"].data_ptr()
        assert limit(curriculum) < 1.5
        curriculum.update(rollout())
        curriculum.load_state_dict(curriculum.state_dict())
        assert curriculum.begin(STREAMS)["episode_limit"].data_ptr() == before


def test_the_released_schedule() -> None:
    """0.5 s, then by the fourth power of the share of the samples: 20 are consumed in a rollout."""
    curriculum = Annealed(Annealed.Options(samples=40), context())
    found = [limit(curriculum)]
    for _ in range(3):
        curriculum.update(rollout(failed=10))
        found.append(limit(curriculum))
    assert found == pytest.approx([0.5, 0.5 + 19.5 / 16, 20.0, 20.0])


def test_the_normalised_return() -> None:
    """12 in episodes of T = 600 decisions; with decisions of two control periods of 300."""
    for decision, expected in ((1, 0.02), (2, 0.04)):
        curriculum = Adaptive(Adaptive.Options(), context(decision=decision))
        for _ in range(3):
            assert curriculum.update(rollout())["normalised_return"] == pytest.approx(expected)
    assert Episodes.ended_in(rollout(10, 3, returns=5.0)) == (10, 3, 50)


def test_a_return_that_does_not_increase_ends_the_training() -> None:
    curriculum = Adaptive(Adaptive.Options(patience=3), context())
    finished = []
    for returns in (1.0, 2.0, 2.0, 3.0, 0.0, 0.0, 0.0):
        curriculum.update(rollout(returns=returns))
        finished.append(curriculum.finished())
    assert finished == [False] * 6 + [True]
    for options in (Adaptive.Options(patience=None), Adaptive.Options()):
        curriculum = Adaptive(options, context())
        for _ in range(20):
            curriculum.update(rollout())
        assert not curriculum.finished()


def test_the_return_is_that_of_several_episodes() -> None:
    """One lucky episode sets no record that lasts: of the last four, three others have little."""
    curriculum = Adaptive(Adaptive.Options(patience=10), context())
    for i in range(60):
        curriculum.update(rollout(1, returns=30.0 if i == 3 else 1.0 + i))
        assert not curriculum.finished()


def test_iterations_in_which_nothing_ends_are_no_stagnation() -> None:
    """Worlds that began together end together, once in many short iterations."""
    curriculum = Adaptive(Adaptive.Options(patience=3), context())
    for i in range(30):
        curriculum.update(rollout(20 if i % 10 == 0 else 0, returns=1.0 + i))
        assert not curriculum.finished()


@pytest.mark.parametrize(
    ("kind", "options"),
    [(Adaptive, {"patience": 4}), (Annealed, {"patience": 4, "samples": 200})],
)
def test_goes_on_exactly(kind: Any, options: Mapping[str, Any]) -> None:
    first, other = (kind(kind.Options(**options), context()) for _ in range(2))
    for returns in (1.0, 3.0, 2.0):
        first.update(rollout(returns=returns))
    other.load_state_dict(first.state_dict())
    for _ in range(4):
        assert first.update(rollout(returns=1.0)) == other.update(rollout(returns=1.0))
        assert limit(first) == limit(other)
        assert first.finished() == other.finished()
    assert first.finished()


def test_evaluations_last_as_long_as_the_difficulty_says() -> None:
    overrides = ["task=deepmimic/walk", "num_worlds=2", "difficulty=0.1"]
    experiment = load_experiment([*overrides, "~termination.terms.fall", "evaluation.failures=[]"])
    lengths = []
    for evaluating in (False, True):
        environment = build_environment(
            experiment, evaluating=evaluating, episode_seconds=20.0
        ).environment
        environment.reset(seed=0)
        for step in range(1, 100):
            found = environment.advance(environment.table["reference_joint_targets"].clone())
            if bool(found.truncated.all()):
                lengths.append(step)
                break
    assert lengths == [30, 87], "1 s of training, and 1 + 19 · 0.1 s"


def test_a_training_ends_by_itself(tmp_path: Any, plugins: Plugins) -> None:
    overrides = [
        "experiment=deepmimic/walk", "num_worlds=4", "policy.hidden=[8]", "learner.batch_size=32",
        "curriculum.patience=2", "curriculum.start=0.2", "difficulty=0", "evaluation.criterion=null",
    ]  # fmt: skip
    training = make_training(plugins, overrides)
    assert training.train() == "finished"
    assert training.progress.iteration < 60
    training.close()


def test_a_resumed_training_is_the_one_that_never_stopped(tmp_path: Path, plugins: Plugins) -> None:
    overrides = [
        "experiment=deepmimic/walk", "num_worlds=4", "policy.hidden=[8]", "learner.batch_size=32",
        "curriculum.start=0.2", "curriculum.fail_rate=1", "simulator.threads=1",
    ]  # fmt: skip
    straight = make_training(plugins, overrides)
    for _ in range(4):
        straight.iterate()
    cut = make_training(plugins, overrides, tmp_path / "run")
    for _ in range(2):
        cut.iterate()
    cut.save()
    assert cut.run is not None
    cut.run.unlock()
    again = resumed(plugins, tmp_path / "run")
    for _ in range(2):
        again.iterate()
    assert again.job.stage() == straight.job.stage() != "episodes of 0.2 s"
    for name in ("environment", "policy", "learner"):
        assert_same_state(straight.state_dict()[name], again.state_dict()[name])


def test_refuses(plugins: Plugins) -> None:
    for name, value in (("step", 0), ("fail_rate", 1.5), ("patience", 0)):
        with pytest.raises(ConfigError, match=rf"^curriculum\.{name}="):
            load_experiment(["experiment=deepmimic/walk", f"curriculum.{name}={value}"], plugins)

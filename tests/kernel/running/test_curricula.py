"""Curricula: what episodes begin with changes as learning goes on."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
import torch
from counted_task import LINE_TASK, Starts, line, line_plugins, push, term
from torch import Tensor
from worlds import assert_same_state, make_training, resumed

from understudy.errors import ConfigError
from understudy.random import WorldStreams
from understudy.records.observer import RunObserver
from understudy.records.runs import Run
from understudy.setup.composition import load_experiment
from understudy.task import Context, Curriculum, Rollout, State
from understudy_reinforcement.evaluator import Evaluator


class Stairs(Curriculum):
    """One stair up at every update: episodes begin `stair` higher and last 1 + `stair` s; on the
    second stair decisions last two control periods."""

    provides = {"stair": (), "episode_limit": (), "gain": (), "difficulty": ()}
    rollout_fields = ("x",)

    def __init__(self, options: None = None, context: Context | None = None) -> None:
        self.evaluating = context is not None and context.evaluating
        self.stair = round(8 * context.difficulty) if context and self.evaluating else 0
        self.recorded: list[Tensor] = []

    def begin(self, streams: WorldStreams) -> dict[str, Tensor]:
        n = len(streams.uniform(1))
        number = float(self.stair)
        return {
            "stair": torch.full((n,), number),
            "episode_limit": torch.full((n,), 1.0 + number),
            "gain": torch.full((n,), 1.0 + number),
            "difficulty": torch.full((n,), number / 8),
        }

    def decision(self) -> int | None:
        return 2 if self.stair == 2 else None

    def update(self, rollout: Rollout) -> dict[str, float]:
        self.recorded.append(rollout.fields["x"].clone())
        self.stair += 1
        return {"stair": self.stair, "mark/up": 1.0}

    def stage(self) -> str:
        return f"stair {self.stair}"

    def state_dict(self) -> State:
        return {"stair": self.stair}

    def load_state_dict(self, state: State) -> None:
        self.stair = state["stair"]


class Short(Stairs):
    """Of three stairs."""

    def finished(self) -> bool:
        return self.stair >= 3


class High(Starts):
    """Begins as high as the curriculum says."""

    reads = ("stair", "difficulty")

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        return {"x": (fields["stair"] + 100 * fields["difficulty"]).unsqueeze(1)}


PARTS = {
    "curriculum": {"my/stairs": Stairs, "my/short": Short},
    "initial_states": {"my/high": High},
}
TASK = (
    *LINE_TASK[:5],
    "+initial_states={name: my/high}",
    *LINE_TASK[6:],
    "+curriculum={name: my/stairs}",
)


def climbing(**more: Any) -> tuple[Any, Stairs]:
    stairs = Stairs()
    return line(curriculum=stairs, initial_states=High(), **more), stairs


class Stages(RunObserver):
    """Notes the stages that a run tells."""

    def __init__(self, found: list[str]) -> None:
        self.found = found

    def iteration(self, run: Run, row: Mapping[str, float], stage: str) -> None:
        self.found.append(stage)


def test_fields_for_initial_states_terms_and_the_simulator() -> None:
    env, stairs = climbing(
        measures=[term(lambda stair, difficulty, gain: stair + difficulty + gain, "s")]
    )
    stairs.stair = 4
    assert env.reset()["state"][:, 0].tolist() == [54] * 4, "stair + 100 × difficulty"
    assert env.measure()["s"].tolist() == [4 + 0.5 + 5] * 4
    push(env, 1)
    assert env.table["x"][:, 0].tolist() == [59] * 4, "the gain of 5 is the simulator's"


def test_only_beginning_episodes_change() -> None:
    env, stairs = climbing(terminations=[term(lambda x: x[:, 0] >= 100, "far")])
    stairs.stair = 3
    env.reset()
    stairs.stair = 4
    push(env, 0, 100, 0, 0)
    assert env.table["stair"].tolist() == [3, 4, 3, 3]
    assert env.table["episode_limit"].tolist() == [4, 5, 4, 4]
    assert env.table["gain"].tolist() == [4, 5, 4, 4]


def test_episode_limit() -> None:
    env, stairs = climbing()
    stairs.stair = 2  # an episode lasts 3 s, a decision 2 s
    env.reset()
    assert env.table["episode_limit"].tolist() == [3] * 4
    assert [push(env).truncated.tolist() for _ in range(2)] == [[False] * 4, [True] * 4]
    stairs.stair = 1
    env.reset()
    assert [push(env).truncated[0].item() for _ in range(3)] == [False, True, False]


def test_decisions_change_for_all_worlds() -> None:
    env, stairs = climbing()
    env.reset()
    assert env.decision == 1
    push(env)
    stairs.stair = 2
    env.reset()
    assert env.decision == 2
    push(env)
    assert env.episode_step.tolist() == [2] * 4


def test_initial_states_that_read_what_no_curriculum_provides() -> None:
    with pytest.raises(ConfigError, match=r"^initial_states needs 'stair' of the curriculum"):
        line(initial_states=High())


def test_difficulty_without_a_curriculum() -> None:
    class Rough(Starts):
        reads = ("difficulty",)

        def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
            return {"x": fields["difficulty"].unsqueeze(1)}

    env = line(initial_states=Rough(), difficulty=0.25)
    assert env.reset()["state"][:, 0].tolist() == [0.25] * 4


def test_training_updates_marks_and_tells(tmp_path: Path) -> None:
    plugins = line_plugins(**PARTS)
    training = make_training(plugins, TASK, tmp_path / "run")
    stages = []
    training.reporter.observers = [Stages(stages)]
    rows = []
    for row in training.rows():
        rows.append(row)
        if len(rows) == 3:
            break
    assert [row["curriculum/stair"] for row in rows] == [1, 2, 3]
    assert [row["mark/up"] for row in rows] == [1, 1, 1]
    assert stages == ["stair 1", "stair 2", "stair 3"]
    stairs = training.job.environment.parts.curriculum
    assert [tuple(x.shape) for x in stairs.recorded] == [(2, 4, 1)] * 3
    assert stairs.recorded[0][0].tolist() == [[0]] * 4


def test_a_curriculum_can_end_the_training(tmp_path: Path) -> None:
    plugins = line_plugins(**PARTS)
    training = make_training(plugins, [*TASK, "curriculum.name=my/short"], tmp_path / "run")
    assert training.train() == "finished"
    assert training.progress.iteration == 3
    training.run.unlock()
    again = resumed(plugins, tmp_path / "run")
    assert again.train() == "finished"
    assert again.progress.iteration == 3


def test_the_stage_is_resumed(tmp_path: Path) -> None:
    plugins = line_plugins(**PARTS)
    straight = make_training(plugins, TASK)
    for _ in range(4):
        straight.iterate()
    cut = make_training(plugins, TASK, tmp_path / "run")
    for _ in range(2):
        cut.iterate()
    cut.save()
    cut.run.unlock()
    again = resumed(plugins, tmp_path / "run")
    assert again.job.stage() == "stair 2"
    for _ in range(2):
        again.iterate()
    assert_same_state(straight.state_dict(), again.state_dict())


def test_rollouts_have_the_returns_of_episodes() -> None:
    """Up to and with each step, over the border of a rollout."""
    training = make_training(line_plugins(), [*LINE_TASK, "policy.push=1", "episode.seconds=3"])
    collect = training.job.collector.collect
    found = torch.cat([collect(2).episode_returns, collect(2).episode_returns])
    assert found[:, 0].tolist() == [1, 1 + 2, 1 + 2 + 3, 1]


@pytest.mark.parametrize("difficulty", [1.0, 0.5, 0.125])
def test_evaluations_stand_at_the_difficulty(difficulty: float) -> None:
    """Whatever the training's curriculum has come to, and for as long as evaluations last."""
    plugins = line_plugins(**PARTS)
    experiment = load_experiment(
        [*TASK, f"difficulty={difficulty}", "+measure.at={name: line/value}"], plugins
    )
    evaluator = Evaluator(experiment)
    policy = make_training(plugins, TASK).job.policy
    found = evaluator.run(policy, "a", 4)
    stair = 8 * difficulty
    assert found.measures["at"].mean == stair + 100 * difficulty
    assert found.mean_episode_seconds == 4, "not the 1 + stair seconds of the curriculum"
    evaluator.run(policy, "b", 4)
    assert evaluator.built.environment.parts.curriculum.stair == stair, "it is never updated"

"""Algorithm 1 as an outer loop: its stages, its order, and a sweep that is killed."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from commands import begin, kill, wait_for
from executors import state_of
from killed_sweeps import rows, told
from worlds import assert_same_state

from understudy.command.cli import main
from understudy.errors import ConfigError
from understudy_sequencing.algorithm import Algorithm1, stages_of
from understudy_sweeps.loops import Report, Trial

SUBTASKS = {"grip": ("experiment=g",), "tuck": ("experiment=t",), "sleeve": ("experiment=s",)}
#: All seven stages in seconds.
SMALL = (
    "search=miniature/algorithm_1", "num_worlds=16", "budget.samples=512",
    "evaluation.episodes=4", "evaluation.final_episodes=4", "evaluation.seconds=0.5", "episode.seconds=0.5",
    "checkpoint.minutes=0", "run.video_seconds=0", "outer_loop.ending=any", "outer_loop.count=32",
)  # fmt: skip


def test_two_passes() -> None:
    stages = stages_of(Algorithm1.Options(SUBTASKS, weight=0.5, count=20, fields=("drag",)))
    assert list(stages) == [
        "grip_starts", "tuck_starts", "sleeve_starts", "grip_first", "tuck_first", "sleeve_first",
        "grip", "grip_ends", "tuck", "tuck_ends", "sleeve",
    ]  # fmt: skip
    towards = (
        "+reward.terms.next_start={name: sequencing/next_start, weight: 0.5, field: qpos, "
        "reads: {value: qpos}, file: '{tuck_starts}'}"
    )
    assert stages["grip_first"] == ("experiment=g", towards)
    assert stages["sleeve_first"] == ("experiment=s",), "nothing follows the last one"
    assert stages["grip"] == (
        "experiment=g", towards, "initial_states=sequencing/gaussian", "initial_states.file='{grip_starts}'",
        "initial_states.widening=2.0", "start.run='{grip_first}'",
    )  # fmt: skip
    assert stages["grip_ends"] == (
        "job=harvest", "job.run='{grip}'", "job.ending=success", "job.count=20", "job.fields=[drag]",
    )  # fmt: skip
    assert stages["sleeve"] == (
        "experiment=s", "initial_states=sequencing/gaussian", "initial_states.file='{tuck_ends}'",
        "initial_states.widening=1.0", "start.run='{sleeve_first}'",
    )  # fmt: skip


def test_first_pass_alone() -> None:
    stages = stages_of(Algorithm1.Options(SUBTASKS, passes="first", weight=0.0))
    assert stages == {f"{name}_first": own for name, own in SUBTASKS.items()}


def test_banks_cold_and_not_widened() -> None:
    options = Algorithm1.Options(SUBTASKS, starts="bank", warm=False, widening=1.0, weight=0.0)
    stages = stages_of(options)
    assert stages["grip"] == ("experiment=g",), "its own starts"
    assert stages["tuck"] == (
        "experiment=t",
        "initial_states=bank",
        "initial_states.file='{grip_ends}'",
    )


def test_what_is_no_ending_is_harvested_as_it_is_told() -> None:
    """A subtask without a successful ending: the moment at which a field changes."""
    moment = ("job.moment=change", "job.field=gripped", "job.value=1")
    stages = stages_of(Algorithm1.Options(SUBTASKS, ends={"grip": moment}, count=20))
    assert stages["grip_ends"][2:] == (*moment, "job.count=20", "job.fields=[]")
    assert "job.ending=success" in stages["tuck_ends"]
    loop = Algorithm1(Algorithm1.Options(SUBTASKS, each=("num_worlds=8",)))
    asked = loop.ask(0)
    assert asked is not None
    assert asked.overrides[:2] == ("num_worlds=8", "experiment=g")


def test_a_task_begins_in_a_bank_by_a_part_of_its_own() -> None:
    own = ("initial_states=a_part", "initial_states.file='{grip_ends}'")
    stages = stages_of(Algorithm1.Options(SUBTASKS, begins={"tuck": own}))
    assert stages["tuck"][2:] == (*own, "start.run='{tuck_first}'")
    assert stages["tuck_first"][0] == "experiment=t"
    assert not set(own) & set(stages["tuck_first"]), "the first pass begins narrowly"
    assert "initial_states=sequencing/gaussian" in stages["sleeve"], "the others as before"


def test_it_asks_as_a_chain_does() -> None:
    loop = Algorithm1(Algorithm1.Options(SUBTASKS))
    asked = [loop.ask(number) for number in range(5)]
    keys = [trial.key for trial in asked if trial]
    assert keys == ["grip_starts", "tuck_starts", "sleeve_starts", "sleeve_first"], "in parallel"
    loop.tell(Report("tuck_starts", "ok", run="runs/t"))
    trial = loop.ask(5)
    assert trial is not None
    assert trial.key == "grip_first"
    assert "file: 'runs/t'" in trial.overrides[1]
    assert loop.share == pytest.approx(1 / 11)
    again = Algorithm1(Algorithm1.Options(SUBTASKS))
    assert again.recall(Trial("sleeve_first", ("experiment=s",)))
    assert not again.recall(Trial("other"))
    with pytest.raises(ConfigError, match="had other overrides"):
        again.recall(Trial("sleeve_first", ("experiment=x",)))


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({}, "give at least one"),
        ({"subtasks": {"a b": ()}}, "letters, digits"),
        ({"subtasks": {"a": (), "a_first": ()}}, "'a_first' would be the name of two stages"),
        ({"subtasks": {"a": ()}, "ends": {"b": ()}}, "ends.b is of no subtask"),
        ({"subtasks": {"a": ()}, "begins": {"b": ()}}, "begins.b is of no subtask"),
        ({"subtasks": {"a": ()}, "begins": {"a": ()}}, "begins.a is not possible"),
        ({"subtasks": {"a": ()}, "widening": 0.0}, "widening"),
        ({"subtasks": {"a": ()}, "count": 1}, "count"),
        ({"subtasks": {"a": ()}, "weight": -1.0}, "weight"),
    ],
)
def test_refused(options: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        Algorithm1.Options(**options)


@pytest.mark.slow
def test_killed_and_begun_again(tmp_path: Path) -> None:
    """A sweep that is killed in its second pass ends as one that never was."""
    straight, killed = tmp_path / "straight", tmp_path / "killed"
    process = begin("sweep", *SMALL, f"run.dir={killed}")
    wait_for(process, killed / "first" / "checkpoints")
    kill(process)
    assert main(["sweep", *SMALL, f"run.dir={straight}"]) == 0
    assert main(["sweep", *SMALL, f"run.dir={killed}"]) == 0
    counts = Counter(row["event"] for row in rows(killed))
    assert counts["asked"] == counts["finished"] == 7
    assert finished(killed) == finished(straight)
    for key in ("first_first", "first", "second"):
        assert_same_state(state_of(straight, key), state_of(killed, key))


def finished(folder: Path) -> list[dict[str, Any]]:
    return [row["report"] for row in told(folder) if row["event"] == "finished"]

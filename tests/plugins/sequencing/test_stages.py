"""The state machine: who acts, when a stage is done, and how its endings are counted."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
import torch
from miniatures import QUICK

from understudy.command.cli import main
from understudy.errors import ConfigError
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy_sequencing.stages import Stage, Stages, Until
from understudy_skills import controller as controllers
from understudy_skills.controller import Controller


@pytest.fixture(scope="module")
def place(built_on: Path) -> Path:
    """The run of a policy that goes to a place."""
    return built_on / "sleeve"


@pytest.fixture(scope="module")
def slow(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One that decides every third control period."""
    folder = tmp_path_factory.mktemp("places") / "slow"
    short = (
        "control.decision=3",
        "budget.samples=1024",
        *QUICK,
        "run.video_seconds=0",
        f"run.dir={folder}",
    )
    assert main(["train", "experiment=miniature/sleeve", *short]) == 0
    return folder


def stages(
    first: Path, second: Path, seconds: float = 5.0, lasting: float = 0.0, within: float = 0.3
) -> str:
    def one(run: Path, name: str) -> str:
        until = f"{{field: {name}_distance, at_most: {within}, lasting: {lasting}}}"
        return (
            f"{{run: {run}, until: {until}, seconds: {seconds}, reads: {{offset: {name}_offset}}}}"
        )

    return f"actuation.stages=[{one(first, 'first')}, {one(second, 'second')}]"


def build(*words: str) -> Any:
    return build_environment(load_experiment(["experiment=miniature/in_sequence", *words]))


def test_one_after_another(place: Path) -> None:
    environment = build(stages(place, place, within=1.0), "num_worlds=16", "seed=1").environment
    environment.reset()
    table = environment.table
    done = torch.zeros(16, dtype=torch.bool)
    for _ in range(60):
        stage, near = table["stage"].clone(), table["first_distance"] <= 1.0
        begun = table["episode_step"] > 0
        step = environment.advance(torch.zeros(16, 1))
        first = stage == 0
        assert torch.equal(table["stage"][first] == 1, (near & begun)[first])
        assert (table["stage_seconds"][table["stage"] > stage] == 0).all()
        done |= step.terminated & ~step.failed
        environment.begin(step.ended)
    assert done.float().mean() > 0.6, "both places were come near to"


def test_it_acts_as_the_run_alone_does(place: Path, slow: Path) -> None:
    """The first stage, from the same start, moves as its own task's policy does."""
    for run, decision in ((place, 1), (slow, 3)):
        built = build(stages(run, place), "num_worlds=4")
        environment, context = built.environment, built.context
        controller = Controller.load(str(run), context, any_rate=True)
        assert controller.decision == decision
        environment.reset()
        table = environment.table
        held = None
        for period in range(7):
            fields = {
                "offset": table["first_offset"].clone(),
                "velocity": table["velocity"].clone(),
            }
            if period % decision == 0:
                held = controller.decide(fields)
            assert held is not None
            wanted = controller.control(held, fields)
            environment.advance(torch.zeros(4, 1))
            at_first = table["stage"] == 0
            torch.testing.assert_close(table["stage_action"][at_first], held[at_first])
            torch.testing.assert_close(
                environment.parts.actuation.part.control(
                    torch.zeros(4, 1), **table.pick(environment.parts.actuation.reads)
                )[at_first],
                wanted[at_first],
            )


def test_longer_control_periods_keep_their_controls(place: Path, slow: Path) -> None:
    """As the run alone does: every third period of this task is one of its own."""
    for run, decision in ((place, 3), (slow, 9)):
        built = build(stages(run, place, within=0.0), "num_worlds=4", "control.frequency=30")
        environment, context = built.environment, built.context
        controller = Controller.load(str(run), context, any_rate=True, slower=True)
        assert (controller.decision, controller.holds) == (decision, decision)
        environment.reset()
        table, part = environment.table, environment.parts.actuation.part
        wanted = None
        for period in range(20):
            fields = {
                "offset": table["first_offset"].clone(),
                "velocity": table["velocity"].clone(),
            }
            if period % decision == 0:
                wanted = controller(fields)
            environment.advance(torch.zeros(4, 1))
            given = part.control(torch.zeros(4, 1), **table.pick(environment.parts.actuation.reads))
            torch.testing.assert_close(given, wanted)
        assert (table["stage"] == 0).all()


def test_control_periods_that_do_not_go_into_its_own_are_refused(place: Path) -> None:
    for rate in ("15", "5", "25"):
        with pytest.raises(ConfigError, match="decides 10 times a second"):
            build(stages(place, place), "num_worlds=1", f"control.frequency={rate}")
    context = build(stages(place, place), "num_worlds=1", "control.frequency=30").context
    with pytest.raises(ConfigError, match="decides 10 times a second"):
        Controller.load(str(place), context, any_rate=True)  # by who cannot keep controls


@pytest.mark.parametrize("wrong", [float("nan"), float("inf"), -float("inf"), 1e12, -3.0])
def test_a_stage_that_went_wrong_stays_in_its_world(place: Path, wrong: float) -> None:
    environment = build(stages(place, place), "num_worlds=3").environment
    environment.reset()
    part, table = environment.parts.actuation.part, environment.table
    fields = dict(table.pick(environment.parts.actuation.reads))

    def found(stage: torch.Tensor) -> list[torch.Tensor]:
        made = part.advance(torch.zeros(3, 1), **{**fields, "stage": stage})
        return [*made.values(), part.control(torch.zeros(3, 1), **{**fields, **made})]

    stage = torch.tensor([0.0, 1.0, 0.0])
    sound, bad = found(stage), found(torch.where(torch.arange(3) == 1, wrong, stage))
    for own, others in zip(sound, bad, strict=True):
        assert torch.equal(own[[0, 2]], others[[0, 2]])


def test_a_run_that_stands_in_itself_is_refused(
    place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = tmp_path / "endless"
    shutil.copytree(place, run)
    info = json.loads((run / "run.json").read_text())
    own = {"run": str(run), "until": {"field": "distance", "at_most": 1.0}}
    info["config"]["actuation"] = {"name": "sequencing/stages", "stages": [own]}
    (run / "run.json").write_text(json.dumps(info))
    context = build(stages(place, place), "num_worlds=1").context
    with monkeypatch.context() as patch:
        patch.setattr(controllers, "_MOST", 10**6)
        with pytest.raises(ConfigError, match="perhaps it stands in itself"):
            Controller.load(str(run), context, any_rate=True)
    own["run"] = str(place)
    info["config"]["actuation"]["stages"] = [own] * 101
    (run / "run.json").write_text(json.dumps(info))
    with pytest.raises(ConfigError, match="100 in all"):
        Controller.load(str(run), context, any_rate=True)


def test_a_criterion_has_to_last(place: Path) -> None:
    def change(lasting: float) -> int:
        """The decision that the second stage begins with, where the first one's criterion always holds."""
        words = (stages(place, place, lasting=lasting, within=1e6), "num_worlds=1")
        environment = build(*words).environment
        environment.reset()
        for period in range(60):
            environment.advance(torch.zeros(1, 1))
            if environment.table["stage"] > 0:
                return period
        return 60

    assert [change(0.0), change(0.1), change(0.3)] == [1, 1, 3]


def test_a_stage_may_end_after_a_time(place: Path) -> None:
    """0.3 s are three periods, whatever the fields of the task."""
    words = stages(place, place).replace(
        "{field: first_distance, at_most: 0.3, lasting: 0.0}",
        "{field: stage_seconds, at_least: 0.299}",
    )
    environment = build(words, "num_worlds=2").environment
    environment.reset()
    seen = []
    for _ in range(5):
        environment.advance(torch.zeros(2, 1))
        seen.append(environment.table["stage"].tolist())
    assert [s[0] for s in seen] == [0, 0, 0, 1, 1]
    assert all(a == b for a, b in seen)


def test_a_stage_may_read_what_was_decided_last(place: Path) -> None:
    """As a run that observes its own last action does; of the same size here, so that it stands for the offset."""
    words = stages(place, place).replace("offset: second_offset", "offset: stage_action")
    environment = build(words, "num_worlds=2").environment
    environment.reset()
    environment.advance(torch.zeros(2, 1))
    assert environment.table["stage_action"].shape == (2, 2)


def test_endings_are_counted_by_stage(place: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    short = stages(place, place, seconds=0.3)
    words = (
        "experiment=miniature/in_sequence",
        "run.video_seconds=0",
        "evaluation.final_episodes=16",
    )
    assert main(["train", *words, short, f"run.dir={run}"]) == 0
    found = json.loads((run / "evaluation.json").read_text())
    violated = found["violated"]
    assert violated["first_overtime"] + violated["second_overtime"] > 0.9
    assert found["measures"]["first"]["mean"] == pytest.approx(1.0 - violated["first_overtime"])
    assert found["success_rate"] < 0.1


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: Until("d"), "without a limit is never done"),
        (lambda: Until("d", at_most=1.0, lasting=-1.0), "lasting"),
        (lambda: Stage("a", Until("d", at_most=1.0), seconds=0.0), "seconds"),
        (lambda: Until("d", at_least=2.0, at_most=1.0), "at_least=2 is above at_most=1"),
        (lambda: Until("reward", at_least=2.0), "known only once"),
        (lambda: Stage("a", Until("d", at_most=1.0, lasting=3.0), seconds=2.0), "is over before"),
        (
            lambda: Stage("a", Until("stage_seconds", at_least=3.0), seconds=2.0),
            "at_least=3 of stage_seconds",
        ),
        (
            lambda: Stage("a", Until("stage_seconds", at_least=1.5, lasting=1.0), seconds=2.0),
            "is over before",
        ),
        (lambda: Until("stage", at_least=1.0), "stays as it is until a stage is done"),
        (lambda: Until("stage_limit", at_least=1.0), "stays as it is"),
        (lambda: Stages.Options(()), "name at least one"),
    ],
)
def test_options_refused(make: Any, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        make()


def test_bad_stages_are_one_sentence(
    place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "run"
    good = stages(place, place)
    for change, sentence in (
        (good.replace("first_distance", "first_distanse"), "first_distanse"),
        (good.replace(str(place), str(tmp_path / "none")), "none"),
        (
            good.replace("{offset: first_offset}", "{ofset: first_offset}"),
            "actuation.stages[0].reads: ",
        ),
        (
            good.replace("field: first_distance", "field: first_offset"),
            "actuation.stages[0].until.field=first_offset has the shape [2]",
        ),
        (
            good.replace("offset: second_offset", "offset: second_distance"),
            "cannot act on fields of these shapes, offset [], ",
        ),
        (
            good.replace("offset: second_offset", "offset: action"),
            "reads its own last action",
        ),
    ):
        assert main(["train", "experiment=miniature/in_sequence", change, f"run.dir={run}"]) == 2
        error = capsys.readouterr().err.strip().splitlines()
        assert sentence in error[-1]
        assert not run.exists()

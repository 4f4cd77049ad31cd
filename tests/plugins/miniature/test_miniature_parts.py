"""What the parts above other runs and searches do, with numbers."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from counted_task import LINE_TASK, line_plugins
from miniatures import QUICK, overrides_of, train
from spoiled_runs import spoiled
from worlds import make_training

from understudy.command.cli import main
from understudy.errors import ConfigError, RunError, TrainingError
from understudy.records.runs import open_run
from understudy.running.training import Training
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy_miniature.cmfbo import RandomFidelity
from understudy_reinforcement.job import Reinforcement
from understudy_skills import bank
from understudy_skills.controller import Controller
from understudy_skills.harvest import Harvest
from understudy_sweeps.loops import Report


def prepared(*overrides: str) -> Training:
    return Training(load_experiment(overrides)).prepare()


def test_each_world_is_moved_by_its_own_controller_towards_its_own_goal(built_on: Path) -> None:
    built = build_environment(load_experiment([*overrides_of("sitting", built_on), "num_worlds=4"]))
    environment, simulator = built.environment, built.environment.parts.simulator
    environment.reset(seed=2)
    alone = [Controller.load(str(built_on / name), built.context) for name in ("go", "stop")]
    action = torch.tensor([[0.0, 1.0, 0.5], [1.0, 1.0, 0.5], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])
    fields = {"offset": 2.0 * action[:, 1:], "velocity": environment.table["velocity"]}
    expected = torch.where((action[:, :1] == 0), alone[0](fields), alone[1](fields))
    seen: list[torch.Tensor] = []
    step = simulator.step

    def spy(control: torch.Tensor, substeps: int | None = None) -> None:
        seen.append(control.clone())
        step(control, substeps)

    simulator.step = spy  # type: ignore[method-assign]
    environment.advance(action)
    assert len(seen) == environment.decision == 5
    torch.testing.assert_close(seen[0], expected)
    assert not torch.equal(seen[0], seen[4]), "controls follow the state within a decision"
    assert environment.table["switch"].tolist() == [0.0, 1.0, 0.0, 1.0]


def elsewhere(run: Path, folder: Path) -> Path:
    """A copy of `run`, as if it had been trained on a simulator that is not installed here."""
    shutil.copytree(run, folder)
    info = json.loads((folder / "run.json").read_text())
    info["config"]["simulator"] = {"name": "elsewhere"}
    (folder / "run.json").write_text(json.dumps(info))
    return folder


def test_a_controller_acts_on_this_tasks_simulator(built_on: Path, tmp_path: Path) -> None:
    runs = [elsewhere(built_on / name, tmp_path / name) for name in ("go", "stop")]
    training = prepared(
        *overrides_of("sitting", built_on), f"actuation.runs=[{runs[0]},{runs[1]}]", "num_worlds=2"
    )
    assert training.iterate()["reward"] != 0


def test_a_harvest_may_be_on_another_simulator(built_on: Path, tmp_path: Path) -> None:
    run = elsewhere(built_on / "sleeve", tmp_path / "sleeve")
    given = [*overrides_of("sleeve_bank", built_on), f"job.run={run}", "num_worlds=64"]
    with pytest.raises(ConfigError, match="elsewhere"):
        prepared(*given)
    own = json.loads((built_on / "sleeve" / "run.json").read_text())["config"]["simulator"]["name"]
    training = prepared(*given, f"+simulator.name={own}")
    training.iterate()
    assert "states" in training.job.stage()


def test_a_bank_has_states_that_ended_as_they_should(built_on: Path) -> None:
    states = bank.load(built_on / "bank")
    assert set(states) == {"positions", "velocities", "drag"}
    assert len(states["drag"]) == 64
    distance = (states["positions"][:, 0] - torch.tensor([1.5, 0.0])).norm(dim=1)
    assert (distance <= 0.2).all()
    assert states["drag"].min() >= 0.5
    assert states["drag"].std() > 0.1, "worlds differed"


def test_a_harvest_of_any_ending_has_states_of_episodes_that_failed_too(built_on: Path) -> None:
    harvests = {}
    for ending in ("success", "any"):
        training = prepared(*overrides_of("sleeve_bank", built_on), f"job.ending={ending}")
        training.iterate()
        assert isinstance(training.job, Harvest)
        positions = training.job.state_dict()["found"]["positions"][:, 0]
        harvests[ending] = (positions - torch.tensor([1.5, 0.0])).norm(dim=1)
    assert (harvests["success"] <= 0.2).all()
    assert (harvests["any"] > 0.2).any()
    assert len(harvests["any"]) > len(harvests["success"])


def test_a_harvest_from_anywhere_keeps_each_moment_of_an_episode_as_often(built_on: Path) -> None:
    harvest = prepared(
        *overrides_of("sleeve_bank", built_on), "job.moment=anywhere", "num_worlds=4000"
    ).job
    assert isinstance(harvest, Harvest)
    for moment in range(10):
        ended = torch.full((4000,), moment == 9)
        kept = harvest._chosen({"at": torch.full((4000, 2), float(moment))}, ended)["at"]
    times = torch.bincount(kept[:, 0].long(), minlength=10)
    assert 320 < int(times.min()) <= int(times.max()) < 480, "400 each, to four standard deviations"
    kept = harvest._chosen({"at": torch.full((4000, 2), 99.0)}, torch.zeros(4000).bool())["at"]
    assert (kept == 99.0).all(), "the next episode has no other state yet"


def test_a_harvest_of_changes_keeps_the_states_that_a_decision_changed(
    built_on: Path, tmp_path: Path
) -> None:
    """Each world's in turn, and not that of a decision which only begins an episode."""
    above = tmp_path / "above"
    shape = (*QUICK, "num_worlds=4", f"run.dir={above}")
    train(*overrides_of("sitting", built_on), "budget.samples=1", *shape)
    harvest = prepared(
        *("experiment=miniature/sleeve_bank", f"job.run={above}", "job.moment=change"),
        *("job.field=switch", "job.value=1", "job.fields=[]", "num_worlds=4"),
    ).job
    assert isinstance(harvest, Harvest)
    table = harvest.environment.table
    for switches, changed in (
        ([1, 0, 1, 0], [0, 0, 0, 0]),  # the first decision of an episode
        ([1, 1, 0, 0], [0, 1, 0, 0]),
        ([0, 1, 1, 0], [0, 0, 1, 0]),
    ):
        before = table["positions"].clone()
        action = torch.tensor([[float(k), 0.5, 0.5] for k in switches])
        states, counts, _ = harvest._advance(action)
        assert counts.long().tolist() == changed
        torch.testing.assert_close(states["positions"], before)
        assert not torch.equal(table["positions"], before)


def test_a_harvest_is_as_hard_as_the_training_came_to_or_as_the_task_is_judged(
    built_on: Path, tmp_path: Path
) -> None:
    above = tmp_path / "above"
    easy = ("curriculum.threshold=-1000", "curriculum.episodes=1", "curriculum.step=0.25")
    train(
        *overrides_of("sitting", built_on), *easy, "budget.samples=2000", *QUICK, f"run.dir={above}"
    )
    came_to = open_run(above).newest()[0]["environment"]["curriculum"]["difficulty"]
    assert came_to > 0.0
    for evaluating, expected in (("false", came_to), ("true", 1.0)):
        harvest = prepared(
            *("experiment=miniature/sleeve_bank", f"job.run={above}", "job.moment=change"),
            *("job.field=switch", "job.value=1", "job.fields=[]", "num_worlds=4"),
            f"job.evaluating={evaluating}",
        ).job
        assert isinstance(harvest, Harvest)
        assert harvest.environment.table["difficulty"].tolist() == [expected] * 4


def test_dressing_begins_in_the_bank_with_what_was_learned(built_on: Path) -> None:
    training = prepared(*overrides_of("dressing", built_on), "num_worlds=256")
    table = training.job.environment.table  # type: ignore[attr-defined]
    states = bank.load(built_on / "bank")
    known = {tuple(row) for row in states["positions"][:, 0].tolist()}
    assert {tuple(row) for row in table["positions"][:, 0].tolist()} <= known
    assert set(table["drag"].tolist()) <= set(states["drag"].tolist())
    first = prepared("experiment=miniature/sleeve", f"start.run={built_on / 'sleeve'}")
    own, other = (t.job.policy.state_dict() for t in (training, first))  # type: ignore[attr-defined]
    fresh = prepared("experiment=miniature/sleeve").job.policy.state_dict()  # type: ignore[attr-defined]
    assert all(torch.equal(own[name], other[name]) for name in own)
    assert not torch.equal(own["actor.0.weight"], fresh["actor.0.weight"])


@pytest.mark.parametrize(
    ("more", "sentence"),
    [
        ("job.fields=[darg]", "job.fields names 'darg'.*Did you mean 'drag'"),
        ("job.ending=reaches", "job.ending=reaches is no ending.*Did you mean 'reached'"),
        (
            "job.ending=failure",
            "no episode of .* can end so, .* is a failure .reached..* job.ending=truncation",
        ),
        ("job.field=drag", "moment=end with field=drag is not possible"),
        ("job.moment=change", "moment=change with field=None is not possible"),
        ("job={moment: change, field: darg}", "job.field=darg is no field.*Did you mean 'drag'"),
    ],
)
def test_harvests_of_what_is_not_there_are_refused(
    built_on: Path, more: str, sentence: str
) -> None:
    with pytest.raises(ConfigError, match=sentence):
        prepared(*overrides_of("sleeve_bank", built_on), more)


def test_a_harvest_whose_budget_ends_says_what_it_has(
    built_on: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without a state it ended well and left no bank; with too few it left them without a word."""
    words = [
        *overrides_of("sleeve_bank", built_on),
        "run.video_seconds=0",
        "job.decisions=1",
        "num_worlds=2",
    ]
    assert main(["train", *words, "budget.samples=2", f"run.dir={tmp_path / 'none'}"]) == 1
    said = capsys.readouterr().err
    assert (
        "No state was found before the budget was spent, so there is no bank: understudy resume"
        in said
    )
    assert not (tmp_path / "none/bank.json").exists()
    more = ["job.decisions=64", "num_worlds=64", "job.count=100000", "budget.samples=4096"]
    assert main(["train", *words, *more, f"run.dir={tmp_path / 'few'}"]) == 0
    count = len(bank.load(tmp_path / "few")["positions"])
    assert f"The budget was spent at {count} of 100000 states" in capsys.readouterr().err


@pytest.mark.parametrize(
    "spoil",
    [lambda v: None, lambda v: "x", lambda v: [], lambda v: v[:-1], lambda v: v[..., :1], lambda v: v.bool()],
)  # fmt: skip
def test_a_harvest_goes_on_with_states_alone(
    spoil: Any, built_on: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [
        *overrides_of("sleeve_bank", built_on),
        "run.video_seconds=0",
        "job.ending=any",
        "job.count=1000",
    ]
    folder = ["budget.samples=4096", f"run.dir={tmp_path / 'first'}"]
    assert main(["train", *words, *folder]) == 0
    state, _ = open_run(tmp_path / "first").newest()
    found = {**state["found"], "positions": spoil(state["found"]["positions"])}
    run = spoiled(tmp_path / "first", tmp_path / "run", found=found)
    assert main(["resume", str(run), "budget.samples=8192"]) == 2
    said = capsys.readouterr().err
    assert (
        "understudy: The checkpoint does not fit" in said
        or "understudy: The states of the checkpoint" in said
    )


def test_a_hopeless_harvest_stops(built_on: Path) -> None:
    """No point can get there in the first tenth of a second."""
    training = prepared(
        *overrides_of("sleeve_bank", built_on), "job.decisions=1", "job.patience=1", "num_worlds=2"
    )
    with pytest.raises(
        TrainingError,
        match=r"No episode of .* ended by job.ending=success in 1 decisions of 2 worlds\. Train",
    ):
        training.iterate()


def test_a_harvest_that_finds_no_more_says_how_many_it_had(built_on: Path) -> None:
    training = prepared(
        *overrides_of("sleeve_bank", built_on), "job.decisions=1", "job.patience=1", "num_worlds=2",
        "job.count=9",
    )  # fmt: skip
    job = training.job
    assert isinstance(job, Harvest)
    job._gathered.add({name: job.environment.table[name].clone() for name in job._names})
    with pytest.raises(
        TrainingError, match=r"No further episode of .* of 2 worlds, after 2 of 9 states\. Train it"
    ):
        training.iterate()


@pytest.mark.parametrize(
    "policy", [3, [], {}, {"log_deviation": torch.zeros(2, dtype=torch.bool)}], ids=str
)
def test_a_harvest_of_a_run_whose_policy_is_none(
    policy: Any, built_on: Path, tmp_path: Path
) -> None:
    run = spoiled(built_on / "sleeve", tmp_path / "run", policy=policy)
    with pytest.raises(
        RunError, match=r"^job\.run: .* (is a run that learns no policy|does not fit)"
    ):
        prepared("experiment=miniature/sleeve_bank", f"job.run={run}")


def test_a_harvest_of_what_learns_no_policy_says_so(built_on: Path) -> None:
    """Not that a scene is missing, which nobody left out."""
    with pytest.raises(RunError, match=r"^job\.run: .*poses is a run that learns no policy\. Name"):
        prepared("experiment=miniature/sleeve_bank", f"job.run={built_on / 'poses'}")


@pytest.mark.parametrize("network", [None, 3, {}], ids=str)
def test_an_auto_encoder_without_its_network_is_refused(
    network: Any, built_on: Path, tmp_path: Path
) -> None:
    run = spoiled(built_on / "poses", tmp_path / "run", network=network)
    with pytest.raises(
        RunError, match=r"^The auto-encoder of .*run does not fit its own config.*: 'network"
    ):
        prepared("experiment=miniature/styles", f"actuation.run={run}")


def test_a_run_of_something_else_is_no_auto_encoder(built_on: Path) -> None:
    with pytest.raises(RunError, match="trained no auto-encoder"):
        prepared("experiment=miniature/styles", f"actuation.run={built_on / 'go'}")


def test_both_hands_use_the_same_parts_under_names_of_their_own() -> None:
    training = prepared("experiment=miniature/chopsticks", "num_worlds=8")
    environment = training.job.environment  # type: ignore[attr-defined]
    table = environment.table
    for side, body in (("left", 2), ("right", 3)):
        way = table[f"{side}_target"] - table["positions"][:, body]
        torch.testing.assert_close(table[f"{side}_offset"], way)
        torch.testing.assert_close(environment.observations[side][:, :2], way)
    step = environment.advance(torch.zeros(8, 4))
    expected = torch.exp(-table["left_distance"] - table["right_distance"])
    torch.testing.assert_close(step.rewards, expected)


def search(**more: Any) -> RandomFidelity:
    return RandomFidelity(RandomFidelity.Options(low={"a.b": 0.0}, high={"a.b": 2.0}, **more), 3)


def finished(key: str, objective: float) -> Report:
    return Report(key, "ok", objective, run=f"runs/{key}")


def test_a_search_from_high_to_low_is_none() -> None:
    with pytest.raises(
        ValueError, match=r"^high\.a\.b=0 is not possible: it must be at least low\.a\.b=2\."
    ):
        RandomFidelity.Options(low={"a.b": 2.0}, high={"a.b": 0.0})


@pytest.mark.parametrize(("words", "said"), [(["difficulty=0.3"], 1), ([], 0)])
def test_a_difficulty_that_nothing_reads_is_said(words: list[str], said: int) -> None:
    note = "difficulty=0.3 changes nothing: no part of this task reads it."
    task = make_training(line_plugins(), [*LINE_TASK, *words])
    assert isinstance(task.job, Reinforcement)
    assert task.job.notes().count(note) == said
    for reads in ("go", "jumping"):  # its initial states, and its curriculum
        job = prepared(f"experiment=miniature/{reads}", *words).job
        assert isinstance(job, Reinforcement)
        assert note not in job.notes()


def test_a_run_that_could_not_be_resumed_is_locked_no_more(
    built_on: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A notebook's process goes on, and said that another process trains there."""
    shutil.copytree(built_on / "go", tmp_path / "run")
    assert main(["resume", str(tmp_path / "run"), "policy.hidden=[3]"]) == 2
    assert "does not fit this configuration" in capsys.readouterr().err
    assert main(["resume", str(tmp_path / "run")]) == 0


@pytest.mark.parametrize("key", ["x", "trial", "trial-1", "trial0x", "trial1"])
def test_a_trial_that_a_search_never_asked_for_is_none_of_its_own(key: str) -> None:
    first = search(trials=4).ask(0)
    assert first is not None
    with pytest.raises(ConfigError, match=f"'{key}' was at another point"):
        search(trials=4).recall(replace(first, key=key))


def test_a_search_raises_fidelity_and_begins_from_the_best() -> None:
    loop = search(trials=4)
    first = [loop.ask(0), loop.ask(1)]
    assert [t and t.fidelity for t in first] == [0.2, 0.2]
    assert all(t is not None and 0 <= t.point["a.b"] <= 2 for t in first)
    assert loop.ask(2) is None, "what it would begin from is not known yet"
    loop.tell(finished("trial0", 0.9))
    loop.tell(finished("trial1", 0.4))
    third = loop.ask(2)
    assert third is not None
    assert third.start is not None
    assert (third.fidelity, third.start["trial"]) == (1.0, "trial0")
    assert loop.ask(4) is None


def test_a_search_stops_what_is_worse_than_the_best_at_its_fidelity() -> None:
    loop = search(trials=3, fidelities=(0.5,), margin=0.2)
    loop.ask(0), loop.ask(1)
    assert loop.tell(Report("trial1", "running", 0.0)) is None, "there is nothing to compare with"
    loop.tell(finished("trial0", 0.9))
    assert loop.tell(Report("trial1", "running", 0.8)) is None
    assert loop.tell(Report("trial1", "running", 0.6)) == "stop"


def test_a_search_repeats_itself() -> None:
    one, two = search(trials=3), search(trials=3)
    first = one.ask(0)
    assert first is not None
    assert two.recall(first)
    assert one.ask(1) == two.ask(1)


def test_a_component_given_whole_inherits_no_option() -> None:
    """As a trial's initial states are: the task's own have options that a bank has not."""
    given = "initial_states={name: bank, file: somewhere}"
    experiment = load_experiment(
        ["experiment=miniature/sleeve", given, "initial_states.leave=[drag]"]
    )
    assert experiment.need("initial_states").effective() == {
        "name": "bank", "file": "somewhere", "leave": ("drag",), "beside": (),
    }  # fmt: skip
    assert load_experiment(["experiment=miniature/sleeve", "scene.drag=2"]).effective()["scene"] == {
        **load_experiment(["experiment=miniature/sleeve"]).effective()["scene"], "drag": 2.0
    }  # fmt: skip


@pytest.mark.parametrize("number", [-1, 1, 2])
def test_a_point_that_the_scene_has_not_got_is_refused(number: int) -> None:
    """The last one was taken for −1, and others ended in a traceback."""
    with pytest.raises(ConfigError, match=f"number={number} is none of the scene's points"):
        build_environment(load_experiment(["task=miniature/go", f"fields.body.number={number}"]))

"""A run-up and a jump in one episode, by two runs that learned next to nothing."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
import torch
from miniatures import AT_ONCE
from worlds import SMALL

from understudy.command.cli import main
from understudy.errors import ConfigError
from understudy.records import checkpoint
from understudy.running.environment import Environment
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy_jumping.approach import beside
from understudy_skills import bank
from understudy_skills.pack_inputs import PackInputs
from understudy_skills.skill import open_skill
from understudy_tensors import rotations

TINY = (
    *SMALL, "num_worlds=4", "learner.rollout_steps=8", "budget.samples=32", "evaluation.episodes=4",
    "evaluation.final_episodes=4", "run.video_seconds=0",
)  # fmt: skip
#: Of a generated run, shortly before its take-off.
CLIP = ("motion.name=run", "motion.file=null", "fields.arrival.at=2.0")


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of ``run_up``, ``jump`` and ``end``, the bank of where the run-up ends by its mode."""
    place = tmp_path_factory.mktemp("in_one")
    begin = ("initial_states.begin=1.7", "initial_states.end=1.8")
    run_up = ("task=jumping/run_up", *CLIP, *TINY, "control.substeps=10", *begin)
    assert main(["train", *run_up, f"run.dir={place / 'run_up'}"]) == 0
    jump = ("task=jumping/high", *TINY, "control.substeps=5", *AT_ONCE)
    assert main(["train", *jump, f"run.dir={place / 'jump'}"]) == 0
    harvest = (
        "job=harvest",
        f"job.run={place / 'run_up'}",
        "job.evaluating=true",
        "job.deterministic=true",
    )
    assert main(["train", *harvest, "job.count=2", "num_worlds=2", f"run.dir={place / 'end'}"]) == 0
    return place


def test_a_bank_says_from_what_clip_it_comes(runs: Path) -> None:
    """So that who uses it knows on what terms."""
    about = checkpoint.load(runs / "end" / "bank")[1]["bank"]
    assert about["clips"] == [{"clip": "run", "licence": "Apache-2.0 (generated)"}]


@pytest.fixture(scope="module")
def played(runs: Path) -> Path:
    """The run folder of both in one episode."""
    assert (
        main(["train", *words(runs), *AT_ONCE, "run.video_seconds=0", f"run.dir={runs / 'whole'}"])
        == 0
    )
    return runs / "whole"


def test_a_pack_of_both_plays_both(
    played: Path, runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:  # fmt: skip
    """It was refused, since a pack had one policy."""
    file = tmp_path / "both.json"
    assert main(["play", str(played), "--pack", str(file)]) == 0
    assert f"The pack has the policy of {runs / 'jump'}, " in capsys.readouterr().out
    monkeypatch.chdir(tmp_path)
    text = file.read_text()
    assert str(runs) not in text, "no folder of its makers"
    inputs = open_skill(str(file)).experiment.inputs
    assert isinstance(inputs, PackInputs)
    assert {*inputs.policies} == {"controller run_up", "controller jump"}
    assert {*inputs.banks} == {"bank end"}
    capsys.readouterr()
    found = []
    for source in (played, file):
        assert main(["licence", str(source), "--json"]) == 0
        items = json.loads(capsys.readouterr().out)["items"]
        found.append({item["what"]: item["licence"] for item in items})
    assert found[0] == found[1]
    assert main(["evaluate", str(file), "half_step=false", "episodes=32"]) == 0
    (made,) = (tmp_path / "runs" / "skills").iterdir()
    judged = [json.loads(next(p.glob("evaluation*.json")).read_text()) for p in (played, made)]
    means = [{name: m["mean"] for name, m in one["measures"].items()} for one in judged]
    assert means[0] == means[1], "it does what the run does"


def test_the_licence_of_a_pack_names_the_bank_that_it_was_given(
    runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of which its run has no copy, and whose states are in the pack."""
    given = f"initial_states={{name: jumping/harvested, file: {runs / 'end'}}}"
    file = tmp_path / "jump.json"
    assert main(["play", str(runs / "jump"), given, "--pack", str(file)]) == 0
    capsys.readouterr()
    assert main(["licence", str(file), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["items"]
    (item,) = [item for item in found if item["what"] == "file end"]
    assert item["licence"] == "Apache-2.0 (generated)"


def test_its_licence_names_clip_bank_and_both_policies(
    played: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["licence", str(played), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["items"]
    assert {item["what"]: item["licence"] for item in found} == {
        "code understudy": "Apache-2.0",
        "clip run": "Apache-2.0 (generated)",
        "model jumper": "Apache-2.0",
        "file end": "Apache-2.0 (generated)",
        "weights of jump": "Apache-2.0",
        "weights of run_up": "Apache-2.0 (generated) AND Apache-2.0",
    }


def words(runs: Path) -> list[str]:
    reads = (
        "{reference_root_position: approached_position, reference_root_heading: approached_heading}"
    )
    first = f"{{run: {runs / 'run_up'}, until: {{field: arrived, at_least: 1}}, seconds: 5, reads: {reads}}}"
    second = f"{{run: {runs / 'jump'}, until: {{field: landed, at_least: 1}}, seconds: 1.99}}"
    return [
        "experiment=jumping/in_one", *CLIP, f"actuation.stages=[{first}, {second}]", "num_worlds=2",
        f"initial_states.file={runs / 'end'}", "initial_states.begin=1.7",
    ]  # fmt: skip


def whole(runs: Path, *more: str) -> Environment:
    experiment = load_experiment([*words(runs), *more])
    found = build_environment(experiment, evaluating=True).environment
    found.reset(seed=0)
    return found


READ = ("ended", "ended_at", "approach_goal")


def at_the_take_off(environment: Environment) -> torch.Tensor:
    """(nq,) where the first stage ends."""
    for _ in range(60):
        before = environment.table["qpos"][0].clone()
        assert float(environment.table["crashed"][0]) == 0.0, "feet that run touch the ground"
        environment.advance(torch.zeros(2, 1))
        if float(environment.table["stage"][0]) == 1.0:
            return before
    raise AssertionError("it never arrives")


def test_the_run_up_ends_as_it_does_alone(runs: Path) -> None:
    """In the heading of its clip, so that friction along the world's axes is the same; but for the clip's velocities, which are
    of poses twice as near to one another here."""
    end = bank.load(runs / "end")["qpos"][0]
    heading = float(rotations.heading(end[3:7]))
    environment = whole(runs, f"initial_states.alpha={heading + math.pi / 2}")
    assert float(environment.table["approach_turn"][0]) == pytest.approx(0.0, abs=1e-6)
    shift = environment.table["approach_shift"][0].clone()
    found = at_the_take_off(environment)
    environment.close()
    np.testing.assert_allclose(found[2:], end[2:], atol=3e-3)
    np.testing.assert_allclose(found[:2], end[:2] + shift, atol=3e-3)


@pytest.mark.parametrize("alpha", [-0.05, 1.2])
def test_it_arrives_where_the_jump_begins(alpha: float, runs: Path) -> None:
    environment = whole(runs, f"initial_states.alpha={alpha}", "difficulty=1.0")
    start = environment.table["qpos"][0].clone()
    away = environment.table["root_position"] - environment.table["approached_position"]
    assert float(away[:, :2].abs().max()) < 1e-4, "it begins where the clip is"
    turned = environment.table["root_heading"] - environment.table["approached_heading"]
    assert float(turned.sin().abs().max()) < 1e-4
    found = at_the_take_off(environment)
    assert float(environment.table["obstacle_height"][0]) == 2.0
    environment.close()
    distance = 1.2 + 0.8 * max(0.0, math.sin(alpha))
    np.testing.assert_allclose(found[:2], [-distance, 0.0], atol=0.05)
    heading = float(rotations.heading(found[3:7]))
    assert math.cos(heading - (alpha - math.pi / 2)) > math.cos(0.1)
    assert float((found[:2] - start[:2]).norm()) > 0.5, "it ran there"


#: Servos that carry nothing.
LIMP = ("scene.servos.natural_frequency=0.3", "scene.servos.keep=false")
FEW = ("evaluation.episodes=2", "evaluation.final_episodes=2", "run.video_seconds=0")


def test_who_falls_in_the_run_up_never_arrives(runs: Path, tmp_path: Path) -> None:
    """The clip's time comes to the take-off of who lies on the ground, too."""
    late = ("fields.arrival.at=3.5", "difficulty=0.5")
    assert main(["train", *words(runs), *FEW, *LIMP, *late, f"run.dir={tmp_path / 'limp'}"]) == 0
    found = json.loads((tmp_path / "limp" / "evaluation.json").read_text())
    assert found["violated"]["fell_running"] == 1.0
    assert found["measures"]["arrived"]["mean"] == 0.0
    assert found["success_rate"] == 0.0


def test_who_takes_off_behind_the_bar_has_cleared_nothing(runs: Path, tmp_path: Path) -> None:
    """A run-up that begins a second sooner than the bank's begins on the mat here, and who lies there at the take-off landed."""
    sooner = ("initial_states.begin=0.5", "difficulty=1.0")
    assert main(["train", *words(runs), *FEW, *LIMP, *sooner, f"run.dir={tmp_path / 'there'}"]) == 0
    found = json.loads((tmp_path / "there" / "evaluation.json").read_text())
    assert found["success_rate"] == 0.0
    assert found["violated"]["crashed"] == 1.0


def test_a_run_up_that_ends_beside_its_place_is_brought_there(runs: Path) -> None:
    """By what the measures say: the world is the same everywhere on the ground."""
    apart = "initial_states.alpha=1.0"  # far from the clip's own heading
    environment = whole(runs, apart)
    root = at_the_take_off(environment)[:2]
    goal = environment.table["approach_goal"][0]
    measured = [
        beside(*(environment.table[name] for name in READ), index=axis)[0].item() for axis in (0, 1)
    ]
    assert measured == pytest.approx((root - goal).tolist(), abs=1e-5)
    environment.close()
    corrected = whole(runs, apart, f"initial_states.beside={measured}")
    assert at_the_take_off(corrected)[:2].tolist() == pytest.approx(goal.tolist(), abs=2e-3)
    corrected.close()


def test_a_run_up_that_never_ended_is_nowhere() -> None:
    places = torch.tensor([[1.0, 2.0, 0.9], [1.0, 2.0, 0.9]])
    found = beside(torch.tensor([1.0, 0.0]), places, torch.tensor([[0.5, 0.0]] * 2))
    assert found[0] == 0.5
    assert found[1].isnan()


def test_a_start_after_the_clip_is_refused(runs: Path) -> None:
    with pytest.raises(
        ConfigError, match=r"initial_states\.begin=99 is not possible: the clip lasts"
    ):
        whole(runs, "initial_states.begin=99", "motion.name=backflip")

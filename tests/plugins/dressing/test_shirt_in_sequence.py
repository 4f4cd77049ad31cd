"""The shirt's subtasks in one episode."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from understudy.command.cli import main
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy_sequencing.stages import Stages
from understudy_skills.skill import names, open_skill

pytest.importorskip("potpourri3d", reason="potpourri3d is not installed")
SMALL = ["device=cpu", "curriculum=null", "simulators.person.name=mujoco", "scenes.cloth.edge=0.03", "scene.steps.cloth=10"]  # fmt: skip
#: Coarser, and put on in fewer sub-steps: the kept policies still do it.
COARSE = [*SMALL, "scenes.cloth.edge=0.032", "scenes.cloth.substeps=5", "simulators.cloth.self_contact=false"]  # fmt: skip
KEPT = Path(__file__).resolve().parents[3] / "docs" / "benchmarks" / "dressing"
GRIP = f"{{run: {KEPT}/shirt_grip.json, until: {{field: gripped, at_least: 1.0}}, seconds: 4.0}}"
TUCK = f"{{run: {KEPT}/shirt_tuck.json, until: {{field: tucked, at_least: 1.0, lasting: 0.64}}, seconds: 4.0}}"
NAMES = ("grip", "tuck", "sleeve", "regrip", "tuck_second", "sleeve_second", "finish")


def test_the_first_two_in_one_episode() -> None:
    """Both kept policies, one after the other, from a shirt on the shoulders."""
    words = ["experiment=dressing/shirt", f"actuation.stages=[{GRIP}, {TUCK}]", *COARSE, "num_worlds=2"]  # fmt: skip
    environment = build_environment(load_experiment(words), evaluating=True).environment
    environment.reset(seed=1)
    done = torch.zeros(2, dtype=torch.bool)
    for decision in range(45):
        step = environment.step(torch.zeros(2, environment.action_size))
        done |= step.terminated & ~step.failed
        if decision == 8:
            assert (environment.table["stage"] == 1).all()
            assert not done.any()
            assert environment.table["grip_closed"].tolist() == [[1.0, 0.0]] * 2
        if decision > 8 and done.all():
            break
    assert done.all()
    environment.close()


def test_the_whole_shirt_that_ships_is_of_the_skills_beside_it() -> None:
    skill = open_skill("dressing/shirt_larger")
    runs = [stage["run"] for stage in skill.card["config"]["actuation"]["stages"]]
    assert runs == [f"dressing/shirt_{name}_larger" for name in NAMES]
    assert set(runs) < set(names())
    assert skill.card["evaluation"]["episodes"] >= 32
    assert skill.card["evaluation"]["success"] == "finished within 39 s"


@pytest.mark.slow
def test_the_whole_shirt_is_put_on() -> None:
    """All seven that ship, from a shirt on the shoulders; the arms through no cloth when they are done."""
    words = ["experiment=dressing/shirt_larger", "device=cpu", "simulators.person.name=mujoco", "num_worlds=2"]  # fmt: skip
    environment = build_environment(load_experiment(words), evaluating=True).environment
    environment.reset(seed=1)
    done = torch.zeros(2, dtype=torch.bool)
    for _ in range(350):
        step = environment.advance(torch.zeros(2, environment.action_size))
        done |= step.terminated & ~step.failed
        environment.begin(step.ended)
        if done.any():
            break
    assert done.any()
    environment.close()


def test_the_third_is_kept_too() -> None:
    """From the sleeve's mouth, which takes two seconds, and through no cloth."""
    sleeve = (
        f"{{run: {KEPT}/shirt_sleeve.json, until: {{field: dressed, at_least: 1.0}}, seconds: 4.0}}"
    )
    words = ["experiment=dressing/shirt", f"actuation.stages=[{sleeve}]", *COARSE, "num_worlds=2", "initial_states.worn=in_sleeve"]  # fmt: skip
    environment = build_environment(load_experiment(words), evaluating=True).environment
    environment.reset(seed=1)
    done, through = torch.zeros(2, dtype=torch.bool), torch.zeros(2, dtype=torch.bool)
    for _ in range(60):
        step = environment.advance(torch.zeros(2, environment.action_size))
        through |= ~done & (environment.table["pierced"] > 0)
        done |= step.terminated & ~step.failed
        environment.begin(step.ended)
        if done.all():
            break
    assert done.all()
    assert not through.any()
    environment.close()


@pytest.mark.slow
def test_all_seven_in_one_episode(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every stage of the experiment finds its fields, those of the second arm among the other's, and has its own hands
    closed."""
    monkeypatch.chdir(tmp_path)
    starts = tmp_path / "starts"
    brief = ["run.video_seconds=0", "learner.rollout_steps=2", "learner.minibatches=1", "budget.samples=4",
             "evaluation.episodes=1", "evaluation.final_episodes=1", "evaluation.seconds=0.08", "num_worlds=2"]  # fmt: skip
    words = ["experiment=dressing/shirt_grip", "job=settle", "job.count=2", "job.seconds=0.04", *SMALL, "num_worlds=2"]  # fmt: skip
    assert main(["train", *words, f"run.dir={starts}"]) == 0
    for name in NAMES:
        words = [f"experiment=dressing/shirt_{name}", "initial_states=bank", f"initial_states.file={starts}", *SMALL, *brief]  # fmt: skip
        assert main(["train", *words, f"run.dir=runs/shirt/{name}"]) == 0
    built = build_environment(
        load_experiment(["experiment=dressing/shirt", *SMALL, "num_worlds=2"])
    )
    environment = built.environment
    stages = environment.parts.actuation.part
    assert isinstance(stages, Stages)
    environment.reset(seed=1)
    table = environment.table
    values = {name: table[name] for name in stages.reads if name in table.shapes}
    kept, closed = stages.begin(**values), []
    for number in range(len(NAMES)):
        here = {**values, **kept, "stage": torch.full((2,), float(number))}
        closed.append(stages.control(torch.zeros(2, 1), **here)[0, -2:].tolist())
    assert closed == [[0.0, 0.0], *[[1.0, 0.0]] * 3, *[[0.0, 1.0]] * 2, [0.0, 0.0]]
    second = stages._fields_of(5, {**values, **kept})
    assert torch.equal(second["feature"], table["right_feature"])
    assert not torch.equal(second["feature"], table["feature"])
    environment.close()

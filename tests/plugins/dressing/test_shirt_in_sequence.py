"""The shirt's subtasks in one episode."""

from __future__ import annotations

from collections.abc import Iterator
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


class Played:
    """Two worlds of `experiment`, played until both are done, or for so many decisions."""

    def __init__(self, experiment: str, *words: str) -> None:
        config = load_experiment([f"experiment={experiment}", *words, "num_worlds=2"])
        self.environment = build_environment(config, evaluating=True).environment
        self.done = torch.zeros(2, dtype=torch.bool)
        self.through = torch.zeros(2, dtype=torch.bool)  #: an arm through the cloth before it was

    def decisions(self, most: int) -> Iterator[int]:
        """Begins anew, and gives each decision once it was made."""
        environment = self.environment
        environment.reset(seed=1)
        for decision in range(most):
            step = environment.advance(torch.zeros(2, environment.action_size))
            self.through |= ~self.done & (environment.table["pierced"] > 0)
            self.done |= step.terminated & ~step.failed
            environment.begin(step.ended)
            yield decision
            if self.done.all():
                break
        environment.close()


def test_the_first_two_in_one_episode() -> None:
    """Both kept policies, one after the other, from a shirt on the shoulders."""
    played = Played("dressing/shirt", f"actuation.stages=[{GRIP}, {TUCK}]", *COARSE)
    last = 0
    for last in played.decisions(45):
        if last == 8:
            assert (played.environment.table["stage"] == 1).all()
            assert not played.done.any()
            assert played.environment.table["grip_closed"].tolist() == [[1.0, 0.0]] * 2
    assert last > 8
    assert played.done.all()


def test_the_third_is_kept_too() -> None:
    """From the sleeve's mouth, which takes two seconds, and through no cloth."""
    sleeve = (
        f"{{run: {KEPT}/shirt_sleeve.json, until: {{field: dressed, at_least: 1.0}}, seconds: 4.0}}"
    )
    played = Played(
        "dressing/shirt", f"actuation.stages=[{sleeve}]", *COARSE, "initial_states.worn=in_sleeve"
    )
    assert len(list(played.decisions(60))) > 1
    assert played.done.all()
    assert not played.through.any()


@pytest.mark.slow
def test_the_whole_shirt_is_put_on() -> None:
    """All seven that ship, from a shirt on the shoulders, and through no cloth."""
    played = Played("dressing/shirt_larger", "device=cpu", "simulators.person.name=mujoco")
    assert len(list(played.decisions(350))) > 100
    assert played.done.any()
    assert not played.through.any()


def test_the_whole_shirt_that_ships_is_of_the_skills_beside_it() -> None:
    skill = open_skill("dressing/shirt_larger")
    runs = [stage["run"] for stage in skill.card["config"]["actuation"]["stages"]]
    assert runs == [f"dressing/shirt_{name}_larger" for name in NAMES]
    assert set(runs) < set(names())
    assert skill.card["evaluation"]["episodes"] >= 32
    assert skill.card["evaluation"]["success"] == "finished within 39 s"


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

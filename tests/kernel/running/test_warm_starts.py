"""Beginning with parts of another run, and other runs' controllers inside a task."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import torch
from counted_task import LINE_TASK, Certain, Push, Starts, Where, line_plugins
from torch import Tensor
from worlds import assert_same_state, make_training, resumed

from understudy.errors import ConfigError, RunError
from understudy.random import WorldStreams
from understudy.records import checkpoint
from understudy.records.runs import newest_state
from understudy.running.training import Training
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.task import Actuation, Context, Curriculum, Encoder, Rollout, State, box
from understudy.testing import FakeScene
from understudy_reinforcement.start import policy_parts
from understudy_skills.controller import Controller


class Learned(Starts):
    """Begins at a place that it learns: one further at each update."""

    @dataclass(frozen=True)
    class Options:
        size: int = 1

    def __init__(self, options: Options, context: Context) -> None:
        self.taken = []
        self.place = torch.zeros(options.size)

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        return {"x": self.place.mean() + 0 * streams.uniform(1)}

    def update(self, rollout: Rollout) -> dict[str, float]:
        self.place += 1
        return {}

    def state_dict(self) -> State:
        return {"place": self.place.clone()}

    def load_state_dict(self, state: State) -> None:
        self.place.copy_(state["place"])


class Steps(Curriculum):
    """Counts updates."""

    provides = {"level": ()}

    def __init__(self, options: None, context: Context) -> None:
        self.level = 0

    def begin(self, streams: WorldStreams) -> dict[str, Tensor]:
        return {"level": 0 * streams.uniform(1)[:, 0] + self.level}

    def update(self, rollout: Rollout) -> dict[str, float]:
        self.level += 1
        return {}

    def stage(self) -> str:
        return f"level {self.level}"

    def state_dict(self) -> State:
        return {"level": self.level}

    def load_state_dict(self, state: State) -> None:
        self.level = state["level"]


class Scaled(Actuation):
    """`factor` times the action, and what is beside it in the state."""

    @dataclass(frozen=True)
    class Options:
        factor: float = 10.0

    reads = ("x",)
    action_space = box(1)

    def __init__(self, options: Options, context: Context) -> None:
        self.factor = options.factor

    def control(self, action: Tensor, x: Tensor) -> Tensor:
        return self.factor * action + x


class Keeping(Push):
    """Keeps a number."""

    keeps = {"number": ()}

    def begin(self, **fields: Tensor) -> dict[str, Tensor]:
        return {"number": torch.zeros(4)}

    def advance(self, action: Tensor, **fields: Tensor) -> dict[str, Tensor]:
        return {"number": action[:, 0]}


class Integrating(Keeping):
    """Goes on from the number that it keeps."""

    reads = ("number",)

    def control(self, action: Tensor, number: Tensor) -> Tensor:
        return action + number.unsqueeze(1)


class Twice(Encoder):
    """Twice the position of another name, (N, 1)."""

    reads = ("place",)
    shape = (1,)

    def __init__(self, options: None, context: Context) -> None:
        pass

    def encode(self, place: Tensor) -> Tensor:
        return 2 * place


PARTS = {
    "initial_states": {"my/learned": Learned},
    "curriculum": {"my/steps": Steps},
    "actuation": {"my/scaled": Scaled, "my/keeping": Keeping, "my/integrating": Integrating},
    "encoder": {"my/twice": Twice},
}
TASK = (
    *LINE_TASK[:5], "+initial_states={name: my/learned}", *LINE_TASK[6:], "+curriculum={name: my/steps}"
)  # fmt: skip


def plugins() -> Any:
    return line_plugins(**PARTS)


def trained(folder: Path, *overrides: str, iterations: int = 3) -> Path:
    training = make_training(plugins(), [*TASK, *overrides], folder)
    for _ in range(iterations):
        training.iterate()
    with torch.no_grad():
        training.job.policy.worth += 5
    training.save()
    training.run.unlock()
    return folder


def start(run: Path, *parts: str) -> str:
    chosen = f", parts: [{', '.join(parts)}]" if parts else ""
    return f"start={{run: '{run}'{chosen}}}"


def taken_over(training: Training) -> dict[str, Any]:
    job: Any = training.job
    environment = job.environment.parts
    return {
        "actor": float(job.policy.push.detach()),
        "critic": float(job.policy.worth.detach()),
        "normaliser": float(job.policy.seen),
        "initial_states": float(environment.initial_states.place),
        "curriculum": environment.curriculum.level,
    }


FRESH = {"actor": 0.0, "critic": 0.0, "normaliser": 0.0, "initial_states": 0.0, "curriculum": 0}
DONE = {"actor": 3.0, "critic": 5.0, "normaliser": 3.0, "initial_states": 3.0, "curriculum": 3}


@pytest.mark.parametrize(
    "parts",
    [(), *((part,) for part in DONE), ("actor", "curriculum"), tuple(DONE)],
    ids=lambda parts: "+".join(parts) or "default",
)
def test_what_is_named_is_taken_over_and_nothing_else(
    tmp_path: Path, parts: tuple[str, ...]
) -> None:
    run = trained(tmp_path / "first")
    training = make_training(plugins(), [*TASK, start(run, *parts)], tmp_path / "second")
    named = parts or ("actor", "critic", "normaliser")
    assert taken_over(training) == {k: (DONE if k in named else FRESH)[k] for k in DONE}
    assert training.progress.samples == 0
    sources = json.loads((tmp_path / "second/run.json").read_text())["sources"]
    assert sources == {
        "start": {"run": str(run), "parts": list(named), "samples": 24, "sources": {}, "behind": []}
    }


def test_what_was_taken_over_is_not_taken_again_by_resuming(tmp_path: Path) -> None:
    run = trained(tmp_path / "first")
    training = make_training(plugins(), [*TASK, start(run, *DONE)], tmp_path / "second")
    training.iterate()
    training.save()
    training.run.unlock()
    again = resumed(plugins(), tmp_path / "second")
    assert taken_over(again)["actor"] == 4.0
    assert_same_state(training.state_dict(), again.state_dict())


def test_the_first_world_begins_where_the_taken_over_states_say(tmp_path: Path) -> None:
    """Not where those of the fresh initial states would have let it begin."""
    run = trained(tmp_path / "first")
    training = make_training(plugins(), [*TASK, start(run, "initial_states", "curriculum")])
    environment = training.job.environment
    assert environment.table["x"][:, 0].tolist() == [3.0] * 4
    assert environment.table["level"].tolist() == [3.0] * 4
    assert environment.observations["state"][:, 0].tolist() == [3.0] * 4


@pytest.mark.parametrize(
    ("override", "parts", "message"),
    [
        ("policy.width=2", (), r"^start\.parts: the critic of .*first does not fit: 'worth' is \(2,\) here and \(1,\) there\. Leave critic out"),
        ("initial_states.size=2", ("initial_states",), r"^start\.parts: the initial_states of .*first do not fit those of this task: 'initial_states/place' is \(2,\) here and \(1,\) there\.$"),
        ("curriculum=null", ("curriculum",), r"^start\.parts names the curriculum, and this task has none \(curriculum=…\)\.$"),
    ],
)  # fmt: skip
def test_misfits_are_named(tmp_path: Path, override: str, parts: tuple, message: str) -> None:
    run = trained(tmp_path / "first")
    with pytest.raises(RunError, match=message):
        make_training(plugins(), [*TASK, start(run, *parts), override], tmp_path / "second")
    assert not (tmp_path / "second").exists(), "nothing is half-written"


def test_a_part_that_does_not_fit_may_be_left_out(tmp_path: Path) -> None:
    run = trained(tmp_path / "first")
    training = make_training(plugins(), [*TASK, start(run, "actor"), "policy.width=2"])
    assert float(training.job.policy.push.detach()) == 3.0


@pytest.mark.parametrize("policy", [None, 3, "x", [], {}], ids=str)
def test_a_start_from_a_run_whose_policy_is_none(policy: Any, tmp_path: Path) -> None:
    run = trained(tmp_path / "first")
    path = run / "checkpoints/00000003"
    state, meta = checkpoint.load(path)
    checkpoint.save(path, {**state, "policy": policy}, meta)
    with pytest.raises(RunError, match=r"^start\.parts: the actor of .*first does not fit: 'push'"):
        make_training(plugins(), [*TASK, start(run)])


def test_a_start_that_takes_nothing_over_is_refused(tmp_path: Path) -> None:
    run = trained(tmp_path / "first")
    with pytest.raises(ConfigError, match=r"^start\.parts=\[\] is not possible: name what"):
        make_training(plugins(), [*TASK, f"start={{run: '{run}', parts: []}}"])


def test_a_start_from_nowhere(tmp_path: Path) -> None:
    with pytest.raises(RunError, match=r"nowhere is no run folder"):
        make_training(plugins(), [*TASK, start(tmp_path / "nowhere")])
    run = trained(tmp_path / "first")
    for file in (run / "checkpoints").iterdir():
        file.write_bytes(b"")
    with pytest.raises(RunError, match=r"no usable checkpoint"):
        make_training(plugins(), [*TASK, start(run)])


def test_which_entries_belong_to_which_part() -> None:
    policy = make_training(plugins(), TASK).job.policy
    assert policy_parts(policy) == {"actor": {"push"}, "critic": {"worth"}, "normaliser": {"seen"}}


# ---------------------------------------------------------------------- controllers


def context(*overrides: str) -> Context:
    """Of another task, in whose scene and simulator the controller is to work."""
    built = build_environment(load_experiment([*TASK, "num_worlds=3", *overrides], plugins()))
    return built.context


MOVER = (
    "actuation={name: my/scaled, factor: 100}",
    "encoder.state={name: my/twice, reads: {place: x}}",
)


def test_a_controller_is_what_the_run_learned(tmp_path: Path) -> None:
    run = trained(tmp_path / "first", *MOVER)
    controller = Controller.load(str(run), context())
    assert controller.reads == ("x",)
    control = controller({"x": torch.tensor([[1.0], [2.0], [3.0]]), "more": torch.zeros(3)})
    assert control.tolist() == [[301.0], [302.0], [303.0]], "100 × push + x"
    assert not any(p.requires_grad for p in controller.parameters())


def test_its_weights_can_be_learned_further(tmp_path: Path) -> None:
    controller = Controller.load(str(trained(tmp_path / "first", *MOVER)), context())
    controller.requires_grad_(True)
    controller({"x": torch.zeros(3, 1)}).sum().backward()
    assert float(controller.policy.push.grad) == 300.0


def test_the_field_it_reads_may_be_renamed_in_its_run(tmp_path: Path) -> None:
    run = trained(tmp_path / "first", "encoder.state={name: my/twice, reads: {place: x}}")
    controller = Controller.load(str(run), context())
    assert controller.reads == ("x",)
    seen = {}
    controller.policy.distribution = lambda observations: (
        seen.update(observations) or Certain(torch.zeros(3, 1))
    )
    controller({"x": torch.tensor([[1.0], [2.0], [3.0]])})
    assert seen["state"].tolist() == [[2.0], [4.0], [6.0]]


def test_a_controller_whose_actuation_goes_on_from_its_own_state_is_refused(tmp_path: Path) -> None:
    run = trained(tmp_path / "first", "actuation={name: my/integrating}")
    with pytest.raises(ConfigError, match=r"cannot be a controller .* a state of its own, number"):
        Controller.load(str(run), context())


def test_what_an_actuation_keeps_for_rewards_alone_is_not_needed_to_act(tmp_path: Path) -> None:
    controller = Controller.load(
        str(trained(tmp_path / "first", "actuation={name: my/keeping}")), context()
    )
    assert torch.isfinite(controller({name: torch.zeros(3, 1) for name in controller.reads})).all()


def test_a_controller_whose_checkpoint_does_not_fit(tmp_path: Path) -> None:
    run = trained(tmp_path / "first")
    path = run / "checkpoints/00000003"
    state, meta = checkpoint.load(path)
    checkpoint.save(path, {**state, "policy": {"push": torch.zeros(3)}}, meta)
    with pytest.raises(RunError, match=r"first does not fit this configuration: push differs"):
        Controller.load(str(run), context())
    with pytest.raises(ConfigError, match=r"There is no skill '.*nowhere'"):
        Controller.load(str(tmp_path / "nowhere"), context())


def test_a_controller_of_another_scene(tmp_path: Path) -> None:
    """Its parts are built for this task's scene, and say what they need."""

    class Picky(Where):
        """Needs its own scene."""

        def __init__(self, options: None, context: Context) -> None:
            context.need_scene(FakeScene, "encoder 'my/picky'")

    loaded = line_plugins(**{**PARTS, "encoder": {"my/picky": Picky}})
    run = trained(tmp_path / "first")
    info = json.loads((run / "run.json").read_text())
    info["config"]["encoder"]["state"] = {"name": "my/picky"}
    (run / "run.json").write_text(json.dumps(info))
    here = build_environment(load_experiment(TASK, loaded)).context
    with pytest.raises(ConfigError, match=r"^encoder 'my/picky' needs a scene of type FakeScene"):
        Controller.load(str(run), here)


@pytest.mark.parametrize(
    "state",
    [
        {},
        [],
        *(
            {"progress": progress}
            for progress in (3, *({"samples": n} for n in ("many", True, -1, 2**63)))
        ),
    ],
    ids=str,
)
def test_a_checkpoint_that_does_not_say_after_how_many_samples(state: Any, tmp_path: Path) -> None:
    run = trained(tmp_path / "first")
    checkpoint.save(run / "checkpoints" / "00009999", state, {})
    with pytest.raises(RunError, match="after how many samples"):
        newest_state(str(run))

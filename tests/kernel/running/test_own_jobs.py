"""Jobs and slots of plugins: what a run iterates need not be reinforcement learning."""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import torch
from counted_task import LINE_TASK, install, line_plugins
from torch import nn
from worlds import assert_same_state, make_training, resumed

from understudy.command.cli import main
from understudy.errors import ConfigError, RunError
from understudy.random import generator, private_rng
from understudy.records import checkpoint
from understudy.records.observer import RunObserver
from understudy.records.runs import Run
from understudy.running.jobs import Job
from understudy.running.training import Progress
from understudy.setup.composition import load_experiment
from understudy.setup.config import Experiment
from understudy.setup.plugins import Plugins, hookimpl, load
from understudy.setup.registry import Registrar
from understudy.task import State
from understudy.testing import fake
from understudy_reinforcement.evaluation import Evaluation, Measured
from understudy_reinforcement.job import Reinforcement


class Waves:
    """Samples x in [0, 1) and sin(`pitch` x)."""

    @dataclass(frozen=True)
    class Options:
        pitch: float = 3.0

    def __init__(self, options: Options) -> None:
        self.pitch = options.pitch

    def draw(self, count: int, source: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
        x = torch.rand(count, 1, generator=source)
        return x, torch.sin(self.pitch * x)


class Regression(Job):
    """Fits a network to the data of the slot ``data``, `batch` samples an iteration."""

    @dataclass(frozen=True)
    class Options:
        batch: int = 32
        rate: float = 0.01
        until: int | None = None  #: iterations after which it is finished

    def __init__(self, options: Options, experiment: Experiment) -> None:
        self.options, self.seed = options, experiment.root.seed
        self.device = torch.device("cpu")
        self._data = experiment.need("data").build()
        self._iterations = 0
        with private_rng(self.seed, "regression"):
            self.net = nn.Sequential(nn.Linear(1, 8), nn.Tanh(), nn.Linear(8, 1))

    def prepare(self) -> None:
        self._optimiser = torch.optim.Adam(self.net.parameters(), self.options.rate)
        self._source = generator(self.seed, "batches")

    def _loss(self, count: int, source: torch.Generator) -> torch.Tensor:
        x, y = self._data.draw(count, source)
        return (self.net(x) - y).square().mean()

    def iterate(self, samples: int) -> dict[str, Any]:
        loss = self._loss(self.options.batch, self._source)
        self._optimiser.zero_grad()
        loss.backward()
        self._optimiser.step()
        self._iterations += 1
        return {"consumed": self.options.batch, "loss": float(loss.detach())}

    def finished(self) -> bool:
        return self._iterations == self.options.until

    def stage(self) -> str:
        return f"epoch {self._iterations}"

    @torch.no_grad()
    def evaluate(
        self, draw: str, episodes: int, *, give_up_below: float | None = None
    ) -> Evaluation:
        error = self._loss(episodes, generator(self.seed, draw)).reshape(1)
        return Evaluation(
            episodes, measures={"error": Measured.of("mean", -error)}, objective="error"
        )

    def products(self, run: Run) -> None:
        run.write_json("curve.json", self.net(torch.linspace(0, 1, 5).view(5, 1)).detach().tolist())

    def sources(self) -> dict[str, Any]:
        return {"data": {"licence": "CC0"}}

    def report(self) -> dict[str, int]:
        return {"odd_samples": 7}

    def state_dict(self) -> State:
        inner = self._optimiser.state_dict()
        return {
            "net": dict(self.net.state_dict()),
            "optimiser": {str(k): v for k, v in inner["state"].items()},
            "groups": inner["param_groups"],
            "source": self._source.get_state(),
            "iterations": self._iterations,
        }

    def load_state_dict(self, state: State) -> None:
        self.load_learned(state, 0)
        inner = {int(k): v for k, v in state["optimiser"].items()}
        self._optimiser.load_state_dict({"state": inner, "param_groups": state["groups"]})
        self._source.set_state(state["source"])
        self._iterations = state["iterations"]

    def load_learned(self, state: State, samples: int) -> None:
        self.net.load_state_dict(state["net"])


def plugins(broken: bool = False, regression: type = Regression) -> Plugins:
    """A plugin with a job, and a kind and a slot of its own."""
    module = ModuleType("regression")

    def register(register: Registrar) -> None:
        register.kind("data", "samples to learn from")
        register.slot("data", "data", "what is learned from")
        register.slot("filters", "data", "several", many=True)
        register.component("data", "my/waves", Waves)
        register.component("job", "my/regression", regression)
        if broken:
            raise RuntimeError("no licence")

    module.understudy_register = hookimpl(register)  # type: ignore[attr-defined]
    return load(
        only=["sweeps", "judging", "reinforcement", "training"],
        extra=[("fake", fake), ("regression", module)],
    )


TASK = ("+job={name: my/regression}", "data={name: my/waves}", "budget.samples=640", "evaluation.final_episodes=50")  # fmt: skip


class Stages(RunObserver):
    """Notes the stages that a run tells."""

    def __init__(self, found: list[str]) -> None:
        self.found = found

    def iteration(self, run: Run, row: Mapping[str, float], stage: str) -> None:
        self.found.append(stage)


def test_a_run_from_beginning_to_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Trained, resumed and evaluated by the commands that know nothing of it."""
    install(monkeypatch, plugins())
    run = tmp_path / "run"
    assert main(["train", *TASK, f"run.dir={run}"]) == 0
    captured = capsys.readouterr()
    assert captured.out.splitlines()[-1] == f"run: {run}"
    assert "The simulator counted 7 × odd samples" in captured.err
    info = json.loads((run / "run.json").read_text())
    assert info["sources"] == {"data": {"licence": "CC0"}}
    assert info["config"]["data"] == {"name": "my/waves", "pitch": 3.0}
    assert {c["kind"] for c in info["components"]} == {"job", "data"}
    rows = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    assert [row["samples"] for row in rows] == list(range(32, 641, 32))
    assert rows[-1]["loss"] < rows[0]["loss"]
    first = json.loads((run / "evaluation.json").read_text())
    assert "success_rate" not in first
    assert first["objective"]["value"] == first["measures"]["error"]["mean"] < 0
    assert len(json.loads((run / "curve.json").read_text())) == 5
    assert not (run / "recording.npz").exists()
    assert main(["resume", str(run), "budget.samples=1280"]) == 0
    assert main(["evaluate", str(run)]) == 0
    second = json.loads((run / "evaluation.json").read_text())
    assert second["samples"] == 1280
    assert second["objective"]["value"] > first["objective"]["value"], "it has learned more"


def test_it_is_resumed_to_the_last_bit(tmp_path: Path) -> None:
    straight = make_training(plugins(), TASK)
    straight.train()
    cut = make_training(plugins(), TASK, tmp_path / "run")
    for _ in range(7):
        cut.iterate()
    cut.save()
    cut.run.unlock()
    again = resumed(plugins(), tmp_path / "run")
    assert again.progress.iteration == 7
    assert again.train() == "budget"
    assert_same_state(straight.state_dict(), again.state_dict())


def test_a_job_that_is_finished(tmp_path: Path) -> None:
    training = make_training(plugins(), [*TASK, "job.until=3"], tmp_path / "run")
    stages = []
    training.reporter.observers = [Stages(stages)]
    assert training.train() == "finished"
    assert stages == ["epoch 1", "epoch 2", "epoch 3"]
    assert training.progress.samples == 96
    assert (tmp_path / "run/curve.json").exists()


class Rehearsing(Regression):
    """Tries itself for itself until it was good once, and wants to be judged soon then."""

    ready = False

    def judging(self) -> str:
        return "evaluation" if self.ready else "trial"

    def between(self, row: Mapping[str, Any], progress: Progress) -> Mapping[str, Any]:
        if self.ready or row.get("trial/success_rate", 0.0) < 0.9:
            return {}
        self.ready, progress.evaluated_at = True, progress.samples - 128
        return {"mark/ready": 1.0}

    def evaluate(
        self, draw: str, episodes: int, *, give_up_below: float | None = None
    ) -> Evaluation:
        return Evaluation(episodes, "", 1.0 if self._iterations >= 10 else 0.2)


def test_evaluations_of_a_jobs_own() -> None:
    """None of them meets the criterion, however good; what they lead to is the job's."""
    criterion = ("evaluation.criterion=0.9", "evaluation.every_samples=160", "budget.samples=6400")
    training = make_training(plugins(regression=Rehearsing), [*TASK, *criterion])
    rows = list(training.rows())
    found = [
        (row["samples"] // 32, key) for row in rows for key in row if key.endswith("success_rate")
    ]
    assert found == [
        (5, "trial/success_rate"),
        (10, "trial/success_rate"),
        (11, "evaluation/success_rate"),
        (11, "confirmation/success_rate"),
    ]
    assert [row["samples"] // 32 for row in rows if "mark/ready" in row] == [10]
    assert training.outcome == "criterion"


def test_it_sweeps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, plugins())
    sweep = [*TASK, "outer_loop=grid", "executor=in_process", "outer_loop.seeds=[0,1]", f"run.dir={tmp_path / 's'}"]  # fmt: skip
    assert main(["sweep", *sweep]) == 0
    (row,) = json.loads((tmp_path / "s/summary.json").read_text())
    assert row["seeds"] == 2
    assert row["objective"] < 0


def test_an_evaluation_repeats_on_its_draw() -> None:
    training = make_training(plugins(), TASK)
    training.iterate()
    assert training.judge() == training.judge()
    assert training.job.evaluate("other", 50) != training.job.evaluate("final", 50)


def test_the_checkpoint_of_another_job(tmp_path: Path) -> None:
    training = make_training(plugins(), TASK, tmp_path / "run")
    training.save()
    state, meta = checkpoint.load(tmp_path / "run/checkpoints/00000000")
    del state["net"]
    checkpoint.save(tmp_path / "run/checkpoints/00000000", state, meta)
    training.run.unlock()
    with pytest.raises(
        RunError,
        match=r"does not fit this configuration: 'net' is a dict here and nothing",
    ):
        resumed(plugins(), tmp_path / "run")


@pytest.mark.parametrize(
    ("name", "count"),
    [
        *itertools.product(["iteration", "samples", "evaluations"], [-1, 1.5]),
        *itertools.product(["iteration", "evaluations", "evaluated_at", "seconds"], [2**63, 10**400]),
        ("evaluated_at", 1.5), ("seconds", -1.0), ("seconds", -1e-9), ("seconds", 1e300),
    ],
)  # fmt: skip
def test_a_checkpoint_that_counts_what_cannot_be(name: str, count: float, tmp_path: Path) -> None:
    """Half an iteration had no file name once the next checkpoint was due."""
    training = make_training(plugins(), TASK, tmp_path / "run")
    training.save()
    path = tmp_path / "run/checkpoints/00000000"
    state, meta = checkpoint.load(path)
    checkpoint.save(path, {**state, "progress": {**state["progress"], name: count}}, meta)
    training.run.unlock()
    cannot = re.escape(f"'progress' cannot be {name}={count}")
    match = f"does not fit this configuration: ({cannot}|Overflow|.*is not finite)"
    with pytest.raises(RunError, match=match if name != "samples" else f"{match}|damaged"):
        resumed(plugins(), tmp_path / "run")


def test_without_a_job_a_run_is_reinforcement_learning() -> None:
    assert isinstance(make_training(line_plugins(), LINE_TASK).job, Reinforcement)


def test_slots_of_plugins() -> None:
    experiment = load_experiment(
        [*TASK, "data.pitch=5", "+filters.a={name: my/waves, pitch: 1}", "+filters.b=my/waves"], plugins()
    )  # fmt: skip
    assert experiment.need("data").build().pitch == 5
    assert [(c.name, c.build().pitch) for c in experiment.many("filters")] == [("a", 1), ("b", 3)]
    assert experiment.effective()["filters"]["b"] == {"name": "my/waves", "pitch": 3.0}
    with pytest.raises(ConfigError, match=r"^data has no option 'pich'\. Did you mean 'pitch'\?"):
        load_experiment([*TASK, "+data.pich=5"], plugins())
    with pytest.raises(ConfigError, match=r"^There is no data 'my/wave' \(asked for at data\)"):
        load_experiment([*TASK, "data.name=my/wave"], plugins())
    with pytest.raises(
        ConfigError, match=r"^data is not set\. .* set it \(data=…\)\. Known: my/waves\."
    ):
        make_training(plugins(), ["+job={name: my/regression}"])


def test_a_plugin_that_breaks_leaves_neither_kinds_nor_slots() -> None:
    loaded = plugins(broken=True)
    assert not {"data", "filters"} & (loaded.registry.kinds.keys() | loaded.registry.slots.keys())
    added = [*loaded.registry.kinds.values(), *loaded.registry.slots.values()]
    assert not [entry.name for entry in added if entry.plugin == "regression"]
    with pytest.raises(
        ConfigError, match=r"no configuration key 'data'.*'regression' did not load"
    ):
        load_experiment(["data={name: my/waves}"], loaded)
    load_experiment([*fake.FAKE_TASK], loaded)

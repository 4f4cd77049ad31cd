"""Fault 11: resuming with another model, world count, version or format names what differs."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch
from worlds import SMALL, assert_same_state, make_training, resumed

from understudy.command.cli import main
from understudy.errors import RunError
from understudy.records import checkpoint, runs
from understudy.setup.composition import compose_raw
from understudy.setup.plugins import Plugins
from understudy.testing.fake import FAKE_TASK
from understudy_training import workflow


@pytest.fixture
def run(plugins: Plugins, tmp_path: Path) -> Path:
    training = make_training(plugins, [*FAKE_TASK, *SMALL], tmp_path / "run")
    training.iterate()
    training.save()
    assert training.run is not None
    training.run.unlock()
    return tmp_path / "run"


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("policy.hidden=[24]", r"'policy/actor.0.weight' is \(24, 2\) here and \(16, 2\) there"),
        (
            "policy.hidden=[16, 16]",
            r"'policy/actor.2.weight' is \(16, 16\) here and \(1, 16\) there",
        ),
        (
            "num_worlds=8",
            r"'environment/simulator/state' is \(8, 2\) .* here and \(16, 2\) .* there",
        ),
    ],
)
def test_another_shape(plugins: Plugins, run: Path, override: str, message: str) -> None:
    with pytest.raises(RunError, match=message):
        resumed(plugins, run, more=[override])


def test_another_learner_state(plugins: Plugins, run: Path) -> None:
    state, meta = checkpoint.load(run / "checkpoints/00000001")
    del state["learner"]["actor"]
    checkpoint.save(run / "checkpoints/00000002", state, meta)
    with pytest.raises(
        RunError, match=r"configuration: 'learner/actor' is a dict here and nothing there\. Use"
    ):
        resumed(plugins, run)


def test_harmless_differences_are_told(plugins: Plugins, run: Path) -> None:
    state, meta = checkpoint.load(run / "checkpoints/00000001")
    meta["versions"]["torch"] = "1.0"
    checkpoint.save(run / "checkpoints/00000001", state, meta)
    messages: list[str] = []
    resumed(plugins, run, messages, ["learner.clip=0.3"])
    assert any(
        m.startswith("Differs from the checkpoint: learner.clip: 0.2 → 0.3") for m in messages
    ), messages
    assert any(
        m.startswith("Version differs from the checkpoint: torch: '1.0' → ") for m in messages
    ), messages


def test_another_number_of_threads_is_told(plugins: Plugins, run: Path, two_threads: None) -> None:
    """It was made at one, before there were two; the run says so, and so do its checkpoints."""
    told = "Threads differ from the checkpoint: 1 → 2. On a CPU the bits are the same only with an equal number"
    assert runs.open_run(run).info["machine"]["threads"] == 1
    messages: list[str] = []
    training = resumed(plugins, run, messages)
    assert any(m.startswith(told) and "OMP_NUM_THREADS=1" in m for m in messages), messages
    training.save()
    assert training.run is not None
    training.run.unlock()
    resumed(plugins, run, messages := [])  # made at two by now
    assert not messages


@pytest.mark.parametrize(
    ("began", "said", "then"), [(1, None, 1), (3, None, 2), (1, "2", 2), ("many", None, 2), (-1, None, 2)]
)  # fmt: skip
def test_a_resume_takes_as_many_threads_as_the_run_began_with(
    plugins: Plugins, run: Path, monkeypatch: pytest.MonkeyPatch, two_threads: None,
    began: object, said: str | None, then: int,
) -> None:  # fmt: skip
    """Unless this machine has fewer cores, or OMP_NUM_THREADS says how many."""
    monkeypatch.setattr(runs, "cores", lambda: 2)
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    if said is not None:
        monkeypatch.setenv("OMP_NUM_THREADS", said)
    info = json.loads((run / "run.json").read_text())
    info["machine"]["threads"] = began
    (run / "run.json").write_text(json.dumps(info))
    composed = runs.Run.experiment
    monkeypatch.setattr(runs.Run, "experiment", lambda of: composed(of, plugins.registry))
    monkeypatch.setattr(workflow, "_carry_out", lambda training: training.close() or 0)
    assert main(["resume", str(run)]) == 0
    assert torch.get_num_threads() == then


def test_newer_checkpoint_format(
    plugins: Plugins, run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    state, meta = checkpoint.load(run / "checkpoints/00000001")
    monkeypatch.setattr(checkpoint, "FORMAT", 4)
    checkpoint.save(run / "checkpoints/00000002", state, meta)
    monkeypatch.setattr(checkpoint, "FORMAT", 3)
    with pytest.raises(RunError, match=r"checkpoint format 4, and this understudy reads 3"):
        resumed(plugins, run)


def test_older_checkpoint_format(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checkpoint, "FORMAT", 4)
    with pytest.raises(RunError, match=r"format 3, and this understudy reads 4.*train anew"):
        checkpoint.load(run / "checkpoints/00000001")


def test_a_checkpoint_of_format_2_is_read(run: Path) -> None:
    path = run / "checkpoints/00000001"
    state, meta = checkpoint.load(path)
    content = checkpoint.read_sealed(path.with_suffix(".json"))
    path.with_suffix(".json").write_bytes(checkpoint._sealed({**content, "format": 2}))
    found, found_meta = checkpoint.load(path)
    assert_same_state(found, state)
    assert found_meta == meta


def test_newer_layout(run: Path) -> None:
    info = json.loads((run / "run.json").read_text())
    (run / "run.json").write_text(json.dumps({**info, "layout": runs.LAYOUT + 1}))
    with pytest.raises(RunError, match=r"newer understudy \(layout 4; this one reads 3\)"):
        runs.open_run(run)


def test_a_run_of_layout_1_is_refused_in_one_sentence(tmp_path: Path) -> None:
    old = {
        "layout": 1,
        "config": {"seed": 0},
        "overrides": ["seed=0"],
        "sources": {},
        "versions": {"understudy": "0.1.7"},
    }
    (tmp_path / "run.json").write_text(json.dumps(old))
    with pytest.raises(RunError) as caught:
        runs.open_run(tmp_path)
    assert str(caught.value) == (
        f"{tmp_path} was written by an older understudy, whose tasks and states mean other things "
        "(layout 1; this one reads 3). Use that version for it, or train anew."
    )


def test_a_checkpoint_of_format_1_is_refused_in_one_sentence(run: Path) -> None:
    path = run / "checkpoints/00000001"
    content = checkpoint.read_sealed(path.with_suffix(".json"))
    path.with_suffix(".json").write_bytes(checkpoint._sealed({**content, "format": 1}))
    with pytest.raises(
        RunError,
        match=r"checkpoint format 1, and this understudy reads 3\. Use .*, or train anew\.$",
    ):
        checkpoint.load(path)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["seed=4"], "seed=4 is another run's: {run} was begun with seed 0"),
        (["seed=4", "budget.samples=99"], "Give `understudy train` seed=4, with start.run={run}"),
        (["run.dir=elsewhere"], "run.dir=elsewhere is another run's folder: {run} goes on where"),
    ],
)
def test_another_seed_or_folder_is_another_run(
    plugins: Plugins, run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
    words: list[str], message: str,
) -> None:  # fmt: skip
    """The folder then said seed 4 of weights that were mostly trained with seed 0; run.dir was passed over."""
    monkeypatch.setattr(workflow, "compose_raw", lambda overrides: compose_raw(overrides, plugins))
    monkeypatch.setattr(workflow, "installed", lambda: plugins)
    composed = runs.Run.experiment
    monkeypatch.setattr(runs.Run, "experiment", lambda of: composed(of, plugins.registry))
    monkeypatch.setattr(workflow, "_carry_out", lambda training: training.close() or 0)
    assert main(["resume", str(run), "seed=0", f"run.dir={run}"]) == 0
    before = (run / "run.json").read_bytes()
    assert main(["resume", str(run), *words]) == 2
    assert message.format(run=run) in capsys.readouterr().err
    assert (run / "run.json").read_bytes() == before

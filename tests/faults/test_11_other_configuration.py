"""Fault 11: resuming with another model, world count, version or format names what differs."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from worlds import SMALL, make_training, resumed

from understudy.errors import RunError
from understudy.records import checkpoint, runs
from understudy.setup.plugins import Plugins
from understudy.testing.fake import FAKE_TASK


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
        ("policy.hidden=[24]", r"'actor.0.weight' is \(24, 2\) here and \(16, 2\) there"),
        ("policy.hidden=[16, 16]", r"'actor.2.weight' is \(16, 16\) here and \(1, 16\) there"),
        ("num_worlds=8", r"16 worlds and this configuration 8\. Set num_worlds=16"),
    ],
)
def test_another_shape(plugins: Plugins, run: Path, override: str, message: str) -> None:
    with pytest.raises(RunError, match=message):
        resumed(plugins, run, more=[override])


def test_another_learner_state(plugins: Plugins, run: Path) -> None:
    state, meta = checkpoint.load(run / "checkpoints/00000001")
    del state["learner"]["actor"]
    checkpoint.save(run / "checkpoints/00000002", state, meta)
    with pytest.raises(RunError, match=r"does not fit this configuration: KeyError: 'actor'"):
        resumed(plugins, run)


def test_harmless_differences_are_told(plugins: Plugins, run: Path) -> None:
    state, meta = checkpoint.load(run / "checkpoints/00000001")
    meta["versions"]["torch"] = "1.0"
    checkpoint.save(run / "checkpoints/00000001", state, meta)
    messages: list[str] = []
    resumed(plugins, run, messages, ["learner.clip=0.3"])
    assert any(
        m.startswith("Differs from the checkpoint: learner.clip: added (0.3)") for m in messages
    ), messages
    assert any(
        m.startswith("Version differs from the checkpoint: torch: '1.0' → ") for m in messages
    ), messages


def test_newer_checkpoint_format(
    plugins: Plugins, run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    state, meta = checkpoint.load(run / "checkpoints/00000001")
    monkeypatch.setattr(checkpoint, "FORMAT", 2)
    checkpoint.save(run / "checkpoints/00000002", state, meta)
    monkeypatch.setattr(checkpoint, "FORMAT", 1)
    with pytest.raises(RunError, match=r"checkpoint format 2, and this understudy reads up to 1"):
        resumed(plugins, run)


def test_older_checkpoint_format_is_migrated(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checkpoint, "FORMAT", 2)
    with pytest.raises(RunError, match="cannot be migrated"):
        checkpoint.load(run / "checkpoints/00000001")
    monkeypatch.setitem(checkpoint.MIGRATIONS, 1, lambda state, meta: ({**state, "new": 7}, meta))
    assert checkpoint.load(run / "checkpoints/00000001")[0]["new"] == 7


def test_newer_layout(run: Path) -> None:
    info = json.loads((run / "run.json").read_text())
    (run / "run.json").write_text(json.dumps({**info, "layout": 2}))
    with pytest.raises(RunError, match=r"newer understudy \(layout 2; this one reads 1\)"):
        runs.open_run(run)

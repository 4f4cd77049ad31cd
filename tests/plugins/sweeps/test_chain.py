"""Trainings that build on one another, as an outer loop."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

from understudy.errors import ConfigError
from understudy_sequencing.algorithm import Algorithm1
from understudy_sweeps import progress
from understudy_sweeps.chain import Chain
from understudy_sweeps.journal import Journal
from understudy_sweeps.loops import Report, Trial


def test_a_chain_trains_what_others_build_on_first() -> None:
    stages = {"a": ("x=1",), "b": ("x=2",), "c": ("run='{a}'", "runs=['{a}','{b}']")}
    chain = Chain(Chain.Options(stages), seed=0)
    first, second = chain.ask(0), chain.ask(1)
    assert first is not None
    assert (first, second) == (Trial("a", ("x=1",), variant="a"), Trial("b", ("x=2",), variant="b"))
    assert chain.ask(2) is None
    chain.tell(Report("a", "ok", run="runs/a"))
    assert chain.ask(2) is None
    chain.tell(Report("b", "ok", run="runs/b"))
    third = chain.ask(2)
    assert third is not None
    assert third.overrides == ("run='runs/a'", "runs=['runs/a','runs/b']")
    assert chain.ask(3) is None
    again = Chain(Chain.Options(stages), seed=0)  # replayed after a kill
    assert again.recall(first)
    again.tell(Report("a", "failed: no reason", run="runs/a"))
    assert again.recall(Trial("b", ("x=2",), variant="b"))
    again.tell(Report("b", "ok", run="runs/b"))
    assert again.ask(2) == Trial("a~2", ("x=1",), variant="a")  # nothing to build on yet
    assert again.ask(2) is None, "once for each call of the sweep"
    again.tell(Report("a~2", "ok", run="runs/a~2"))
    third = again.ask(3)
    assert third is not None
    assert third.overrides == ("run='runs/a~2'", "runs=['runs/a~2','runs/b']")
    assert [row["status"] for row in again.summary()] == ["ok", "ok", "not begun"]
    assert again.missing == ["c"]
    with pytest.raises(ConfigError, match=r"had other overrides when this sweep began: x=1\. Give"):
        Chain(Chain.Options({"a": ("x=3",)}), seed=0).recall(first)
    with pytest.raises(
        ConfigError, match=r"had other overrides when this sweep began: none\. Give"
    ):
        Chain(Chain.Options({"a": ("x=3",)}), seed=0).recall(Trial("a", variant="a"))


def test_a_chain_names_only_stages_before() -> None:
    with pytest.raises(ValueError, match="'walk', which is no stage before it"):
        Chain.Options({"sit": ("start.run={walk}",), "walk": ("x=1",)})


def test_what_every_experiment_of_a_chain_has() -> None:
    """A harvest has its run's configuration, so it gets none of it; a stage's own words come later, and so count."""
    stages = {"a": ("experiment=e", "num_worlds=64"), "ends": ("job=harvest", "job.run='{a}'")}
    chain = Chain(Chain.Options(stages, each=("num_worlds=2048", "edge=0.03")), seed=0)
    first = chain.ask(0)
    assert first is not None
    assert first.overrides == ("num_worlds=2048", "edge=0.03", "experiment=e", "num_worlds=64")
    chain.tell(Report("a", "ok", run="runs/a"))
    second = chain.ask(1)
    assert second is not None
    assert second.overrides == ("job=harvest", "job.run='runs/a'")
    with pytest.raises(ValueError, match="each names the stage 'a'"):
        Chain.Options(stages, each=("start.run={a}",))


@pytest.mark.parametrize("alike", [True, False])
def test_no_time_is_told_from_stages_that_are_not_alike(
    alike: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of two stages of seconds followed two minutes and a quarter, it was said, of a judgement that took eight."""
    now = [0.0]
    monkeypatch.setattr(progress, "time", SimpleNamespace(monotonic=lambda: now[0]))
    assert not Chain.alike
    assert not Algorithm1.alike
    journal = Journal(tmp_path / "journal.jsonl")
    with progress.Progress({"a", "b", "c"}, alike) as line:
        line.show(journal, 0.0, 1)
        now[0] = 68.0
        journal.events.append(Report("a", "ok", run="runs/a"))
        line.show(journal, 1 / 3, 1)
    said = capsys.readouterr().err
    assert "1 of 3 done" in said
    assert ("left" in said) == alike
    assert ("about 2:16 left" in said) == alike

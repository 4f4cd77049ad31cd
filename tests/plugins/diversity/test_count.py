"""Counting the strategies of finished searches, from the command line."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
import torch

from understudy.command.cli import main
from understudy_diversity.count import Count
from understudy_sweeps.journal import Journal
from understudy_sweeps.loops import Report, Trial
from understudy_tensors import rotations

AXES = ("x0", "x1", "x2", "z0", "z1", "z2")


def searched(folder: Path, turns: list[float], failed: float | None = None) -> str:
    """A search whose trials faced up by the angles `turns` about x; one at `failed` mostly failed."""
    folder.mkdir()
    journal = Journal(folder / "journal.jsonl")
    every = turns if failed is None else [*turns, failed]
    for number, turn in enumerate(every):
        q = rotations.from_axis_angle(torch.tensor([1.0, 0.0, 0.0]), torch.tensor(turn))
        axes = dict(zip(AXES, rotations.tangent_normal(q).tolist(), strict=True))
        success = 0.3 if number == len(turns) else 1.0
        trial = Trial(f"trial{number}", point={"a.x": 0.5})
        journal.ask(trial)
        measures = {"angle": abs(turn), "success_rate": success, **axes}
        journal.tell(Report(trial.key, "ok", success, measures, 10.0))
    journal.ask(Trial("running", point={"a.x": 0.5}))
    return str(folder)


def test_it_counts_by_several_measures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Turned to one side and to the other are alike by the angle, and not as rotations."""
    first = searched(tmp_path / "a", [0.5, -0.5, 0.6, 2.0], failed=3.0)
    second = searched(tmp_path / "b", [0.5, 1.0])
    words = ["--by", "0.35", "angle", "--by-rotation", "0.35", *AXES]
    assert main(["diversity", "count", first, second, *words]) == 0
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert rows[1] == [first, "5", "2", "3"]
    assert rows[2] == [second, "2", "2", "2"]
    assert rows[3][0] == "mean"
    assert " ".join(rows[3][-6:]) == "2.0 (2 searches) 2.5 (2 searches)"  # too few for an interval
    third = searched(tmp_path / "c", [0.5, -0.5])
    assert main(["diversity", "count", first, second, third, *words]) == 0
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    reach = 4.303 * math.sqrt(1 / 3) / math.sqrt(3)  # of 3, 2, 2 kinds
    assert " ".join(rows[4][-3:]) == f"{7 / 3:.1f} [{7 / 3 - reach:.1f}, {7 / 3 + reach:.1f}]"
    assert main(["diversity", "count", first, *words[:3], "--success", "0.2"]) == 0
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert rows[1:] == [[first, "5", "3"], ["mean", "5.0", "3.0"]]


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ([], "Say by which measures"),
        (["--by", "angle"], "could not convert string to float"),
        (["--by", "0.3"], "features must not be empty"),
        (["--by", "nan", "angle"], "distinct=nan is not possible"),
        (["--by", "inf", "angle"], "distinct=inf is not possible"),
        (["--by", "0.3", "angle", "--success", "2"], "success=2.0 is not possible"),
        (["--by-rotation", "0.3", "x0"], "takes six"),
        (["--by", "0.3", "angel"], "The feature 'angel' is no measure of trial 'trial0'"),
    ],
)
def test_what_cannot_be_counted_is_one_sentence(
    words: list[str], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = searched(tmp_path / "a", [0.5])
    assert main(["diversity", "count", folder, *words]) == 2
    assert sentence in capsys.readouterr().err
    assert main(["diversity", "count", str(tmp_path), "--by", "1", "angle"]) == 2
    assert "is no folder of a search" in capsys.readouterr().err


def test_its_example_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of searches whose trials measured an angle."""
    (tmp_path / "runs").mkdir()
    searched(tmp_path / "runs" / "vault", [0.5, 2.0])
    monkeypatch.chdir(tmp_path)
    assert main(Count.example.split()[1:]) == 0

"""What the environment says of processes, whoever set it."""

from __future__ import annotations

from pathlib import Path

import pytest

from understudy.command.cli import main
from understudy.errors import ConfigError
from understudy_training import processes


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"WORLD_SIZE": "abc"}, "WORLD_SIZE=abc in the environment is not possible: it takes a whole number from 1 on"),
        ({"WORLD_SIZE": "0"}, "WORLD_SIZE=0 in the environment is not possible"),
        ({"WORLD_SIZE": "2"}, "WORLD_SIZE=2 is in the environment without RANK, MASTER_ADDR, MASTER_PORT"),
        ({"WORLD_SIZE": "2", "RANK": "x"}, "without MASTER_ADDR, MASTER_PORT"),
        ({"WORLD_SIZE": "2", "RANK": "x", "MASTER_ADDR": "a", "MASTER_PORT": "1"}, "RANK=x in the environment"),
        ({"WORLD_SIZE": "2", "RANK": "2", "MASTER_ADDR": "a", "MASTER_PORT": "1"}, "RANK=2 is not possible: WORLD_SIZE=2"),
    ],
    ids=str,
)  # fmt: skip
@pytest.mark.parametrize("command", ["train", "sweep"])
def test_what_no_torchrun_set_is_refused(
    given: dict[str, str],
    said: str,
    command: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Clusters and images set such variables, too; torch ended in a traceback."""
    for name in ("WORLD_SIZE", "RANK", "LOCAL_RANK", "MASTER_ADDR", "MASTER_PORT"):
        monkeypatch.delenv(name, raising=False)
    for name, value in given.items():
        monkeypatch.setenv(name, value)
    words = ["experiment=miniature/go", f"run.dir={tmp_path / 'run'}"]
    assert main([command, *words, *(["variants={a: []}"] if command == "sweep" else [])]) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("patience", ["abc", "nan", "inf", "-1", ""])
def test_an_impossible_patience_is_refused(patience: str, monkeypatch: pytest.MonkeyPatch) -> None:
    here = {"WORLD_SIZE": "2", "RANK": "0", "MASTER_ADDR": "localhost", "MASTER_PORT": "1"}
    for name, value in {**here, "UNDERSTUDY_PATIENCE": patience}.items():
        monkeypatch.setenv(name, value)
    with pytest.raises(ConfigError, match=f"^UNDERSTUDY_PATIENCE={patience} in the environment"):
        processes.start("cpu")

"""When a stop signal interrupts: not in the middle of an import, and at last in any case."""

from __future__ import annotations

import importlib
import signal
import sys
from pathlib import Path

import pytest
from commands import forked

from understudy.signals import StopRequest

#: A module in whose import a signal comes, which a library would make nothing of.
STOPPED = """
import contextlib, os, signal
from understudy.signals import StopRequest

with contextlib.suppress(KeyboardInterrupt):
    os.kill(os.getpid(), signal.SIGTERM)
with StopRequest():  # one that passes on what it does not answer
    pass
import stopped_within
whole = True
"""


@pytest.fixture
def stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """The name of that module, which imports another."""
    (tmp_path / "stopped_at_import.py").write_text(STOPPED)
    (tmp_path / "stopped_within.py").touch()
    monkeypatch.syspath_prepend(tmp_path)
    for name in ("stopped_at_import", "stopped_within"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    return "stopped_at_import"


def test_an_import_ends_before_it_is_interrupted(stopped: str) -> None:
    with StopRequest(at_once=True) as stop:
        with pytest.raises(KeyboardInterrupt, match="SIGTERM"):
            importlib.import_module(stopped)
        assert stop.received == signal.SIGTERM
    assert sys.modules[stopped].whole
    assert sys.getprofile() is None


def test_what_fails_to_be_imported_is_interrupted(stopped: str, tmp_path: Path) -> None:
    (tmp_path / "stopped_within.py").write_text("raise ImportError")
    with pytest.raises(KeyboardInterrupt), StopRequest(at_once=True):
        importlib.import_module(stopped)
    assert stopped not in sys.modules


def test_an_import_that_began_outside_holds_nothing_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As of a script of a user's that is imported, and runs a command."""
    (tmp_path / "runs_at_import.py").write_text(
        "import os, signal\nfrom understudy.signals import StopRequest\n"
        "with StopRequest(at_once=True):\n    os.kill(os.getpid(), signal.SIGTERM)\n    late = True\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(KeyboardInterrupt):
        importlib.import_module("runs_at_import")


#: A library that makes nothing of Ctrl-C.
SWALLOWS = """
import signal, sys
from understudy.signals import StopRequest
with StopRequest(at_once=sys.argv[1] == "at once"):
    for _ in range(4):
        try:
            signal.raise_signal(signal.SIGINT)
        except:
            print("swallowed", flush=True)
print("went on", flush=True)
"""


@pytest.mark.parametrize("how", ["at once", "later"])
def test_a_third_ctrl_c_ends_it_in_any_case(how: str, tmp_path: Path) -> None:
    ended = forked(SWALLOWS, how, cwd=tmp_path)
    assert (ended.returncode, ended.stdout) == (-signal.SIGINT, "swallowed\n")

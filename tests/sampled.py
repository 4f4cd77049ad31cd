"""Where the tests' processor time goes, by cause: a plugin of pytest that looks at the stack every 3 ms of it.

``pytest -p sampled TESTS`` (with this folder on ``PYTHONPATH``) prints, of all functions: the seconds within them, those
within what they call included, and those that are nearest below one of ours. What other threads and C code take counts
where the main thread is; of what tests start, which is not sampled, it prints the sum. It takes some 3 % more time.
"""

from __future__ import annotations

import resource
import signal
import sys
import time
from collections import Counter
from pathlib import Path
from types import CodeType, FrameType

import pytest

#: s of processor time between two looks.
EVERY = 0.003
#: Functions that are printed of each kind.
MOST = 60
ROOT = Path(__file__).resolve().parents[1]
_stacks: Counter[tuple[CodeType, ...]] = Counter()
_last = 0.0


def _look(number: int, frame: FrameType | None) -> None:
    global _last
    now = time.process_time()
    stack = []
    while frame is not None:
        stack.append(frame.f_code)
        frame = frame.f_back
    _stacks[tuple(stack)] += now - _last  # type: ignore[assignment]
    _last = now


def _name(code: CodeType) -> str:
    file = code.co_filename
    for folder in ("site-packages", f"python3.{sys.version_info.minor}", str(ROOT)):
        file = file.rpartition(f"{folder}/")[2]
    return f"{file}:{code.co_firstlineno} {code.co_qualname}"


@pytest.hookimpl(tryfirst=True)
def pytest_load_initial_conftests() -> None:
    signal.signal(signal.SIGPROF, _look)
    signal.setitimer(signal.ITIMER_PROF, EVERY, EVERY)  # which a fork does not have


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    signal.setitimer(signal.ITIMER_PROF, 0.0)
    within: Counter[CodeType] = Counter()
    nearest: Counter[CodeType] = Counter()
    for stack, seconds in _stacks.items():
        for code in set(stack):
            within[code] += seconds  # type: ignore[assignment]
        ours = (
            c for c in stack if c.co_filename.startswith(str(ROOT)) and ".venv" not in c.co_filename
        )
        nearest[next(ours, stack[0])] += seconds  # type: ignore[assignment]
    started = resource.getrusage(resource.RUSAGE_CHILDREN)
    write = terminalreporter.write_line
    write(
        f"{sum(_stacks.values()):.1f} s here, {started.ru_utime + started.ru_stime:.1f} s in what ended by now"
    )
    for title, counted in (("nearest of ours", nearest), ("within", within)):
        terminalreporter.write_sep("-", title)
        for code, seconds in counted.most_common(MOST):
            write(f"{seconds:8.2f} {_name(code)}")

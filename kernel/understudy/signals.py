"""Stop signals of Ctrl-C, a scheduler or a closed terminal: work is saved first."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass
from types import FrameType
from typing import Any, ClassVar

from understudy.errors import PreemptedError

__all__ = ["StopRequest", "is_stop"]


@dataclass(eq=False)
class StopRequest:
    """Inside, a stop signal is noted in `received`. The first one interrupts if `at_once`, else a
    second Ctrl-C does; not before the end of an import that has begun inside. A third Ctrl-C ends
    the process, whatever a library made of those before.

    They nest: the innermost decides. At its end, a signal that led to no PreemptedError is passed
    to the next outer one. After one that is `for_good`, signals do nothing. SIGHUP stays ignored if
    it was (``nohup``). Outside the main thread nothing is handled: the caller handles signals. The
    outermost's `tell` hears of a first Ctrl-C that is only noted.
    """

    at_once: bool = False
    for_good: bool = False
    received: int | None = None
    tell: Callable[[str], None] = lambda text: None
    advice: str = "Give the same command again."  #: for the user who stopped it

    _pressed: int = 0  # Ctrl-C, as the outermost counts
    _entered: int = 0  # the frame, by its id

    SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGUSR1, signal.SIGHUP)
    _nested: ClassVar[list[StopRequest]] = []
    _previous: ClassVar[dict[int, Any]] = {}

    def __enter__(self) -> StopRequest:
        if threading.current_thread() is threading.main_thread():
            self.received = self._nested[-1].received if self._nested else None
            self._entered = id(sys._getframe(1))
            self._nested.append(self)
            ignored = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
            for number in self.SIGNALS[: 3 if ignored else 4]:
                if signal.getsignal(number) is not _note:  # again, if a library replaced it
                    self._previous[number] = signal.signal(number, _note)
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self in self._nested:
            self._nested.remove(self)  # maybe not the last: a generator may be closed later than it
            while self._previous and not self._nested:
                number, before = self._previous.popitem()
                signal.signal(number, signal.SIG_IGN if self.for_good else before)
            if self.received is not None and kind is not PreemptedError:
                _note(self.received)

    def advise(self, text: str) -> None:
        for request in self._nested:
            request.advice = text


def is_stop(error: BaseException) -> bool:
    """Whether a stop signal raised the error, rather than code that raises KeyboardInterrupt."""
    asked = any(r.received is not None for r in StopRequest._nested) or not StopRequest._nested
    return isinstance(error, KeyboardInterrupt) and asked


def _note(number: int, frame: FrameType | None = None) -> None:
    for request in StopRequest._nested[-1:]:
        before, request.received = request.received, request.received or number
        ctrl_c = frame is not None and number == signal.SIGINT  # not one passed on
        StopRequest._nested[0]._pressed += ctrl_c
        if StopRequest._nested[0]._pressed > 2:
            signal.signal(number, signal.SIG_DFL)
            signal.raise_signal(number)
        if before is None if request.at_once else before == number == signal.SIGINT:
            _interrupt(signal.Signals(number).name, request._entered)
        elif before is None and ctrl_c:
            text = "Stopping once what is begun is finished. A second Ctrl-C stops at once."
            StopRequest._nested[0].tell(text)


def _interrupt(name: str, entered: int) -> None:
    """Raise KeyboardInterrupt; after an import that is under way, since C++ that is imported may
    abort the process, or swallow it and stay half imported."""
    frame, importing = sys._getframe(), None
    while frame is not None and id(frame) != entered:
        if frame.f_code.co_filename.startswith("<frozen importlib._bootstrap"):
            importing = frame  # at last the outermost
        frame = frame.f_back

    def ended(frame: FrameType, event: str, _: object) -> None:
        if frame is importing and event == "return":
            raise KeyboardInterrupt(name)  # after which Python calls this no more

    if importing is None:
        raise KeyboardInterrupt(name)
    sys.setprofile(ended)

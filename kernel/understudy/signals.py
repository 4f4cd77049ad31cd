"""Stop signals: what Ctrl-C, a scheduler or a closed terminal ends is saved first where that matters."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

from understudy.errors import PreemptedError

__all__ = ["StopRequest", "is_stop"]


@dataclass(eq=False)
class StopRequest:
    """Inside, signals are noted in `received`; `at_once` the first, else a second Ctrl-C interrupts.

    They nest: the innermost decides, and a signal that led to no PreemptedError goes on to the next
    outer one in the end. After one that is `for_good`, signals do nothing. SIGHUP stays ignored
    where it was (``nohup``). Outside the main thread nothing happens: whoever runs us handles
    signals. The outermost's `tell` hears of a first Ctrl-C that is noted.
    """

    at_once: bool = False
    for_good: bool = False
    received: int | None = None
    tell: Callable[[str], None] = lambda text: None
    advice: str = "Give the same command again."  #: to who stopped us

    SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGUSR1, signal.SIGHUP)
    _nested: ClassVar[list[StopRequest]] = []
    _previous: ClassVar[dict[int, Any]] = {}

    def __enter__(self) -> StopRequest:
        if threading.current_thread() is threading.main_thread():
            self.received = self._nested[-1].received if self._nested else None
            self._nested.append(self)
            ignored = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
            for number in self.SIGNALS[: 3 if ignored else 4]:
                if signal.getsignal(number) is not _note:  # anew where a library took it since
                    self._previous[number] = signal.signal(number, _note)
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self in self._nested:
            self._nested.remove(self)  # a generator that is closed later may have come after it
            while self._previous and not self._nested:
                number, before = self._previous.popitem()
                signal.signal(number, signal.SIG_IGN if self.for_good else before)
            if self.received is not None and kind is not PreemptedError:
                _note(self.received)

    def advise(self, text: str) -> None:
        for request in self._nested:
            request.advice = text


def is_stop(error: BaseException) -> bool:
    """Whether a stop signal raised the error, rather than some code by itself."""
    asked = any(r.received is not None for r in StopRequest._nested) or not StopRequest._nested
    return isinstance(error, KeyboardInterrupt) and asked


def _note(number: int, frame: object = None) -> None:
    for request in StopRequest._nested[-1:]:
        before, request.received = request.received, request.received or number
        if before is None if request.at_once else before == number == signal.SIGINT:
            raise KeyboardInterrupt(signal.Signals(number).name)
        if frame is not None and before is None and number == signal.SIGINT:  # as it comes, once
            text = "Stopping once this iteration is finished. A second Ctrl-C stops at once."
            StopRequest._nested[0].tell(text)

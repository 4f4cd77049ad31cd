"""The controls of pages on which a world runs by itself: pause, restart, speed."""

from __future__ import annotations

from collections.abc import Callable

import viser

from understudy_play.pace import Pace

_SPEEDS = {"0.25 ×": 0.25, "0.5 ×": 0.5, "1 ×": 1.0}


class Controls:
    """The buttons, and the clock that they govern. The browser's events only set what :meth:`run` and
    the page read, in one assignment each."""

    def __init__(self) -> None:
        self.closed = False
        self.again = False  #: whether the visitor wants a new episode
        self._playing, self._speed = True, 1.0

    def add_to(self, gui: viser.GuiApi) -> None:
        """Put the buttons where `gui` has come to."""
        pause, again = gui.add_button("Pause"), gui.add_button("Start again")
        speed = gui.add_dropdown("Speed", tuple(_SPEEDS), initial_value="1 ×")

        @pause.on_click
        def _(_: object) -> None:
            self._playing = not self._playing
            pause.label = "Pause" if self._playing else "Play"

        @again.on_click
        def _(_: object) -> None:
            self.again = True

        @speed.on_update
        def _(_: object) -> None:
            self._speed = _SPEEDS[speed.value]

    def taken_again(self) -> bool:
        """Whether the visitor wanted a new episode since this was last asked."""
        wanted, self.again = self.again, False
        return wanted

    def run(self, dt: float, advance: Callable[[Callable[[], None]], None]) -> None:
        """Until the page is closed: `advance` by a decision, which is given what lets `dt` s pass."""
        pace = Pace()

        def wait() -> None:
            pace.wait(dt / self._speed)

        while not self.closed:
            if self._playing:
                advance(wait)
            else:
                wait()

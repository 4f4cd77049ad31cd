"""Serving a page until Ctrl-C."""

from __future__ import annotations

import webbrowser
from typing import Protocol

__all__ = ["serve"]


class Served(Protocol):
    """A page that is served."""

    @property
    def url(self) -> str: ...
    def run(self) -> None: ...
    def close(self) -> None: ...


def serve(page: Served, does: str, *, browser: bool) -> None:
    """Serve `page` until Ctrl-C, after a line that says what it `does`; with `browser`, open it there."""
    try:
        print(f"{page.url} {does}; Ctrl-C ends it.", flush=True)
        if browser:
            webbrowser.open(page.url)
        page.run()
    except KeyboardInterrupt:
        pass
    finally:
        page.close()

"""A page's server: viser's, which answers its own address alone and says nothing."""

from __future__ import annotations

import contextlib
import io
import logging

import viser

from understudy_viewer.guard import Door, guarded

__all__ = ["open_server", "stop_server"]


def open_server(host: str, port: int) -> tuple[viser.ViserServer, str]:
    """A server at `host` and the first free port from `port` on, and its address for a browser."""
    # Browsers open connections in advance and drop them, which is no error.
    logging.getLogger("websockets.server").setLevel(logging.CRITICAL)
    door = Door()
    with guarded(host, door), contextlib.redirect_stdout(io.StringIO()):  # viser announces itself
        server = viser.ViserServer(host, port, label="understudy", verbose=False)
    door.gui = server.gui
    at = f"[{host}]" if ":" in host else host
    return server, f"http://{at}:{server.get_port()}"


def stop_server(server: viser.ViserServer) -> None:
    """End it, without viser's farewell."""
    with contextlib.redirect_stdout(io.StringIO()):
        server.stop()

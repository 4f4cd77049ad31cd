"""Who may talk to a page: any number of browsers that opened it, but not other sites' pages that these browsers have
open, too."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import http
import ipaddress
import socket
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import urlsplit

import viser.infra._infra
import websockets.asyncio.server as server
from viser.infra._async_message_buffer import AsyncMessageBuffer
from websockets import Headers
from websockets.http11 import Request, Response

__all__ = ["guarded"]


def is_own(headers: Headers, host: str) -> bool:
    """Whether a request with these `headers` means the page served at `host`.

    It names the page by an address, as a name that someone else gave it (DNS rebinding) does not, by one
    of this machine's own names, or by `host`; and a browser sends it from no other page.
    """
    named, origins = headers.get_all("Host"), headers.get_all("Origin")
    if len(named) != 1 or len(origins) > 1:
        return False
    try:
        name = urlsplit(f"//{named[0]}").hostname or ""
        origin = urlsplit(origins[0]) if origins else None
    except ValueError:
        return False
    if origin is not None and (origin.scheme not in ("http", "https") or origin.netloc != named[0]):
        return False
    if name in {"localhost", host.lower(), socket.gethostname().lower()}:
        return True
    with contextlib.suppress(ValueError):
        return bool(ipaddress.ip_address(name))
    return False


#: Where viser takes them from.
infra: Any = viser.infra._infra


class _Event(asyncio.Event):
    """Set by its own loop alone, which viser asks for each time. viser sets it at once, too, from whatever
    thread draws, and while visitors come and go that ends the drawing with an error."""

    def set(self) -> None:
        try:
            asyncio.get_running_loop()
        except RuntimeError:
            return
        super().set()


@dataclass
class _Messages(AsyncMessageBuffer):
    """To all visitors, from any thread."""

    message_event: asyncio.Event = field(default_factory=_Event)


@contextlib.contextmanager
def guarded(host: str) -> Iterator[None]:
    """Inside, servers of viser that begin at `host` refuse whatever :func:`is_own` does not know, and what is
    drawn for all may be drawn in any thread. viser itself has no such options."""
    serve, messages = server.serve, infra.AsyncMessageBuffer

    @functools.wraps(serve)
    def ours(
        *arguments: Any, process_request: Callable[..., Any] | None = None, **more: Any
    ) -> Any:
        def check(connection: server.ServerConnection, request: Request) -> Any:
            if not is_own(request.headers, host):
                text = b"This page answers its own address alone.\n"
                length = Headers({"Content-Length": str(len(text)), "Connection": "close"})
                return Response(http.HTTPStatus.FORBIDDEN, "Forbidden", length, text)
            return process_request(connection, request) if process_request else None

        return serve(*arguments, process_request=check, **more)

    server.serve, infra.AsyncMessageBuffer = ours, _Messages  # type: ignore[misc]
    try:
        yield
    finally:
        server.serve, infra.AsyncMessageBuffer = serve, messages  # type: ignore[misc]

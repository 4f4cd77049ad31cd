"""Who may talk to a page, and what they may say: any number of browsers that opened it, but not other sites' pages that
these browsers have open, too; what the page asks for, and nothing else."""

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

import msgspec
import viser.infra._infra
import websockets.asyncio.server as server
from viser import _messages
from viser.infra._async_message_buffer import AsyncMessageBuffer
from websockets import Headers
from websockets.http11 import Request, Response

__all__ = ["Door", "guarded"]

#: By name, what a browser says that shows one of our pages. viser listens to more: to whoever asks for it, it
#: takes in files, and shows the page to the whole internet.
_TAKEN: dict[str, Any] = {
    kind.__name__: kind
    for kind in (
        _messages.ViewerCameraMessage,
        _messages.ScenePointerMessage,
        _messages.TransformControlsDragStartMessage,
        _messages.TransformControlsUpdateMessage,
        _messages.TransformControlsDragEndMessage,
        _messages.GuiUpdateMessage,
        _messages.CommandTriggerMessage,
    )
}
#: Most bytes of a message, and the largest number in it: m, pixels.
_LONGEST, _LARGEST = 2**16, 1e6


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


class Door:
    """Which messages are let in: those of a kind, of numbers and of values that the page can have. The others
    are as if they had not been sent; viser would set what they say, whatever it is."""

    def __init__(self) -> None:
        self.gui: viser.GuiApi | None = None  #: the page's, once it is there

    def lets_in(self, raw: Any) -> bool:
        """Whether the message `raw`, as it was received, is one of those."""
        try:
            content = msgspec.msgpack.decode(raw)
            kind = content.pop("type")
            message = msgspec.convert(content, _TAKEN[kind])
        except (
            msgspec.MsgspecError,
            ValueError,
            LookupError,
            TypeError,
            AttributeError,
            RecursionError,
        ):
            return False
        if isinstance(message, _messages.GuiUpdateMessage):
            return self._fits(message)
        if isinstance(message, _messages.ScenePointerMessage):
            of_click = (message.ray_origin, message.ray_direction, message.screen_pos)
            return message.event_type == "click" and all(of_click) and _bounded(content)
        return _bounded(content)

    def _fits(self, message: _messages.GuiUpdateMessage) -> bool:
        known: Any = {} if self.gui is None else self.gui._gui_input_handle_from_uuid
        handle = known.get(message.uuid)
        if handle is None or set(message.updates) != {"value"}:
            return False
        before, value = handle.value, message.updates["value"]
        if isinstance(before, str):
            return value in handle.options
        if isinstance(before, bool):
            return isinstance(value, bool)
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        return number and handle.min <= value <= handle.max

    def watched(self, handler: Callable[..., Any]) -> Callable[..., Any]:
        """The `handler` of connections, which receives from each only what is let in."""

        async def handle(connection: server.ServerConnection) -> None:
            receive: Any = connection.recv

            async def received() -> str | bytes:
                while not self.lets_in(raw := await receive()):
                    pass
                return raw

            connection.recv = received  # type: ignore[method-assign, assignment]
            await handler(connection)

        return handle


def _bounded(value: Any) -> bool:
    """Whether all numbers in `value` are finite, and none is too large for a place."""
    if isinstance(value, dict):
        return all(map(_bounded, value.values()))
    if isinstance(value, (list, tuple)):
        return all(map(_bounded, value))
    return not isinstance(value, (int, float)) or abs(value) <= _LARGEST


@contextlib.contextmanager
def guarded(host: str, door: Door) -> Iterator[None]:
    """Inside, servers of viser that begin at `host` refuse whatever :func:`is_own` does not know, hear what the
    `door` lets in, and what is drawn for all may be drawn in any thread. viser itself has no such options."""
    serve, messages = server.serve, infra.AsyncMessageBuffer

    @functools.wraps(serve)
    def ours(
        handler: Callable[..., Any],
        *arguments: Any,
        process_request: Callable[..., Any] | None = None,
        **more: Any,
    ) -> Any:
        def check(connection: server.ServerConnection, request: Request) -> Any:
            if not is_own(request.headers, host):
                text = b"This page answers its own address alone.\n"
                length = Headers({"Content-Length": str(len(text)), "Connection": "close"})
                return Response(http.HTTPStatus.FORBIDDEN, "Forbidden", length, text)
            return process_request(connection, request) if process_request else None

        more |= {"process_request": check, "max_size": _LONGEST}
        return serve(door.watched(handler), *arguments, **more)

    server.serve, infra.AsyncMessageBuffer = ours, _Messages  # type: ignore[misc]
    try:
        yield
    finally:
        server.serve, infra.AsyncMessageBuffer = serve, messages  # type: ignore[misc]

"""Pages of others, which a browser has open beside ours, reach nothing of it."""

from __future__ import annotations

import contextlib
import io
import socket
import threading
import time
from typing import Any

import pytest
from page_requests import CAMERA, CLICK, NO_MESSAGES, nonsense

pytest.importorskip("viser", reason="viser is not installed (the extra 'view')")

import msgspec
import viser
import viser.infra._infra
from websockets import Headers

from understudy_viewer.guard import Door, guarded, is_own


def headers(host: str | None, *origins: str) -> Headers:
    pairs = [] if host is None else [("Host", host)]
    return Headers([*pairs, *(("Origin", origin) for origin in origins)])


OWN = [
    ("127.0.0.1:8080",),
    ("localhost:8080", "http://localhost:8080"),
    ("localhost:9000", "http://localhost:9000"),  # through a tunnel
    ("[::1]:8080", "http://[::1]:8080"),
    ("10.1.2.3:8080", "http://10.1.2.3:8080"),
    ("LOCALHOST",),
    (f"{socket.gethostname()}:8080",),
    ("lab.example:8080", "https://lab.example:8080"),  # as --host says
]
OTHERS = [
    (None,),
    ("",),
    ("evil.example:8080",),
    ("evil.example:8080", "http://evil.example:8080"),
    ("127.0.0.1.evil.example:8080",),
    ("localhost.evil.example",),
    ("127.0.0.1:8080", "http://evil.example"),
    ("127.0.0.1:8080", "http://127.0.0.1:8888"),  # another server of this machine
    ("127.0.0.1:8080", "http://localhost:8080"),
    ("127.0.0.1:8080", "null"),
    ("127.0.0.1:8080", "file://127.0.0.1:8080"),
    ("127.0.0.1:8080", "http://127.0.0.1:8080", "http://evil.example"),
    ("127.0.0.1:8080", "http://user@127.0.0.1:8080"),
    ("[::1", "http://[::1"),
]


@pytest.mark.parametrize("given", OWN, ids=str)
def test_own(given: tuple[str, ...]) -> None:
    assert is_own(headers(*given), "lab.example")


@pytest.mark.parametrize("given", OTHERS, ids=str)
def test_others(given: tuple[str | None, ...]) -> None:
    assert not is_own(headers(given[0], *(o for o in given[1:] if o)), "lab.example")


def test_two_hosts_are_none() -> None:
    both = Headers([("Host", "127.0.0.1"), ("Host", "evil.example")])
    assert not is_own(both, "127.0.0.1")


def test_what_a_browser_says_is_let_in() -> None:
    moved = {"name": "/target", "wxyz": (1, 0, 0, 0), "position": (0.5, 0, -2.0), "owner": "server"}
    for kind, fields in (
        ("ViewerCameraMessage", CAMERA),
        ("ScenePointerMessage", CLICK),
        ("ScenePointerMessage", {**CLICK, "modifier": "cmd/ctrl+shift"}),
        ("TransformControlsDragStartMessage", {"name": "/target", "owner": ""}),
        ("TransformControlsUpdateMessage", moved),
        ("TransformControlsDragEndMessage", {"name": "/target", "owner": ""}),
        ("CommandTriggerMessage", {"uuid": "x"}),
    ):
        assert Door().lets_in(msgspec.msgpack.encode({"type": kind, **fields})), kind


def test_nonsense_is_not_let_in() -> None:
    for raw in NO_MESSAGES:
        assert not Door().lets_in(raw), raw[:20]
    for kind, fields in nonsense(["x"]):
        assert not Door().lets_in(msgspec.msgpack.encode({"type": kind, **fields})), (kind, fields)


def test_the_library_is_as_it_was() -> None:
    import websockets.asyncio.server as server

    infra: Any = viser.infra._infra
    before = server.serve, infra.AsyncMessageBuffer
    with guarded("127.0.0.1", Door()):
        assert server.serve is not before[0]
    assert (server.serve, infra.AsyncMessageBuffer) == before


class Visitor:
    """Waits for something to be drawn, and notes in which thread it is asked whether it still does."""

    def __init__(self) -> None:
        self.asked_in: set[int] = set()

    def done(self) -> bool:
        self.asked_in.add(threading.get_ident())
        return True


def test_visitors_are_woken_in_their_own_thread() -> None:
    """viser wakes them in the one that draws, too, in which the list of them may change meanwhile: the page
    ended with `deque mutated during iteration` within a minute of fifty who come and go."""
    with guarded("127.0.0.1", Door()), contextlib.redirect_stdout(io.StringIO()):
        server = viser.ViserServer("127.0.0.1", 8950, verbose=False)
    try:
        visitor: Any = Visitor()
        event: Any = server._websock_server._broadcast_buffer.message_event
        event._waiters.append(visitor)
        event.clear()
        server.scene.add_frame("/drawn")
        deadline = time.monotonic() + 10
        while not visitor.asked_in:
            assert time.monotonic() < deadline, "nobody is told of what was drawn"
            time.sleep(0.01)
        assert threading.get_ident() not in visitor.asked_in
        event._waiters.remove(visitor)
    finally:
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()

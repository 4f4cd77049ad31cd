"""Requests to a page, as browsers and others make them."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from urllib.parse import urlsplit

import pytest


def status(url: str, *lines: str) -> int:
    """Of what is answered to a request with these header lines."""
    port = urlsplit(url).port
    with socket.create_connection(("127.0.0.1", port or 0), timeout=10) as talk:
        talk.sendall("\r\n".join(["GET / HTTP/1.1", *lines, "", ""]).encode())
        return int(talk.recv(64).split()[1])


@contextmanager
def visitor(url: str) -> Iterator[Callable[..., None]]:
    """What sends a browser's messages to the page at `url`: a type of viser's, and its fields."""
    viser = pytest.importorskip("viser", reason="viser is not installed (the extra 'view')")
    import msgspec
    from websockets.sync.client import connect
    from websockets.typing import Subprotocol

    version = Subprotocol(f"viser-v{viser.__version__}")
    with connect(url.replace("http", "ws"), subprotocols=[version], max_size=None) as sockets:
        yield lambda kind, **fields: sockets.send(msgspec.msgpack.encode({"type": kind, **fields}))


SOCKET = ("Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13",
          "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==", "Sec-WebSocket-Protocol: viser-v1.1.1")  # fmt: skip


def check_page(url: str) -> None:
    """A page at `url` answers its own address and no other."""
    own = urlsplit(url).netloc
    assert status(url, f"Host: {own}") == 200
    assert status(url, "Host: evil.example") == 403
    assert status(url, f"Host: {own}", f"Origin: {url}", *SOCKET) == 101
    assert status(url, f"Host: {own}", *SOCKET) == 101, "what is no browser has no origin"
    for origin in ("http://evil.example", "null", "http://127.0.0.1:1"):
        assert status(url, f"Host: {own}", f"Origin: {origin}", *SOCKET) == 403
    assert status(url, "Host: evil.example", "Origin: http://evil.example", *SOCKET) == 403

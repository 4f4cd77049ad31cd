"""Pages of others, which a browser has open beside ours, reach nothing of it."""

from __future__ import annotations

import socket

import pytest

pytest.importorskip("viser", reason="viser is not installed (the extra 'view')")

from websockets import Headers

from understudy_viewer.guard import guarded, is_own


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


def test_the_library_is_as_it_was() -> None:
    import websockets.asyncio.server as server

    before = server.serve
    with guarded("127.0.0.1"):
        assert server.serve is not before
    assert server.serve is before

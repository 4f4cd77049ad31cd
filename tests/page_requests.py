"""Requests to a page, as browsers and others make them."""

from __future__ import annotations

import collections
import socket
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any
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


#: What a browser says first, and of a click.
CAMERA: dict[str, Any] = {
    "wxyz": (1.0, 0.0, 0.0, 0.0), "position": (0.0, -3.0, 1.0), "fov": 0.8, "near": 0.01, "far": 1000.0,
    "image_height": 600, "image_width": 900, "look_at": (0.0, 0.0, 1.0), "up_direction": (0.0, 0.0, 1.0),
}  # fmt: skip
CLICK: dict[str, Any] = {
    "event_type": "click", "ray_origin": (0.0, -3.0, 1.0), "ray_direction": (0.0, 0.9, -0.3),
    "screen_pos": ((0.5, 0.5),), "modifier": None,
}  # fmt: skip
_NAN, _HUGE = float("nan"), 1e300
#: What nothing on a page can be, what can be set of nothing, and what is no message.
_VALUES = (_NAN, float("inf"), -_HUGE, _HUGE, -1, "", "x", "0.5", None, [], [1.0], {}, {"x": 1}, b"x", 2**63)  # fmt: skip
_KEYS = ("props", "update_cb", "gui_api", "sync_cb", "is_button", "removed", "uuid", "__class__", "x")  # fmt: skip
NO_MESSAGES = (
    b"", b"\x00", b"\xff", b"\xc1" * 9, b"\x93\x01\x02\x03", b"\x81", "", "hello", "{}", b"\xdf\xff\xff\xff\xff",
    b"\x81\xa4type\xa1x", b"\x81\xa4type\x01", b"\x81\xa4type\xa7Message", b"\x91" * 5000,
)  # fmt: skip


def nonsense(inputs: Iterable[str]) -> Iterator[tuple[str, dict[str, Any]]]:
    """What no browser says to a page with these `inputs`, though the library would hear it: kind and fields."""
    for name in inputs:
        for updates in (
            *({"value": v} for v in _VALUES),
            *({k: 1} for k in _KEYS),
            {},
            [],
            1,
            None,
        ):
            yield "GuiUpdateMessage", {"uuid": name, "updates": updates}
        file = {"filename": "../x", "mime_type": "", "part_count": 2**40, "size_bytes": 2**60}
        yield "FileTransferStartUpload", file | {"source_component_uuid": name, "transfer_uuid": ""}
    for kind in ("ShareUrlRequest", "ShareUrlDisconnect", "Message", "GuiUpdateMessage"):
        yield kind, {}
    wrong = (_NAN, _HUGE, "x", {}, [], [_NAN] * 3, [_HUGE] * 3, [_HUGE] * 4, ["x"] * 3, [0.0] * 2)
    for kind, whole in (("ViewerCameraMessage", CAMERA), ("ScenePointerMessage", CLICK)):
        for key in whole:
            for value in wrong:
                yield kind, {**whole, key: value}
    turn = (1.0, 0.0, 0.0, 0.0)
    for value in wrong:
        yield "TransformControlsUpdateMessage", {"name": "/target", "wxyz": turn, "position": value}
        yield "TransformControlsUpdateMessage", {"name": "/target", "wxyz": value, "position": [0.0] * 3}  # fmt: skip


def check_nonsense(url: str, server: Any) -> None:
    """Nothing of what no browser says to the page at `url` changes what viser's `server` has; what is said after
    it is heard."""
    pytest.importorskip("viser", reason="viser is not installed (the extra 'view')")
    import msgspec
    import viser
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.client import connect
    from websockets.typing import Subprotocol

    shared: list[str] = []
    server.request_share_url = lambda *_, **__: shared.append("the page is shown to everybody")
    inputs = dict(server.gui._gui_input_handle_from_uuid)
    before = {name: handle.value for name, handle in inputs.items()}
    chosen = next(n for n, handle in inputs.items() if isinstance(handle, viser.GuiDropdownHandle))
    value = next(option for option in inputs[chosen].options if option != before[chosen])
    version = Subprotocol(f"viser-v{viser.__version__}")
    at = url.replace("http", "ws")
    with connect(at, subprotocols=[version], max_size=None) as talk:
        for message in NO_MESSAGES:
            talk.send(message)
        for kind, fields in nonsense(inputs):
            talk.send(msgspec.msgpack.encode({"type": kind, **fields}))
        fields = {"uuid": chosen, "updates": {"value": value}}
        talk.send(msgspec.msgpack.encode({"type": "GuiUpdateMessage", **fields}))
        due = time.monotonic() + 20.0
        while inputs[chosen].value != value:
            assert time.monotonic() < due, "what a browser says is not heard any more"
            time.sleep(0.02)
    after = {name: handle.value for name, handle in inputs.items()}
    assert after == {**before, chosen: value}
    assert not shared
    assert not server.gui._current_file_upload_states
    with connect(at, subprotocols=[version], max_size=None) as talk:
        talk.send(b"x" * 2**20)
        with pytest.raises(ConnectionClosed):
            collections.deque(talk, maxlen=0)


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

"""Bringing one file here, so that an interruption costs only what is still missing.

The content is collected in a partial file. Beside it stands the validator (RFC 9110, 8.8) of what it
is the beginning of; with it the server is asked for the remainder on the condition that the file is
still the same (``Range`` with ``If-Range``). A server that does not do this is asked for everything.
"""

from __future__ import annotations

import http.client
import json
import re
import socket
import ssl
import string
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any
from urllib.error import HTTPError, URLError
from urllib.parse import quote, urljoin, urlsplit
from urllib.request import (
    HTTPDefaultErrorHandler,
    HTTPErrorProcessor,
    HTTPHandler,
    HTTPSHandler,
    OpenerDirector,
    ProxyHandler,
    Request,
    url2pathname,
)

from understudy import __version__
from understudy.errors import FileError
from understudy.folders import sync
from understudy_motion.limits import read_bytes

PART = ".part"
"""Ending of a partial file."""
VALIDATOR = ".validator"
"""Ending of the partial file's validator."""
MAX_BYTES = 64 * 2**20
ATTEMPTS = 5
BACKOFF = 0.5
"""Seconds before the second attempt; each further pause is twice as long."""
TIMEOUT = 30.0
"""Seconds without an answer or without further content."""
MAX_REDIRECTS = 5

Progress = Callable[[int, int | None], None]
"""Told the bytes that are here, and how many there will be if that is known."""

_BLOCK = 2**16
_REDIRECTS = {301, 302, 303, 307, 308}
_ABSENT = {403, 404, 410}
_PASSING_STATUS = {408, 429, 500, 502, 503, 504}
_PASSING_ERRORS = (
    ConnectionResetError,
    ConnectionAbortedError,
    BrokenPipeError,
    TimeoutError,
    ssl.SSLEOFError,
    http.client.IncompleteRead,
)


class AbsentError(FileError):
    """There is no such file at the address."""


class _InterruptedError(Exception):
    """An attempt failed in a way that another one may not; says how."""


def download(url: str, part: Path, progress: Progress) -> None:
    """Bring the whole content of `url` into the file `part`, which may hold its beginning already.

    Parameters
    ----------
    url
        an ``http``, ``https`` or ``file`` address.
    part
        the partial file; it and its validator stay where a later call can go on from them.
    progress
        told how far it is.

    Raises
    ------
    AbsentError
        there is no such file at `url`.
    FileError
        the address cannot be used, the server refuses or cannot be reached, all attempts
        were interrupted, the content is larger than 64 MB, or `part` cannot be written.
    """
    try:
        if urlsplit(url).scheme == "file":
            return _copy(url, part)
        for attempt in range(1, ATTEMPTS):
            try:
                return _attempt(url, part, progress)
            except _InterruptedError:
                time.sleep(BACKOFF * 2 ** (attempt - 1))
        _attempt(url, part, progress)
    except _InterruptedError as error:
        raise FileError(
            f"{url}: {error}, in the last of {ATTEMPTS} attempts; try again later, and it goes on "
            "from there if the server can."
        ) from error
    except OSError as error:
        raise FileError(f"{part} cannot be written: {error.strerror}.") from error


def discard(part: Path) -> None:
    """Remove a partial file and its validator."""
    _validator_file(part).unlink(missing_ok=True)
    part.unlink(missing_ok=True)


def checked_address(url: str) -> str:
    """`url` with unusual characters quoted, if it is an http(s) address without a password.

    Raises
    ------
    FileError
        it is not.
    """
    refusal = FileError(f"'{url}' is not an http:// or https:// address.")
    try:
        parts = urlsplit(quote(url, safe=string.punctuation))
        usable = parts.scheme in ("http", "https") and parts.hostname and parts.port != 0
    except ValueError as error:
        raise refusal from error
    if not usable:
        raise refusal
    if parts.username is not None:
        raise FileError(f"The address for {parts.hostname} holds a user name: leave it out.")
    return parts._replace(fragment="").geturl()


def local_path(url: str) -> Path:
    """The path that a ``file:`` address means."""
    return Path(url2pathname(urlsplit(url).path))


def _copy(url: str, part: Path) -> None:
    """As :func:`download`, from a file of this machine."""
    file = local_path(url)
    if not file.is_file():
        raise AbsentError(f"there is no file {file}")
    content = read_bytes(file, MAX_BYTES)
    discard(part)
    part.write_bytes(content)


def _attempt(url: str, part: Path, progress: Progress) -> None:
    """Ask once for what `part` lacks and append it."""
    validator = _begun(part, url)
    size = part.stat().st_size if validator else 0
    with _answer(
        url, part, {"Range": f"bytes={size}-", "If-Range": validator} if size else {}
    ) as r:
        if r.headers.get_content_type() == "text/html":
            raise AbsentError(f"{url} is a web page")
        if r.status == 206:
            start, total = _range(r)
            if start != size or _validator(r) not in (validator, ""):
                discard(part)
                raise _InterruptedError("the server sent another part than the one asked for")
        elif r.status == 200:
            discard(part)
            size, total = 0, r.length
            if again := _validator(r):
                _validator_file(part).write_text(
                    json.dumps({"url": url, "validator": again}), encoding="utf-8"
                )
        else:
            raise FileError(f"{url}: the server answered {r.status} {r.reason}.")
        with part.open("ab") as file:
            for block in _blocks(r, total):
                size += len(block)
                if max(size, total or 0) > MAX_BYTES:
                    discard(part)
                    raise FileError(f"{url} is larger than {MAX_BYTES // 2**20} MB.")
                file.write(block)
                progress(size, total)
            file.flush()
            sync(file.fileno())
    if size == 0:
        raise FileError(f"{url} is empty.")
    if total is not None and size != total:
        raise _InterruptedError(f"the connection ended after {size} of {total} bytes")


def _answer(url: str, part: Path, headers: Mapping[str, str]) -> http.client.HTTPResponse:
    """The server's answer to one request, redirections followed."""
    headers = {"User-Agent": f"understudy/{__version__}", "Accept-Encoding": "identity", **headers}
    address = url
    for _ in range(MAX_REDIRECTS + 1):
        try:
            return _opener().open(Request(address, headers=headers), timeout=TIMEOUT)
        except HTTPError as error:
            error.close()
            target = error.headers.get("Location")
            if error.code not in _REDIRECTS or not target:
                raise _refusal(url, part, error) from error
            address = _redirected(address, target)
        except (OSError, http.client.HTTPException, UnicodeError) as error:
            raise _failure(url, error) from error
    raise FileError(f"{url} is redirected more than {MAX_REDIRECTS} times; check the address.")


def _redirected(address: str, target: str) -> str:
    """Where `address` is redirected to, if that is no step down from https."""
    location = quote(target, safe=string.punctuation, encoding="iso-8859-1")
    try:
        new = checked_address(urljoin(address, location))
    except ValueError as error:
        raise FileError(f"{address} is redirected to '{location}', which is no address.") from error
    if urlsplit(address).scheme == "https" and urlsplit(new).scheme != "https":
        raise FileError(f"{address} is redirected to {new}, which is not encrypted; it is refused.")
    return new


def _refusal(url: str, part: Path, error: HTTPError) -> Exception:
    """What an error status means."""
    answer = f"{error.code} {error.reason}"
    if error.code in _ABSENT:
        return AbsentError(f"{url} is not there ({answer})")
    if error.code == 416:  # the file became shorter, or all of it was here
        discard(part)
    if error.code in {416, *_PASSING_STATUS}:
        return _InterruptedError(f"the server answered {answer}")
    return FileError(f"{url}: the server answered {answer}.")


def _failure(url: str, error: Exception) -> Exception:
    """What an error of the connection means."""
    reason = error.reason if isinstance(error, URLError) else error
    if isinstance(reason, _PASSING_ERRORS):
        return _InterruptedError(f"the connection failed ({reason or type(reason).__name__})")
    host = urlsplit(url).hostname
    if isinstance(reason, socket.gaierror):
        return FileError(f"No server named {host} can be found: check the address and the network.")
    return FileError(f"{host} cannot be reached: {reason or type(reason).__name__}.")


def _blocks(response: http.client.HTTPResponse, total: int | None) -> Iterator[bytes]:
    try:
        while block := response.read1(_BLOCK):
            yield block
    except (OSError, http.client.HTTPException) as error:
        raise _failure(response.url, error) from error


def _opener() -> OpenerDirector:
    """Speaks http and https only, through the environment's proxies, and leaves redirections to us."""
    opener = OpenerDirector()
    for handler in (
        ProxyHandler(), HTTPHandler(), HTTPSHandler(), HTTPDefaultErrorHandler(), HTTPErrorProcessor(),
    ):  # fmt: skip
        opener.add_handler(handler)
    return opener


def _range(response: http.client.HTTPResponse) -> tuple[int, int | None]:
    """Where a partial content begins, -1 if it does not say, and how long the whole one is."""
    found = re.fullmatch(r"bytes (\d+)-\d+/(\d+|\*)", response.headers.get("Content-Range", ""))
    if not found:
        return -1, None
    return int(found[1]), None if found[2] == "*" else int(found[2])


def _validator(response: http.client.HTTPResponse) -> str:
    """What tells this content from another one at its address; empty if nothing does for sure."""
    tag = response.headers.get("ETag", "")
    if tag:
        return "" if tag.startswith("W/") else tag
    return response.headers.get("Last-Modified", "")


def _begun(part: Path, url: str) -> str:
    """The validator of the content of which `part` is the beginning, if that is the content of `url`."""
    try:
        note: Any = json.loads(_validator_file(part).read_text(encoding="utf-8"))
        if part.is_file() and note["url"] == url and note["validator"].isprintable():
            return note["validator"]
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        pass
    return ""


def _validator_file(part: Path) -> Path:
    return part.with_suffix(VALIDATOR)

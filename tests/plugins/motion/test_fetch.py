"""``understudy motion fetch`` against servers that behave well and badly."""

from __future__ import annotations

import hashlib
import io
import json
import re
import shutil
import struct
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from email.message import Message
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from socket import SO_LINGER, SOL_SOCKET
from typing import Any
from urllib.error import HTTPError
from urllib.parse import quote

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from understudy.command import cli
from understudy.errors import FileError
from understudy.inputs import Inputs
from understudy.records.runs import Run
from understudy.setup import plugins
from understudy.setup.registry import Component, Registrar, Registry
from understudy_motion import library
from understudy_motion.clip import Clip
from understudy_motion.fetch import cmu, command, download
from understudy_motion.fetch.repositories import DEEPMIMIC, JUMP, Repository
from understudy_motion.limits import read_bytes
from understudy_motion.origin import provenance, read_record, record_path
from understudy_motion.readers import deepmimic
from understudy_motion.readers.amc import AmcReader
from understudy_motion.reading import UNSAID, ClipReader, ReadOptions
from understudy_motion.section import Motion, MotionOptions
from understudy_report.provenance import Provenance

SKELETON, MOTION = b"the skeleton of 02", b"the motion of 02_01" * 5000
FOLDERS = {"/subjects/02/02.asf": SKELETON, "/subjects/02/02_01.amc": MOTION}
FLAT = {"/02.asf": SKELETON, "/02_01.amc": MOTION}


def digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


# ---------------------------------------------------------------------- a server


@dataclass
class Site:
    """What a server has, how it behaves, and what it was asked for."""

    address: str = ""
    files: dict[str, bytes] = field(default_factory=dict)
    redirects: dict[str, str] = field(default_factory=dict)
    ranges: bool = True
    if_range: bool = True  #: whether it looks at the condition of a range
    length: bool = True  #: whether it says how long its answers are
    validators: bool = True
    reset: bool = False  #: whether a cut is a reset rather than an end
    headers: dict[str, str] = field(default_factory=dict)
    statuses: list[int] = field(default_factory=list)  #: what the next requests get instead
    cuts: list[int] = field(default_factory=list)  #: after how many bytes the next answers end
    asked: list[tuple[str, str | None]] = field(default_factory=list)  #: path and Range

    def ranges_of(self, path: str) -> list[str | None]:
        return [asked for where, asked in self.asked if where == path]


class Handler(BaseHTTPRequestHandler):
    @property
    def site(self) -> Site:
        return self.server.site  # pyright: ignore[reportAttributeAccessIssue]

    def do_GET(self) -> None:
        site, asked = self.site, self.headers["Range"]
        site.asked.append((self.path, asked))
        content = site.files.get(self.path)
        if site.statuses:
            return self.send_error(site.statuses.pop(0))
        if self.path in site.redirects:
            self.send_response(302)
            self.send_header("Location", site.redirects[self.path])
            self.send_header("Content-Length", "0")
            return self.end_headers()
        if content is None:
            return self.send_error(404)
        tag = f'"{digest(content)[:8]}"'
        start, status = 0, 200
        same = self.headers["If-Range"] == tag or not site.if_range
        if site.ranges and asked and same:
            start, status = int(asked.removeprefix("bytes=").rstrip("-")), 206
            if start >= len(content):
                return self.send_error(416)
        self.send_response(status)
        if status == 206:
            last = len(content) - 1
            self.send_header("Content-Range", f"bytes {start}-{last}/{len(content)}")
        if site.length:
            self.send_header("Content-Length", str(len(content) - start))
        if site.validators:
            self.send_header("ETag", tag)
        for name, value in site.headers.items():
            self.send_header(name, value)
        self.end_headers()
        stop = start + site.cuts.pop(0) if site.cuts else len(content)
        try:
            self.wfile.write(content[start:stop])
            if stop < len(content) and site.reset:
                self.connection.setsockopt(SOL_SOCKET, SO_LINGER, struct.pack("ii", 1, 0))
                self.connection.close()
        except ConnectionError:
            pass  # the client has had enough

    def log_message(self, format: str, *arguments: Any) -> None:
        pass


@pytest.fixture(scope="module")
def server() -> Iterator[ThreadingHTTPServer]:
    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True)
        thread.start()
        yield server
        server.shutdown()
        thread.join()


def new_site(server: ThreadingHTTPServer, **behaviour: Any) -> Site:
    site = Site(f"http://127.0.0.1:{server.server_port}", **behaviour)
    server.site = site  # pyright: ignore[reportAttributeAccessIssue]
    return site


@pytest.fixture
def site(server: ThreadingHTTPServer) -> Site:
    return new_site(server, files=dict(FOLDERS))


@pytest.fixture(scope="module", autouse=True)
def _no_waiting() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(download, "BACKOFF", 0.0)
        patch.setenv("no_proxy", "*")
        yield


class Fetching:
    """The command, and one reader."""

    @plugins.hookimpl
    def understudy_register(self, register: Registrar) -> None:
        register.kind("clip_reader", "reads a format of motion clips")
        register.component("clip_reader", "deepmimic", deepmimic.DeepMimicReader)
        register.component("command", "motion fetch", command.Fetch)


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder, beside the user's data folder, into which nothing is to be written."""
    (tmp_path / "data").mkdir()
    (tmp_path / "users").mkdir()
    monkeypatch.chdir(tmp_path / "data")
    monkeypatch.setenv(library.DATA_VARIABLE, str(tmp_path / "users"))
    loaded = plugins.load(only=[], extra=[("motion", Fetching())])
    monkeypatch.setattr(plugins, "installed", lambda: loaded)
    return tmp_path / "data"


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()} if folder.exists() else set()


def fetched(*arguments: str) -> None:
    assert cli.main(["motion", "fetch", *arguments]) == 0


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """The one sentence with which the command fails."""
    capsys.readouterr()
    assert cli.main(["motion", "fetch", *arguments]) == 2
    error = capsys.readouterr().err
    assert error.startswith("understudy: ")
    assert error.count("\n") == 1
    return error


# ---------------------------------------------------------------------- names


@pytest.mark.parametrize(
    ("text", "clips"),
    [
        ("02_01", ["02_01"]),
        ("cmu/2_1", ["02_01"]),
        ("143_18", ["143_18"]),
        ("02_09..02_11", ["02_09", "02_10", "02_11"]),
        ("http://mocap.cs.cmu.edu/subjects/08/08_04.amc", ["08_04"]),
        ("walk", []),
        ("02_01..", []),
        ("02_01..02_02..02_03", []),
        ("../02_01", []),
        ("https://example.org/02_01.amc", []),
    ],
)
def test_names_of_the_database(text: str, clips: list[str]) -> None:
    assert cmu.clips(text) == clips


@pytest.mark.parametrize(
    ("repository", "text", "clips"),
    [
        (DEEPMIMIC, "humanoid3d_dance_a", ["humanoid3d_dance_a"]),
        (DEEPMIMIC, "deepmimic/humanoid3d_walk", ["humanoid3d_walk"]),
        (DEEPMIMIC, "humanoid3d_", []),
        (DEEPMIMIC, "humanoid3d_../walk", []),
        (DEEPMIMIC, "humanoid3d_walk.txt", []),
        (DEEPMIMIC, "02_01", []),
        (JUMP, "VC5_sprint__curves_03", ["VC5_sprint__curves_03"]),
        (JUMP, "jump/VC5_Run_jumpToBox_01", ["VC5_Run_jumpToBox_01"]),
        (JUMP, "VC5_", []),
        (JUMP, "VC5_../walk", []),
        (JUMP, "VC5_sprint__curves_03.txt", []),
        (JUMP, "humanoid3d_walk", []),
    ],
)
def test_names_of_repositories_clips(repository: Repository, text: str, clips: list[str]) -> None:
    assert repository.clips(text) == clips


@pytest.mark.parametrize("text", ["02_05..02_01", "02_01..03_01", "00_01", "145_01"])
def test_clips_that_cannot_be_are_refused(text: str) -> None:
    with pytest.raises(FileError, match=f"'{re.escape(text)}'"):
        cmu.clips(text)


def test_official_addresses() -> None:
    skeleton, motion = command.wanted(["02_01"])
    assert skeleton.addresses[0] == "http://mocap.cs.cmu.edu/subjects/02/02.asf"
    assert motion.addresses[0] == "http://mocap.cs.cmu.edu/subjects/02/02_01.amc"
    (walk,) = command.wanted(["humanoid3d_walk"])
    assert walk.addresses[0] == (
        "https://raw.githubusercontent.com/xbpeng/DeepMimic/master/data/motions/humanoid3d_walk.txt"
    )
    (run_up,) = command.wanted(["VC5_sprint__curves_03"])
    assert re.fullmatch(
        r"https://raw\.githubusercontent\.com/arpspoof/Jump/[0-9a-f]{40}/data/motions/beyond/"
        r"VC5_sprint__curves_03\.txt",
        run_up.addresses[0],
    )


def test_a_skeleton_is_fetched_once(data: Path) -> None:
    files = [file.path.name for file in command.wanted(["02_01..02_02", "02_02", "03_01"])]
    assert files == ["02.asf", "02_01.amc", "02_02.amc", "03.asf", "03_01.amc"]


@given(st.text(max_size=40), st.booleans())
def test_an_address_names_a_plain_file_or_is_refused(text: str, quoted: bool) -> None:
    url = "http://example.org/clips/" + (quote(text, safe="") if quoted else text)
    try:
        (file,) = command.wanted([url], folder=Path("to"))
    except FileError:
        return
    assert file.path.parent == Path("to")
    assert re.fullmatch(r"[^/\\\0\n.][^/\\\0\n]*\.\w+", file.path.name)


@pytest.mark.parametrize(
    "end",
    [
        "", "/", "/clips", "/clips/", "/..", "/.hidden.bvh", "/..%2F..%2Fetc", "/..%5C..%5Cwalk.bvh",
        "/%2e%2e", "/walk.bvh%00.txt", "/walk.bvh%0A", "/walk.part", "/walk.bvh.validator",
        "/walk.provenance.json", "/?file=walk.bvh", f"/{'x' * 300}.bvh",
    ],
)  # fmt: skip
def test_addresses_that_end_in_no_file_name_are_refused(end: str) -> None:
    with pytest.raises(FileError, match="does not end in the name of a clip file"):
        command.wanted([f"http://example.org{end}"])


def test_the_server_does_not_choose_the_name(site: Site, data: Path, tmp_path: Path) -> None:
    site.files["/a/walk.txt"] = b"walk"
    site.headers["Content-Disposition"] = 'attachment; filename="../../evil.txt"'
    site.redirects["/walk.txt"] = "/a/walk.txt"
    fetched(f"{site.address}/walk.txt")
    assert names(data / "motions" / "fetched") == {"walk.txt", "walk.provenance.json", "SHA256SUMS"}
    assert names(tmp_path) == {"data", "users"}


# ---------------------------------------------------------------------- fetching


def test_the_plugin_has_the_command() -> None:
    assert plugins.load(only=["motion"]).registry.find("command", "motion fetch").factory is (
        command.Fetch
    )


def test_a_clip_of_the_database(
    site: Site, data: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    fetched("02_01", "--from", f"{site.address}/")
    folder = Path("motions") / "cmu"
    assert (data / folder / "02.asf").read_bytes() == SKELETON
    assert (data / folder / "02_01.amc").read_bytes() == MOTION
    assert names(folder) == {
        "02.asf", "02.provenance.json", "02_01.amc", "02_01.provenance.json", "SHA256SUMS"
    }  # fmt: skip
    assert (folder / "SHA256SUMS").read_text() == (
        f"{digest(SKELETON)}  02.asf\n{digest(MOTION)}  02_01.amc\n"
    )
    record = json.loads((folder / "02_01.provenance.json").read_text())
    assert re.fullmatch(r"\d{4}-\d\d-\d\d", record.pop("date"))
    assert record == {
        "clip": "02_01",
        "url": f"{site.address}/subjects/02/02_01.amc",
        "sha256": digest(MOTION),
        "licence": "free for research and commercial use, not for resale as data",
        "attribution": "The data used in this project was obtained from mocap.cs.cmu.edu. "
        "The database was created with funding from NSF EIA-0196217.",
    }
    assert capsys.readouterr().out.splitlines() == [
        f"{folder}/02.asf: fetched, 18 bytes",
        f"{folder}/02_01.amc: fetched, 95.0 kB; no reader here knows its format, so it was not checked",
        "Use it with motion.name=02_01",
    ]

    site.asked.clear()
    monkeypatch.delenv(library.DATA_VARIABLE)
    fetched("02_01", "--from", site.address, "--to", str(folder))
    assert site.asked == []
    assert capsys.readouterr().out.splitlines() == [
        f"{folder}/02.asf: there already, verified",
        f"{folder}/02_01.amc: there already, verified",
        "Use it with motion.name=02_01",
    ]


@pytest.mark.parametrize("files", [FOLDERS, FLAT])
@pytest.mark.parametrize("scheme", ["http", "file", "path"])
def test_mirrors_of_both_layouts(
    server: ThreadingHTTPServer, data: Path, tmp_path: Path, files: dict[str, bytes], scheme: str
) -> None:
    site = new_site(server, files=files)
    mirror = tmp_path / "a mirror"
    for path, content in files.items():
        (mirror / path[1:]).parent.mkdir(parents=True, exist_ok=True)
        (mirror / path[1:]).write_bytes(content)
    base = {"http": site.address, "file": mirror.as_uri(), "path": str(mirror)}[scheme]
    fetched("02_01", "--from", base)
    folder = data / "motions" / "cmu"
    assert (folder / "02.asf").read_bytes() == SKELETON
    assert (folder / "02_01.amc").read_bytes() == MOTION
    path = next(path for path in files if path.endswith(".amc"))
    assert read_record(folder / "02_01.amc")["url"] == {
        "http": site.address, "file": mirror.as_uri(), "path": mirror.as_uri()
    }[scheme] + path  # fmt: skip


def test_without_a_data_folder_clips_go_below_the_working_folder(
    site: Site, data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.delenv(library.DATA_VARIABLE)
    monkeypatch.chdir(tmp_path)
    fetched("02_01", "--from", site.address)
    assert (tmp_path / "motions" / "cmu" / "02_01.amc").read_bytes() == MOTION
    assert capsys.readouterr().out.endswith("Use it with motion.name=02_01\n")


def test_nothing_is_left_of_what_cannot_be_fetched(
    site: Site, data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    refused(capsys, f"{site.address}/no_such_walk.bvh")
    assert not any(data.iterdir()), "no empty folder"


def test_the_users_data_folder_is_read_and_not_written(site: Site, data: Path) -> None:
    fetched("02_01", "--from", site.address)
    users = data.parent / "users"
    assert not any(users.iterdir())
    shutil.copytree(data / "motions", users / "motions")
    shutil.rmtree(data / "motions")
    site.asked.clear()
    fetched("02_01", "--from", site.address)
    assert site.asked == []
    assert not any(data.iterdir()), "it is there already"


def still() -> bytes:
    """A clip of DeepMimic's format."""
    pose = [0.5, 0, 1, 0] + [
        x for _, n in deepmimic.JOINTS for x in ([1, 0, 0, 0] if n == 4 else [0])
    ]
    return json.dumps({"Loop": "none", "Frames": [pose, pose]}).encode()


@pytest.mark.parametrize(
    ("collection", "name", "where", "licence"),
    [
        ("deepmimic", "humanoid3d_still", "/data/motions/", "2018 Xue Bin Peng"),
        ("deepmimic", "humanoid3d_still", "/", "2018 Xue Bin Peng"),
        ("jump", "VC5_still__01", "/data/motions/beyond/", "2021 arpspoof"),
        ("jump", "VC5_still__01", "/", "2021 arpspoof"),
    ],
)
def test_a_clip_of_deepmimics_humanoid(
    site: Site,
    data: Path,
    capsys: pytest.CaptureFixture[str],
    collection: str,
    name: str,
    where: str,
    licence: str,
) -> None:
    site.files[f"{where}{name}.txt"] = still()
    fetched(name, "--from", site.address)
    path = data / "motions" / collection / f"{name}.txt"
    assert path.read_bytes() == still()
    assert capsys.readouterr().out.splitlines()[-1] == f"Use it with motion.name={name}"
    motion = Motion(MotionOptions(name=path.stem), plugins.installed().registry, Inputs())
    assert motion.provenance()["licence"] == f"MIT License, copyright (c) {licence}"


def test_an_address_with_terms(site: Site, data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    site.files["/clips/still.json"] = content = still()
    fetched(f"{site.address}/clips/still.json#top", "--licence", "CC BY 4.0")
    path = data / "motions" / "fetched" / "still.json"
    assert capsys.readouterr().out.splitlines() == [
        f"{path.relative_to(data)}: fetched, {len(content)} bytes",
        f"Use it with motion.file={path}",
    ]
    motion = Motion(MotionOptions(file=str(path)), plugins.installed().registry, Inputs())
    assert motion.provenance() == {
        "clip": "still",
        "source": str(path),
        "licence": "CC BY 4.0",
        "sha256": digest(content),
        "url": f"{site.address}/clips/still.json",
        "seconds": 0.5,
    }


def test_a_damaged_clip_is_not_kept(
    site: Site, data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    site.files["/still.json"] = b'{"Loop": "none", "Frames": [[1], [2]]}'
    error = refused(capsys, f"{site.address}/still.json")
    assert f"{site.address}/still.json is not kept." in error
    assert "frame 0" in error
    assert names(data / "motions" / "fetched") == set()


# ---------------------------------------------------------------------- resuming


@pytest.mark.parametrize("reset", [False, True])
def test_after_a_cut_only_the_remainder_is_asked_for(site: Site, data: Path, reset: bool) -> None:
    site.reset = reset
    site.cuts = [len(SKELETON), 50_000, 20_000]
    fetched("02_01", "--from", site.address)
    assert (data / "motions" / "cmu" / "02_01.amc").read_bytes() == MOTION
    first, *others = site.ranges_of("/subjects/02/02_01.amc")
    assert first is None
    if not reset:  # a reset may lose what was on its way
        assert others == ["bytes=50000-", "bytes=70000-"]


@settings(max_examples=25, deadline=None)
@given(
    st.binary(min_size=1, max_size=300),
    st.lists(st.integers(1, 300), max_size=download.ATTEMPTS - 1),
)
def test_any_cuts_give_the_whole_content(
    server: ThreadingHTTPServer, tmp_path_factory: pytest.TempPathFactory, content: bytes,
    cuts: list[int],
) -> None:  # fmt: skip
    site = new_site(server, files={"/x.bvh": content}, cuts=list(cuts))
    part = tmp_path_factory.mktemp("cuts") / "x.bvh.part"
    seen: list[int] = []
    download.download(f"{site.address}/x.bvh", part, lambda done, total: seen.append(done))
    assert part.read_bytes() == content
    assert seen[-1] == len(content)
    had = 0
    for asked, cut in zip(site.ranges_of("/x.bvh"), [*cuts, len(content)], strict=False):
        assert asked == (f"bytes={had}-" if had else None)
        had += cut


def cut_short(site: Site, capsys: pytest.CaptureFixture[str], *, after: int = 50_000) -> str:
    """Leave the beginning of the motion behind; returns the address."""
    url = f"{site.address}/subjects/02/02_01.amc"
    site.cuts = [after] + [0] * (download.ATTEMPTS - 1)
    error = refused(capsys, url)
    assert f"in the last of {download.ATTEMPTS} attempts" in error
    assert site.cuts == []
    site.asked.clear()
    return url


def test_a_later_call_goes_on(site: Site, data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = Path("motions") / "fetched"
    url = cut_short(site, capsys)
    assert names(folder) == {"02_01.amc.part", "02_01.amc.validator"}
    fetched(url)
    assert site.ranges_of("/subjects/02/02_01.amc") == ["bytes=50000-"]
    assert (folder / "02_01.amc").read_bytes() == MOTION
    assert names(folder) == {"02_01.amc", "02_01.provenance.json", "SHA256SUMS"}


def test_the_beginning_of_another_address_is_not_gone_on_from(
    site: Site, data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cut_short(site, capsys)
    site.files["/other/02_01.amc"] = MOTION
    fetched(f"{site.address}/other/02_01.amc")
    assert site.ranges_of("/other/02_01.amc") == [None]


@pytest.mark.parametrize("if_range", [True, False])
def test_a_changed_file_starts_again(
    site: Site, data: Path, capsys: pytest.CaptureFixture[str], if_range: bool
) -> None:
    url = cut_short(site, capsys)
    site.if_range = if_range
    site.files["/subjects/02/02_01.amc"] = changed = b"another motion" * 5000
    fetched(url)
    assert (data / "motions" / "fetched" / "02_01.amc").read_bytes() == changed


def test_a_file_that_became_shorter_starts_again(
    site: Site, data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    url = cut_short(site, capsys)
    site.if_range = False
    site.files["/subjects/02/02_01.amc"] = b"short"
    fetched(url)
    assert (data / "motions" / "fetched" / "02_01.amc").read_bytes() == b"short"


@pytest.mark.parametrize("behaviour", ["ranges", "validators"])
def test_a_server_without_ranges_or_validators_starts_again(
    site: Site, data: Path, behaviour: str
) -> None:
    setattr(site, behaviour, False)
    site.cuts = [len(SKELETON), 50_000]
    fetched("02_01", "--from", site.address)
    assert (data / "motions" / "cmu" / "02_01.amc").read_bytes() == MOTION
    assert site.ranges_of("/subjects/02/02_01.amc") == [
        None,
        "bytes=50000-" if behaviour == "ranges" else None,
    ]


@pytest.mark.parametrize(
    "note", [b"", b"[]", b"{}", b'{"url": 1, "validator": 2}', b"\xff", b"9" * 9999]
)
def test_a_damaged_validator_starts_again(
    site: Site, data: Path, capsys: pytest.CaptureFixture[str], note: bytes
) -> None:
    url = cut_short(site, capsys)
    (data / "motions" / "fetched" / "02_01.amc.validator").write_bytes(note)
    fetched(url)
    assert site.ranges_of("/subjects/02/02_01.amc") == [None]
    assert (data / "motions" / "fetched" / "02_01.amc").read_bytes() == MOTION


# ---------------------------------------------------------------------- servers that fail


def test_a_server_that_recovers(site: Site, data: Path) -> None:
    site.statuses = [503, 429, 500]
    fetched("02_01", "--from", site.address)
    assert (data / "motions" / "cmu" / "02_01.amc").read_bytes() == MOTION


def test_a_server_that_does_not_recover(
    site: Site, data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    site.statuses = [503] * 99
    assert "answered 503 Service Unavailable" in refused(capsys, "02_01", "--from", site.address)
    assert len(site.asked) == download.ATTEMPTS
    assert names(data / "motions" / "cmu") == set()


def test_pauses_grow(site: Site, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pauses: list[float] = []
    monkeypatch.setattr(download, "BACKOFF", 0.5)
    monkeypatch.setattr(download.time, "sleep", pauses.append)
    site.statuses = [503] * 99
    with pytest.raises(FileError):
        download.download(f"{site.address}/x.bvh", tmp_path / "x.part", lambda done, total: None)
    assert pauses == [0.5, 1.0, 2.0, 4.0]


def test_a_silent_server_is_given_up(
    site: Site, data: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(download, "TIMEOUT", 0.05)
    monkeypatch.setattr(Handler, "do_GET", lambda self: threading.Event().wait(0.2))
    assert "timed out" in refused(capsys, "02_01", "--from", site.address)


def test_refusals_are_not_repeated(
    site: Site, data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    site.statuses = [401]
    assert "answered 401 Unauthorized" in refused(capsys, f"{site.address}/walk.bvh")
    assert len(site.asked) == 1


def test_what_is_not_there_says_where_to_look(
    site: Site, data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    error = refused(capsys, "02_99", "--from", site.address)
    assert (
        f"No 02_99.amc: {site.address}/subjects/02/02_99.amc is not there (404 Not Found)" in error
    )
    assert f"{site.address}/02_99.amc is not there" in error
    assert "Look the clip up at http://mocap.cs.cmu.edu" in error
    for name, page in {
        "humanoid3d_wlak": "xbpeng/DeepMimic/tree/master/data/motions,",
        "VC5_sprint_curves_03": "arpspoof/Jump/tree/73b0c3ddf336ad341897d2fb7965c26060b18160/data/motions/beyond,",
    }.items():  # pages that a browser shows, which raw.githubusercontent.com has none of
        error = refused(capsys, name, "--from", site.address)
        assert f"Look the clip up at https://github.com/{page}" in error
    error = refused(capsys, f"{site.address}/walk.bvh")
    assert "Check the address in a browser" in error
    error = refused(capsys, "03_01", "--from", str(tmp_path))
    assert f"there is no file {tmp_path}/subjects/03/03.asf" in error
    assert names(data / "motions" / "cmu") == {"02.asf", "02.provenance.json", "SHA256SUMS"}


def test_a_web_page_is_no_clip(site: Site, data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    site.headers["Content-Type"] = "text/html; charset=utf-8"
    assert "02.asf is a web page" in refused(capsys, "02_01", "--from", site.address)
    assert names(data / "motions" / "cmu") == set()


def test_nobody_listens(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as closed:
        port = closed.server_port
    assert "127.0.0.1 cannot be reached" in refused(capsys, f"http://127.0.0.1:{port}/walk.bvh")


def test_no_such_host(
    data: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def unknown(*_: Any, **__: Any) -> None:
        raise download.socket.gaierror(-2, "Name or service not known")

    monkeypatch.setattr(download.socket, "getaddrinfo", unknown)
    assert "No server named mocap.cs.cmu.edu can be found" in refused(capsys, "02_01")


@pytest.mark.parametrize("length", [True, False])
@pytest.mark.parametrize("over", [0, 1])
def test_the_size_is_limited(
    site: Site, data: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
    length: bool, over: int,
) -> None:  # fmt: skip
    monkeypatch.setattr(download, "MAX_BYTES", 2**20)
    site.length = length
    site.files["/walk.bvh"] = b"x" * (2**20 + over)
    if not over:
        return fetched(f"{site.address}/walk.bvh")
    assert "larger than 1 MB" in refused(capsys, f"{site.address}/walk.bvh")
    assert names(data / "motions" / "fetched") == set()


def test_a_large_file_of_a_mirror_folder_is_refused(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(download, "MAX_BYTES", 2**20)
    (tmp_path / "02.asf").write_bytes(b"x" * (2**20 + 1))
    assert "larger than 1 MB" in refused(capsys, "02_01", "--from", str(tmp_path))
    assert names(data / "motions" / "cmu") == set()


def test_an_empty_file_is_refused(
    site: Site, data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    site.files["/walk.bvh"] = b""
    assert "is empty" in refused(capsys, f"{site.address}/walk.bvh")


# ---------------------------------------------------------------------- redirections


def test_redirections_are_followed(
    site: Site, data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    site.redirects = {
        "/walk.bvh": "a%20place",
        "/a%20place": f"{site.address}/subjects/02/02_01.amc",
    }
    site.cuts = [50_000]
    fetched(f"{site.address}/walk.bvh")
    path = data / "motions" / "fetched" / "walk.bvh"
    assert path.read_bytes() == MOTION
    assert site.ranges_of("/subjects/02/02_01.amc") == [None, "bytes=50000-"]
    assert read_record(path)["url"] == f"{site.address}/walk.bvh"


def test_redirection_loops_end(site: Site, data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    site.redirects = {"/a.bvh": "/b.bvh", "/b.bvh": "/a.bvh"}
    error = refused(capsys, f"{site.address}/a.bvh")
    assert f"redirected more than {download.MAX_REDIRECTS} times" in error
    assert len(site.asked) == download.MAX_REDIRECTS + 1


@pytest.mark.parametrize(
    "target", ["file:///etc/passwd", "ftp://127.0.0.1/x", "data:,x", "http://[::1/x"]
)
def test_redirections_stay_on_the_web(
    site: Site, data: Path, capsys: pytest.CaptureFixture[str], target: str
) -> None:
    site.redirects = {"/walk.bvh": target}
    error = refused(capsys, f"{site.address}/walk.bvh")
    assert re.search(r"is not an http:// or https:// address|which is no address", error)
    assert names(data / "motions" / "fetched") == set()


def test_redirections_do_not_leave_encryption(
    data: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    class Redirecting:
        def open(self, request: Any, timeout: float) -> None:
            headers = Message()
            headers["Location"] = "http://example.org/walk.bvh"
            raise HTTPError(request.full_url, 301, "Moved", headers, io.BytesIO())

    monkeypatch.setattr(download, "_opener", Redirecting)
    assert "is not encrypted; it is refused" in refused(capsys, "https://example.org/walk.bvh")


# ---------------------------------------------------------------------- checksums


def test_a_given_digest_must_fit(
    site: Site, data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    error = refused(capsys, "02_01", "--from", site.address, "--sha256", "0" * 64)
    assert f"its SHA-256 is {digest(MOTION)}, and by --sha256 it should be {'0' * 64}" in error
    assert names(data / "motions" / "cmu") == {"02.asf", "02.provenance.json", "SHA256SUMS"}
    fetched("02_01", "--from", site.address, "--sha256", digest(MOTION).upper())
    error = refused(capsys, "02_01", "--from", site.address, "--sha256", "0" * 64)
    assert "is there already, but its SHA-256" in error
    assert (data / "motions" / "cmu" / "02_01.amc").read_bytes() == MOTION


def test_a_recorded_digest_must_fit(
    site: Site, data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = data / "motions" / "cmu" / "02_01.amc"
    fetched("02_01", "--from", site.address)
    path.unlink()
    site.files["/subjects/02/02_01.amc"] = b"changed"
    error = refused(capsys, "02_01", "--from", site.address)
    assert f"by SHA256SUMS it should be {digest(MOTION)}" in error
    assert not path.exists()
    site.files["/subjects/02/02_01.amc"] = MOTION
    fetched("02_01", "--from", site.address)
    assert path.read_bytes() == MOTION
    assert len(path.with_name("SHA256SUMS").read_text().splitlines()) == 2


def test_a_file_changed_here_is_kept(
    site: Site, data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = Path("motions") / "cmu" / "02_01.amc"
    fetched("02_01", "--from", site.address)
    path.write_bytes(b"edited")
    error = refused(capsys, "02_01", "--from", site.address)
    assert f"{path} is there already, but its SHA-256 is {digest(b'edited')}" in error
    assert path.read_bytes() == b"edited"


def test_files_from_elsewhere_are_kept_and_said_to_be_unchecked(
    site: Site, data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = data / "motions" / "cmu"
    folder.mkdir(parents=True)
    (folder / "02.asf").write_bytes(b"ours")
    (folder / "SHA256SUMS").write_text(f"{'1' * 64} *./03.asf")  # no line end
    fetched("02_01", "--from", site.address)
    assert "02.asf: there already; SHA256SUMS beside it does not list it" in capsys.readouterr().out
    assert (folder / "02.asf").read_bytes() == b"ours"
    assert (folder / "SHA256SUMS").read_text() == (
        f"{'1' * 64} *./03.asf\n{digest(MOTION)}  02_01.amc\n"
    )


def test_the_terms_of_a_clip_that_is_there_already_are_recorded(
    site: Site, data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """So that checking it does not send one to fetch it again."""
    folder = data / "motions" / "cmu"
    folder.mkdir(parents=True)
    (folder / "02.asf").write_bytes(b"skeleton")
    (folder / "02_01.amc").write_bytes(MOTION)
    fetched("02_01", "--from", site.address)
    assert "its terms are recorded in 02_01.provenance.json" in capsys.readouterr().out
    about = provenance(folder / "02_01.amc", MOTION)
    assert about["licence"] == cmu.LICENCE
    assert about["attribution"] == cmu.ATTRIBUTION
    assert about["url"] == ""
    before = (folder / "02_01.provenance.json").read_bytes()
    fetched("02_01", "--from", site.address)
    assert "recorded" not in capsys.readouterr().out
    assert (folder / "02_01.provenance.json").read_bytes() == before
    assert site.asked == []


# ---------------------------------------------------------------------- wrong use


def test_two_clips_of_one_stem_are_kept_apart(
    site: Site, data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    site.files |= {"/a/walk.bvh": b"a", "/b/walk.bvh": b"b", "/b/walk.txt": b"c"}
    fetched(f"{site.address}/a/walk.bvh")
    for other in ("/b/walk.bvh", "/b/walk.txt"):
        error = refused(capsys, f"{site.address}{other}")
        assert f"has a clip 'walk' from {site.address}/a/walk.bvh" in error
    with pytest.raises(FileError, match=r"named 'walk\.bvh'"):
        command.wanted([f"{site.address}/a/walk.bvh", f"{site.address}/b/walk.bvh"])


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["walk"], "'walk' is neither a clip of the CMU database"),
        (["ftp://example.org/walk.bvh"], "neither a clip of the CMU database"),
        (["http:///walk.bvh"], "is not an http:// or https:// address"),
        (["http://[::1/walk.bvh"], "is not an http:// or https:// address"),
        (["http://example.org:x/walk.bvh"], "is not an http:// or https:// address"),
        (
            ["http://ada:secret@example.org/walk.bvh"],
            "The address for example.org holds a user name",
        ),
        (["02_01", "--sha256", "12"], "it takes 64 hexadecimal digits"),
        (["02_01..02_02", "--sha256", "0" * 64], "the digest of one clip"),
        (["02_01", "--from", "no/such/folder"], "there is no such folder"),
        (["http://example.org/walk.bvh", "--from", "."], "is for clips that are known by name"),
    ],
)
def test_wrong_arguments(
    data: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], problem: str
) -> None:
    error = refused(capsys, *arguments)
    assert problem in error
    assert "secret" not in error
    assert not any(data.iterdir())


def test_a_folder_that_cannot_be_made(
    site: Site, data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    error = refused(capsys, "02_01", "--from", site.address, "--to", str(tmp_path / "file"))
    assert "cannot be written" in error
    assert site.asked == []


def test_one_fetch_at_a_time(site: Site, data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = data / "motions" / "cmu"
    folder.mkdir(parents=True)
    with command._alone(folder):
        assert "Another fetch is at work" in refused(capsys, "02_01", "--from", site.address)
    fetched("02_01", "--from", site.address)


# ---------------------------------------------------------------------- the licence record


class FakeReader(ClipReader):
    """Takes every file for a clip of one joint that does nothing."""

    suffixes = (".amc",)

    def recognises(self, head: bytes, path: Path) -> bool:
        return True

    def read(self, path: Path, options: ReadOptions = UNSAID) -> Clip:
        one = torch.tensor([1.0, 0.0, 0.0, 0.0]).expand(2, 1, 4)
        return Clip(
            path.stem, torch.tensor([0.0, 1.0]), torch.zeros(2, 3), one, ("root",), False,
            **provenance(path, read_bytes(path)),
        )  # fmt: skip


def registry(reader: type[ClipReader] = FakeReader) -> Registry:
    registry = Registry()
    registry.components["clip_reader", "only"] = Component("clip_reader", "only", reader, "tests")
    return registry


def test_licence_and_acknowledgement_reach_the_report(
    site: Site, data: Path, tmp_path: Path
) -> None:
    for file in command.wanted(["02_01"], site.address):
        command.fetch(file, registry())
    source = Motion(MotionOptions(name="02_01"), registry(), Inputs()).provenance()
    assert source["licence"] == cmu.LICENCE
    assert source["attribution"] == cmu.ATTRIBUTION
    assert source["url"] == f"{site.address}/subjects/02/02_01.amc"
    html = Provenance().html(Run(tmp_path, {"sources": {"motion": source}})) or ""
    for text in (cmu.LICENCE, cmu.ATTRIBUTION, source["url"]):
        assert text in html


def test_a_record_of_other_content_counts_for_nothing(tmp_path: Path) -> None:
    clip = tmp_path / "walk.bvh"
    record_path(clip).write_text(
        json.dumps(
            {"sha256": digest(b"fetched"), "licence": "CC0", "attribution": "Ada", "url": "u"}
        )
    )
    assert provenance(clip, b"fetched") == {
        "source": str(clip), "licence": "CC0", "sha256": digest(b"fetched"),
        "url": "u", "attribution": "Ada",
    }  # fmt: skip
    edited = provenance(clip, b"edited")
    assert (edited["licence"], edited["url"], edited["attribution"]) == ("unknown", "", "")
    (tmp_path / "LICENSE").write_text("MIT\n")
    assert provenance(clip, b"edited")["licence"] == "MIT; see LICENSE beside the clip"
    assert provenance(clip, b"fetched")["licence"] == "CC0"


@pytest.mark.parametrize(
    "record",
    [b"", b"[1]", b"\xff", b"[" * 60_000, b"x" * 70_000, b'{"sha256": 1}', b'{"licence": ["CC0"]}'],
    ids=["empty", "list", "bytes", "nested", "large", "number", "mapping"],
)
def test_a_damaged_record_counts_for_nothing(tmp_path: Path, record: bytes) -> None:
    clip = tmp_path / "walk.bvh"
    record_path(clip).write_bytes(record)
    assert provenance(clip, b"content")["licence"] == "unknown"


def test_texts_of_a_record_are_short_printable_lines(tmp_path: Path) -> None:
    clip = tmp_path / "walk.bvh"
    record_path(clip).write_text(
        json.dumps({"sha256": digest(b"x"), "licence": "C\x1b[31m\nC0\ud800" + "!" * 9999})
    )
    licence = provenance(clip, b"x")["licence"]
    assert licence.startswith("C[31mC0!")
    assert len(licence) == 2000


# ---------------------------------------------------------------------- real clips


def real_mirror() -> Path | None:
    folder = library.data_folder()
    mirror = folder / "motions" / "cmu" if folder else None
    return mirror if mirror and (mirror / "02_01.amc").is_file() else None


@pytest.mark.skipif(
    real_mirror() is None,
    reason="no recorded clips: UNDERSTUDY_DATA is not set and ../shared is absent",
)
def test_a_recorded_clip(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mirror = real_mirror()
    known = registry(AmcReader)
    monkeypatch.setenv(library.DATA_VARIABLE, str(tmp_path / "users"))
    monkeypatch.chdir(tmp_path)
    for file in command.wanted(["02_01"], str(mirror and mirror.resolve())):
        assert command.fetch(file, known).startswith("fetched")
    motion = Motion(MotionOptions(name="02_01"), known, Inputs())
    assert motion.provenance()["licence"] == cmu.LICENCE
    assert motion.clip.num_frames > 100

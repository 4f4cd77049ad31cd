"""``understudy motion fetch``: clips by name or address, checked, with the record of their licence.

A file that is there already is never replaced. What is fetched appears complete or not at all, once
its SHA-256 fits what was asked for and what ``SHA256SUMS`` beside it recorded when it was first here.
"""

from __future__ import annotations

import argparse
import fcntl
import hashlib
import json
import os
import re
import shlex
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from urllib.parse import unquote, urlsplit

from rich import filesize
from rich.console import Console
from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TransferSpeedColumn

from understudy.command.command import Command
from understudy.errors import ConfigError, FileError, RunError
from understudy.folders import write_atomically
from understudy.setup import plugins
from understudy.setup.registry import Registry
from understudy_motion.fetch import cmu, download
from understudy_motion.fetch.repositories import DEEPMIMIC, JUMP
from understudy_motion.library import DATA_VARIABLE, data_folder
from understudy_motion.limits import read_bytes
from understudy_motion.origin import RECORD_SUFFIX, read_record, record_path
from understudy_motion.reading import ReadOptions, UnknownFormatError, reader_of

PUBLISHERS = (cmu, DEEPMIMIC, JUMP)
"""Who publishes clips that are known by name."""
SUMS = "SHA256SUMS"
MAX_SUMS_BYTES = 2**24
SKELETON = ".asf"
ANY_OPTIONS = ReadOptions(unit="m", up="z", rate=30.0)
"""Answers to what a format leaves unsaid, of no account for whether a file is sound."""

_FILE_NAME = re.compile(r"\w[\w .+,=@()-]{0,100}\.[A-Za-z0-9]{1,9}")
_OWN_ENDINGS = (download.PART, download.VALIDATOR, RECORD_SUFFIX)


@dataclass(frozen=True)
class Wanted:
    """A file to fetch."""

    path: Path
    """Where it is wanted."""
    addresses: tuple[str, ...]
    """Where it may be, tried in order."""
    sha256: str | None = None
    """What its digest must be."""
    licence: str | None = None
    attribution: str | None = None
    publisher: str | None = None
    """Whose name for it says what it is, wherever it is fetched from; their address."""

    def is_at(self, url: str) -> bool:
        """Whether `url` is an address of this file."""
        named = self.publisher is not None and url.endswith(f"/{self.path.name}")
        return named or url in self.addresses


class Fetch(Command):
    """Downloads clips of the CMU database, of DeepMimic and of the jumping paper by name, and of any other
    place by address."""

    example = "understudy motion fetch 02_01"

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument(
            "clips",
            nargs="+",
            metavar="NAME_OR_URL",
            help="a clip of the CMU Graphics Lab Motion Capture Database (02_01), several of one "
            "subject (02_01..02_05), one of DeepMimic (humanoid3d_walk), one of the jumping paper "
            "(VC5_sprint__curves_03), or an http(s) address",
        )
        parser.add_argument(
            "--from",
            dest="mirror",
            metavar="MIRROR",
            help="address or folder of a copy of that collection, instead of the official one",
        )
        parser.add_argument(
            "--to",
            type=Path,
            metavar="FOLDER",
            help="destination; by default motions/cmu, motions/deepmimic or motions/jump, for "
            "addresses motions/fetched, of the working folder",
        )
        parser.add_argument(
            "--sha256", metavar="DIGEST", help="what the clip's digest must be (of one clip only)"
        )
        parser.add_argument(
            "--licence", metavar="TEXT", help="terms of what is fetched, to be recorded"
        )

    def run(self, options: argparse.Namespace) -> int:
        registry = plugins.installed().registry
        files = wanted(options.clips, options.mirror, options.to, options.sha256, options.licence)
        for file in files:
            print(f"{file.path}: {fetch(file, registry)}")
        print(usage(next((f for f in files if f.path.suffix != SKELETON), files[0])))
        return 0


def wanted(
    names: Sequence[str],
    mirror: str | None = None,
    folder: Path | None = None,
    sha256: str | None = None,
    licence: str | None = None,
) -> list[Wanted]:
    """The files that the arguments of the command ask for, each once, a skeleton before its motions.

    Raises
    ------
    FileError
        a name that is none, or an address that names no file.
    ConfigError
        an option that does not go with the others.
    """
    if sha256 is not None and not re.fullmatch(r"[0-9A-Fa-f]{64}", sha256):
        raise ConfigError(f"--sha256={sha256} is not possible: it takes 64 hexadecimal digits.")
    digest = sha256.lower() if sha256 else None
    base = None if mirror is None else _base(mirror)
    files = []
    for name in names:
        known = [(by, clip) for by in PUBLISHERS for clip in by.clips(name)]
        files += [
            Wanted(
                path=(folder or _default_folder(by.FOLDER, by.files(clip))) / file,
                addresses=by.addresses(clip, file, base or by.OFFICIAL),
                sha256=None if file.endswith(SKELETON) else digest,
                licence=licence or by.LICENCE,
                attribution=by.ATTRIBUTION,
                publisher=by.PAGE,
            )
            for by, clip in known
            for file in by.files(clip)
        ]
        if known:
            continue
        url = _address(name)
        path = (folder or _default_folder("fetched", [_file_name(url)])) / _file_name(url)
        files.append(Wanted(path, (url,), digest, licence))
        if mirror is not None:
            raise ConfigError(
                f"--from={mirror} is for clips that are known by name, which '{name}' is not."
            )
    found: dict[Path, Wanted] = {}
    for file in files:
        if found.setdefault(file.path, file).addresses != file.addresses:
            raise FileError(
                f"Two of the clips are named '{file.path.name}': fetch them into separate folders."
            )
    if sum(file.sha256 is not None for file in found.values()) > 1:
        raise ConfigError("--sha256 is the digest of one clip, and several are asked for.")
    return list(found.values())


def fetch(file: Wanted, registry: Registry) -> str:
    """Bring `file` to its place, if it is not there; returns what was done, in words.

    Raises
    ------
    FileError
        it cannot be fetched, is not what its digests say, or is a damaged clip; nothing
        of it is in its place then, or what was there still is.
    """
    folder = file.path.parent
    try:
        with _made(folder), _alone(folder):
            expected = {"--sha256": file.sha256, SUMS: _sums(folder).get(file.path.name)}
            _refuse_namesake(file)
            if file.path.exists():
                return _verified(file.path, expected) + _noted(file)
            return _fetch(file, expected, registry)
    except OSError as error:
        raise FileError(f"{file.path} cannot be written: {error.strerror}.") from error


def usage(file: Wanted) -> str:
    """How to refer to a fetched file in a configuration."""
    path = file.path.resolve()
    if file.publisher is None or path.parent.parent.name != "motions":
        return f"Use it with {shlex.quote(f'motion.file={path}')}"
    root = path.parents[2]
    line = f"Use it with motion.name={path.stem}"
    if root in {folder.resolve() for folder in (Path(), data_folder()) if folder is not None}:
        return line
    return f"{line} and the environment variable {DATA_VARIABLE}={shlex.quote(str(root))}"


def _fetch(file: Wanted, expected: Mapping[str, str | None], registry: Registry) -> str:
    path = file.path
    part = path.with_name(path.name + download.PART)
    url = _download(file, part)
    digest = _sha256(part)
    if difference := _difference(digest, expected):
        download.discard(part)
        raise FileError(
            f"{url} is not kept: {difference}. Try another source, or, if the file was changed for "
            f"good, fetch it without --sha256 and without its line in {path.with_name(SUMS)}."
        )
    os.replace(part, path)
    download.discard(part)
    try:
        known = _check(path, registry)
        _write_record(file, url, digest)
        _record_sum(path, digest)
    except BaseException as error:
        path.unlink()
        if isinstance(error, FileError):
            raise FileError(f"{url} is not kept. {error}") from error
        raise
    done = f"fetched, {filesize.decimal(path.stat().st_size)}"
    return done if known else f"{done}; no reader here knows its format, so it was not checked"


def _download(file: Wanted, part: Path) -> str:
    """Bring the file's content into `part` from the first address that has it; returns the address."""
    absences = []
    console = Console(stderr=True)
    with Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        DownloadColumn(),
        TransferSpeedColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    ) as bar:
        task = bar.add_task(file.path.name, total=None)
        for url in file.addresses:
            try:
                download.download(
                    url, part, lambda done, total: bar.update(task, completed=done, total=total)
                )
                return url
            except download.AbsentError as error:
                absences.append(str(error))
    advice = (
        f"Look the clip up at {file.publisher}, or give another --from."
        if file.publisher is not None
        else "Check the address in a browser; it must be of the file itself."
    )
    raise FileError(f"No {file.path.name}: {', and '.join(absences)}. {advice}")


def _difference(digest: str, expected: Mapping[str, str | None]) -> str:
    """How `digest` differs from what somebody (by name) expects, empty if it does not."""
    for source, other in expected.items():
        if other not in (None, digest):
            return f"its SHA-256 is {digest}, and by {source} it should be {other}"
    return ""


def _verified(path: Path, expected: Mapping[str, str | None]) -> str:
    """What there is to say of a file that is there already."""
    if not path.is_file():
        raise FileError(f"{path} is not a file; give another folder with --to.")
    if not any(expected.values()):
        return f"there already; {SUMS} beside it does not list it, so it was not checked"
    if difference := _difference(_sha256(path), expected):
        raise FileError(
            f"{path} is there already, but {difference}; move it away to fetch it again."
        )
    return "there already, verified"


def _noted(file: Wanted) -> str:
    """Record the terms of a file that is there already, if nothing says them; what was done."""
    path = file.path
    if not (file.licence and path.is_file()) or record_path(path).exists():
        return ""
    try:
        _write_record(file, "", _sha256(path))
    except RunError:  # a folder that others keep
        return ""
    return f"; its terms are recorded in {record_path(path).name}"


def _refuse_namesake(file: Wanted) -> None:
    """Clips are known by their stem, so a folder has one of each."""
    owner = read_record(file.path).get("url")
    if owner is not None and not file.is_at(owner):
        raise FileError(
            f"{file.path.parent} has a clip '{file.path.stem}' from {owner}; give another folder with "
            f"--to, or remove that clip and {record_path(file.path).name}."
        )


def _check(path: Path, registry: Registry) -> bool:
    """Whether a reader knows the file's format; skeletons are checked with the clips that need them.

    Raises
    ------
    FileError
        the reader refuses the file.
    """
    if path.suffix == SKELETON:
        return True
    try:
        reader_of(path, registry).read(path, ANY_OPTIONS)
    except UnknownFormatError:
        return False
    return True


def _write_record(file: Wanted, url: str, digest: str) -> None:
    record = {
        "clip": file.path.stem,
        "url": url,
        "date": datetime.now(UTC).date().isoformat() if url else "",
        "sha256": digest,
        "licence": file.licence,
        "attribution": file.attribution,
    }
    known = {key: value for key, value in record.items() if value}
    write_atomically(record_path(file.path), json.dumps(known, indent=1).encode() + b"\n")


def _sums(folder: Path) -> dict[str, str]:
    """By file name: the digests that the folder's ``SHA256SUMS`` lists."""
    if not (folder / SUMS).exists():
        return {}
    text = read_bytes(folder / SUMS, MAX_SUMS_BYTES).decode(errors="replace")
    lines = re.findall(r"^([0-9a-fA-F]{64}) [ *](?:\./)?(.+)$", text, re.MULTILINE)
    return {name: digest.lower() for digest, name in lines}


def _record_sum(path: Path, digest: str) -> None:
    """List the file in its folder's ``SHA256SUMS``, as ``sha256sum -c`` reads it."""
    sums = path.with_name(SUMS)
    if path.name not in _sums(path.parent):
        before = sums.read_bytes() if sums.exists() else b""
        if before and not before.endswith(b"\n"):
            before += b"\n"
        write_atomically(sums, before + f"{digest}  {path.name}\n".encode())


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@contextmanager
def _made(folder: Path) -> Iterator[None]:
    """Make the folder; what was made goes again if nothing came into it."""
    new = [path for path in (folder, *folder.parents) if not path.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    try:
        yield
    finally:
        with suppress(OSError):  # not empty
            for path in new:
                path.rmdir()


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Keep other fetches out of the folder."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise FileError(
                f"Another fetch is at work in {folder}: wait until it is done."
            ) from error
        except OSError:
            pass  # not every network file system locks folders
        yield
    finally:
        os.close(descriptor)


def _default_folder(collection: str, files: Sequence[str]) -> Path:
    """Of the data folder where it has these files already, else of the working folder."""
    data = data_folder()
    known = data / "motions" / collection if data is not None else None
    if known is not None and all((known / file).exists() for file in files):
        return known
    return Path("motions") / collection


def _base(mirror: str) -> str:
    """The mirror as an address without a slash at its end."""
    if _is_address(mirror):
        return download.checked_address(mirror).rstrip("/")
    folder = download.local_path(mirror) if mirror.startswith("file:") else Path(mirror)
    if not folder.is_dir():
        raise FileError(
            f"--from={mirror}: there is no such folder; give one, or an http(s) address."
        )
    return folder.resolve().as_uri()


def _is_address(text: str) -> bool:
    return text.lower().startswith(("http://", "https://"))


def _address(name: str) -> str:
    if not _is_address(name):
        raise FileError(
            f"'{name}' is neither a clip of the CMU database, such as 02_01 or 02_01..02_05, nor one of "
            "DeepMimic, such as humanoid3d_walk, nor an http(s) address."
        )
    return download.checked_address(name)


def _file_name(url: str) -> str:
    """The name under which to keep the content of `url`: the last part of its path, if it is safe."""
    name = unquote(urlsplit(url).path).rpartition("/")[2]
    if not _FILE_NAME.fullmatch(name) or name.lower().endswith(_OWN_ENDINGS):
        raise FileError(
            f"{url} does not end in the name of a clip file, such as walk.bvh, by which to keep it."
        )
    return name

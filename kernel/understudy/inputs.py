"""The files that parts read. A run keeps copies of them, and its parts read those from then on."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path

from understudy.errors import RunError
from understudy.folders import opened

__all__ = ["Inputs"]


@dataclass
class Inputs:
    """The files that parts read, by what was asked for: an option, in words."""

    folder: Path = Path()  #: of a run's copies
    #: By what was asked for, each copy's digest by its name in the folder, the main file first.
    kept: dict[str, dict[str, str]] = field(default_factory=dict)
    _read: dict[str, list[Path]] = field(default_factory=dict)
    _fills: dict[str, Callable[[Path], None]] = field(default_factory=dict)

    def file(self, asked: str, find: Callable[[], Iterable[Path]]) -> Path:
        """The file to open for what is `asked`: the run's copy, else the first that `find` gives.
        The others that it gives (meshes, a licence) are copied along, below the same folder. A
        RunError if a copy is not what the run was made with."""
        if asked not in self.kept:
            self._read[asked] = self._read.get(asked) or list(find())
            return self._read[asked][0]
        for name, digest in self.kept[asked].items():
            path = self.folder / name
            inside = ".." not in Path(name).parts and not Path(name).is_absolute()
            try:
                inside &= path.resolve().is_relative_to(self.folder.resolve()) and path.is_file()
            except ValueError:  # no file can have such a name
                inside = False
            if not inside or _digest(path) != digest:
                raise RunError(f"{path} is not what the run was made with: put that back.")
        return self.folder / next(iter(self.kept[asked]))

    def folder_of(self, asked: str, source: Path, fill: Callable[[Path], None]) -> Path:
        """As :meth:`file`, but a folder: the run's copy, which `fill` writes, else `source`."""
        if asked in self.kept:
            return self.file(asked, list).parent
        self._fills[asked] = fill
        return source

    def copy(self, folder: Path) -> dict[str, dict[str, str]]:
        """Copy what was read into `folder`, and read it there from now on; returns :attr:`kept`."""
        for asked, paths in self._read.items():
            top, self.kept[asked] = paths[0].absolute().parent, {}
            for path in map(Path.absolute, paths):
                below = path.relative_to(top) if path.is_relative_to(top) else Path(path.name)
                name, content = f"{len(self.kept)}/{below.as_posix()}", path.read_bytes()
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                (folder / name).write_bytes(content)
                self.kept[asked][name] = hashlib.sha256(content).hexdigest()
        for asked, fill in self._fills.items():
            fill(top := folder / str(len(self.kept) + 1))
            files = sorted(filter(Path.is_file, top.rglob("*")), key=lambda f: (len(f.parts), f))
            self.kept[asked] = {f.relative_to(folder).as_posix(): _digest(f) for f in files}
        self._read, self._fills, self.folder = {}, {}, folder
        return self.kept


def _digest(path: Path) -> str:
    try:
        with opened(path, 2**34) as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise RunError(f"{path} cannot be read: {error.strerror}.") from error

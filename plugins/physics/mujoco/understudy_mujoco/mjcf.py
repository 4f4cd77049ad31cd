"""Reading an MJCF model with the meshes, textures and includes of its own folder, and nothing else.

A model is a stranger's: what it refers to is read here, and MuJoCo is given the content instead of
the paths. Whatever this does not read, MuJoCo does not either.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn
from xml.etree import ElementTree

from understudy.errors import FileError

MAX_BYTES = 16 * 2**20
"""Of all MJCF files of a model together."""
MAX_ASSET_BYTES = 512 * 2**20
"""Of all meshes and textures together."""
MAX_FILES = 2000
MAX_DEPTH = 200
"""How deeply elements and includes may be nested."""

_REFUSED = ("plugin", "extension", "model")
"""Elements by which a model has libraries loaded, or models that refer to files of their own."""
_DIRECTORIES: tuple[str, ...] = ("assetdir", "meshdir", "texturedir")


@dataclass(frozen=True)
class Mjcf:
    """A model that refers to nothing but its assets."""

    text: str
    assets: Mapping[str, bytes]
    """By the name under which the text refers to them: a path within the model's folder."""
    files: tuple[Path, ...]
    """What was read: the model's file, then its includes and assets."""


def read_mjcf(path: Path) -> Mjcf:
    """The model at `path`, its includes in place.

    Raises:
        FileError: it cannot be read, is too large, is no XML, or refers to a file that is missing or
            not in its own folder, or to plugins.
    """
    return _Reader(path).read()


class _Reader:
    def __init__(self, path: Path) -> None:
        self._path = path
        self._folder = path.parent.resolve()
        self._bytes_left, self._asset_bytes_left = MAX_BYTES, MAX_ASSET_BYTES
        self._files: list[Path] = []
        self._assets: dict[str, bytes] = {}

    def read(self) -> Mjcf:
        root = self._parse(self._folder / self._path.name)
        self._include(root, (self._path.resolve(),))
        elements = list(root.iter())
        for element in elements:
            if element.tag in _REFUSED:
                self._refuse(f"<{element.tag}>")
        directories = self._directories(elements)
        for element in elements:
            for key, name in list(element.items()):
                if key.startswith("file"):
                    kind = "texturedir" if element.tag == "texture" else "meshdir"
                    element.set(key, self._asset(directories, kind, name))
        text = ElementTree.tostring(root, encoding="unicode")
        return Mjcf(text, self._assets, tuple(dict.fromkeys(self._files)))

    def _parse(self, path: Path) -> ElementTree.Element:
        text = self._content(path, self._bytes_left, MAX_BYTES)
        self._bytes_left -= len(text)
        if b"<!DOCTYPE" in text or b"<!ENTITY" in text or b"\0" in text:
            raise FileError(f"The model {path} does not load: it is no plain XML in UTF-8.")
        try:
            return ElementTree.fromstring(text.decode("utf-8-sig"))
        except (ElementTree.ParseError, ValueError) as error:
            raise FileError(f"The model {path} does not load: no XML in UTF-8: {error}.") from error

    def _include(
        self, parent: ElementTree.Element, within: tuple[Path, ...], depth: int = 1
    ) -> None:
        """Put the content of included files in the place of the elements that include them."""
        if depth > MAX_DEPTH:
            raise FileError(
                f"The model {self._path} does not load: nested more than {MAX_DEPTH} deep."
            )
        for index in reversed(range(len(parent))):
            child = parent[index]
            if child.tag != "include":
                self._include(child, within, depth + 1)
                continue
            path = self._inside(child.get("file", ""))
            if path in within:
                raise FileError(f"The model {path} includes itself.")
            included = self._parse(path)
            self._include(included, (*within, path), depth + 1)
            parent[index : index + 1] = list(included)

    def _directories(self, elements: list[ElementTree.Element]) -> dict[str, str]:
        """Where meshes and textures are; of several compiler elements the last one says it."""
        found = dict.fromkeys(_DIRECTORIES, "")
        for compiler in (e for e in elements if e.tag == "compiler"):
            for key in _DIRECTORIES:
                found[key] = compiler.attrib.pop(key, found[key])
            if compiler.attrib.pop("strippath", "false") == "true":
                found["strippath"] = "true"
        return found

    def _asset(self, directories: Mapping[str, str], kind: str, name: str) -> str:
        folder = directories[kind] or directories["assetdir"]
        if "strippath" in directories:
            name = name.replace("\\", "/").rpartition("/")[2]
        path = self._inside(f"{folder}/{name}" if folder else name)
        key = path.relative_to(self._folder).as_posix()
        if key not in self._assets:
            content = self._content(path, self._asset_bytes_left, MAX_ASSET_BYTES)
            self._asset_bytes_left -= len(content)
            self._assets[key] = content
        return key

    def _inside(self, name: str) -> Path:
        """The file that the model calls `name`, which must be in its folder."""
        try:
            path = (self._folder / name).resolve()
        except (OSError, ValueError, RuntimeError):
            self._refuse(name)
        if Path(name).is_absolute() or "\\" in name or not path.is_relative_to(self._folder):
            self._refuse(name)
        return path

    def _refuse(self, what: str) -> NoReturn:
        raise FileError(
            f"The model {self._path} refers to other files than those of its own folder, or to "
            f"plugins ({what!r}); put its meshes and includes into the folder, and refer to them there."
        )

    def _content(self, path: Path, limit: int, total: int) -> bytes:
        self._files.append(path)
        if len(self._files) > MAX_FILES:
            raise FileError(f"The model {self._path} refers to more than {MAX_FILES} files.")
        try:
            if not path.is_file():
                raise FileError(f"The model {self._path} cannot be read: there is no file {path}.")
            with path.open("rb") as file:
                content = file.read(limit + 1)
        except OSError as error:
            raise FileError(
                f"The model {self._path} cannot be read: {path}: {error.strerror}."
            ) from error
        if len(content) > limit:
            raise FileError(f"The model {self._path} is larger than {total >> 20} MiB.")
        return content

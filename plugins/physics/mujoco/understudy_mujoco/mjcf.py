"""Reading an MJCF or URDF model with the meshes, textures and includes of its folder, and nothing else.

A model is a stranger's: what it refers to is read here, and MuJoCo is given the content instead of
the paths. Whatever this does not read, MuJoCo does not either.
"""

from __future__ import annotations

import codecs
import itertools
import os
import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn
from xml.etree import ElementTree

from understudy.errors import FileError

__all__ = ["read_mjcf"]

MAX_BYTES = 16 * 2**20
"""Of all MJCF files of a model together."""
MAX_ASSET_BYTES = 512 * 2**20
"""Of all meshes and textures together."""
MAX_FILES = 2000
MAX_DEPTH = 200
"""How deeply elements and includes may be nested."""
MAX_ATTACHED = 8
"""How deeply models may be attached to one another."""

_REFUSED = ("plugin", "extension")
"""Elements by which a model has libraries loaded."""
_OF_URDF = ("link", "joint", "material", "mujoco")
"""What is read of a URDF; the rest is for other programs (``gazebo``, ``transmission``, ``ros2_control``), which load
plugins by it."""
_DIRECTORIES: tuple[str, ...] = ("assetdir", "meshdir", "texturedir")
_MARKS = {
    codecs.BOM_UTF8: "utf-8-sig",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
}
_DECLARED = re.compile(rb"\s*<\?xml[^>]*?encoding\s*=\s*[\"']([\w.:-]+)")
_PACKAGE = re.compile(r"(?:(?:package|model)://|(?:file://)?\$\(find )([^/)]+)\)?/(.*)")
"""How a URDF names a file of a package, which :data:`_TEMPLATE` is not."""
_TEMPLATE = re.compile(r"<xacro:|\$\{|\$\((?!find )")
#: How the small files begin that a checkout without Git LFS has in place of large ones.
_POINTER = b"version https://git-lfs.github.com/spec/"


@dataclass(frozen=True)
class Mjcf:
    """A model that refers to nothing but its assets, among which are the models that it attaches."""

    text: str
    assets: Mapping[str, bytes]
    """By the name under which the text refers to them: a path within the folder that it may read."""
    urdf: bool = False  #: whether it is a URDF, whose first link is to be free

    def write(self, path: Path) -> None:
        """Write it to `path`, and its assets below the same folder, so that :func:`read_mjcf` reads it
        there as it is."""
        for name, content in self.assets.items():
            (path.parent / name).parent.mkdir(parents=True, exist_ok=True)
            (path.parent / name).write_bytes(content)
        path.write_text(self.text, encoding="utf-8")


def split_root(named: str) -> tuple[Path, Path]:
    """The file that `named` is, and the folder that it may refer to: what is before a double slash
    (``package//mjcf/robot.xml``), else the file's own."""
    root, _, _ = named.rpartition("//")
    return Path(named), Path(root) if root else Path(named).parent


def read_mjcf(path: Path, root: Path | None = None) -> Mjcf:
    """The model at `path`, its includes in place; it may refer to files below the folder `root`, or if
    that is None below its own.

    Raises
    ------
    FileError
        it cannot be read, is too large, is no XML, or refers to a file that is missing or
        not in the folder, or to plugins.
    """
    return _Reader(path, root or path.parent).read()


class _Reader:
    def __init__(self, path: Path, root: Path, within: tuple[Path, ...] = ()) -> None:
        self._path = path
        self._within = within or (
            path.resolve(),
        )  #: the files that attach one another, this one last
        self._folder, self._root = path.parent.resolve(), root.resolve()
        self._bytes_left, self._asset_bytes_left = MAX_BYTES, MAX_ASSET_BYTES
        self._num_files = 0
        self._assets: dict[str, bytes] = {}

    def read(self) -> Mjcf:
        root = self._parse(self._folder / self._path.name)
        self._include(root, (self._path.resolve(),), self._folder)
        urdf = root.tag == "robot"
        if not urdf and root.tag != "mujoco":
            raise FileError(
                f"The model {self._path} does not load: <{root.tag}> is neither MJCF (<mujoco>) nor URDF (<robot>)."
            )
        if urdf:
            for child in [c for c in root if c.tag not in _OF_URDF]:
                root.remove(child)
            _without_visuals(root)
            self._check_limits(root)
            if followers := [
                j.get("name", "") for j in root.iter("joint") if j.find("mimic") is not None
            ]:
                warnings.warn(
                    f"The model {self._path} has joints that follow others (mimic); here each moves by itself: "
                    f"{', '.join(followers)}.",
                    stacklevel=2,
                )
        elements = list(root.iter())
        for element in elements:
            if element.tag in _REFUSED:
                self._refuse(f"<{element.tag}>")
        if not urdf:
            self._attach(elements)
        directories = self._directories(elements)
        for element in (e for e in elements if e.tag != "model"):
            for key, name in list(element.items()):
                if key.startswith("file"):
                    kind = "texturedir" if element.tag == "texture" else "meshdir"
                    if urdf:
                        name = self._of_package(name, directories)
                    element.set(key, self._asset(directories, kind, name))
        if urdf:
            own = root.find("mujoco")
            own = ElementTree.SubElement(root, "mujoco") if own is None else own
            compiler = own.find("compiler")
            compiler = ElementTree.SubElement(own, "compiler") if compiler is None else compiler
            compiler.set("strippath", "false")
            compiler.set("fusestatic", "false")
        text = ElementTree.tostring(root, encoding="unicode")
        return Mjcf(text, self._assets, urdf)

    def _attach(self, elements: list[ElementTree.Element]) -> None:
        """Read the models that this one attaches, each as any model is read, and have it refer to what was read of them, under
        names without folders."""
        for element in (e for e in elements if e.tag == "model"):
            if not (name := element.get("file", "")):
                raise FileError(
                    f"The model {self._path} does not load: a <model> names no file (file=…)."
                )
            path = self._inside(name)
            if path in self._within:
                raise FileError(f"The model {path} attaches itself.")
            if len(self._within) > MAX_ATTACHED:
                raise FileError(
                    f"The model {self._path} does not load: models attached more than {MAX_ATTACHED} deep."
                )
            other = _Reader(path, self._root, (*self._within, path))
            other._bytes_left, other._num_files = self._bytes_left, self._num_files
            other._asset_bytes_left, other._assets = self._asset_bytes_left, self._assets
            found = other.read()
            if found.urdf:
                raise FileError(
                    f"The model {self._path} attaches the URDF {path}; attach an MJCF (<mujoco>)."
                )
            self._bytes_left, self._num_files = other._bytes_left, other._num_files
            self._asset_bytes_left = other._asset_bytes_left
            taken = {*self._assets, self._within[0].name}
            own = next(n for k in itertools.count(1) if (n := f"attached-{k}.xml") not in taken)
            self._assets[own] = found.text.encode()
            if not element.get("name") and (
                model := ElementTree.fromstring(found.text).get("model")
            ):
                element.set("name", model)
            element.set("file", own)

    def _check_limits(self, robot: ElementTree.Element) -> None:
        """Refuse a joint whose range is upside down, which MuJoCo takes for one without, or its effort below 0."""
        for joint in robot.iter("joint"):
            limit = joint.find("limit")
            if limit is None:
                continue
            lower, upper, effort = (limit.get(end, "0") for end in ("lower", "upper", "effort"))
            try:
                wrong = (
                    f"the lower limit {lower}, above its upper one of {upper}"
                    if float(lower) > float(upper)
                    else f"an effort of {effort}"
                    if float(effort) < 0.0
                    else None
                )
            except ValueError:  # MuJoCo says it
                continue
            if wrong:
                raise FileError(
                    f"The model {self._path} does not load: joint '{joint.get('name', '')}' has {wrong}."
                )

    def _parse(self, path: Path) -> ElementTree.Element:
        content = self._content(path, self._bytes_left, MAX_BYTES)
        self._bytes_left -= len(content)
        text = re.sub(r"<!DOCTYPE\s+\w+\s*>", "", _decoded(path, content))
        if "<!DOCTYPE" in text or "<!ENTITY" in text or "\0" in text:
            raise FileError(f"The model {path} does not load: it is no plain XML.")
        # MuJoCo's parser takes "--" in comments and blanks before the declaration, Python's does not.
        text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL).strip()
        if "<robot" in text and _TEMPLATE.search(text):
            raise FileError(
                f"The model {path} is a template: expand it first, by xacro FILE > robot.urdf."
            )
        try:
            root = ElementTree.fromstring(text)
        except (ElementTree.ParseError, ValueError) as error:
            raise FileError(f"The model {path} does not load: no XML: {error}.") from error
        # Without the name of a namespace, which MuJoCo does not know either.
        for element in root.iter():
            element.tag = element.tag.rpartition("}")[2]
        return root

    def _include(
        self, parent: ElementTree.Element, within: tuple[Path, ...], beside: Path, depth: int = 1
    ) -> None:
        """Put the content of included files in the place of the elements that include them. Where the
        model's own folder has none of that name, the folder `beside` the including file may."""
        if depth > MAX_DEPTH:
            raise FileError(
                f"The model {self._path} does not load: nested more than {MAX_DEPTH} deep."
            )
        for index in reversed(range(len(parent))):
            child = parent[index]
            if child.tag != "include":
                self._include(child, within, beside, depth + 1)
                continue
            path = self._included(child.get("file", ""), beside)
            if path in within:
                raise FileError(f"The model {path} includes itself.")
            included = self._parse(path)
            self._include(included, (*within, path), path.parent, depth + 1)
            parent[index : index + 1] = list(included)

    def _included(self, name: str, beside: Path) -> Path:
        """The file to include, as the model's own folder or, if that has none, the folder `beside` has it."""
        if not name:
            raise FileError(
                f"The model {self._path} does not load: an <include> names no file (file=…)."
            )
        own = self._folder / name.replace("\\", "/")
        if beside != self._folder and not own.is_file():
            return self._inside(name, beside)
        return self._inside(name)

    def _directories(self, elements: list[ElementTree.Element]) -> dict[str, str]:
        """Where meshes and textures are; of several compiler elements the last one says it."""
        found = dict.fromkeys(_DIRECTORIES, "")
        for compiler in (e for e in elements if e.tag == "compiler"):
            for key in _DIRECTORIES:
                found[key] = compiler.attrib.pop(key, found[key])
            strips = compiler.attrib.pop("strippath", "true" if "strippath" in found else "false")
            if strips == "true":
                found["strippath"] = "true"
            else:
                found.pop("strippath", None)
        return found

    def _asset(self, directories: Mapping[str, str], kind: str, name: str) -> str:
        if not name:
            raise FileError(
                f"The model {self._path} does not load: a mesh or texture names no file."
            )
        folder = directories[kind] or directories["assetdir"]
        if "strippath" in directories:
            name = name.replace("\\", "/").rpartition("/")[2]
        path = self._inside(f"{folder}/{name}" if folder else name)
        key = path.relative_to(self._root).as_posix()
        if key not in self._assets:
            content = self._content(path, self._asset_bytes_left, MAX_ASSET_BYTES)
            self._asset_bytes_left -= len(content)
            self._assets[key] = content
        return key

    def _of_package(self, name: str, directories: dict[str, str]) -> str:
        """The path, from the model's folder, that a URDF's ``package://NAME/PATH`` means: NAME is a folder
        around the model's, or beside one of these; if neither has the file, one around it that the model may
        read may have another name. Other names are looked for as they are, then in the folders around, then,
        as MuJoCo does it, without their folders."""
        directories.pop("strippath", None)
        name = name.replace("\\", "/")
        around = (self._folder, *self._folder.parents)
        own = [f for f in around if f.is_relative_to(self._root)]
        if found := _PACKAGE.fullmatch(name):
            package, rest = found.groups()
            named = [f for f in around if f.name == package] or [f / package for f in around]
            missing = named[0]
        else:
            rest = name.removeprefix("file://")
            if (
                not Path(rest).is_absolute()
                and (self._folder / directories["meshdir"] / rest).is_file()
            ):
                return rest
            named, missing = [self._root] if Path(rest).is_absolute() else [], None
        there = next((f for f in (*named, *own) if (f / rest).is_file()), missing)
        if there is None:
            return rest.rpartition("/")[2]
        directories["meshdir"] = directories["assetdir"] = ""
        return os.path.relpath(there / rest, self._folder)

    def _inside(self, name: str, folder: Path | None = None) -> Path:
        """The file that the model calls `name`, as seen from a `folder`, or else its own; it must be
        below the folder that the model may refer to."""
        name = name.replace("\\", "/")  # as written on Windows
        try:
            path = ((folder or self._folder) / name).resolve()
        except (OSError, ValueError, RuntimeError):
            self._refuse(name)
        if Path(name).is_absolute():
            self._refuse(name)
        if not path.is_relative_to(self._root):
            self._refuse(name, path)
        return path

    def _refuse(self, what: str, path: Path | None = None) -> NoReturn:
        way = "put its meshes and includes into the folder, and refer to them there."
        if path is not None and not Path(what).is_absolute():
            common = Path(os.path.commonpath([self._root, path.parent]))
            own = self._folder / self._path.name
            way = (
                "if you trust it, say by a double slash from which folder on it may read: "
                f"{common}//{own.relative_to(common).as_posix()}"
            )
        raise FileError(
            f"The model {self._path} refers to other files than those of its own folder, or to "
            f"plugins ({what!r}); {way}"
        )

    def _content(self, path: Path, limit: int, total: int) -> bytes:
        self._num_files += 1
        if self._num_files > MAX_FILES:
            raise FileError(f"The model {self._path} refers to more than {MAX_FILES} files.")
        try:
            if not path.is_file():
                alike = [
                    p.name for p in path.parent.glob("*") if p.name.lower() == path.name.lower()
                ]
                hint = f" There is {alike[0]}: names differ in capitals here." if alike else ""
                if path.exists():
                    hint = " It is a folder." if path.is_dir() else " It is a pipe or a device."
                raise FileError(
                    f"The model {self._path} cannot be read: there is no file {path}.{hint}"
                )
            with path.open("rb") as file:
                content = file.read(limit + 1)
        except OSError as error:
            raise FileError(
                f"The model {self._path} cannot be read: {path}: {error.strerror}."
            ) from error
        if content.startswith(_POINTER):
            raise FileError(
                f"The model {self._path} cannot be read: {path} only points to a file of Git LFS; fetch it with "
                "`git lfs pull` where the model is from."
            )
        if len(content) > limit:
            raise FileError(f"The model {self._path} is larger than {total >> 20} MiB.")
        return content


def _decoded(path: Path, content: bytes) -> str:
    """The text of the model at `path`, in the encoding that it says, else UTF-8, else, as MuJoCo takes any
    bytes for a name, Latin-1. What says UTF-16 in plain bytes is not in it: programs say so of text in memory."""
    marked = next((name for mark, name in _MARKS.items() if content.startswith(mark)), None)
    if marked is None and b"\0" in content[:2]:
        marked = "utf-16-le" if content[1:2] == b"\0" else "utf-16-be"
    declared = _DECLARED.match(content)
    said = marked or (declared[1].decode("ascii") if declared else None)
    if (
        not marked
        and said
        and said.lower().replace("_", "-").startswith(("utf-16", "utf-32", "ucs-2"))
    ):
        said = None
    try:
        return content.decode(said or "utf-8")
    except LookupError as error:
        raise FileError(
            f"The model {path} does not load: no encoding {said!r} is known."
        ) from error
    except UnicodeError as error:
        if said is None:
            return content.decode("latin-1")
        raise FileError(f"The model {path} does not load: it is not in {said}: {error}.") from error


def _without_visuals(robot: ElementTree.Element) -> None:
    """Take what a URDF only shows out of it: textures, and if it also has what collides, its visuals; MuJoCo does
    not read most of the formats of such meshes, and leaves them out by default."""
    for material in list(robot.iter("material")):
        for texture in material.findall("texture"):
            material.remove(texture)
    if robot.find("link/collision") is not None:
        for link in robot.iter("link"):
            for visual in link.findall("visual"):
                link.remove(visual)

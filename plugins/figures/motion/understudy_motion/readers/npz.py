"""NPZ archives of strangers: sizes are checked before anything is read, objects never made."""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from understudy.errors import FileError
from understudy_motion.reading import read_bytes

MAX_MEMBERS = 256
MAX_ARRAY_BYTES = 128 * 2**20
"""All arrays of a clip together, unpacked: ten minutes of 55 joints at 120 frames/s."""
ZIP_MAGIC = b"PK\x03\x04"
_ENTRY = b"PK\x01\x02"  # begins every entry of a zip's directory
_KINDS: Mapping[str, str] = {"f": "floats", "i": "whole numbers", "U": "text", "b": "true or false"}


class Archive:
    """The arrays of an NPZ file, read one by one as asked for.

    Raises:
        FileError: missing, too large, or not a sound zip archive.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.content = read_bytes(path)
        if self.content.count(_ENTRY) > MAX_MEMBERS:
            raise FileError(f"Clip {path}: more than {MAX_MEMBERS} arrays.")
        try:
            self._zip = zipfile.ZipFile(io.BytesIO(self.content))
        except Exception as error:  # zipfile raises whatever its parsing of damage raises
            raise FileError(f"Clip {path}: not a sound NPZ archive: {_brief(error)}.") from error
        self._left = MAX_ARRAY_BYTES

    @property
    def names(self) -> frozenset[str]:
        """Names of the arrays."""
        members = self._zip.namelist()
        return frozenset(m.removesuffix(".npy") for m in members if m.endswith(".npy"))

    def floats(self, name: str, *shape: int | None) -> np.ndarray:
        """The finite array `name` as float64; None in `shape` is any size."""
        array = self._array(name, "f", shape).astype(np.float64)
        finite = np.isfinite(array)
        if not finite.all():
            where = f"frame {int(np.argwhere(~finite)[0, 0])}: " if array.ndim else ""
            raise FileError(f"Clip {self._path}: {where}'{name}' is not finite.")
        return array

    def numbers(self, name: str) -> np.ndarray:
        """The array `name` of numbers or truth values, of any shape, which need not be finite."""
        return self._array(name, "fib", None)

    def number(self, name: str) -> float:
        """The single number `name`."""
        array = self._array(name, "fi", None)
        if array.size != 1 or not np.isfinite(array).all():
            raise FileError(f"Clip {self._path}: '{name}' is not one finite number.")
        return float(array.reshape(()))

    def integers(self, name: str, *shape: int | None) -> np.ndarray:
        """The array `name` of whole numbers."""
        return self._array(name, "i", shape)

    def flag(self, name: str) -> bool:
        """The truth value `name`."""
        return bool(self._array(name, "b", ()))

    def text(self, name: str) -> str:
        """The text `name`."""
        return str(self._array(name, "U", ()))

    def texts(self, name: str) -> tuple[str, ...]:
        """The list of texts `name`."""
        return tuple(map(str, self._array(name, "U", (None,))))

    def _array(self, name: str, kinds: str, shape: tuple[int | None, ...] | None) -> np.ndarray:
        """The array `name` of one of the dtype `kinds`; any shape if None."""
        if name not in self.names:
            raise FileError(f"Clip {self._path}: the array '{name}' is missing.")
        try:
            member = self._zip.getinfo(f"{name}.npy")
            if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                raise ValueError("compressed in a way that is not read here")
            if member.file_size > self._left:
                raise ValueError(f"the arrays are larger than {MAX_ARRAY_BYTES // 2**20} MB")
            self._left -= member.file_size
            with self._zip.open(member) as file:
                version = np.lib.format.read_magic(file)
                if version not in ((1, 0), (2, 0)):
                    raise ValueError(f"version {version} is not known")
                read_header = (
                    np.lib.format.read_array_header_1_0
                    if version == (1, 0)
                    else np.lib.format.read_array_header_2_0
                )
                found, fortran_order, dtype = read_header(file)
                if dtype.kind not in kinds or (dtype.kind == "f" and dtype.itemsize > 8):
                    wanted = " or ".join(_KINDS[kind] for kind in kinds)
                    raise ValueError(f"holds {dtype} where {wanted} are needed")
                size = math.prod(found) * dtype.itemsize
                if min(found, default=0) < 0 or size != member.file_size - file.tell():
                    raise ValueError(f"its shape {found} is not the size of its content")
                if shape is not None and not _fits(found, shape):
                    wanted = ", ".join("any" if n is None else str(n) for n in shape)
                    raise ValueError(f"its shape is {found} and should be ({wanted})")
                array = np.frombuffer(file.read(size), dtype)
            return array.reshape(found, order="F" if fortran_order else "C")
        except (
            Exception
        ) as error:  # zipfile and numpy raise whatever their parsing of damage raises
            raise FileError(f"Clip {self._path}: array '{name}': {_brief(error)}.") from error


def array_names(path: Path) -> frozenset[str]:
    """Names of the arrays of an NPZ file; none of a file that is not a sound one."""
    try:
        return Archive(path).names
    except FileError:
        return frozenset()


def _brief(error: Exception) -> str:
    """The error's text, in which zipfile quotes any amount of the file."""
    text = " ".join(str(error).split())
    return text if len(text) <= 200 else f"{text[:200]}…"


def _fits(found: tuple[int, ...], wanted: tuple[int | None, ...]) -> bool:
    return len(found) == len(wanted) and all(
        n is None or n == size for size, n in zip(found, wanted, strict=True)
    )

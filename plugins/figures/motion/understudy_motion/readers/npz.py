"""NPZ archives of strangers: sizes are checked before anything is read, objects never made."""

from __future__ import annotations

import io
import math
import os
import pickletools
import warnings
import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from understudy.errors import FileError
from understudy_motion.limits import read_bytes
from understudy_motion.readers.text import is_number

__all__ = ["Archive"]

MAX_MEMBERS = 256
MAX_ARRAY_BYTES = 128 * 2**20
"""All arrays of a clip together, unpacked: ten minutes of 55 joints at 120 frames/s."""
MAX_DIRECTORY = 2**20
"""Bytes at the end of a file in which its directory is looked for, where names alone are asked for."""
TEXT_BYTES = 64
"""Of memory that any text takes, however short."""
MAX_LITERALS = 4096
"""Bytes of an array of objects in which a single number is looked for."""
_NUMBERS = ("BININT", "BININT1", "BININT2", "LONG1", "INT", "LONG", "BINFLOAT", "FLOAT")
_STRUCTURE = (
    "MEMOIZE",
    "PUT",
    "BINPUT",
    "LONG_BINPUT",
    "MARK",
    "APPEND",
    "APPENDS",
    "TUPLE",
    "BUILD",
    "STOP",
)
ZIP_MAGIC = b"PK\x03\x04"
_ENTRY = b"PK\x01\x02"  # begins every entry of a zip's directory
_KINDS: Mapping[str, str] = {
    "f": "floats",
    "i": "whole numbers",
    "u": "",
    "O": "",
    "U": "text",
    "S": "",
    "b": "true or false",
}


class Archive:
    """The arrays of an NPZ file, read one by one as asked for.

    Raises
    ------
    FileError
        missing, too large, or not a sound zip archive.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.content = read_bytes(path)
        if not _few(self.content):
            raise FileError(f"Clip {path}: more than {MAX_MEMBERS} arrays.")
        try:
            self._zip = zipfile.ZipFile(io.BytesIO(self.content))
        except Exception as error:  # zipfile raises whatever its parsing of damage raises
            raise FileError(f"Clip {path}: not a sound NPZ archive: {_brief(error)}.") from error
        self._left = MAX_ARRAY_BYTES

    @property
    def names(self) -> frozenset[str]:
        """Names of the arrays."""
        return _names(self._zip)

    def floats(self, name: str, *shape: int | None) -> np.ndarray:
        """The finite array `name` of floats or whole numbers as float64; None in `shape` is any size."""
        with np.errstate(invalid="ignore"):  # of signalling NaN, which are refused below
            array = self._array(name, "fiu", shape).astype(np.float64)
        finite = np.isfinite(array)
        if not finite.all():
            where = f"frame {int(np.argwhere(~finite)[0, 0])}: " if array.ndim else ""
            raise FileError(f"Clip {self._path}: {where}'{name}' is not finite; fill it in.")
        return array

    def numbers(self, name: str) -> np.ndarray:
        """The array `name` of numbers or truth values, of any shape, which need not be finite."""
        return self._array(name, "fib", None)

    def shape(self, name: str) -> tuple[int, ...]:
        """The shape of the array `name` of numbers, whose size still counts when it is read."""
        left = self._left
        shape = self._array(name, "fiu", None).shape
        self._left = left
        return shape

    def number(self, name: str) -> float:
        """The single number `name`, which may be saved as an object or as text."""
        array = self._array(name, "fiuOUS", None)
        if array.size == 1 and array.dtype.kind in "US":
            word = str(array.astype("U40").reshape(()))
            array = np.array(float(word) if is_number(word) else np.nan)
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
            with self._zip.open(member) as file, warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of the parser, about a stranger's header
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
                    wanted = " or ".join(_KINDS[kind] for kind in kinds if _KINDS[kind])
                    raise ValueError(f"holds {dtype} where {wanted} are needed")
                if dtype.kind == "O":
                    return _literals(file.read(MAX_LITERALS + 1))
                size = math.prod(found) * dtype.itemsize
                if min(found, default=0) < 0 or size != member.file_size - file.tell():
                    raise ValueError(f"its shape {found} is not the size of its content")
                if shape is not None and not _fits(found, shape):
                    wanted = ", ".join("any" if n is None else str(n) for n in shape)
                    raise ValueError(f"its shape is {found} and should be ({wanted})")
                if math.prod(found) * _held(dtype) > MAX_ARRAY_BYTES * 2:
                    raise ValueError(f"its shape {found} is of more than is read")
                array = np.frombuffer(file.read(size), dtype)
                if dtype.kind in "US" and not _is_text(array):
                    raise ValueError("holds what is no text")
            return array.reshape(found, order="F" if fortran_order else "C")
        except (
            Exception
        ) as error:  # zipfile and numpy raise whatever their parsing of damage raises
            raise FileError(f"Clip {self._path}: array '{name}': {_brief(error)}.") from error


def array_names(path: Path) -> frozenset[str]:
    """Names of the arrays of an NPZ file; none of a file that is not a sound one. Only its end is read."""
    try:
        with path.open("rb") as file:
            file.seek(-min(MAX_DIRECTORY, file.seek(0, os.SEEK_END)), os.SEEK_END)
            end = file.read(MAX_DIRECTORY)
        return _names(zipfile.ZipFile(io.BytesIO(end))) if _few(end) else frozenset()
    except Exception:  # of the system, or whatever zipfile's parsing of damage raises
        return frozenset()


def _few(content: bytes) -> bool:
    """Whether the directory of a zip has no more entries than are read."""
    return content.count(_ENTRY) <= MAX_MEMBERS


def _names(archive: zipfile.ZipFile) -> frozenset[str]:
    return frozenset(m.removesuffix(".npy") for m in archive.namelist() if m.endswith(".npy"))


def _held(dtype: np.dtype) -> int:
    """Bytes of memory that one item of an array takes once it is used."""
    if dtype.kind in "US":
        return max(2 * dtype.itemsize, TEXT_BYTES)
    return dtype.itemsize if dtype.kind == "b" else 8


def _is_text(array: np.ndarray) -> bool:
    """Whether an array of texts holds characters alone: ASCII of bytes, else no surrogates, and none beyond Unicode."""
    if not array.size:
        return True
    if array.dtype.kind == "S":
        return bool(array.view(np.uint8).max() < 128)
    codes = array.view(f"{array.dtype.byteorder}u4")
    return not bool(((codes > 0x10FFFF) | ((codes >= 0xD800) & (codes < 0xE000))).any())


def _literals(pickled: bytes) -> np.ndarray:
    """The numbers in an array of objects, read off its opcodes: nothing is unpickled or called.

    Raises
    ------
    ValueError
        it holds more than plain numbers.
    """
    numbers: list[float] | None = None
    if len(pickled) <= MAX_LITERALS:
        for opcode, argument, _ in pickletools.genops(pickled):
            if opcode.name == "EMPTY_LIST" and numbers is None:  # the array's content
                numbers = []
            elif numbers is None or opcode.name in _STRUCTURE:
                continue
            elif opcode.name in _NUMBERS and argument is not None:
                numbers.append(float(argument))
            else:
                numbers = None
                break
    if numbers is None:
        raise ValueError("holds objects where numbers are needed, and objects are not unpickled")
    return np.array(numbers)


def _brief(error: Exception) -> str:
    """The error's text, in which zipfile quotes any amount of the file."""
    text = " ".join(str(error).split()) or type(error).__name__
    return text if len(text) <= 200 else f"{text[:200]}…"


def _fits(found: tuple[int, ...], wanted: tuple[int | None, ...]) -> bool:
    return len(found) == len(wanted) and all(
        n is None or n == size for size, n in zip(found, wanted, strict=True)
    )

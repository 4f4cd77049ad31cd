"""Checkpoints: tensors as safetensors, everything else as JSON, both written atomically.

A checkpoint ``NAME`` is two files: ``NAME.safetensors`` and ``NAME.json``. The JSON is written last
and has digests of the tensors and of itself, so a checkpoint exists completely or not at all, and a
changed byte is noticed. Loading executes nothing: both formats are plain data. Tensors of a
mebibyte or more are deflated if that makes them much smaller (lists of worlds with unused places).
"""

from __future__ import annotations

import ctypes
import hashlib
import json
import math
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load as load_tensors
from safetensors.torch import save as save_tensors
from torch import Tensor

from understudy.errors import PluginError, RunError
from understudy.folders import opened, read, write_atomically

__all__ = ["load", "misshapen", "newest", "read_sealed", "save"]

#: Version of the layout that is written. Version 2, without deflated tensors, is read, too.
FORMAT = 3
_LEAST, _MOST = 2**20, 2**32  #: bytes: the least of a deflated tensor, the most of all together
_LARGEST = 2**33  #: most bytes of a file of tensors
_TYPES = {str(t): t for t in (torch.float32, torch.float64, torch.int32, torch.int64)}


def save(path: Path, state: Mapping[str, Any], meta: Mapping[str, Any]) -> None:
    """Write the checkpoint `path` of `state`: nested mappings, lists, tensors, numbers, text."""
    file, tensor_file = _files(path)
    tensors: dict[str, Tensor] = {}
    tree = _take_tensors(state, "", tensors, _Room())
    data = save_tensors(tensors)
    digest = hashlib.sha256(data).hexdigest()
    content = {"format": FORMAT, "meta": dict(meta), "state": tree, "sha256": digest}
    write_atomically(tensor_file, data)
    write_atomically(file, _sealed(content))
    del tensors, data
    if trim := getattr(ctypes.CDLL(None), "malloc_trim", None):
        trim(0)  # else copies as large as the state would leave more and more gaps in the heap


def load(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """The ``(state, meta)`` of the checkpoint `path` (with or without an ending); a RunError if it
    is missing, damaged, or of another format."""
    file, tensor_file = _files(path)
    document = read_sealed(file)
    if not isinstance(document, dict) or not {"state", "meta", "sha256"} <= document.keys():
        raise RunError(f"{file} is damaged: it is no checkpoint.")
    if (version := document.get("format")) not in (2, FORMAT):
        raise RunError(
            f"{path} has checkpoint format {version}, and this understudy reads {FORMAT}. Use the "
            "version of understudy that wrote it, or train anew."
        )
    try:
        with opened(tensor_file, _LARGEST) as tensor_bytes:
            digest = hashlib.file_digest(tensor_bytes, "sha256").hexdigest()
            if digest != document.get("sha256"):  # before memory is taken for all of it
                raise RunError(f"{tensor_file} is damaged: its digest does not match.")
            tensor_bytes.seek(0)
            data = tensor_bytes.read(_LARGEST)
    except OSError as error:
        raise RunError(f"{tensor_file} cannot be read: {error.strerror}.") from error
    try:
        tensors = load_tensors(data)
    except SafetensorError as error:
        raise RunError(f"{tensor_file} is damaged: {error}.") from error
    try:
        state, meta = _put_tensors(document["state"], tensors, _Room()), dict(document["meta"])
    except (LookupError, TypeError, ValueError, AttributeError, RuntimeError, zlib.error) as error:
        raise RunError(f"{file} is damaged: its state is not readable.") from error
    return state, meta


def _files(path: Path) -> tuple[Path, Path]:
    """The two files of the checkpoint `path`, whose own name may have dots."""
    if not (name := path.name.removesuffix(".json").removesuffix(".safetensors")):
        raise RunError(f"{path} names no file. Give one: NAME, NAME.json or NAME.safetensors.")
    return path.with_name(f"{name}.json"), path.with_name(f"{name}.safetensors")


class _Room:
    """How many bytes deflated tensors may still have once they are inflated."""

    def __init__(self) -> None:
        self._left = _MOST

    def take(self, size: int) -> bool:
        """Whether a tensor of `size` bytes may be deflated: it is large enough, and has room."""
        fits = _LEAST <= size <= self._left
        self._left -= size if fits else 0
        return fits


def _sealed(content: Mapping[str, Any]) -> bytes:
    body = json.dumps(content, allow_nan=False)  # unsorted, as the order of some mappings matters
    digest = hashlib.sha256(body.encode()).hexdigest()
    return json.dumps({"digest": digest, "content": body}).encode()


def _finite(text: str) -> float:
    if not math.isfinite(number := float(text)):
        raise ValueError(f"{text} is no number of JSON")
    return number


def read_sealed(path: Path) -> dict[str, Any]:
    """What the sealed JSON file of a checkpoint has; a RunError if it is missing, or its digest does not match."""
    try:
        outer = json.loads(read(path))
        body = outer["content"]
        if hashlib.sha256(body.encode()).hexdigest() != outer["digest"]:
            raise RunError(f"{path} is damaged: its digest does not match.")
        return json.loads(body, parse_float=_finite, parse_constant=_finite)
    except OSError as error:
        raise RunError(f"{path} cannot be read: {error.strerror}.") from error
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise RunError(f"{path} is damaged: it is no complete checkpoint.") from error


def _take_tensors(value: Any, where: str, tensors: dict[str, Tensor], room: _Room) -> Any:
    if isinstance(value, Tensor):
        # copies, since safetensors refuses tensors that share memory
        own = tensors[where] = value.detach().to("cpu", copy=True).contiguous()
        if str(own.dtype) not in _TYPES or not room.take(own.nbytes):
            return {"tensor": where}
        eighth = own.flatten().view(torch.uint8).unfold(0, 2**15, 2**18).contiguous()
        for part, most in ((eighth, 0.9), (own, 0.75)):  # an eighth tells enough of most tensors
            if len(packed := zlib.compress(part.numpy().data, 1)) > most * part.nbytes:
                return {"tensor": where}
        tensors[where] = torch.frombuffer(bytearray(packed), dtype=torch.uint8)
        return {"deflated": [where, str(own.dtype), list(own.shape)]}
    if isinstance(value, Mapping):
        under = f"{where}/" if where else ""
        found = {str(k): _take_tensors(v, f"{under}{k}", tensors, room) for k, v in value.items()}
        return {"map": found}
    if isinstance(value, (list, tuple)):
        items = [_take_tensors(v, f"{where}/{i}", tensors, room) for i, v in enumerate(value)]
        return {"list": items}
    if isinstance(value, float) and not math.isfinite(value):
        return {"float": repr(value)}
    if value is None or isinstance(value, (bool, int, float, str)):
        return {"value": value}
    raise PluginError(f"The state '{where}' is a {type(value).__name__}, which is not data.")


def _put_tensors(value: Any, tensors: dict[str, Tensor], room: _Room) -> Any:
    (kind, content), *_ = value.items()
    if kind == "tensor":
        return tensors.pop(content)  # each is in one place only
    if kind == "deflated":
        name, dtype, shape = content
        if not room.take(size := math.prod(shape) * _TYPES[dtype].itemsize):
            raise ValueError
        raw = zlib.decompressobj().decompress(tensors.pop(name).numpy().data, size)
        return torch.frombuffer(bytearray(raw), dtype=_TYPES[dtype]).view(shape)
    if kind == "map":
        return {k: _put_tensors(v, tensors, room) for k, v in content.items()}
    if kind == "list":
        return [_put_tensors(v, tensors, room) for v in content]
    return float(content) if kind == "float" else content


def misshapen(own: Any, other: Any, where: str) -> Iterator[str]:
    """Where the nested state `other` has not the form of `own`, or is not finite while `own` is."""
    if own is None:
        return
    if _kind(own) != _kind(other):
        yield f"'{where}' is {_kind(own)} here and {_kind(other)} there"
    elif isinstance(own, Mapping):
        for name, value in own.items():
            yield from misshapen(value, other.get(name), f"{where}/{name}".lstrip("/"))
    elif not isinstance(own, (str, list)):
        finite = [bool(torch.as_tensor(value).isfinite().all()) for value in (own, other)]
        if finite == [True, False]:
            yield f"'{where}' is not finite"


def _kind(value: Any) -> str:
    if isinstance(value, Tensor):
        return f"{tuple(value.shape)} {value.dtype}".replace(" torch.float32", "")
    kinds = {"NoneType": "nothing", "int": "a number", "float": "a number", "tuple": "a list"}
    return kinds.get(type(value).__name__, f"a {type(value).__name__}")


def newest(folder: Path) -> list[Path]:
    """The checkpoints in `folder`, newest first, without their endings."""
    return [p.with_suffix("") for p in sorted(folder.glob("[0-9]*.json"), reverse=True)]


def load_newest(
    folder: Path, warn: Any = lambda text: None
) -> tuple[dict[str, Any], dict[str, Any], Path]:
    """``(state, meta, path)`` of the newest intact checkpoint; `warn` hears of damaged ones."""
    reasons = []
    for path in newest(folder):
        try:
            state, meta = load(path)
            return state, meta, path
        except RunError as error:
            if "checkpoint format" in str(error):
                raise
            reasons.append(str(error))
            warn(f"{error} Falling back to the one before it.")
    detail = f" The newest: {reasons[0]}" if reasons else ""
    raise RunError(f"{folder} has no usable checkpoint.{detail}")


def prune(folder: Path, keep: int, last: Path | None = None) -> None:
    """Delete leftovers of interrupted writes, and all checkpoints but the `keep` newest and the
    `last` that was written; those with a higher number than that were damaged."""
    for path in (p for p in newest(folder)[keep:] if p != last):
        path.with_suffix(".json").unlink(missing_ok=True)
    for path in folder.glob("*.safetensors"):
        if not path.with_suffix(".json").exists():
            path.unlink(missing_ok=True)
    for path in folder.glob(".*.partial"):
        path.unlink(missing_ok=True)

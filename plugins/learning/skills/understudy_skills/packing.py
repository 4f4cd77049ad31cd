"""How a pack writes what it has: weights in few bits, and names of no one's folders."""

from __future__ import annotations

import hashlib
import itertools
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor

__all__ = [
    "BITS",
    "card_of_no_folder",
    "is_left_over",
    "is_of_a_disk",
    "names_within",
    "of_no_folder",
    "packed_tensor",
    "renamed",
    "renamed_in",
    "sources_of_no_folder",
    "unpacked",
    "without_place",
    "words_in",
    "words_of_no_folder",
]

#: That a packed weight may have. With 32 nothing is rounded.
BITS = (8, 16, 32)
_INTEGERS = {8: torch.int8, 16: torch.int16}
_SCALES = (torch.float32, torch.float64)


#: How a path begins that leads through somebody's folders, and such a path within other words.
_OF_A_DISK = r"(?:/|~[\w.-]*/|[A-Za-z]:[\\/])(?=[\w.~])"
_WITHIN = re.compile(rf"(?<![\w./:~\\-]){_OF_A_DISK}[^,\]}}'\"=]*")
#: What a card says of the process that wrote it, and no pack needs.
_OF_THE_PROCESS = ("command", "machine")


def is_of_a_disk(word: str) -> bool:
    """Whether `word` is a path from the root of a disk, from a home, or out of the working folder."""
    return re.match(rf"{_OF_A_DISK}|\.\.[\\/]\S", word) is not None


def _bare(path: str) -> str:
    return path.rstrip("\\/").replace("\\", "/").rpartition("/")[2]


def words_of_no_folder(value: Any) -> Any:
    """Nested plain data with names for paths through somebody's folders, be they all of a word, as ``/home/me/walk.bvh``, or
    within it, as ``clip /home/me/walk.bvh``."""
    if isinstance(value, Mapping):
        return {words_of_no_folder(k): words_of_no_folder(part) for k, part in value.items()}
    if isinstance(value, list | tuple):
        return [words_of_no_folder(part) for part in value]
    if not isinstance(value, str):
        return value
    return _bare(value) if is_of_a_disk(value) else _WITHIN.sub(lambda m: _bare(m[0]), value)


def card_of_no_folder(name: str, content: bytes) -> bytes:
    """The file `name` of a run that a pack carries: of its card and of its checkpoint's what others can use, without the words
    that made it; any other as it is."""
    if not name.endswith(".json"):
        return content
    try:
        document = json.loads(content)
        if name.rpartition("/")[2] == "run.json" and "config" in document:
            return json.dumps(_shared(document), indent=1).encode()
        body = json.loads(document["content"])
        body["meta"] = _shared(body["meta"])
        text = json.dumps(body, allow_nan=False)  # sealed as a checkpoint is
        digest = hashlib.sha256(text.encode()).hexdigest()
        return json.dumps({"digest": digest, "content": text}).encode()
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return content  # which whoever reads it will refuse, if it is no such file


def _shared(card: Mapping[str, Any]) -> dict[str, Any]:
    kept = {key: value for key, value in card.items() if key not in _OF_THE_PROCESS}
    if "overrides" in kept:
        kept["overrides"] = []
    kept = words_of_no_folder(kept)
    if isinstance(config := kept.get("config"), dict):
        kept["config"] = without_place(config)
    return kept


def without_place(config: Mapping[str, Any]) -> dict[str, Any]:
    """A configuration that does not say in which folder its run was."""
    return {**config, "run": {**(config.get("run") or {}), "dir": None}}


def words_in(value: Any, key: str = "") -> Iterator[tuple[str, str]]:
    """The words of a configuration, each with its key path."""
    if isinstance(value, str):
        yield key, value
    elif isinstance(value, Mapping | list | tuple):
        inner = value.items() if isinstance(value, Mapping) else enumerate(value)
        for name, part in inner:
            yield from words_in(part, f"{key}.{name}".lstrip("."))


def names_within(paths: Sequence[str], overrides: Any) -> dict[str, str]:
    """By the path of a bank or run its name in a pack, of no one's folders, where the words that made the skill can say so, if
    there are any."""
    found = dict[str, str]()
    for path in paths:
        tries = itertools.chain([""], (f"-{number}" for number in itertools.count(2)))
        name = next(
            n for end in tries if (n := (Path(path).name or "it") + end) not in found.values()
        )
        words = overrides if isinstance(overrides, list) else None
        if words is None or any(renamed_in(word, {path: f"{name} "}) != word for word in words):
            found[path] = name
    return found


def of_no_folder(item: Mapping[str, Any]) -> dict[str, Any]:
    """An item of a licence, whose source may name a bank or run of its makers."""
    source = str(item.get("source", ""))
    if "://" in source:
        return dict(item)
    # as "bank PATH", "grip.file=PATH", "understudy licence PATH"
    asked, path = re.fullmatch(r"((?:[^/=]*[ =])?)(.*)", source, re.DOTALL).groups()  # type: ignore[union-attr]
    return {**item, "source": asked + Path(path).name} if path else dict(item)


def sources_of_no_folder(sources: Any) -> Any:
    """What a run recorded of its sources, and of those of the runs that it began with, with names for its makers' paths."""
    if isinstance(sources, list):
        return [sources_of_no_folder(part) for part in sources]
    if not isinstance(sources, Mapping):
        return words_of_no_folder(sources)
    return {
        words_of_no_folder(key): Path(value).name
        if key in ("source", "run") and isinstance(value, str)
        else sources_of_no_folder(value)
        for key, value in sources.items()
    }


def renamed(value: Any, names: Mapping[str, str]) -> Any:
    """A configuration with the words of `names` replaced."""
    if isinstance(value, Mapping):
        return {key: renamed(part, names) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [renamed(part, names) for part in value]
    return names.get(value, value) if isinstance(value, str) else value


def renamed_in(override: str, names: Mapping[str, str]) -> str:
    """An override with the paths of `names` replaced where they stand by themselves."""
    for old in sorted(names, key=len, reverse=True):
        alone = rf"(?<![\w./-]){re.escape(old)}(?![\w./-])"
        override = re.sub(alone, lambda _, new=names[old]: new, override)
    return override


def is_left_over(file: Path) -> bool:
    """Whether `file` has the tensors of a pack that was killed before it had a card, without which they are useless."""
    if file.with_suffix(".json").exists():
        return False
    try:
        with safe_open(file, "pt") as tensors:
            parts = ("policy/", "policies/", "banks/", "files/")
            return all(name.startswith(parts) for name in tensors.keys())  # noqa: SIM118 - no mapping
    except (OSError, SafetensorError):
        return False


def packed_tensor(value: Tensor, bits: int) -> Tensor | dict[str, Tensor]:
    """A matrix as whole numbers of so many `bits` and a scale a row; anything else as it is."""
    if value.ndim != 2 or bits == max(BITS):
        return value
    integer = _INTEGERS[bits]
    # of each row the largest weight is the largest integer
    scale = value.abs().amax(dim=1).clamp(min=1e-12) / torch.iinfo(integer).max
    return {"rows": (value / scale[:, None]).round().to(integer), "scale": scale}


def unpacked(value: Tensor | Mapping[str, Tensor]) -> Tensor:
    """What :func:`packed_tensor` was given, but for rounding; a ValueError if it did not make this."""
    if isinstance(value, Tensor):
        return value
    rows, scale = value["rows"], value["scale"]
    if rows.ndim != 2 or scale.shape != rows.shape[:1]:
        raise ValueError(f"{tuple(scale.shape)} scales do not fit {tuple(rows.shape)} weights")
    if rows.dtype not in _INTEGERS.values() or scale.dtype not in _SCALES:
        raise ValueError(f"weights of {rows.dtype} by scales of {scale.dtype}")
    return rows.float() * scale[:, None]

"""Whose motion is behind what a run learned: the terms of its clips are those of the states that it leaves."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from understudy.errors import RunError
from understudy.folders import read
from understudy.records.checkpoint import read_sealed

__all__ = ["clips_behind", "clips_of_bank"]

#: What is kept of a clip.
_TERMS = ("clip", "licence", "url", "attribution")
#: How deep runs within runs are followed.
_DEPTH = 8
#: What is behind that and says nothing of itself.
_UNKNOWN = {"licence": "unknown"}


def clips_behind(info: Mapping[str, Any], folder: Path) -> list[dict[str, str]]:
    """What the run of this ``run.json`` in `folder` learned from, each clip once, as far as its copies say it: its own clip,
    those of the runs that it began with, of the banks that it began in and of the policies inside it. What says nothing of
    itself is there, too, with an unknown licence.
    """
    found = [_terms(clip) for clip in _behind(info, folder, _DEPTH)]
    return [clip for at, clip in enumerate(found) if clip not in found[:at]]


def clips_of_bank(about: Mapping[str, Any]) -> list[dict[str, str]] | None:
    """The clips behind the states of a bank, by what it says of itself; None where it does not say."""
    bank = _mapping(about.get("bank"))
    clips = bank.get("clips")
    if isinstance(clips, list):
        return [_terms(_mapping(clip)) for clip in clips]
    clip = _mapping(bank.get("clip"))  # as was written before there were several
    return [_terms(clip)] if clip else None


def _behind(info: Mapping[str, Any], folder: Path, depth: int) -> Iterator[Mapping[str, Any]]:
    items = _mapping(info.get("licence")).get("items")
    if isinstance(items, list):  # of a pack, whose copies are not all there
        yield from (_of_item(_mapping(item)) for item in items if _is_data(_mapping(item)))
        return
    if depth == 0:
        yield _UNKNOWN
        return
    yield from _of_sources(_mapping(info.get("sources")), depth)
    for asked, files in _mapping(info.get("inputs")).items():
        kind, names = str(asked).partition(" ")[0], [Path(str(name)) for name in _mapping(files)]
        inside = [
            folder / "inputs" / n for n in names if not n.is_absolute() and ".." not in n.parts
        ]
        cards = [file for file in inside if file.suffix == ".json"]
        own = next((file for file in cards if file.name == "run.json"), None)
        if kind == "bank":
            clips = clips_of_bank(_card(cards[0])) if cards else None
            yield from [_UNKNOWN] if clips is None else clips
        elif kind == "controller":
            card = _run_card(own) if own else _card(cards[0]) if cards else {}
            yield from _behind(card, own.parent, depth - 1) if own and card else _of_card(card)


def _of_sources(sources: Mapping[str, Any], depth: int) -> Iterator[Mapping[str, Any]]:
    if clip := _mapping(sources.get("motion")):
        yield clip
    if start := _mapping(sources.get("start")):
        inner = start.get("sources")
        if depth and isinstance(inner, Mapping):
            yield from _of_sources(inner, depth - 1)
        else:
            yield _UNKNOWN
    if sources.get(
        "policy"
    ):  # a run that judges one of another run, of which nothing more is known
        yield _UNKNOWN


def _of_card(card: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    """Of a packed policy that acts inside."""
    if "licence" in card:
        yield from _behind(card, Path(), 1)
    elif isinstance(sources := card.get("sources"), Mapping):
        yield from _of_sources(sources, _DEPTH)
    else:
        yield _UNKNOWN


def _is_data(item: Mapping[str, Any]) -> bool:
    return str(item.get("what", "")).startswith(("clip ", "file "))


def _of_item(item: Mapping[str, Any]) -> Mapping[str, Any]:
    name = str(item.get("what", "")).partition(" ")[2]
    return {**item, "clip": name, "url": item.get("source", "")}


def _terms(clip: Mapping[str, Any]) -> dict[str, str]:
    return {key: str(clip[key]) for key in _TERMS if clip.get(key)}


def _card(file: Path) -> Mapping[str, Any]:
    with suppress(RunError):
        return _mapping(_mapping(read_sealed(file)).get("meta"))
    return {}


def _run_card(file: Path) -> Mapping[str, Any]:
    with suppress(OSError, ValueError, RecursionError):
        return _mapping(json.loads(read(file)))
    return {}


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}

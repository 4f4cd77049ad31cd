"""What is behind what a run learned: the terms of its data are those of the weights and states that it leaves."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from understudy.errors import RunError
from understudy.folders import read
from understudy_reinforcement.licences import beside, record_beside

__all__ = ["KINDS", "clips_of_job", "terms_behind", "terms_of_bank", "terms_of_record"]

#: What it may be, by the word for it.
KINDS = ("clip", "model", "file", "weights")
#: What is kept of it.
_TERMS = (*KINDS, "licence", "url", "attribution")
#: How deep runs within runs are followed.
_DEPTH = 8
#: What is behind that and says nothing of itself.
_UNKNOWN = {"licence": "unknown"}


def terms_behind(info: Mapping[str, Any], folder: Path) -> list[dict[str, str]]:
    """What the run of this ``run.json`` in `folder` learned from, each once, as far as its copies say it: its own clips and
    models and the files that it read, those of the runs that it began with, of the banks that it began in and of the
    policies inside it. What says nothing of itself is there, too, with an unknown licence.
    """
    found = [_terms(row) for row in _behind(info, folder, _DEPTH)]
    return [row for at, row in enumerate(found) if row not in found[:at]]


def terms_of_bank(about: Mapping[str, Any]) -> list[dict[str, str]] | None:
    """What is behind the states of a bank, by what it says of itself; None where it does not say."""
    bank = _mapping(about.get("bank"))
    clips = bank.get("clips")
    if isinstance(clips, list):
        return [_terms(_mapping(clip)) for clip in clips]
    clip = _mapping(bank.get("clip"))  # as was written before there were several
    return [_terms(clip)] if clip else None


def terms_of_record(record: Mapping[str, Any]) -> list[dict[str, str]] | None:
    """What is behind a run that another one names among its sources, by that record; None where it does not say."""
    behind = record.get("behind")
    return [_terms(_mapping(row)) for row in behind] if isinstance(behind, list) else None


def clips_of_job(info: Mapping[str, Any]) -> list[dict[str, str]]:
    """The clips from which the job of a run learned, as its sources say it; of unknown licence where they do not."""
    sources = _mapping(info.get("sources"))
    clips, poses = sources.get("clips"), _mapping(sources.get("poses"))
    if isinstance(clips, list):
        return [_terms(_mapping(clip)) for clip in clips]
    named = _mapping(_mapping(info.get("config")).get("job")).get("clips")
    name = ", ".join(map(str, named)) if isinstance(named, list | tuple) else ""
    licences = poses.get("licences")  # as was written before each had its own
    if isinstance(licences, list):
        return [_terms({"clip": name, "licence": licence}) for licence in licences]
    return [_terms({"clip": name, **_UNKNOWN})] if name else []


def _behind(info: Mapping[str, Any], folder: Path, depth: int) -> Iterator[Mapping[str, Any]]:
    items = _mapping(info.get("licence")).get("items")
    if isinstance(items, list):  # of a pack, whose copies are not all there
        yield from (_of_item(row) for row in map(_mapping, items) if _is_data(row))
        return
    if depth == 0:
        yield _UNKNOWN
        return
    sources = _mapping(info.get("sources"))
    yield from _of_sources(sources, depth)
    yield from clips_of_job(info)
    for asked, files in _mapping(info.get("inputs")).items():
        names = [Path(str(name)) for name in _mapping(files)]
        inside = [
            folder / "inputs" / n for n in names if not n.is_absolute() and ".." not in n.parts
        ]
        if not (str(asked).startswith("motion.") and sources.get("motion")):
            yield from _of_input(str(asked), inside, depth)


def _of_input(asked: str, files: Sequence[Path], depth: int) -> Iterator[Mapping[str, Any]]:
    """Of the copies `files` of what was `asked` for."""
    kind, path = asked.partition(" ")[0], re.split("[ =]", asked, maxsplit=1)[-1]
    cards = [file for file in files if file.suffix == ".json"]
    own = next((file for file in cards if file.name == "run.json"), None)
    if kind == "bank":
        rows = terms_of_bank(_card(cards[0])) if cards else None
        yield from [_UNKNOWN] if rows is None else rows
    elif own is not None:
        card = _run_card(own)
        yield from _behind(card, own.parent, depth - 1) if "sources" in card else [_UNKNOWN]
    elif kind == "controller":
        yield from _of_card(_card(cards[0]) if cards else {})
    elif asked.startswith(("clip ", "motion.")):
        record = record_beside(files)
        yield {"clip": Path(path).name, **record, "licence": record.get("licence") or beside(files)}
    else:
        yield {"model" if kind == "mjcf" else "file": Path(path).name, "licence": beside(files)}


def _of_sources(sources: Mapping[str, Any], depth: int) -> Iterator[Mapping[str, Any]]:
    if clip := _mapping(sources.get("motion")):
        yield clip
    for key in ("start", "policy", "bank"):
        if not (record := _mapping(sources.get(key))):
            continue
        rows = terms_of_record(record)
        if rows is not None:
            yield from rows
            continue
        # as was written before, of which the clip alone is known
        inner = record.get("sources")
        if depth and isinstance(inner, Mapping):
            yield from _of_sources(inner, depth - 1)
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
    return not str(item.get("what", "")).startswith("code ")


def _of_item(item: Mapping[str, Any]) -> Mapping[str, Any]:
    what = str(item.get("what", ""))
    kind, _, name = what.partition(" ")
    if kind == "weights":
        name = name.partition(" ")[2]  # of, or below
    row = {kind: name} if kind in KINDS else {"file": what}  # as meshes of a model
    return {**item, **row, "url": item.get("source", "")}


def _terms(row: Mapping[str, Any]) -> dict[str, str]:
    return {key: str(row[key]) for key in _TERMS if row.get(key)} or dict(_UNKNOWN)


def _card(file: Path) -> Mapping[str, Any]:
    from understudy.records.checkpoint import (
        read_sealed,
    )  # takes torch, which most licences need not

    with suppress(RunError):
        return _mapping(_mapping(read_sealed(file)).get("meta"))
    return {}


def _run_card(file: Path) -> Mapping[str, Any]:
    with suppress(OSError, ValueError, RecursionError):
        return _mapping(json.loads(read(file)))
    return {}


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}

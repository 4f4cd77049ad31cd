"""What a run consists of that is somebody's: code, clips, models and their meshes, weights."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from understudy.errors import RunError
from understudy.folders import read
from understudy.records import runs
from understudy.setup.plugins import installed
from understudy.setup.registry import Registry
from understudy_credits.terms import PURPOSES, Purpose, Verdict, judge
from understudy_reinforcement.licences import beside, named, record_beside
from understudy_reinforcement.origins import KINDS, clips_of_job, terms_of_bank, terms_of_record
from understudy_report import words
from understudy_report.values import mapping, sequence

__all__ = ["answer", "in_a_line", "open_made"]

#: How far runs that began with runs are followed.
_DEPTH = 8


@dataclass(frozen=True)
class Item:
    """Something that a run was made of."""

    what: str  #: in words, as ``clip walk``
    licence: str  #: ``unknown`` where nothing says
    attribution: str = ""  #: the acknowledgement that the licence asks for
    source: str = ""  #: an address, or the name of a file


@dataclass(frozen=True)
class Made:
    """What is known of a run, a packed skill or one that comes with a plugin."""

    name: str
    info: Mapping[str, Any]  #: as ``run.json``, or a skill's card
    folder: Path | None = None  #: of a run, with its copies
    shipped: str = ""  #: the distribution that it comes with, whose licence its weights have


def open_made(source: str, registry: Registry | None = None) -> Made:
    """What `source` names: a run folder, a packed skill (.json), or the name of a skill.

    Raises
    ------
    ConfigError, RunError
        if there is none, or it is damaged.
    """
    path = Path(source)
    if path.is_dir() or not (
        path.suffix == ".json" or source in installed().registry.names("skill")
    ):
        run = runs.open_run(path)
        return Made(str(path), run.info, run.path)
    return _skill(source, registry or installed().registry)


def _skill(source: str, registry: Registry) -> Made:
    from understudy_skills.skill import open_skill  # and torch, for its weights

    component = registry.components.get(("skill", source))
    shipped = component.distribution if component else ""
    return Made(source, open_skill(source, registry=registry).card, None, shipped)


def items_of(made: Made, registry: Registry | None = None) -> list[Item]:
    """Everything that `made` consists of, each once, in the order code, clips, models, files, weights."""
    registry = registry or installed().registry
    recorded = sequence(mapping(made.info.get("licence")).get("items"))
    if recorded:  # it was packed from a run that had copies of more
        keys = ("what", "licence", "attribution", "source")
        texts = [{key: words.text(mapping(row).get(key, "")) for key in keys} for row in recorded]
        found = [Item(**{**row, "licence": row["licence"] or "unknown"}) for row in texts]
        if made.shipped:
            # Its distribution answers for its weights, and for those that they began with.
            named = [
                f"weights {at} {name}" for name in _began_with(made.info) for at in ("of", "below")
            ]
            begun = {(what, "unknown") for what in named}
            found = [item for item in found if (item.what, item.licence) not in begun]
            found.append(Item(f"weights of {made.name}", _distribution_licence(made.shipped)))
        return found
    found = [*_code(made.info), *_data(made, registry, _DEPTH)]
    return list(dict.fromkeys(found))


def _began_with(info: Mapping[str, Any]) -> Iterator[str]:
    """The names of the runs that began one another, from the last to the first."""
    start = mapping(mapping(info.get("sources")).get("start"))
    for _ in range(_DEPTH):
        if not start:
            return
        yield Path(words.text(start.get("run") or "")).name
        start = mapping(mapping(start.get("sources")).get("start"))


def answer(
    made: Made, registry: Registry | None = None, more: Mapping[str, list[Path]] | None = None
) -> dict[str, Any]:
    """What travels with what is made from it, as plain data: its items, and by purpose what stands in the
    way (nothing: an empty list). `more` are files of which `made` has no copies, by what was asked for."""
    registry = registry or installed().registry
    items = items_of(made, registry)
    for asked, files in (more or {}).items():
        kind, _, name = asked.partition(" ")
        found = [*_file(asked, files)]
        if kind == "controller":
            found = [*_weights_of(name, _inner(name, files, registry), registry, _DEPTH)]
        items += [item for item in found if item not in items]
    return {
        "items": [{k: v for k, v in asdict(item).items() if v} for item in items],
        **{
            purpose: [f"{i.what}: {v.why}" for i, v in obstacles(items, purpose)]
            for purpose in PURPOSES
        },
    }


def obstacles(items: list[Item], purpose: Purpose) -> list[tuple[Item, Verdict]]:
    """What of `items` is not known to be allowed for `purpose`."""
    judged = [(item, judge(item.licence, purpose)) for item in items]
    return [(item, verdict) for item, verdict in judged if not verdict.allowed]


def in_a_line(made: Made, registry: Registry | None = None) -> tuple[str, str]:
    """The licences of all but the code, as one expression; and the acknowledgements with what stands in the
    way of commercial use, for files that have a line for each."""
    items = [item for item in items_of(made, registry) if not item.what.startswith("code ")]
    licences = dict.fromkeys(f"{item.licence} ({item.what})" for item in items)
    stands = [f"{item.what}: {verdict.why}" for item, verdict in obstacles(items, "commercial")]
    commercial = f"Commercial use: {'; '.join(stands) or 'nothing stands in the way'}."
    told = dict.fromkeys(item.attribution for item in items if item.attribution)
    alike = {item.licence for item in items}
    licences = alike if len(alike) == 1 else licences
    return " AND ".join(licences), " ".join([*told, commercial])


# ---------------------------------------------------------------------- what there is


def _code(info: Mapping[str, Any]) -> Iterator[Item]:
    names = {"understudy": None}
    names |= {
        words.text(mapping(c).get("distribution", "")): None
        for c in sequence(info.get("components"))
    }
    for name in filter(None, names):
        yield Item(f"code {name}", _distribution_licence(name))


def _distribution_licence(name: str) -> str:
    try:
        about: Any = metadata.metadata(name)
    except metadata.PackageNotFoundError:
        return "unknown"
    for key in ("License-Expression", "License"):
        if text := (about.get(key) or "").strip():
            return named(text) if "\n" in text else text
    classified = [c for c in about.get_all("Classifier") or [] if c.startswith("License ::")]
    return classified[0].rpartition(" :: ")[2] if classified else "unknown"


def _data(made: Made, registry: Registry, depth: int) -> Iterator[Item]:
    sources = mapping(made.info.get("sources"))
    copies = _copies(made)
    clip = mapping(sources.get("motion"))
    if clip:
        yield _clip(clip, copies)
    for row in clips_of_job(made.info):
        yield _of_terms(row, "")
    yield from _model(made.info, copies, registry)
    for asked, files in copies.items():
        if asked.startswith("clip ") or (asked.startswith("motion.") and not clip):
            yield _copied_clip(re.split("[ =]", asked, maxsplit=1)[1], files)
        elif any(file.name == "run.json" for file in files) and not asked.startswith("controller "):
            # what a run learned, such as features of motions
            name = asked.rpartition(" ")[2]
            yield from _weights_of(name, _inner(name, files, registry), registry, depth)
        elif not asked.startswith(("motion.", "mjcf ", "controller ")):
            yield from _file(asked, files)
    yield from _weights(made, sources, copies, registry, depth)


def _of_terms(row: Mapping[str, str], name: str) -> Item:
    """What a record says of something behind the run `name`."""
    kind = next((kind for kind in KINDS if row.get(kind)), "")
    licence, whom = row.get("licence") or "unknown", row.get("attribution", "")
    of = "of " if kind == "weights" else ""
    what = f"{kind} {of}{row[kind]}" if kind else f"weights below {Path(name).name}"
    return Item(what, licence, whom, row.get("url", ""))


def _all_of(licences: Iterable[str]) -> str:
    """Several licences as one expression, each once."""
    return " AND ".join(dict.fromkeys(part for text in licences for part in text.split(" AND ")))


def _file(asked: str, files: list[Path]) -> Iterator[Item]:
    """A file that it read; none for a bank of states behind which is nobody's clip."""
    clips = _clips_of_bank(files) if asked.startswith("bank ") else None
    if clips == []:
        return
    clips = clips or [{"licence": beside(files)}]

    def of_all(key: str, sign: str) -> str:
        return sign.join(dict.fromkeys(clip[key] for clip in clips if clip.get(key)))

    yield Item(
        f"file {Path(asked.partition('=')[2] or asked).name}",
        _all_of(clip.get("licence") or "unknown" for clip in clips),
        of_all("attribution", " "),
        of_all("url", " ") or asked,
    )


def _copies(made: Made) -> dict[str, list[Path]]:
    """By what was asked for, the run's own copies, which lie within its folder (`open_run` saw to that)."""
    found = {}
    for asked, files in mapping(made.info.get("inputs")).items():
        names = [Path(str(name)) for name in mapping(files)]
        inside = [n for n in names if not n.is_absolute() and ".." not in n.parts]
        found[str(asked)] = [made.folder / "inputs" / n for n in inside] if made.folder else []
    return found


def _clip(clip: Mapping[str, Any], copies: Mapping[str, list[Path]]) -> Item:
    licence = words.text(clip.get("licence") or "unknown")
    whole = [beside(files) for asked, files in copies.items() if asked.startswith("motion.")]
    if whole and whole[0] != "unknown" and ("see LICENSE" in licence or licence == "unknown"):
        licence = whole[0]
    return Item(
        f"clip {words.text(clip.get('clip', ''))}",
        licence,
        words.text(clip.get("attribution") or ""),
        words.text(clip.get("url") or "") or Path(words.text(clip.get("source") or "")).name,
    )


def _copied_clip(asked: str, files: list[Path]) -> Item:
    """A clip of which nothing but its copy is recorded, with the record beside that."""
    record = record_beside(files)
    name = Path(asked).name
    return Item(
        f"clip {name}",
        words.text(record.get("licence") or beside(files)),
        words.text(record.get("attribution") or ""),
        words.text(record.get("url") or "") or name,
    )


def _model(
    info: Mapping[str, Any], copies: Mapping[str, list[Path]], registry: Registry
) -> Iterator[Item]:
    of_files = [(asked, files) for asked, files in copies.items() if asked.startswith("mjcf ")]
    for asked, files in of_files:
        licence, name = beside(files), Path(asked.removeprefix("mjcf ")).name
        yield Item(f"model {name}", licence)
        meshes = [f for f in files if f.suffix.lower() in (".stl", ".obj", ".msh", ".ply", ".dae")]
        if meshes:
            yield Item(f"meshes of {name} ({len(meshes)})", licence)
    asked = words.text(mapping(mapping(info.get("config")).get("scene")).get("character") or "")
    component = registry.components.get(("character", asked))
    if component is not None:
        yield Item(f"model {asked}", _distribution_licence(component.distribution))
    elif asked and not of_files:
        yield Item(f"model {Path(asked).name}", "unknown")


def _clips_of_bank(files: list[Path]) -> list[dict[str, str]] | None:
    """The clips behind a bank; None where it does not say, or is damaged."""
    from understudy.records.checkpoint import read_sealed  # and torch, for its tensors

    for path in files:
        if path.suffix == ".json":
            with suppress(RunError):
                return terms_of_bank(mapping(mapping(read_sealed(path)).get("meta")))
    return None


def _weights(
    made: Made,
    sources: Mapping[str, Any],
    copies: Mapping[str, list[Path]],
    registry: Registry,
    depth: int,
) -> Iterator[Item]:
    """What the weights that it began with, or uses inside, were made of."""
    if depth == 0:
        yield Item(f"weights below {Path(made.name).name}", "unknown")
        return
    config, start = mapping(made.info.get("config")), mapping(sources.get("start"))
    records = [start, *(mapping(sources.get(key)) for key in ("policy", "bank"))]
    asked = {words.text(name) for name in sequence(mapping(config.get("actuation")).get("runs"))}
    # wherever the configuration names them, as in stages of a sequence
    asked |= {key.removeprefix("controller ") for key in copies if key.startswith("controller ")}
    if made.shipped:
        yield Item(f"weights of {made.name}", _distribution_licence(made.shipped))
    else:
        asked |= {
            words.text(mapping(config.get(part)).get("run") or "") for part in ("start", "job")
        }
        asked.add(words.text(start.get("run") or ""))
    for name in sorted(asked - {""}):
        files = copies.get(f"controller {name}", [])
        inner = _inner(name, files, registry)
        record = next((r for r in records if r.get("run") == name), {})
        if inner is None and (rows := terms_of_record(record)) is not None:
            items = [asdict(_of_terms(row, name)) for row in rows]
            inner = Made(
                name, {"licence": {"items": items}, "config": {}, "sources": {}, "inputs": {}}
            )
        elif inner is None and isinstance(record.get("sources"), Mapping):
            # as was written before: the clip alone is known
            old = Made(name, {"sources": record["sources"]})
            below = Item(
                f"weights below {Path(name).name}", "unknown", source=f"understudy licence {name}"
            )
            items = [asdict(item) for item in (*_data(old, registry, depth - 1), below)]
            inner = Made(name, {"licence": {"items": items}})
        yield from _weights_of(name, inner, registry, depth)


def _weights_of(name: str, inner: Made | None, registry: Registry, depth: int) -> Iterator[Item]:
    """The weights of the run or skill `name`, and what the run `inner` says that they were made of."""
    if inner is None:
        yield Item(f"weights of {Path(name).name}", "unknown", source=f"understudy licence {name}")
        return
    known = mapping(inner.info.get("licence")).get("items")  # of a pack
    whole = items_of(inner, registry) if known else _data(inner, registry, depth - 1)
    parts = [item for item in whole if not item.what.startswith("code ")]
    if not parts and (known or {"config", "sources", "inputs"} <= inner.info.keys()):
        return  # of nobody's but its own maker's, who has this run
    licence = _all_of(item.licence for item in parts)
    whom = "" if licence else f"understudy licence {name}"
    yield Item(f"weights of {Path(name).name}", licence or "unknown", source=whom)
    yield from parts


def _inner(name: str, files: list[Path], registry: Registry) -> Made | None:
    """What the run has a copy of, or the skill that comes with a plugin."""
    from understudy.records import checkpoint

    # first its own card: a run of before may have put other files into its folder
    for file in sorted(files, key=lambda file: file.name != "run.json"):
        try:
            if file.name == "run.json":
                return Made(name, mapping(json.loads(read(file))), file.parent)
            if file.suffix == ".json":
                return Made(name, checkpoint.load(file)[1], None)
        except (OSError, ValueError, RecursionError, RunError):
            return None
    if name in registry.names("skill"):
        try:
            return _skill(name, registry)
        except RunError:
            return None
    return None

"""``understudy cite`` and ``understudy licence``: both read, and write nothing."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from understudy import __version__
from understudy.command.command import Command
from understudy.setup.plugins import installed
from understudy_credits.bibtex import entry, escaped, written
from understudy_credits.terms import PURPOSES, judge
from understudy_credits.walk import Item, Made, answer, items_of, obstacles, open_made
from understudy_report import words
from understudy_report.values import mapping, sequence

_WHAT = "a run folder, a packed skill (.json), or a skill that comes with a plugin"


class Cite(Command):
    """Prints BibTeX for the code, for the papers whose parts the run used, and for its clips."""

    example = "understudy cite runs/spacetime-walk-001 > refs.bib"

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("run", metavar="RUN", help=_WHAT)

    def run(self, options: argparse.Namespace) -> int:
        made = open_made(options.run)
        taken: set[str] = set()
        version = words.text(mapping(made.info.get("versions")).get("understudy", __version__))
        fields = {
            "author": "{The authors of understudy}",
            "title": "understudy: simulated characters learn physical skills",
            "year": words.text(made.info.get("created") or "")[:4],
            "version": version,
            "license": "Apache-2.0",
        }
        print(
            written(
                "software",
                "understudy",
                {k: escaped(v) if k != "author" else v for k, v in fields.items()},
                taken,
            )
        )
        for part in dict.fromkeys(
            (
                words.text(mapping(c).get("distribution", "")),
                words.text(mapping(c).get("version", "")),
            )
            for c in sequence(made.info.get("components"))
        ):
            if part[0] not in ("", "understudy"):
                about = {"title": escaped(part[0]), "version": escaped(part[1])}
                print(written("software", part[0], about, taken))
        for citation in _citations(made.info):
            print(entry(citation, taken))
        for item in items_of(made):
            if item.what.startswith(("clip ", "model ")) and (item.source or item.attribution):
                about = {
                    "title": escaped(item.what),
                    "howpublished": escaped(item.source),
                    "note": escaped(
                        " ".join(filter(None, (item.attribution, f"Licence: {item.licence}")))
                    ),
                }
                print(written("misc", item.what, about, taken))
        return 0


def _citations(info: object) -> list[str]:
    """Those that the run recorded; of a packed skill, those of the plugins whose parts it names."""
    recorded = mapping(info).get("citations")
    if recorded is not None:
        return [words.text(text) for text in sequence(recorded)]
    registry, used = installed().registry, set()
    text = json.dumps(mapping(info).get("config"), default=str)
    for (_, name), component in registry.components.items():
        if f'"name": {json.dumps(name)}' in text:
            used.add(component.plugin)
    return [c.summary for c in registry.citations.values() if c.plugin in used]


class Licence(Command):
    """Lists everything that a run was made of, with its licence, and what stands in the way of a use; the exit status
    is 1 if something does. A reading aid, and no legal advice."""

    example = "understudy licence runs/spacetime-walk-001 --for commercial"

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("run", metavar="RUN", help=_WHAT)
        parser.add_argument(
            "--for",
            dest="purpose",
            choices=PURPOSES,
            default="commercial",
            help="the use that is meant (%(default)s)",
        )
        parser.add_argument(
            "--json", action="store_true", help="print JSON, as exported files carry it"
        )

    def run(self, options: argparse.Namespace) -> int:
        made = open_made(options.run)
        items = items_of(made)
        in_the_way = obstacles(items, options.purpose)
        if options.json:
            print(json.dumps(answer(made), indent=1, ensure_ascii=False))
            return int(bool(in_the_way))
        width = max(len(item.what) for item in items)
        licences = max(len(item.licence) for item in items)
        for item in items:
            verdict = judge(item.licence, options.purpose)
            mark = {True: "yes", False: "no", None: "?"}[verdict.allowed]
            line = f"{mark:<4}{_plain(item.what):<{width}}  {_plain(item.licence):<{licences}}  {verdict.why}"
            print(_plain(line).rstrip())
            if item.attribution:
                print(f"    {'':<{width}}  name: {_plain(item.attribution)}")
            if verdict.allowed is None and (asked := _whom_to_ask(item, made)):
                print(f"    {'':<{width}}  ask: {_plain(asked)}")
        what = {"commercial": "commercial use", "sharing": "passing it on", "research": "research"}
        if in_the_way:
            named = ", ".join(_plain(item.what) for item, _ in in_the_way)
            print(f"In the way of {what[options.purpose]}: {named}.")
            if any(verdict.allowed is None for _, verdict in in_the_way):
                print(_TO_DO[made.folder is not None])
        else:
            print(f"Nothing stands in the way of {what[options.purpose]}, as far as was recorded.")
        return int(bool(in_the_way))


#: What to do about the unknown, of a pack and of a run.
_TO_DO = (
    'What is marked "?" is unknown: ask whoever made this file.',
    'What is marked "?" is unknown: ask those it comes from. Where a clip or a model has its terms beside it, in a file LICENSE, '
    "what is trained after that knows them.",
)


def _whom_to_ask(item: Item, made: Made) -> str:
    """The command that says more of what a run does not know; nothing where none does."""
    if made.folder is None:  # whose makers' runs are elsewhere
        return ""
    kind, _, path = item.source.partition(" ")
    if kind == "bank":
        folder = Path(path).parent if Path(path).name.startswith("bank") else Path(path)
        return f"understudy licence {folder}"
    return item.source if kind == "understudy" else ""


def _plain(text: str) -> str:
    return "".join(c for c in text if c.isprintable())

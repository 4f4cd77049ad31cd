"""What is needed to repeat a run, and whom to credit."""

from __future__ import annotations

from collections.abc import Iterable

from markupsafe import Markup

from understudy.records.runs import Run
from understudy_report import words
from understudy_report.markup import nested, piece, table
from understudy_report.section import ReportSection
from understudy_report.values import Row, mapping, sequence


class Provenance(ReportSection):
    """Command, machine, versions, sources with their licences, components, citations."""

    title = "Provenance"
    order = 80

    def html(self, run: Run) -> str | None:
        info = run.info
        facts = {
            "Created": info.get("created"),
            "Command": " ".join(map(words.text, sequence(info.get("command")))),
            "Overrides": " ".join(map(words.text, sequence(info.get("overrides")))),
            "Seed": mapping(info.get("config")).get("seed"),
            **{str(k).capitalize(): v for k, v in mapping(info.get("machine")).items()},
        }
        cited = [words.text(c) for c in sequence(info.get("citations"))]
        parts = {
            "Run": table((k, nested(v)) for k, v in facts.items() if v not in (None, "")),
            "Versions": nested(mapping(info.get("versions"))),
            "Sources": Markup().join(
                piece("named", words.text(k), Markup(nested(v)))
                for k, v in mapping(info.get("sources")).items()
            ),
            "Components": _components(map(mapping, sequence(info.get("components")))),
            "Please cite": piece("items", cited) if cited else "",
        }
        cards = [
            piece("card", title, Markup(content)) for title, content in parts.items() if content
        ]
        return str(piece("masonry", cards)) if cards else None


def _components(components: Iterable[Row]) -> str:
    """Each part of the experiment with the plugin it is from."""
    return table(
        (
            f"{words.text(c.get('kind', ''))}/{words.text(c.get('name', ''))}",
            piece(
                "plugin", *(words.text(c.get(k, "")) for k in ("plugin", "distribution", "version"))
            ),
        )
        for c in components
    )

"""The configuration of a run, every default filled in."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

import yaml
from markupsafe import Markup

from understudy.records.runs import Run
from understudy_report import words
from understudy_report.markup import grid, piece
from understudy_report.section import ReportSection
from understudy_report.values import mapping


class Configuration(ReportSection):
    """All values with what set them, folded away; as YAML where the run has not recorded that."""

    title = "Configuration"
    order = 90

    def html(self, run: Run) -> str | None:
        config = mapping(run.info.get("config"))
        if not config:
            return None
        # Through JSON, so that YAML has neither anchors for shared parts nor tags for odd types.
        plain = json.loads(json.dumps(config, default=str))
        origins = mapping(run.info.get("origins"))
        if origins:
            return _values(plain, origins)
        text = yaml.safe_dump(plain, sort_keys=False, allow_unicode=True, width=88)
        return str(piece("folded", "The composed configuration", piece("verbatim", text)))


#: How the origin of what nobody set begins.
_DEFAULT = "default of "


def _values(config: Mapping[str, Any], origins: Mapping[str, Any]) -> str:
    """Two tables of key, value and origin: what somebody set, and the defaults."""
    rows = [
        (key, json.dumps(value, ensure_ascii=False), words.text(origins.get(key, "")))
        for key, value in _flat(config, "")
    ]
    tables = {
        "What files and the command line set": [r for r in rows if not r[2].startswith(_DEFAULT)],
        "Defaults": [r for r in rows if r[2].startswith(_DEFAULT)],
    }
    heads = ("Key", "Value", "Set by")
    return "".join(
        piece("folded", f"{title} ({len(found)} values)", Markup(grid(heads, found)))
        for title, found in tables.items()
        if found
    )


def _flat(value: Any, prefix: str) -> Iterator[tuple[str, Any]]:
    if isinstance(value, Mapping) and (value or not prefix):
        for key, item in value.items():
            yield from _flat(item, f"{prefix}.{key}" if prefix else str(key))
    else:
        yield prefix, value

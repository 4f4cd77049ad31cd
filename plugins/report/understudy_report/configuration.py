"""The composed configuration of a run."""

from __future__ import annotations

import json
from html import escape

import yaml

from understudy.records.runs import Run
from understudy_report.section import ReportSection
from understudy_report.values import mapping


class Configuration(ReportSection):
    """All options, as YAML, folded away."""

    title = "Configuration"
    order = 90

    def html(self, run: Run) -> str | None:
        config = mapping(run.info.get("config"))
        if not config:
            return None
        # Through JSON, so that YAML has neither anchors for shared parts nor tags for odd types.
        plain = json.loads(json.dumps(config, default=str))
        text = yaml.safe_dump(plain, sort_keys=False, allow_unicode=True, width=88)
        return (
            '<details class="card"><summary>The composed configuration</summary>'
            f"<pre>{escape(text)}</pre></details>"
        )

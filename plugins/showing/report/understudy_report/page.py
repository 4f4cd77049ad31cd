"""The report of a run: one HTML file, self-contained and readable offline.

Names, configurations and metrics may come from strangers, so templates escape all text that enters
the page, and the page's security policy lets no script run but the stick figure player.
"""

from __future__ import annotations

import base64
import hashlib
from dataclasses import dataclass
from pathlib import Path

from markupsafe import Markup

from understudy.folders import write_atomically
from understudy.records.runs import Run
from understudy.setup.registry import Component, Registry
from understudy_report import words
from understudy_report.markup import check_markup, piece
from understudy_report.markup import page as whole_page
from understudy_report.section import ReportSection
from understudy_report.stick_figures import PLAYER_SCRIPT
from understudy_report.values import mapping, sequence

__all__ = ["bare_page", "html_page", "name_of"]

_HERE = Path(__file__).parent
_STYLE = (_HERE / "page.css").read_text(encoding="utf-8")


def write_report(run: Run, registry: Registry | None = None) -> Path:
    """Write ``report.html`` into the folder of `run` from what is there; returns its path.

    Parameters
    ----------
    run
        The run; its evaluation, metrics, stick figures and video may be missing.
    registry
        Where the sections are found; by default where the parts of the run are.

    Raises
    ------
    RunError
        if the file cannot be written; the old one is untouched.
    """
    page = html_page(
        name_of(run),
        "understudy report",
        words.text(run.info.get("created", ""))[:16].replace("T", " "),
        _sections(run, registry or run.registry),
    )
    path = run.path / "report.html"
    write_atomically(path, page)
    return path


def name_of(run: Run) -> str:
    """The experiment of `run`, else its task, else its folder's name."""
    given = map(words.text, sequence(run.info.get("overrides")))
    named = [o.partition("=")[2] for o in given if o.lstrip("+").startswith("experiment=")]
    task = mapping(run.info.get("config")).get("task")
    return words.text((named or [task])[-1] or run.path.name)


def html_page(title: str, over: str, created: str, content: str, style: str = "") -> bytes:
    """A page of `content`, which is HTML, in the style of all pages and what `style` adds to it.

    Raises
    ------
    ValueError
        see `check_markup`, which `content` passes.
    """
    return bare_page(title, over, created, content, _STYLE + style)


def bare_page(title: str, over: str, created: str, content: str, style: str) -> bytes:
    """A page of `content`, which is HTML, in this `style` alone; refused like `html_page`'s."""
    check_markup(content)
    page = whole_page(
        policy=Markup(_security_policy()),
        style=Markup(style),
        title=title,
        over=over,
        created=created,
        content=Markup(content),
    )
    # JSON can smuggle in lone surrogates, which UTF-8 has no bytes for.
    return page.encode(errors="replace")


@dataclass(frozen=True)
class _Part:
    """What a section gave."""

    order: float
    title: str
    content: Markup


def _sections(run: Run, registry: Registry) -> str:
    names = registry.names("report_section")
    parts = [_part(registry.find("report_section", name), run) for name in names]
    shown = sorted((p for p in parts if p is not None), key=lambda p: p.order)
    return Markup().join(piece("section", part.title, part.content) for part in shown)


def _part(component: Component, run: Run) -> _Part | None:
    """What a section shows, or a sentence that names the one that cannot show itself."""
    order, title = ReportSection.order, component.name
    try:
        section: ReportSection = component.factory()
        order, title = float(section.order), str(section.title)
        content = section.html(run)
        if content is None:
            return None
        check_markup(content)
        return _Part(order, title, Markup(content))
    except Exception as error:  # it comes from any plugin, and the others are worth reading
        why = f"{type(error).__name__}: {error}"
        text = f"The section '{component.name}' of plugin '{component.plugin}' is left out: {why[:500]}"
        return _Part(order, title, piece("failed", text))


def _security_policy() -> str:
    digest = base64.b64encode(hashlib.sha256(PLAYER_SCRIPT.encode()).digest()).decode()
    return (
        "default-src 'none'; style-src 'unsafe-inline'; img-src data:; media-src data:; "
        f"script-src 'sha256-{digest}'; base-uri 'none'; form-action 'none'"
    )

"""Pieces of HTML for report sections, and the rules for a section's HTML.

Run folders may come from strangers, so templates escape by default, and only what they produced
(:class:`~markupsafe.Markup`) is left unescaped.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape

from understudy_report import words
from understudy_report.stick_figures import PLAYER_SCRIPT

__all__ = ["bar", "check_markup", "grid", "nested", "piece", "table"]


_TEMPLATES = Environment(
    loader=FileSystemLoader(Path(__file__).parent / "templates"), autoescape=True,
    undefined=StrictUndefined,
)  # fmt: skip
_PIECES = _TEMPLATES.get_template("pieces.html").module


def piece(name: str, *content: Any) -> Markup:
    """A piece of ``templates/pieces.html``. Of `content`, whatever is not a piece itself is escaped."""
    return Markup(getattr(_PIECES, name)(*content))


def page(**content: Any) -> str:
    """The whole page, escaped as pieces are."""
    return _TEMPLATES.get_template("page.html").render(**content)


def table(rows: Iterable[tuple[Any, str]]) -> str:
    """A table of names, which are escaped, and of values that are HTML already. HTML."""
    found = [(words.text(name), Markup(value)) for name, value in rows]
    return str(piece("table", found)) if found else ""


def grid(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table with a head, all of plain text; the first of each row is its name. HTML."""
    found = [tuple(row) for row in rows]
    return str(piece("grid", heads, found)) if found else ""


def nested(value: Any) -> str:
    """A value as escaped HTML; mappings as inner tables."""
    if isinstance(value, Mapping):
        return table((k, nested(v)) for k, v in value.items())
    return str(escape(words.text(value)))


def bar(share: float) -> str:
    """A share as a bar beside its percentage. HTML."""
    width = 100 * min(max(share, 0.0), 1.0)
    return str(piece("bar", f"{width:.1f}", words.share(share)))


# What a browser ends by itself; every other element must be closed.
_VOID = {"area", "br", "col", "hr", "img", "input", "source", "wbr"}
# What belongs to the page and not to a part of it, or embeds other pages.
_REFUSED = {"html", "head", "body", "main", "base", "meta", "link", "style", "title", "form",
            "iframe", "frame", "object", "embed", "portal", "template", "plaintext"}  # fmt: skip
# Attributes whose address the browser loads; those of links are the reader's choice.
_LOADED = {"src", "srcset", "poster", "data", "background", "action", "formaction", "xlink:href"}
_LINKS = ("http:", "https:", "mailto:")


def check_markup(html: str) -> None:
    """Whether `html` can be a part of the page without breaking it or needing anything else.

    Raises
    ------
    ValueError
        if elements do not nest, or it would load something, run a script, or change the page.
    """
    _Checker().check(html)


class _Checker(HTMLParser):
    """Raises ValueError at the first thing that is wrong."""

    def __init__(self) -> None:
        super().__init__()
        self._open: list[str] = []
        self._script: str | None = None  # the text so far of the script that is open

    def check(self, html: str) -> None:
        self.feed(html)
        self.close()
        if self._open:
            raise ValueError(f"its <{self._open[-1]}> is not closed")

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_startendtag(tag, attrs)
        if tag not in _VOID:
            self._open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag in _REFUSED and not (tag in ("title", "style") and "svg" in self._open):
            raise ValueError(f"<{tag}> has no place in a section")
        for name, value in attrs:
            address = (value or "").strip()
            if name.startswith("on"):
                raise ValueError(f"the script in {name}=… would not run")
            if name in _LOADED or (name == "href" and tag != "a"):
                if not address.startswith(("data:", "#")):
                    raise ValueError(
                        f"{name}={address[:80]} would be loaded, and is no data: address"
                    )
            elif (
                name == "href"
                and ":" in address.partition("/")[0]
                and not address.startswith(_LINKS)
            ):
                raise ValueError(f"{address[:80]} is no link")
        if tag == "script" and dict(attrs).get("type") != "application/json":
            self._script = ""

    def handle_data(self, data: str) -> None:
        if self._script is not None:
            self._script += data

    def handle_endtag(self, tag: str) -> None:
        if self._open[-1:] != [tag]:
            inside = f"in <{self._open[-1]}>" if self._open else "where none is open"
            raise ValueError(f"</{tag}> stands {inside}")
        self._open.pop()
        if self._script not in (None, PLAYER_SCRIPT):
            raise ValueError("its script would not run")
        self._script = None

    def handle_comment(self, data: str) -> None:
        if data.startswith(("[if", "<![")):
            raise ValueError("it has a conditional comment")

    def handle_decl(self, decl: str) -> None:
        raise ValueError("a declaration has no place in a section")

    def unknown_decl(self, data: str) -> None:
        raise ValueError("a declaration has no place in a section")

    def handle_pi(self, data: str) -> None:
        raise ValueError("a processing instruction has no place in a section")

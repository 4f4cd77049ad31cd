"""Citations as BibTeX, from the one line in which plugins write them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

_SPECIAL = {"\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", **{c: f"\\{c}" for c in "&%$#_"}}
_SPECIAL |= {"~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}


def entry(citation: str, taken: set[str]) -> str:
    """``AUTHORS YEAR. TITLE. VENUE.`` or ``AUTHORS. TITLE. VENUE, YEAR.`` as an entry whose key is not among
    those `taken`, and is added; what has another form is kept whole, as a note."""
    text = " ".join(citation.split())
    year = re.search(r"\b(19|20)\d\d\b", re.sub(r"arXiv:\S+", "", text))
    dated = re.match(r"((?:(?!\. ).|(?<=et al)\.)+?),? (?:19|20)\d\d\. (.*)", text)
    authors, after = (dated[1], dated[2]) if dated else text.partition(". ")[::2]
    found: dict[str, str] = {}
    title, venue = after.partition(". ")[::2]
    if title:
        found = {"author": _authors(authors), "title": f"{{{escaped(title.rstrip('.'))}}}"}
        preprint = re.search(r"arXiv:(\S+?)[.,;]?(\s|$)", f"{title}. {venue}")
        if preprint:
            found |= {"eprint": escaped(preprint[1]), "archiveprefix": "arXiv"}
        venue = re.sub(r"\s*arXiv:\S+", "", venue)
        place = re.sub(r",?\s*\b(19|20)\d\d\b\.?$", "", venue).strip(" .")
        if place:
            found["journal"] = escaped(place)
    if year:
        found["year"] = year[0]
    found["note"] = escaped(text)
    first = re.search(r"\w+", title or "")
    name = re.search(r"[^\W\d_]+", authors)
    key = (name[0] if name else "anon") + found.get("year", "") + (first[0] if first else "")
    return written("article" if "journal" in found else "misc", key, found, taken)


def written(kind: str, key: str, fields: Mapping[str, str], taken: set[str]) -> str:
    """An entry; values are BibTeX already."""
    plain = re.sub(r"[^a-z0-9]+", "", key.lower().encode("ascii", "ignore").decode()) or "entry"
    free = next(
        k for n in range(1, 10_000) if (k := plain if n == 1 else f"{plain}{n}") not in taken
    )
    taken.add(free)
    lines = "".join(f"  {name} = {{{value}}},\n" for name, value in fields.items() if value)
    return f"@{kind}{{{free},\n{lines}}}"


def escaped(text: str) -> str:
    """`text` with BibTeX's own signs escaped: it may be a stranger's."""
    return "".join(_SPECIAL.get(c, c) for c in text if c.isprintable())


def _authors(text: str) -> str:
    """``A, B et al.`` as BibTeX separates authors."""
    text, others = re.subn(r"\s+et al\b\.?", "", text)
    names: Iterable[str] = filter(None, (n.strip() for n in re.split(r",|\band\b|&", text)))
    return " and ".join([*map(escaped, names), *(["others"] if others else [])])

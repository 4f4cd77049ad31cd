"""What comes with plugins says on what terms it does, and whom to cite."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from understudy.command.cli import main
from understudy.setup.plugins import installed
from understudy_credits.bibtex import entry
from understudy_credits.walk import items_of, open_made


def test_nothing_in_the_way(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["licence", "spacetime/walk"]) == 0
    assert "Nothing stands in the way of commercial use" in capsys.readouterr().out


@pytest.mark.parametrize("name", sorted(installed().registry.names("skill")))
def test_every_skill_that_ships_says_on_what_terms(name: str) -> None:
    found = {item.what: item.licence for item in items_of(open_made(name))}
    assert found[f"weights of {name}"] == "Apache-2.0"
    assert {what for what, licence in found.items() if licence == "unknown"} == set()


def test_every_citation_of_the_plugins_becomes_an_entry() -> None:
    """Authors, title and year of each; keys are unique, and braces balance."""
    taken: set[str] = set()
    citations = [c.summary for c in installed().registry.citations.values()]
    for text in citations:
        found = entry(text, taken)
        for field in ("author", "title", "year"):
            assert re.search(rf"^  {field} = {{..+}},$", found, re.MULTILINE), found
        title = re.search(r"title = {{(.*)}}", found)
        assert title is not None, found
        assert len(title[1]) > 15, found
        assert found.count("{") == found.count("}")
    assert len(taken) == len(citations) > 10

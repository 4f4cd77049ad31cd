"""Figures on the pages are those of their records, and verdicts what these bear."""

from __future__ import annotations

import hashlib
import json
import re
import sys
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))

import figures
import held
import mistakes
import shipped

from understudy_skills.skill import open_skill

SPEC = figures.load()


@pytest.mark.parametrize("page", figures.PAGES, ids=lambda page: page.name)
def test_a_page_has_what_its_records_have(page: Path) -> None:
    assert figures.written(page, SPEC) == page.read_text(encoding="utf-8"), "run `make figures`"
    assert figures.untraced(page) == [], "a table of results that names no record"


def test_a_figure_that_was_changed_by_hand_is_seen() -> None:
    page = figures.RECORDS.parent / "papers" / "spacetime-bounds.md"
    text = page.read_text(encoding="utf-8")
    assert "0.65 M (0.26 to 1.04)" in text
    changed = text.replace("0.65 M (0.26 to 1.04)", "0.45 M (0.26 to 1.04)")
    assert figures.written(page, SPEC, changed) == text


@pytest.mark.parametrize(
    "line", ["", "<!-- record: nowhere.jsonl -->\n\n", "<!-- no record: -->\n\n"]
)
def test_a_result_without_a_record_is_seen(line: str) -> None:
    table = "| seed | samples |\n|---|---|\n| 0 | 1.2 M |\n"
    page = figures.RECORDS / "README.md"
    assert len(figures.untraced(page, f"Words.\n\n{line}{table}")) == 1
    assert not figures.untraced(
        page, f"<!-- record: diversity.jsonl; beside: 0, 1.2 -->\n\n{table}"
    )
    assert not figures.untraced(page, "| option | default |\n|---|---|\n| `x` | 2 % |\n")


def test_a_difference_of_shares_may_be_below_none() -> None:
    found = figures.Measured({0: 0.0, 1: -0.02, 2: -0.04})
    assert figures.words(found, "points") == "-2.0 points (-7.0 to +3.0)"


@pytest.mark.parametrize(
    "cell",
    [
        "0.20 m",
        "1.5 cm",
        "2.4 rad",
        "19 s",
        "12 ms",
        "131°",
        "116.9 k",
        "0.3 m/s, of 4",
        "3 m (2)",
        "-1.57",
    ],
)
def test_a_result_is_known_by_its_unit(cell: str) -> None:
    page, table = figures.PAGES[0], f"| | a |\n|---|---|\n| b | {cell} |\n"
    assert len(figures.untraced(page, table)) == 1
    assert not figures.untraced(page, table.replace("| | a |", "| paper | here |"))


@pytest.mark.parametrize("page", figures.PAGES, ids=lambda page: page.stem)
def test_no_page_says_a_sentence_twice_running(page: Path) -> None:
    said = re.findall(r"(?<=[.:] )([^.:\n|]{8,}[.:]) \1", page.read_text(encoding="utf-8"))
    assert not said


def test_the_page_of_mistakes_has_the_answers_of_today() -> None:
    record = json.loads(mistakes.RECORD.read_text(encoding="utf-8"))
    assert mistakes.page(record) == mistakes.PAGE.read_text(encoding="utf-8")
    for typed, right in mistakes.mistakes().items():
        found = record["after"][typed]
        assert found["status"] == 2, typed
        assert right in found["answer"], f"{typed}: run `python benchmarks/mistakes.py`"


def test_a_number_that_its_record_has_not_is_seen() -> None:
    """One Hopper return is 3436; 3437 is nowhere in the record, unless it is said to be beside it."""
    page = figures.RECORDS / "README.md"
    table = "| seed | return |\n|---|---|\n| 0 | 3436, 3437 ± 1 |\n"
    assert figures.untraced(page, f"<!-- record: ppo_vs_sb3.jsonl -->\n\n{table}") == [
        "| seed | return |: 3437"
    ]
    assert not figures.untraced(page, f"<!-- record: ppo_vs_sb3.jsonl; beside: 3437 -->\n\n{table}")


def test_what_figures_are_made_of_is_used() -> None:
    """Each table and value of docs/figures.yaml stands on a page, and each record there is one of a figure."""
    pages = "".join(page.read_text(encoding="utf-8") for page in figures.PAGES)
    made = [*SPEC["tables"].values(), *SPEC["values"].values(), *SPEC["claims"].values()]
    text = str(made)
    named = [*SPEC["tables"], *SPEC["values"]]
    assert [name for name in named if f"<!-- figures: {name} -->" not in pages] == []
    assert [name for name in SPEC["records"] if f"'{name}'" not in text] == []


def test_dates_are_the_records_own() -> None:
    """A date beside rows that have their own is refused, and so is a record of which nobody says when."""
    what = [{"record": "shipped.jsonl", "where": {"skill": "spacetime/walk"}}]
    told = {"records": {"shipped.jsonl": {"hardware": "a core"}}}
    assert "a core, 2026-11-" in figures.origin(told, what, [])
    told["records"]["shipped.jsonl"]["date"] = "2026-11-01"
    with pytest.raises(ValueError, match="take its date out"):
        figures.origin(told, what, [])
    with pytest.raises(ValueError, match="must give its hardware"):
        figures.origin({"records": {}}, what, [])
    assert figures.days({"2026-11-27", "2026-11-24", "2026-11-26"}) == "2026-11-24, 26 and 27"


def test_what_stays_within_bounds_is_counted_by_the_same_bounds() -> None:
    """Imitation at 0.6 with less volume, 128 episodes: one of seed 0 stays within the bounds for styles and 18 of
    seed 2, by records of which one has its measures as a line's own. Seed 1 was looked at by tighter bounds only."""
    asked = [c for c in SPEC["claims"]["spacetime-bounds"] if "less volume lasts" in c["claim"]]
    (found,) = asked
    theirs = figures.measure({**found, **found["more"]})
    assert theirs.values == pytest.approx({0: 1 / 128, 2: 18 / 128})
    assert sorted(figures.measure(found).values) == [0, 1, 2]
    for name in figures.records(found["more"]):
        text = (figures.RECORDS / name).read_text(encoding="utf-8")
        assert "spacetime/reported" not in text
        assert "styles/" in text


def claim(
    monkeypatch: pytest.MonkeyPatch, ours: list[Any], theirs: list[Any] | float, **more: Any
) -> str:
    """The verdict of a claim that `ours` is less; None is a seed that had not met its criterion by 5."""

    def rows(_: str) -> tuple[dict[str, Any], ...]:
        both = {"ours": ours, "theirs": theirs if isinstance(theirs, list) else []}
        return tuple(
            {"variant": name, "seed": s, "cost": 5.0 if v is None else v, "met": v is not None}
            for name, values in both.items()
            for s, v in enumerate(values)
        )

    monkeypatch.setattr(figures, "rows", rows)
    other = {"where": {"variant": "theirs"}} if isinstance(theirs, list) else theirs
    what = {"record": "x", "where": {"variant": "ours"}, "value": "cost", "only": {"met": True}}
    return figures.verdict({**what, **({"less": other} | more)})


@pytest.mark.parametrize(
    ("ours", "theirs", "expected"),
    [
        ([1.0, 1.1, 1.2], 4.0, figures.HOLDS),
        ([5.0, 5.1, 5.2], 4.0, figures.FAILS),
        ([1.0, 4.0, 6.0], 4.0, figures.UNDECIDED),
        ([1.0], 4.0, figures.ONE),
        ([1.0, 1.1, None], 4.0, figures.UNDECIDED),  # how many the third needs, nobody knows
        ([None, None, 5.5], 4.0, figures.FAILS),  # more than 4 in any case
        ([1.0, 1.1, 1.2], [2.0, 2.1, 2.3], figures.HOLDS),
        ([1.0, 1.1, 1.2], [None, None, None], figures.HOLDS),  # at least 5
        ([None, None, None], [1.0, 1.1, 1.2], figures.FAILS),  # at least 5
        ([None, 0.5, 0.6], [1.0, 1.1, 1.2], figures.UNDECIDED),
        ([1.0, 3.0, 2.0], [2.0, 2.1, 2.3], figures.UNDECIDED),
        ([1.0, 1.1], [2.0], figures.ONE),
    ],
)
def test_verdicts(
    monkeypatch: pytest.MonkeyPatch, ours: list[Any], theirs: Any, expected: str
) -> None:
    assert claim(monkeypatch, ours, theirs) == expected


def test_a_saved_interval_decides_as_its_seeds_would() -> None:
    """The second landscape's interval is far from 0, the last one's holds it."""
    synthetic = [c for c in SPEC["claims"]["diversity"] if c["record"] == "diversity.jsonl"]
    decided = {c["where"]["landscape"]: figures.verdict(c) for c in synthetic}
    assert decided["steps, 3 dimensions, 17 trials"] == figures.HOLDS
    assert decided["patches, 4 dimensions, 10 trials"] == figures.UNDECIDED


def test_what_ships_was_measured_as_it_is() -> None:
    """Every packaged skill of a character has its line, of the training that is packed, and a place in the gallery."""
    measured = {row["skill"]: row for row in figures.rows("shipped.jsonl")}
    packed = {name: open_skill(name).samples for name in shipped.characters()}
    assert {name: row["samples"] for name, row in measured.items()} == packed
    for one in ("shipped", "gallery"):
        assert set(SPEC["tables"][one]["rows"]) == {f"`{name}`" for name in packed}


def test_what_moves_materials_was_recorded_as_it_ships() -> None:
    recorded = {row["skill"]: row for row in figures.rows("materials.jsonl")}
    assert recorded.keys() == set(shipped.materials())
    for name, row in recorded.items():
        found = open_skill(name).card["evaluation"]
        assert (row["samples"], row["success"]) == (open_skill(name).samples, found["success_rate"])
    assert set(SPEC["tables"]["amorphous/shipped"]["rows"]) == {f"`{name}`" for name in recorded}


def test_films_are_of_what_ships() -> None:
    """A film of a packaged skill is of the files that are packed now, or the gallery says what it was filmed with."""
    page = (figures.ROOT / "docs" / "gallery" / "index.md").read_text(encoding="utf-8")
    captions = re.findall(r'<video src="../media/(\w+[.]mp4)".*?</figure>', page, re.S)
    blocks = dict(zip(captions, page.split("<figure>")[1:], strict=True))
    shown = {
        f: m[1] for f, b in blocks.items() if (m := re.search(r"understudy play (\w+/\w+)", b))
    }
    films = json.loads((figures.ROOT / "docs" / "media" / "films.json").read_text(encoding="utf-8"))
    assert {name: film["skill"] for name, film in films.items()} == shown
    for name, film in films.items():
        paper, _, skill = film["skill"].partition("/")
        packed = sorted(figures.ROOT.glob(f"plugins/*/*/understudy_{paper}/skills/{skill}.*"))
        digest = hashlib.sha256(b"".join(file.read_bytes() for file in packed)).hexdigest()[:16]
        if film["sha256"] != digest:
            assert film.get("older", "film it again") in page, f"{name}: {digest}"


def test_what_hands_do_was_measured_as_it_ships() -> None:
    """Every packaged skill of a hand, of the training that is packed; what is beyond is said."""
    found = figures.rows("held.jsonl")
    packed = {name: open_skill(name).samples for name in held.hands()}
    assert {row["skill"]: row["samples"] for row in found} == packed
    assert set(SPEC["tables"]["held"]["rows"]) == {f"`{name}`" for name in packed}
    for row in found:
        beyond = [k for k, most in held.THRESHOLDS.items() if row["played"][k] > most]
        assert row["beyond"] == (", ".join(beyond) or "–"), row["skill"]


def test_thresholds_for_shipping_are_those_of_the_page() -> None:
    page = (figures.ROOT / "docs" / "conventions.md").read_text(encoding="utf-8")
    more, most = zip(*shipped.THRESHOLDS.values(), strict=True)
    for words in (f"| {more[0]:.1f} m/s | {most[0]:.1f} m/s |", f"| {100 * more[1]:g} cm | {100 * most[1]:g} cm |",
                  f"| {more[2]:g} s, two frames | {most[2]:g} s |", f"| {most[3]:g} m/s³ |"):  # fmt: skip
        assert words in page
    for row in figures.rows("shipped.jsonl"):
        beyond = ", ".join(shipped.believable(row["played"], row["clip"])) or "–"
        assert row["beyond"] == beyond, row["skill"]

"""The list of tables: what is on record, how much of a table that is, and what it bears."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Literal

import pytest
from scipy import stats

from understudy.command.cli import main
from understudy.errors import FileError
from understudy.setup.plugins import installed
from understudy_reproduce.card import Card
from understudy_reproduce.command import listed
from understudy_reproduce.tables import Figure, PaperTable, Printed, Record, load_table, table_files
from understudy_sweeps.intervals import from_below, verdict_between

TABLE = PaperTable(
    "A title",
    "a paper",
    {"walk": (), "run": ()},
    {"full": (), "without": ()},
    (Figure("samples", better="less"),),
    {"walk": {"full": 4e6, "without": {"says": "slower", "more": "full"}}},
    records={"whole.jsonl": Record(), "small.jsonl": Record(less="a tenth of the samples")},
)


def journal(
    folder: Path, name: str, cells: dict[str, tuple[float, ...]], outcome: str = "criterion"
) -> None:
    """The final reports of trainings that took so many samples, seed by seed."""
    lines = [
        {
            "event": "finished",
            "report": {
                "key": f"{cell}/seed{seed}",
                "status": "ok",
                "cost": cost,
                "outcome": outcome,
            },
        }
        for cell, costs in cells.items()
        for seed, cost in enumerate(costs)
    ]
    with (folder / name).open("a") as file:
        file.writelines(json.dumps(line) + "\n" for line in lines)


def card(folder: Path, table: PaperTable = TABLE) -> Card:
    return Card("mine/one", table, folder / "here", folder)


def test_a_table_of_no_record_is_not_begun_and_has_no_verdict(tmp_path: Path) -> None:
    found = card(tmp_path)
    assert found.state().startswith("not begun: 0 of 12 trainings")
    assert [said for *_, said in found.verdicts()] == ["", ""]


def test_states_by_what_is_on_record(tmp_path: Path) -> None:
    journal(tmp_path, "small.jsonl", {"walk/full": (1e5, 2e5, 1e5), "other/full": (1.0,)})
    assert card(tmp_path).state() == "in small: 3 of 12 trainings, 3 of them on record, 3 in small"
    journal(tmp_path, "whole.jsonl", {"walk/full": (1e6, 1.1e6)})
    partly = card(tmp_path)
    assert partly.state() == "partly: 2 of 12 trainings, 2 of them on record", (
        "never mixed in a cell"
    )
    assert "a tenth" not in next(partly.compared())
    cells = {
        f"{row}/{column}": (1e6, 1.1e6, 1.2e6) for row in TABLE.rows for column in TABLE.columns
    }
    journal(tmp_path, "whole.jsonl", cells)
    assert card(tmp_path).state() == "done: 12 of 12 trainings, 12 of them on record"


def test_trainings_that_ended_before_the_tables_samples_are_told_of(tmp_path: Path) -> None:
    """By minutes, say. What met its criterion needed no more, and nine tenths of them are enough."""
    table = replace(
        TABLE,
        figures=(Figure("success_rate"),),
        rows={"walk": ("budget.samples=10000000",), "run": ()},
    )
    ends = [
        ("walk/full/seed0", 4e5, "budget"),
        ("walk/full/seed1", 1e6, "budget"),
        ("walk/full/seed2", 1e6, "criterion"),
        ("walk/without/seed0", 9.1e6, "budget"),
        ("run/full/seed0", 4e5, "budget"),
    ]
    reports = [
        {
            "key": key,
            "status": "ok",
            "cost": cost,
            "outcome": outcome,
            "measures": {"success_rate": 1},
        }
        for key, cost, outcome in ends
    ]
    text = "".join(json.dumps({"event": "finished", "report": one}) + "\n" for one in reports)
    (tmp_path / "whole.jsonl").write_text(text)
    found = card(tmp_path, table)
    early, enough, unsaid = found.compared()
    assert "(3); 2 with 400k to 1M of 10M samples" in early
    assert "samples" not in enough + unsaid
    assert found.state() == "partly: 5 of 12 trainings, 5 of them on record, 2 in small"
    (tmp_path / "small.jsonl").write_text(text)
    (tmp_path / "whole.jsonl").unlink()
    assert "; 2 with" not in next(card(tmp_path, table).compared()), "said already, in words"


@pytest.mark.parametrize(
    ("word", "expected"),
    [("budget.samples=1e6", 1e6), ("++budget.samples=2_000", 2000.0), ("budget.samples=null", None),
     ("budget.samples=${more}", None), ("budget.minutes=5", None)],
)  # fmt: skip
def test_the_samples_that_a_cells_words_give(word: str, expected: float | None) -> None:
    table = replace(TABLE, overrides=("budget.samples=7",), rows={"walk": (word,), "run": ()})
    told = 7.0 if word.startswith("budget.minutes") else expected
    assert table.samples("walk", "full") == told
    assert table.samples("run", "full") == 7.0


@pytest.mark.parametrize(
    ("full", "without", "expected"),
    [
        ((1e6, 1.1e6, 1.2e6), (2e6, 2.2e6, 2.1e6), ["holds", "holds"]),
        ((5e6, 5.1e6, 5.2e6), (2e6, 2.2e6, 2.1e6), ["does not hold", "does not hold"]),
        ((1e6, 3e6, 9e6), (2e6, 2.2e6, 2.1e6), ["undecided", "undecided"]),
        ((1e6,), (2e6,), ["one seed", "one seed"]),
        ((1e6, 1.1e6, 1.2e6), (), ["holds", ""]),
    ],
)
def test_verdicts_on_a_number_and_on_the_cell_beside(
    tmp_path: Path, full: tuple[float, ...], without: tuple[float, ...], expected: list[str]
) -> None:
    journal(tmp_path, "whole.jsonl", {"walk/full": full, "walk/without": without})
    assert [said for *_, said in card(tmp_path).verdicts()] == expected


@pytest.mark.parametrize("shift", [0.0, 1.2, 1.6, 4.0])
def test_samples_of_other_seeds_are_told_apart_by_welchs_t(shift: float) -> None:
    first, second = [1.0, 1.4, 2.1, 1.2], [2.0 + shift, 3.9 + shift, 1.1 + shift]
    p = stats.ttest_ind(first, second, equal_var=False).pvalue  # type: ignore[attr-defined]
    found = verdict_between(dict(enumerate(first)), dict(enumerate(second, 10)), "less")
    assert found == ("holds" if p < 0.05 else "undecided")


def test_what_missed_its_criterion_is_known_from_below(tmp_path: Path) -> None:
    journal(tmp_path, "whole.jsonl", {"walk/full": (1e6, 1.1e6, 1.2e6)})
    journal(tmp_path, "whole.jsonl", {"walk/without": (5e6, 5e6, 5e6)}, outcome="budget")
    assert [said for *_, said in card(tmp_path).verdicts()] == ["holds", "holds"]
    turned = replace(TABLE, paper={"walk": {"without": {"says": "quicker", "less": "full"}}})
    assert [said for *_, said in card(tmp_path, turned).verdicts()] == ["", "does not hold"]


@pytest.mark.parametrize("better", ["less", "more"])
@pytest.mark.parametrize(("ours", "theirs"), [(False, True), (True, False), (True, True)])
def test_only_the_side_that_needs_more_may_be_known_from_below(
    ours: bool, theirs: bool, better: Literal["less", "more"]
) -> None:
    few, many = dict(enumerate((1.0, 1.1, 1.2))), dict(enumerate((5.0, 5.1, 5.3)))
    for first, second, few_missed in ((few, many, ours), (many, few, theirs)):
        found = verdict_between(first, second, better)
        decided = "holds" if (first is few) == (better == "less") else "does not hold"
        assert found == decided
        assert from_below(found, better, ours, theirs) == ("undecided" if few_missed else decided)


def test_cells_that_were_trained_otherwise_are_not_compared(tmp_path: Path) -> None:
    journal(tmp_path, "small.jsonl", {"walk/full": (1e5, 1.1e5, 1.2e5)})
    journal(tmp_path, "whole.jsonl", {"walk/without": (2e6, 2.2e6, 2.1e6)})
    assert [said for *_, said in card(tmp_path).verdicts()] == ["holds", ""]
    assert "(a tenth of the samples)" in next(card(tmp_path).compared())


def test_a_list_says_what_its_numbers_are(tmp_path: Path) -> None:
    table = replace(TABLE, figures=(Figure("speed", title="Speed, m/s"), Figure("height")))
    means = "ours are means over seeds [95 % interval] (seeds)"
    assert listed("walk", table, tmp_path)[2] == f"Speed, m/s: {means}"
    searches = replace(TABLE, searches=True)
    assert listed("walk", searches, tmp_path)[2] == f"Best value: {means}"
    assert means not in "".join(listed("walk", replace(TABLE, paper={}), tmp_path))


def test_another_figure_is_named_in_words_with_its_unit(tmp_path: Path) -> None:
    journal(tmp_path, "whole.jsonl", {"walk/full": (1e6, 1.1e6, 1.2e6)})
    table = replace(
        TABLE,
        figures=(Figure("success_rate"), Figure("samples", title="Samples to the criterion, all")),
        paper={"walk": {"full": {"says": "few", "of": "samples"}}},
    )
    shown = next(ours for _, _, ours, _ in card(tmp_path, table).verdicts())
    assert shown.startswith("samples to the criterion, all: 1.1M [")


def test_shares_of_a_paper_are_shown_as_ours_are(tmp_path: Path) -> None:
    table = replace(
        TABLE,
        figures=(Figure("solved", share=True), Figure("speed")),
        paper={
            "walk": {"full": 0.316, "without": {"says": "fails", "less": 0.5}},
            "run": {"full": {"says": 0.316, "of": "speed"}},
        },
    )
    found = [printed for _, printed, *_ in card(tmp_path, table).verdicts()]
    assert found == ["31.6 %", "fails (less than 50 %)", "0.316"]
    (_, shares), *_ = card(tmp_path, table).tables()
    assert shares.rows[0][1] == "31.6 %"


def test_what_was_begun_here_goes_before_the_record(tmp_path: Path) -> None:
    journal(tmp_path, "whole.jsonl", {"walk/full": (1e6, 1e6, 1e6)})
    (tmp_path / "here").mkdir()
    trial = {"key": "walk/full/seed0", "overrides": [], "variant": "walk/full", "seed": 0}
    (tmp_path / "here" / "journal.jsonl").write_text(json.dumps({"event": "asked", "trial": trial}))
    assert card(tmp_path).state() == "partly: 2 of 12 trainings, 2 of them on record"


def test_rows_of_csv_and_json(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(  # as a spreadsheet saves it
        "\ufeffskill,kind,speed,seed,done\nwalk,full,2.5,1,True\nwalk,full,fast,2,True\nwalk,full,9,0,False\n"
    )
    (tmp_path / "b.jsonl").write_text(
        'no JSON\n[1]\n{"what": "a run", "found": {"speed": 3}}\n{"what": "a run"}\n'
    )
    named = {"walk-full": "walk/full", "a run": "run/full"}
    table = replace(
        TABLE,
        figures=(Figure("speed", better="more"),),
        records={
            "a.csv": Record(
                by=("skill", "kind"), values={"speed": "speed"}, where={"done": "True"}
            ),
            "b.jsonl": Record(by=("what",), cells=named, values={"speed": "found.speed"}),
        },
    )
    found = card(tmp_path, table)
    assert found.cells["walk", "full"].by_seed("speed") == {1: 2.5}
    assert found.cells["run", "full"].by_seed("speed") == {0: 3.0}


def test_a_record_that_is_no_file_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "a.csv").mkdir()
    table = replace(TABLE, records={"a.csv": Record(by=("skill",), values={"samples": "n"})})
    with pytest.raises(FileError, match="cannot be read"):
        card(tmp_path, table)


#: Records in rows, and a table of them.
BY = Record(by=("cell",), values={"samples": "n"})
ROWS = replace(TABLE, columns={"full": ()}, paper={}, records={"a.csv": BY, "b.jsonl": BY})


@pytest.mark.parametrize("seed", ["1e999", "nan", "-1", "0.5", "9" * 400, "0x10", "first"])
def test_a_row_of_no_possible_seed_is_not_counted(
    seed: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.csv").write_text(f"cell,n,seed\nwalk,3,0\nwalk,7,{seed}\nwalk,9,1.0\n")
    assert card(tmp_path, ROWS).cells["walk", "full"].by_seed("samples") == {0: 3.0, 1: 9.0}
    said = f"A row is damaged in {tmp_path / 'a.csv'} and left out: what such a row told of is not counted."
    assert capsys.readouterr().err == f"{said}\n"


def test_rows_that_are_damaged_are_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = ['{"cell": "walk", "n": 3}', '{"cell": "walk", "n"', "[" * 10**5, '{"cell": "run", "n": 4, "seed": []}',
            '{"cell": "run", "n": -4}', '{"cell": "run", "n": 1, "seed": {}}', "", '{"cell": "run", "n": 5}']  # fmt: skip
    (tmp_path / "b.jsonl").write_text("\n".join(rows))
    journal(tmp_path, "whole.jsonl", {"walk/full": (1.0,)})
    with (tmp_path / "whole.jsonl").open("ab") as file:
        file.write(b'{"event": "finished", "report": {"key"')
    found = card(tmp_path, replace(ROWS, records={**ROWS.records, "whole.jsonl": Record()}))
    assert found.cells["run", "full"].by_seed("samples") == {0: 5.0}
    said = capsys.readouterr().err
    assert f"5 rows are damaged in {tmp_path / 'b.jsonl'}" in said, "no JSON, no seed, no cost"
    assert f"A row is damaged in {tmp_path / 'whole.jsonl'}" in said


def test_a_record_that_is_no_csv_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(f"cell,n,seed\nwalk,{'9' * 200_000},0\n")
    with pytest.raises(FileError, match=r"a\.csv is no table of CSV: field larger than"):
        card(tmp_path, ROWS)


@pytest.mark.parametrize("name", ["/etc/passwd", "../x.jsonl"])
def test_records_stay_in_their_folder(name: str) -> None:
    with pytest.raises(ValueError, match="not in the folder of records"):
        replace(TABLE, records={name: Record()})


def test_a_folder_of_records_that_is_none_or_leads_out_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["reproduce", "--records", str(tmp_path / "nowhere")]) == 2
    assert "--records" in capsys.readouterr().err
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "x.jsonl").symlink_to("/etc/passwd")
    assert main(["reproduce", "--records", str(tmp_path / "out")]) == 2
    assert "leads out" in capsys.readouterr().err


def test_less_and_more_exclude_each_other() -> None:
    with pytest.raises(ValueError, match="both"):
        Printed(1.0, less=1.0, more="walk")
    with pytest.raises(ValueError, match="belong together"):
        Record(by=("skill",))


def test_every_bundled_record_is_there_and_is_of_its_table() -> None:
    records = Path(__file__).parents[3] / "docs" / "benchmarks"
    for name in table_files(installed()):
        table = load_table(name, installed())
        known = Card(name, table, Path("nowhere"), records).recorded
        for file, record in table.records.items():
            if not table.open.startswith("all of it"):
                assert record in known.values(), f"{name}: {file} has nothing of it"
        assert listed(name, table, records)

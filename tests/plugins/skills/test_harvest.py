"""What a harvest keeps of the decisions of a run's policy."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from torch import Tensor

from understudy_skills.harvest import Harvest


def flags(text: str) -> Tensor:
    return torch.tensor([sign == "1" for sign in text])


@pytest.mark.parametrize(
    ("ending", "counts"), [("any", "0101"), ("failure", "0001"), ("truncation", "0100"), ("fall", "0001")]
)  # fmt: skip
def test_states_whose_numbers_went_wrong_are_none(ending: str, counts: str) -> None:
    """Of four worlds the second was truncated, and the others failed, two of them by their numbers."""
    step = SimpleNamespace(
        unsound=flags("1010"), failed=flags("1011"), terminated=flags("1011"), truncated=flags("0100"),
        ended=flags("1111"), succeeded=flags("0000"), endings={"fall": flags("1001")},
    )  # fmt: skip
    begun: list[Tensor] = []
    environment = SimpleNamespace(
        table={"x": torch.arange(4.0)}, advance=lambda action: step, begin=begun.append
    )
    harvest: Any = object.__new__(Harvest)
    harvest.environment, harvest._names = environment, ("x",)
    harvest.options = SimpleNamespace(field=None, ending=ending)
    harvest._begun = torch.zeros(4, dtype=torch.bool)
    _, counted, ended = harvest._advance(torch.zeros(4, 1))
    assert counted.tolist() == flags(counts).tolist()
    assert bool(ended.all())
    assert len(begun) == 1


def counted_of_changes(
    before: str, rows: Sequence[str], wrong: Sequence[str], ended: Sequence[str], **options: Any
) -> list[list[bool]]:
    """What counts in each decision of a harvest of changes of a switch, which stands as in `before` and then as in
    `rows`; worlds in which numbers go `wrong` and those that have `ended`, by decision."""
    table = {"x": torch.arange(float(len(before))), "switch": 2.0 * flags(before)}
    decisions = iter(zip(rows, wrong, ended, strict=True))

    def advance(action: Tensor) -> Any:
        row, unsound, over = (flags(text) for text in next(decisions))
        table["switch"], none = 2.0 * row, torch.zeros_like(unsound)
        return SimpleNamespace(
            unsound=unsound, failed=unsound, terminated=unsound, truncated=none, ended=over | unsound,
            succeeded=none, endings={},
        )  # fmt: skip

    harvest: Any = object.__new__(Harvest)
    harvest.environment = SimpleNamespace(table=table, advance=advance, begin=lambda worlds: None)
    harvest._names, harvest._lasted = ("x",), torch.zeros(len(before))
    harvest._begun = torch.full((len(before),), options.pop("begun"))
    harvest.options = SimpleNamespace(field="switch", value=2.0, ending="any", **options)
    return [harvest._advance(torch.zeros(len(before), 1))[1].tolist() for _ in rows]


def test_a_change_in_a_world_that_went_wrong_is_none() -> None:
    counted = counted_of_changes("000", ["110"], ["100"], ["000"], begun=True, lasting=1)
    assert counted == [[False, True, False]]


def test_a_change_counts_when_it_has_lasted() -> None:
    """The switch is on in each decision's row; an episode of the last world ends after the fourth decision."""
    rows = ["0110", "0100", "1111", "1111", "1111", "1101"]
    never, ended = ["0000"] * 6, [*["0000"] * 3, "0001", *["0000"] * 2]
    counted = counted_of_changes("0100", rows, never, ended, begun=False, lasting=3)
    # the second began switched on, the third was switched off in between
    assert [row[0] for row in counted] == [False] * 4 + [True, False]
    assert not any(row[1] for row in counted)
    assert [row[2] for row in counted] == [False] * 4 + [True, False]
    assert not any(row[3] for row in counted)


def test_what_has_no_field_cannot_last() -> None:
    with pytest.raises(ValueError, match="only moment=change has a field"):
        Harvest.Options("runs/some", lasting=2)
    assert Harvest.Options("runs/some", moment="change", field="x", lasting=2).lasting == 2

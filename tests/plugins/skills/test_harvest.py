"""What a harvest keeps of the decisions of a run's policy."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
import torch
from torch import Tensor

from understudy.setup.composition import load_experiment
from understudy_skills.harvest import Harvest, _with_simulators, _without_simulators


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


def test_a_change_in_a_world_that_went_wrong_is_none() -> None:
    table = {"x": torch.arange(3.0), "switch": torch.zeros(3)}
    step = SimpleNamespace(
        unsound=flags("100"), failed=flags("100"), terminated=flags("100"), truncated=flags("000"),
        ended=flags("100"), succeeded=flags("000"), endings={},
    )  # fmt: skip

    def advance(action: Tensor) -> Any:
        table["switch"] = torch.tensor([2.0, 2.0, 0.0])
        return step

    harvest: Any = object.__new__(Harvest)
    harvest.environment = SimpleNamespace(table=table, advance=advance, begin=lambda worlds: None)
    harvest._names, harvest._begun = ("x",), torch.ones(3, dtype=torch.bool)
    harvest._lasted = torch.zeros(3)
    harvest.options = SimpleNamespace(field="switch", value=2.0, ending="any", lasting=1)
    assert harvest._advance(torch.zeros(3, 1))[1].tolist() == [False, True, False]


def test_a_change_counts_when_it_has_lasted() -> None:
    """The switch is on in each decision's row; an episode of the last world ends after the fourth decision."""
    rows = ["0110", "0100", "1111", "1111", "1111", "1101"]
    table = {"x": torch.zeros(4), "switch": torch.tensor([0.0, 1.0, 0.0, 0.0])}
    step = SimpleNamespace(
        unsound=flags("0000"), failed=flags("0000"), terminated=flags("0000"), truncated=flags("0000"),
        succeeded=flags("0000"), endings={},
    )  # fmt: skip
    count = iter(range(len(rows)))

    def advance(action: Tensor) -> Any:
        k = next(count)
        table["switch"] = flags(rows[k]).float()
        step.ended = flags("0001" if k == 3 else "0000")
        return step

    harvest: Any = object.__new__(Harvest)
    harvest.environment = SimpleNamespace(table=table, advance=advance, begin=lambda worlds: None)
    harvest._names, harvest._begun = ("x",), torch.zeros(4, dtype=torch.bool)
    harvest._lasted = torch.zeros(4)
    harvest.options = SimpleNamespace(field="switch", value=1.0, ending="any", lasting=3)
    counted = [harvest._advance(torch.zeros(4, 1))[1].tolist() for _ in rows]
    # the second began switched on, the third was switched off in between
    assert [row[0] for row in counted] == [False] * 4 + [True, False]
    assert not any(row[1] for row in counted)
    assert [row[2] for row in counted] == [False] * 4 + [True, False]
    assert not any(row[3] for row in counted)


def test_what_has_no_field_cannot_last() -> None:
    with pytest.raises(ValueError, match="only moment=change has a field"):
        Harvest.Options("runs/some", lasting=2)
    assert Harvest.Options("runs/some", moment="change", field="x", lasting=2).lasting == 2


def test_a_member_of_a_composite_may_have_another_simulator() -> None:
    """As where a packed skill, which plays on a CPU, is harvested on a GPU."""
    found = load_experiment(["experiment=dressing/sleeve_small"])
    own = load_experiment(["job=harvest", "job.run=x", "simulators.person.name=mujoco_warp"])
    config = {
        "simulator": {"name": "composite"},
        "simulators": {"person": {"threads": 1}, "cloth": {}},
    }
    assert _without_simulators(config, own) == {**config, "simulators": {"cloth": {}}}
    members = {c.name: c.component.name for c in _with_simulators(found, own)["simulators"]}
    assert members == {"person": "mujoco_warp", "cloth": "cloth"}
    before = {c.name: c.component.name for c in found.choices["simulators"]}
    assert before == {"person": "mujoco", "cloth": "cloth"}


def test_a_simulator_of_the_harvest_takes_the_runs_place() -> None:
    found = load_experiment(["experiment=spacetime/walk"])
    own = load_experiment(["job=harvest", "job.run=x", "simulator=mujoco_warp", "device=cpu"])
    assert "simulator" not in _without_simulators({"simulator": {"name": "mujoco"}}, own)
    assert [c.component.name for c in _with_simulators(found, own)["simulator"]] == ["mujoco_warp"]
    nothing = load_experiment(["job=harvest", "job.run=x"])
    assert _with_simulators(found, nothing)["simulator"] == found.choices["simulator"]

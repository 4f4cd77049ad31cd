"""The state of worlds: what is set, kept, restored and judged stays in its own world."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy_warp_torch.world_state import WorldState

WORLDS = 4
SECOND = torch.tensor([False, True, False, False])


@pytest.fixture
def memory() -> dict[str, Tensor]:
    """A simulator's own: two points, their velocities, a counter, and a parameter."""
    return {
        "position": torch.zeros(WORLDS, 2, 3),
        "velocity": torch.zeros(WORLDS, 2, 3),
        "count": torch.zeros(WORLDS),
        "friction": torch.ones(WORLDS, 1),
    }


@pytest.fixture
def worlds(memory: dict[str, Tensor]) -> WorldState:
    state = {name: memory[name] for name in ("position", "velocity", "count")}
    return WorldState(
        "toy",
        views={name: memory[name] for name in ("position", "velocity")},
        state=state,
        initial={name: view[:1].clone() for name, view in state.items()},
        set_by=("position", "velocity"),
        parameters={"friction": memory["friction"]},
        extent=100.0,
        speed=10.0,
    )


def test_setting_begins_the_chosen_worlds_anew(
    worlds: WorldState, memory: dict[str, Tensor]
) -> None:
    memory["count"].fill_(7.0)
    ones = torch.ones(WORLDS, 2, 3)
    worlds.set(SECOND, {"position": ones, "velocity": 2 * ones})
    assert memory["position"][:, 0, 0].tolist() == [0, 1, 0, 0]
    assert memory["velocity"][:, 0, 0].tolist() == [0, 2, 0, 0]
    assert memory["count"].tolist() == [7, 0, 7, 7]  # nobody gives it: it begins anew


def test_what_varies_is_read_set_and_kept(worlds: WorldState, memory: dict[str, Tensor]) -> None:
    with pytest.raises(ConfigError, match=r"no parameter 'fricton'.*Did you mean 'friction'"):
        worlds.vary(["fricton"])
    assert "friction" not in worlds.views
    assert worlds.vary(["friction"]) == {"friction": (1,)}
    kept = worlds.snapshot()
    rows = {name: memory[name].clone() for name in ("position", "velocity")}
    worlds.set(SECOND, {**rows, "friction": torch.full((WORLDS, 1), 0.5)})
    assert worlds.views["friction"].squeeze(1).tolist() == [1, 0.5, 1, 1]
    memory["position"].fill_(3.0)
    worlds.restore(kept, SECOND)
    assert memory["friction"].squeeze(1).tolist() == [1, 1, 1, 1]
    assert memory["position"][:, 0, 0].tolist() == [3, 0, 3, 3]
    worlds.restore(kept)
    assert memory["position"].abs().max() == 0


@pytest.mark.parametrize(
    ("name", "value"),
    [("position", math.nan), ("position", 101.0), ("velocity", 11.0), ("velocity", -math.inf)],
)
def test_one_unsound_world_is_told_of_even_if_a_step_hides_it(
    worlds: WorldState, memory: dict[str, Tensor], name: str, value: float
) -> None:
    assert not worlds.failed().any()
    memory[name][1, 0, 2] = value
    assert worlds.failed().tolist() == SECOND.tolist()
    worlds.begin_step()
    memory[name][1] = 0.0  # as a step might
    worlds.begin_step()
    assert worlds.failed().tolist() == SECOND.tolist()
    worlds.begin_step()
    assert not worlds.failed().any(), "who was told of is so no longer"


def test_what_is_fast_may_be_less_far(worlds: WorldState, memory: dict[str, Tensor]) -> None:
    memory["position"].fill_(99.0)
    memory["velocity"].fill_(9.0)
    assert not worlds.failed().any()

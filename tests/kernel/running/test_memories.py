"""Memory: what the environment keeps for its parts from step to step."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest
import torch
from counted_task import bound, line, push, term
from torch import Tensor
from worlds import assert_same_state

from understudy.errors import ConfigError
from understudy.task import Memory


class Highest(Memory):
    """The highest position of the episode, ``highest``, and the steps since then, ``since``."""

    reads = ("x",)
    keeps = {"highest": (), "since": ()}

    def begin(self, x: Tensor) -> Mapping[str, Tensor]:
        return {"highest": x[:, 0].clone(), "since": torch.zeros(len(x))}

    def advance(self, kept: Mapping[str, Tensor], x: Tensor) -> Mapping[str, Tensor]:
        higher = x[:, 0] > kept["highest"]
        return {
            "highest": torch.where(higher, x[:, 0], kept["highest"]),
            "since": torch.where(higher, 0.0, kept["since"] + 1),
        }


class Twice(Memory):
    """Twice what another memory keeps now."""

    reads = ("highest",)
    keeps = {"twice": ()}

    def begin(self, highest: Tensor) -> Mapping[str, Tensor]:
        return {"twice": 2 * highest}

    def advance(self, kept: Mapping[str, Tensor], highest: Tensor) -> Mapping[str, Tensor]:
        return {"twice": 2 * highest}


class Drawn(Memory):
    """Two random numbers at the beginning; one of them anew in each step."""

    keeps = {"goal": (), "noise": ()}
    uniforms = 2

    def begin(self, uniforms: Tensor) -> Mapping[str, Tensor]:
        return {"goal": uniforms[:, 0], "noise": uniforms[:, 1]}

    def advance(self, kept: Mapping[str, Tensor], uniforms: Tensor) -> Mapping[str, Tensor]:
        return {"goal": kept["goal"], "noise": uniforms[:, 1]}


def with_memories(**more: Any) -> Any:
    memories = {"first": bound(Highest()), "second": bound(Twice()), "third": bound(Drawn())}
    environment = line(
        memories=more.pop("memories", memories),
        terminations=[term(lambda x: x[:, 0] >= 10, "far")],
        **more,
    )
    environment.reset()
    return environment


def test_what_is_kept() -> None:
    environment = with_memories()
    found = []
    for forces in ((1, 2, 3, 4), (1, -1, 0, 10), (-1, 1, 2, 3)):
        push(environment, *forces)
        found.append({k: environment.table[k].tolist() for k in ("highest", "since", "twice")})
    assert found == [
        {"highest": [1, 2, 3, 4], "since": [0, 0, 0, 0], "twice": [2, 4, 6, 8]},
        {"highest": [2, 2, 3, 0], "since": [0, 1, 1, 0], "twice": [4, 4, 6, 0]},
        {"highest": [2, 2, 5, 3], "since": [1, 2, 0, 0], "twice": [4, 4, 10, 6]},
    ]


def test_memories_advance_in_the_order_of_the_configuration() -> None:
    """The other way round, the second reads what the first kept before."""
    environment = with_memories(
        memories={
            "second": bound(Twice(), provides={"twice": "double"}),
            "first": bound(Highest()),
        }
    )
    push(environment, 1, 2, 3, 4)
    assert environment.table["double"].tolist() == [0, 0, 0, 0]
    push(environment, 1, 1, 1, 1)
    assert environment.table["double"].tolist() == [2, 4, 6, 8]


def test_memories_advance_once_a_control_period() -> None:
    environment = with_memories(decision=3)
    push(environment, -1)
    assert environment.table["since"].tolist() == [3] * 4


def test_random_numbers_depend_on_seed_memory_and_world_alone() -> None:
    drawn = []
    for worlds, others in ((4, True), (9, False)):
        memories = {"third": bound(Drawn())}
        if others:
            again = bound(Drawn(), provides={"goal": "goal_2", "noise": "noise_2"})
            memories = {"fourth": again, "first": bound(Highest()), **memories}
        environment = with_memories(worlds=worlds, memories=memories, seconds=20.0)
        rows = []
        for step in range(6):
            # world 1 begins anew in the third step; in the larger batch the others do all the time
            push(environment, 0, 10 * (step == 2), 0, 0, *([10] * (worlds - 4)))
            rows.append(torch.stack([environment.table[k][:4] for k in ("goal", "noise")]))
        drawn.append(torch.stack(rows))
        if others:
            assert not torch.equal(environment.table["goal"], environment.table["goal_2"])
    assert torch.equal(*drawn)
    goals, noises = drawn[0][:, 0], drawn[0][:, 1]
    assert (goals == goals[0]).all(0).tolist() == [True, False, True, True]
    assert len(noises.unique()) == noises.numel()
    assert ((drawn[0] >= 0) & (drawn[0] < 1)).all()


def test_a_reset_with_a_seed_draws_the_same() -> None:
    environment = with_memories()
    environment.reset(seed=5)
    first = environment.table["goal"].clone()
    environment.reset()
    assert not torch.equal(environment.table["goal"], first)
    environment.reset(seed=5)
    assert torch.equal(environment.table["goal"], first)
    environment.reset(seed=5, draw="evaluation")
    assert not torch.equal(environment.table["goal"], first)


def test_memory_is_resumed() -> None:
    one, two = with_memories(), with_memories()
    push(one, 3, 1, 2, 4), push(two, 1), push(two, 9)
    two.load_state_dict(one.state_dict())
    for force in (1, -2, 10, 1):
        for name in ("highest", "since", "twice", "goal", "noise"):
            assert torch.equal(one.table[name], two.table[name]), name
        assert_same_state(vars(push(one, force)), vars(push(two, force)))
    assert_same_state(one.state_dict(), two.state_dict())


def test_previous_fields() -> None:
    """Any field before this step; itself just after a beginning."""

    def change(x: Tensor, previous_x: Tensor, previous_highest: Tensor) -> Tensor:
        seen.append((x[:, 0].tolist(), previous_x[:, 0].tolist(), previous_highest.tolist()))
        return (x - previous_x)[:, 0]

    seen: list[Any] = []
    environment = with_memories(rewards=[term(change)])
    seen.clear()
    rewards = [
        push(environment, *forces).rewards.tolist() for forces in ((1, 2, 3, 10), (1, -1, 0, 5))
    ]
    assert rewards == [[1, 2, 3, 10], [1, -1, 0, 5]]
    assert seen == [
        ([1, 2, 3, 10], [0, 0, 0, 0], [0, 0, 0, 0]),
        ([2, 1, 3, 5], [1, 2, 3, 0], [1, 2, 3, 0]),
    ]
    push(environment, 0, 0, 0, 5)
    assert environment.table["previous_x"][:, 0].tolist() == [2, 1, 3, 0]
    assert environment.table["x"][:, 0].tolist() == [2, 1, 3, 0]


def test_previous_fields_are_resumed() -> None:
    def change(x: Tensor, previous_x: Tensor) -> Tensor:
        return (x - previous_x)[:, 0]

    one, two = (with_memories(rewards=[term(change)]) for _ in range(2))
    push(one, 1), push(two, 5), push(two, -7)
    two.load_state_dict(one.state_dict())
    assert two.table["previous_x"][:, 0].tolist() == [0] * 4
    assert push(two, 3).rewards.tolist() == push(one, 3).rewards.tolist() == [3] * 4


def test_of_a_field_that_does_not_exist_there_is_no_previous() -> None:
    def change(previous_y: Tensor) -> Tensor: ...

    with pytest.raises(ConfigError, match=r"change needs the state field 'previous_y'"):
        line(rewards=[term(change)])


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({}, r"^part promises 'level' and does not return it\.$"),
        (
            {"level": torch.zeros(4, 1)},
            r"^'level' of part has shape \(4, 1\); it must be \(4,\), one row of shape \[\] per",
        ),
    ],
)
def test_a_memory_keeps_its_promise(given: dict[str, Tensor], message: str) -> None:
    class Odd(Memory):
        keeps = {"level": ()}

        def begin(self) -> Mapping[str, Tensor]:
            return given

        def advance(self, kept: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
            return given

    with pytest.raises(ConfigError, match=message):
        line(memories={"odd": bound(Odd())}).reset()

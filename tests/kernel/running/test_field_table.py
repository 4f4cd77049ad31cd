"""State fields: renamed, unknown, missing, optional, and in circles."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest
import torch
from counted_task import LINE_TASK, Where, bound, line, line_plugins, push, term
from torch import Tensor

from understudy.errors import ConfigError
from understudy.setup.building import build_environment, providers_of
from understudy.setup.composition import load_experiment
from understudy.task import Context, Encoder, Fields, Memory


def fields(reads: tuple[str, ...], *provides: str) -> Any:
    """Fields that are each one more than the sum of what is read."""

    class Sum(Fields):
        calls = 0

        def __init__(self, options: None = None, context: Context | None = None) -> None:
            pass

        def compute(self, **given: Tensor) -> Mapping[str, Tensor]:
            type(self).calls += 1
            total = sum(v.reshape(len(v)) for v in given.values()) + 1
            return dict.fromkeys(provides, total)  # type: ignore[arg-type]

    Sum.reads, Sum.provides = reads, dict.fromkeys(provides, ())
    return Sum


class Last(Memory):
    """The number that it reads, one period later."""

    reads = ("number",)
    keeps = {"last": ()}

    def __init__(self, options: None = None, context: Context | None = None) -> None:
        pass

    def begin(self, number: Tensor) -> Mapping[str, Tensor]:
        return {"last": number.reshape(len(number))}

    advance = lambda self, kept, number: self.begin(number)  # noqa: E731


class Two(Encoder):
    """Two numbers side by side, (N, 2)."""

    reads = ("one", "two")
    shape = (2,)

    def __init__(self, options: None = None, context: Context | None = None) -> None:
        pass

    def encode(self, one: Tensor, two: Tensor) -> Tensor:
        return torch.stack([one.reshape(len(one)), two.reshape(len(two))], 1)


PARTS = {
    "fields": {"my/sum": fields(("x",), "y"), "my/pair": fields(("a", "b"), "c", "d")},
    "memory": {"my/last": Last},
    "encoder": {"my/two": Two},
    "reward": {"my/ratio": lambda: None},
}


def ratio(
    top: Tensor, bottom: Tensor, offset: Tensor | None = None, *, factor: float = 1.0
) -> Tensor:
    """`factor` × top / bottom + offset."""
    return factor * top / bottom + (0.0 if offset is None else offset)


PARTS["reward"] = {"my/ratio": ratio}


def built(*overrides: str) -> Any:
    plugins = line_plugins(**PARTS)
    environment = build_environment(load_experiment([*LINE_TASK, *overrides], plugins)).environment
    environment.reset()
    return environment


def test_renaming_everything() -> None:
    """One kind of part twice, side by side under other names."""
    environment = built(
        "+fields.first={name: my/sum}",
        "+fields.second={name: my/sum, reads: {x: y}, provides: {y: z}}",
        "+fields.pair={name: my/pair, reads: {a: y, b: z}, provides: {d: e}}",
        "+memory.one={name: my/last, reads: {number: y}, provides: {last: last_y}}",
        "+memory.two={name: my/last, reads: {number: c}}",
        "encoder.state={name: my/two, reads: {one: last_y, two: last}}",
        "+reward.terms.ratio={name: my/ratio, reads: {top: e, bottom: z}, factor: 2}",
        "reward.terms.at=null",
    )
    step = push(environment, 1, 2, 3, 4)
    x = torch.tensor([1.0, 2, 3, 4])
    y, z = x + 1, x + 2
    assert torch.equal(step.rewards, 2 * (y + z + 1) / z)
    assert torch.equal(step.observations["state"], torch.stack([y, y + z + 1], 1))


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("+fields.a={name: my/sum, reads: {w: y}}", r"^fields\.a\.reads: there is no field 'w' to rename\. Known: x\.$"),
        ("+fields.a={name: my/sum, provides: {x: y}}", r"^fields\.a\.provides: there is no field 'x' to rename\. Known: y\.$"),
        ("+memory.a={name: my/last, reads: {numbr: x}}", r"^memory\.a\.reads: .*Did you mean 'number'\?$"),
        ("+memory.a={name: my/last, provides: {number: x}}", r"^memory\.a\.provides: there is no field 'number'"),
        ("+encoder.state.reads={y: x}", r"^encoder\.state\.reads: there is no field 'y'"),
        ("+reward.terms.at.reads={y: x}", r"^reward\.terms\.at\.reads: there is no field 'y'"),
        ("+actuation.reads={y: x}", r"^actuation\.reads: there is no field 'y' to rename\. None is known here\.$"),
    ],
)  # fmt: skip
def test_renaming_what_is_not_there(override: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        built(override)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["+reward.terms.at.reads={x: y}"], r"^reward\.terms\.at needs the state field 'y', which nothing in this task provides\. It would come from fields 'my/sum'\.$"),
        (["+encoder.state.reads={x: y}"], r"^encoder\.state needs the state field 'y'"),
        (["+memory.m={name: my/last, reads: {number: y}}"], r"^memory\.m needs the state field 'y'"),
        (["+fields.f={name: my/sum, reads: {x: w}}"], r"^fields\.f needs the state field 'w', which nothing in this task provides\. Known: action, .*, x, y\.$"),
        (["+fields.f={name: my/sum, reads: {x: episode_tim}}"], r"which nothing in this task provides\. Did you mean 'episode_time'\?$"),
        (["+measure.m={name: line/value, reads: {x: last}}"], r"^measure\.m needs the state field 'last', .* It would come from memory 'my/last'\.$"),
        (["+fields.f={name: my/sum, provides: {y: x}}"], r"^fields\.f provides the field 'x', which the simulator provides already\."),
        (["+fields.f={name: my/sum}", "+fields.g={name: my/sum}"], r"^fields\.g provides the field 'y', which fields\.f provides already\. .*PART\.NAME\.provides=\{y: other_y\}"),
        (["+memory.m={name: my/last, reads: {number: x}, provides: {last: failed}}"], r"^memory\.m provides the field 'failed', which the environment provides already"),
    ],
)  # fmt: skip
def test_fields_that_are_missing_or_there_twice(overrides: list[str], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        built(*overrides)


def test_who_would_provide_a_field() -> None:
    plugins = line_plugins(fields={"broken": "no_such_module:Fields"}, **{k: v for k, v in PARTS.items() if k != "fields"})  # fmt: skip
    assert list(providers_of("last", plugins.registry)) == ["memory 'my/last'"]
    assert list(providers_of("x", plugins.registry)) == ["simulator 'line'"]
    assert list(providers_of("nothing", plugins.registry)) == []


def test_circles_are_named() -> None:
    a, b, c = fields(("r",), "p"), fields(("p",), "q"), fields(("q", "x"), "r")
    with pytest.raises(
        ConfigError, match=r"^The fields (p → r → q → p|q → p → r → q|r → q → p → r) need one another in a circle\."
    ):  # fmt: skip
        line(fields=[bound(part()) for part in (a, b, c)])
    with pytest.raises(ConfigError, match=r"^The fields p → p need one another in a circle"):
        line(fields=[bound(fields(("p",), "p")())])


def test_long_chains_are_no_circles() -> None:
    """Many fields, each from the two before: there are a million ways from the last to the first."""
    chain = [bound(fields(("x",), f"f{i}")()) for i in range(2)]
    chain += [bound(fields((f"f{i}", f"f{i + 1}"), f"f{i + 2}")()) for i in range(60)]
    environment = line(fields=chain, rewards=[term(lambda f2: f2, "two")])
    environment.reset()
    assert push(environment, 1).rewards.tolist() == [2 + 2 + 1] * 4


def test_fields_are_computed_once_a_step_and_only_if_read() -> None:
    used, unused = fields(("x",), "y"), fields(("x",), "z")
    environment = line(
        fields=[bound(used()), bound(unused())],
        rewards=[term(lambda y: y, "one"), term(lambda y: y, "two")],
        encoders={"state": Where()},
    )
    environment.reset()
    used.calls = unused.calls = 0
    for _ in range(3):
        push(environment, 1)
    assert (used.calls, unused.calls) == (3, 0)


def test_fields_follow_what_they_are_made_of() -> None:
    """A field of ``failed`` is that of this step's failures, for rewards."""

    class Alive(Fields):
        reads = ("failed",)
        provides = {"alive": ()}

        def compute(self, failed: Tensor) -> Mapping[str, Tensor]:
            return {"alive": (~failed).float()}

    environment = line(
        fields=[bound(Alive())],
        rewards=[term(lambda alive: alive, "alive")],
        terminations=[term(lambda x, alive: (x[:, 0] > 2) & (alive > 0), "far")],
    )
    environment.reset()
    assert push(environment, 1, 2, 3, 4).rewards.tolist() == [1, 1, 0, 0]


def test_a_field_of_another_shape_than_promised() -> None:

    odd = fields(("x",), "y")()
    odd.provides = {"y": (3,)}
    with pytest.raises(
        ConfigError,
        match=r"^the field 'y' of part has shape \(4,\); it must be \(4, 3\), one row of shape \[3\] per",
    ):
        line(fields=[bound(odd)]).reset()
    odd.provides = {"y": (), "w": ()}
    with pytest.raises(ConfigError, match=r"^part promises the field 'w' and does not return it"):
        line(fields=[bound(odd)]).reset()


# ---------------------------------------------------------------------- optional parameters


def test_optional_parameters_of_terms() -> None:
    """Filled where the task has the field, left out where it has not."""
    top = "+reward.terms.ratio={name: my/ratio, reads: {top: %s, bottom: %s}}"
    plain = built("+fields.f={name: my/sum}", top % ("y", "y"), "reward.terms.at=null")
    assert push(plain, 1).rewards.tolist() == [1] * 4
    offset = built(
        "+fields.f={name: my/sum}",
        "+fields.g={name: my/sum, provides: {y: offset}}",
        top % ("y", "y"),
        "reward.terms.at=null",
    )
    assert push(offset, 1).rewards.tolist() == [1 + 2] * 4


def test_an_optional_parameter_that_is_renamed_to_nothing() -> None:
    """Asking for it by name is no asking for it if it can be left out: the same as not having it."""
    environment = built(
        "+fields.f={name: my/sum}",
        "+reward.terms.ratio={name: my/ratio, reads: {top: y, bottom: y, offset: nowhere}}",
        "reward.terms.at=null",
    )
    assert push(environment, 1).rewards.tolist() == [1] * 4


def test_optional_previous_fields() -> None:
    def change(x: Tensor, previous_x: Tensor | None = None, previous_y: Tensor | None = None) -> Tensor:  # fmt: skip
        assert previous_x is not None
        assert previous_y is None
        return (x - previous_x)[:, 0]

    environment = line(rewards=[term(change)])
    environment.reset()
    assert push(environment, 1, 2, 3, 4).rewards.tolist() == [1, 2, 3, 4]

from __future__ import annotations

import functools
import signal
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import pytest

from understudy.errors import ConfigError, PluginError
from understudy.options import REQUIRED, check_range, coerce, make_options, options_of
from understudy.setup.registry import Component, Registrar, Registry
from understudy.signals import StopRequest
from understudy.testing.sentences import sentences


@dataclass(frozen=True)
class Inner:
    size: int = 3


@dataclass(frozen=True)
class Outer:
    name: str
    inner: Inner = field(default_factory=Inner)
    many: tuple[float, ...] = ()
    maybe: int | None = None

    def __post_init__(self) -> None:
        check_range(self, "maybe", least=0, most=5)


class Part:
    Options = Outer


@dataclass(frozen=True)
class Said:
    """Options with their sentences where people and formatters put them."""

    #: above it,
    #: on two lines
    above: int = 3
    behind: int = 4  #: behind it
    long: dict[str, int] = field(default_factory=dict)  #: behind what the formatter wrapped
    both: float = 1.0  #: within its brackets
    unsaid: int = 5  # a comment for the reader of the source
    #: of the one that follows
    last: str = ""


@dataclass(frozen=True)
class More(Said):
    behind: int = 5  #: said anew
    more: int = 6  #: its own


def said(
    qpos: Any,  #: no option
    *,
    scale: float = 2.0,  #: m
    #: above it
    limit: float,
    unsaid: int = 1,
) -> Any: ...


def test_sentences_of_options() -> None:
    expected = {
        "above": "above it, on two lines", "behind": "behind it", "last": "of the one that follows",
        "long": "behind what the formatter wrapped", "both": "within its brackets",
    }  # fmt: skip
    assert sentences(Said) == expected
    assert sentences(More) == {**expected, "behind": "said anew", "more": "its own"}
    assert {k: v for k, v in sentences(said).items() if k != "qpos"} == {
        "scale": "m",
        "limit": "above it",
    }
    assert sentences(max) == {}, "there is no source"


def term(qpos: Any, qvel: Any, *, scale: float = 2.0, limit: float) -> Any: ...


@pytest.mark.parametrize(
    ("value", "annotation", "result"),
    [
        (3, float, 3.0), (1e6, int, 1_000_000), (True, bool, True), ("a", str, "a"), (None, int | None, None),
        (2, int | None, 2), ([1, 2], tuple[float, ...], (1.0, 2.0)), ([1, "a"], tuple[int, str], (1, "a")),
        ([1], list[float], [1.0]), ({"a": 1}, Mapping[str, float], {"a": 1.0}), ("x", Literal["x", "y"], "x"),
        ({"size": 4}, Inner, Inner(4)), ({"a": object}, Any, {"a": object}), ("7", int | str, "7"),
    ],
)  # fmt: skip
def test_coerce(value: Any, annotation: Any, result: Any) -> None:
    found = coerce(value, annotation, "here")
    assert found == result
    assert type(found) is type(result)


@pytest.mark.parametrize(
    ("value", "annotation", "where"),
    [
        (True, int, "here=true"), (1.5, int, "here=1.5"), (1, bool, "here=1"), (None, str, "here=null"), ([1, [2]], list[str], r"here\[1\]=\[2\]"), ("1", float, "here='1'"),
        (float("nan"), float, "here=nan"), (float("inf"), float, "here=inf"), (None, float, "here=null"),
        ([1, "a"], tuple[float, ...], r"here\[1\]='a'"), ([1], tuple[int, str], "here takes 2 values, got 1"),
        ({"a": "b"}, Mapping[str, float], r"here\.a='b'"), ("z", Literal["x", "y"], "here='z'"),
        ({"size": "b"}, Inner, r"here\.size='b'"), ({"sise": 1}, Inner, "here has no option 'sise'. Did you mean 'size'"),
        (3, Inner, "it takes a mapping"), ("abc", tuple[str, ...], "here='abc'"), ("x", int | None, "here='x'"),
        ("x", float | list[list[float]], "it takes a number or a list of lists of numbers"),
        ([0.2], float | list[list[float]], r"here\[0\]=0.2 is not possible: it takes a list of numbers"),
    ],
)  # fmt: skip
def test_coerce_refuses(value: Any, annotation: Any, where: str) -> None:
    with pytest.raises(ConfigError, match=where):
        coerce(value, annotation, "here")


def test_options_of_classes_and_functions() -> None:
    assert options_of(Part)["name"].default is REQUIRED
    assert options_of(Part)["inner"].default == Inner()
    assert list(options_of(term)) == ["scale", "limit"]
    assert options_of(term)["scale"].default == 2.0
    assert options_of(term)["limit"].default is REQUIRED
    assert options_of(type("Plain", (), {})) == {}


def test_options_of_a_function_partly_filled_in() -> None:
    def term(number: int, *, scale: float = 2.0) -> float:
        return number * scale

    found = options_of(functools.partial(term, 3))
    assert {name: (o.annotation, o.default) for name, o in found.items()} == {"scale": (float, 2.0)}


def test_make_options() -> None:
    made = make_options(Outer, {"name": "a", "inner": {"size": 1}, "many": [1]}, "part")
    assert made == Outer("a", Inner(1), (1.0,))
    with pytest.raises(ConfigError, match=r"^part\.name is not set"):
        make_options(Outer, {}, "part")
    with pytest.raises(ConfigError, match=r"^part\.maybe=6 is not possible: it must be at most 5"):
        make_options(Outer, {"name": "a", "maybe": 6}, "part")
    with pytest.raises(ConfigError, match=r"^maybe=-1 is not possible"):
        make_options(Outer, {"name": "a", "maybe": -1}, "")


def test_find() -> None:
    registry = Registry()
    register = Registrar(registry, "mine", "mine-dist", "1.0")
    register.component("learner", "mine/ppo", Part, "text")
    found = registry.find("learner", "mine/ppo")
    assert (found.plugin, found.distribution, found.version) == ("mine", "mine-dist", "1.0")
    with pytest.raises(
        ConfigError,
        match=r"There is no learner 'mine/pop' \(asked for at learner\)\. Did you mean 'mine/ppo'",
    ):
        registry.find("learner", "mine/pop", "learner")
    with pytest.raises(ConfigError, match=r"'mine/ppo' is a learner\."):
        registry.find("policy", "mine/ppo")
    with pytest.raises(PluginError, match="Both plugin 'mine' and plugin 'other'"):
        Registrar(registry, "other").component("learner", "mine/ppo", Part)
    registry.remove("mine")
    assert registry.names("learner") == []


@pytest.mark.parametrize("what", ["task", "section", "kind"])
def test_everything_once(what: str) -> None:
    register = Registrar(Registry(), "mine")
    arguments = {"task": ("x", ""), "section": ("x", dict, dict), "kind": ("x", "")}[what]
    getattr(register, what)(*arguments)
    with pytest.raises(PluginError):
        getattr(register, what)(*arguments)


def test_targets_are_imported_when_used() -> None:
    component = Component("learner", "x", "understudy_ppo.learner:PPO", "ppo")
    assert component.factory.__name__ == "PPO"
    assert component.options["clip"].default == 0.2
    with pytest.raises(PluginError, match="cannot be used"):
        _ = Component("learner", "x", "nowhere.at_all:PPO", "ppo").factory
    with pytest.raises(PluginError, match="does not exist"):
        _ = Component("learner", "x", "understudy_ppo.learner:POP", "ppo").factory


def test_a_stop_signal_waits_until_a_module_is_imported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """PyTorch's import aborts the process if Python raises in the middle of its C++."""
    (tmp_path / "stopped_in_import.py").write_text(
        "import os, signal\nos.kill(os.getpid(), signal.SIGTERM)\nwhole = True\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    component = Component("learner", "x", "stopped_in_import:whole", "some")
    with StopRequest(at_once=True) as stop:
        with pytest.raises(KeyboardInterrupt):
            _ = component.factory
        assert stop.received == signal.SIGTERM
    assert sys.modules.pop("stopped_in_import").whole

"""Lists and mappings on the command line as people write them, and types in their words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser

from understudy.options import in_words
from understudy.setup.composition import readable


@pytest.mark.parametrize(
    ("written", "meant"),
    [
        ("{ppo: [], trpo: [learner=trpo]}", {"ppo": [], "trpo": ["learner=trpo"]}),
        ("{a: [x.y=1, z=[8,16]], b: [w={k: 1}]}", {"a": ["x.y=1", "z=[8,16]"], "b": ["w={k: 1}"]}),
        ("{a: ['x=1', \"y=2, z\"]}", {"a": ["x=1", "y=2, z"]}),
        ("{a: [~x.y, +z=1]}", {"a": ["~x.y", "+z=1"]}),
        ("{a: {b: c=d}, e: 3}", {"a": {"b": "c=d"}, "e": 3}),
        ("{name: ppo, gamma: 0.9}", {"name": "ppo", "gamma": 0.9}),
        ("[learner=trpo, seed=3]", ["learner=trpo", "seed=3"]),
        ("[C:/clips/a=b.bvh]", ["C:/clips/a=b.bvh"]),
        ("[a b, c]", ["a b", "c"]),
        ("{}", {}),
    ],
)
def test_read_as_meant(written: str, meant: Any) -> None:
    override = OverridesParser.create().parse_override(readable(f"key={written}"))

    def plain(value: Any) -> Any:
        if isinstance(value, Mapping):
            return {str(k): plain(v) for k, v in value.items()}
        if isinstance(value, list):
            return [plain(v) for v in value]
        return value.text if hasattr(value, "text") else value

    assert plain(override.value()) == meant


@pytest.mark.parametrize("broken", ["{a: [b=1}", "{a: [b=1]", "[a=(", "{a: 'b}"])
def test_what_does_not_close_stays_as_it_is(broken: str) -> None:
    assert readable(f"key={broken}") == f"key={broken}"


@pytest.mark.parametrize(
    ("annotation", "words"),
    [
        (int, "a whole number"),
        (float | None, "a number or null"),
        (tuple[int, ...], "a list of whole numbers"),
        (tuple[float, float], "a list of 2 numbers"),
        (list[list[float]], "a list of lists of numbers"),
        (str | tuple[str, ...], "text or a list of text"),
        (Mapping[str, int], "a mapping"),
        (Literal["relu", "tanh"], "relu or tanh"),
        (bool, "true or false"),
    ],
)
def test_types_in_words(annotation: Any, words: str) -> None:
    assert in_words(annotation) == words

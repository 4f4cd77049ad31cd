"""Lists and mappings on the command line as people write them, and types in their words."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Mapping
from typing import Any, Literal

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser

from understudy.errors import ConfigError
from understudy.options import in_words
from understudy.setup.composition import _each_word, compose_raw, readable


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


@pytest.mark.parametrize(
    "value",
    ["{a: [], a: [seed=3]}", "{name: grid, name: chain}", "{'a': 1, \"a\": 2}", "{b: {a: 1, a: 2}}", "{c: [{a: 1}, {b: 2,b: 3}]}", "{a: {b: 1}, c: 2, a: 3}"],
)  # fmt: skip
def test_a_key_that_stands_twice_in_a_value_is_refused(value: str) -> None:
    """The last one was taken, in silence: of two variants of one name the other was never trained."""
    with pytest.raises(ConfigError, match=r"'(a|b|name)' stands twice in .* Write it once\."):
        compose_raw([f"outer_loop={value}"])


@pytest.mark.parametrize(
    "value", ["{a: a, b: a}", "{a: [b={a: 1}], b: [b={a: 1}]}", "{a: [{b: 1}, {b: 2}]}", "{a: {a: {a: 1}}, b: {a: 2}}", "{a: '{a: 1, a: 2}'}", "{a: x:a}"],
)  # fmt: skip
def test_the_same_key_elsewhere_in_it_is_another(value: str) -> None:
    with contextlib.suppress(ConfigError):
        compose_raw([f"outer_loop={value}"])
    assert _each_word(value, lambda word: word) == value


@pytest.mark.parametrize(
    "group", ["learner", "task", "experiment", "outer_loop", "encoder", "+style"]
)
@pytest.mark.parametrize("value", ["[null]", "[{a: 1}]", "[[a]]", "[1]", "[true]", "[a,{b: c}]"])
def test_a_list_of_what_names_no_option(group: str, value: str) -> None:
    """It was a traceback of Hydra's."""
    with pytest.raises(ConfigError, match=r"names no option of .* Write .*=NAME|There is no"):
        compose_raw([f"{group}={value}"])


@pytest.mark.parametrize("value", ["[ppo,trpo]", "[]"])
def test_a_slot_of_one_part_takes_one(value: str) -> None:
    """Of two learners the last was taken, with what the other's file says of options; of none, none was."""
    with pytest.raises(ConfigError, match=r"names no option of learner\. Write learner=NAME"):
        compose_raw(["experiment=miniature/go", f"learner={value}"])
    assert compose_raw(["experiment=miniature/go", "learner=[ppo]"])["learner"]["name"] == "ppo"


@pytest.mark.parametrize(
    "word", ["seed=3", "+seed=3", "++seed=3", "num_worlds=3", "++num_worlds=3"]
)
def test_a_number_is_one_whatever_stands_before_its_key(word: str) -> None:
    """As those who know Hydra write it: the number was text, and refused as such."""
    key = word.lstrip("+").partition("=")[0]
    assert compose_raw(["experiment=miniature/go", word])[key] == 3


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["+run.dir=a", "+run.dir=b"], "run.dir has a value already. Write run.dir=VALUE, without +."),
        (["seed=${seed}"], "A key takes its own value, or that of one which takes its: break the circle of ${…}."),
        (["seed=${oc.decode:'!!python'}"], "What ${…:…} is given cannot be read."),
        (["++learner=ppo"], "learner chooses a file. Write learner=ppo, without +."),
        (["+learner=trpo"], "learner is chosen already. Write learner=NAME once, without +."),
        (["~learner=trpo"], "~learner=trpo leaves nothing out: that is not chosen."),
        (["~num_worlds=3"], "~num_worlds leaves nothing out: nothing that was chosen sets num_worlds."),
        (["budget.samples=5", "~budget.samples=7"], "~budget.samples=7 leaves nothing out: budget.samples is 5."),
        (["seed=${abc}"], "${abc} takes the value of a key, and there is none of this name."),
        (["run.dir=${seed}"], "seed is not set. Give it a value."),
        (["run.dir=${budget.minutes}"], "budget.minutes is not set. Give it a value."),
        (["run.dir=${budget.nothing}"], "${budget.nothing} takes the value of a key, and there is none of this name."),
        (["run.dir=a${b"], "run.dir='a${b' cannot be read: what follows ${ is no name of a key, or } is missing."),
        (["run.dir=${}"], "run.dir='${}' cannot be read: what follows ${ is no name of a key, or } is missing."),
        (["experiment=miniature/go", "policy.hidden.x.y=3"], "A list has no 'x'. Give the whole list, or the number of a place in it."),
        (["learner-gamma=0.9"], "There is no configuration key 'learner-gamma'. Did you mean 'learner'?"),
    ],
)  # fmt: skip
def test_what_hydra_says_is_said_in_our_words(words: list[str], said: str) -> None:
    with pytest.raises(ConfigError, match=f"^{re.escape(said)}"):
        compose_raw(["task=miniature/go", *words])


@pytest.mark.parametrize("name", ["läufer", "a#b", "'ab'", '"ab"', "a: {ä", "ok: 1, n°"])
def test_names_that_no_mapping_can_have_are_said_to_be_it(name: str) -> None:
    """Only brackets and quotes were, which are right."""
    ends = "}" * (1 + name.count("{"))
    with pytest.raises(ConfigError, match=r"names in {} are of a-z, digits and _-\./, unquoted\."):
        compose_raw(["task=miniature/go", f"reward.terms={{{name}: [1]{ends}"])


@pytest.mark.parametrize("value", ["{a: [b}", "{a: 'b}", "{a: ü, b: [}"])
def test_names_are_not_blamed_for_brackets(value: str) -> None:
    with pytest.raises(ConfigError, match=r"cannot be read\. Check brackets and quotes\.$"):
        compose_raw(["task=miniature/go", f"reward.terms={value}"])


@pytest.mark.parametrize(
    "name", ["lr=0.1,seed=3", "a,", ",", "a=1,2", "ü,ö", "(a,b)", "walk(1),2.bvh", "#1,#2"]
)
def test_names_that_are_several_values_to_nobody_are_text(name: str) -> None:
    """Of one with a comma it was said that its brackets and quotes are wrong, which it does not have."""
    assert compose_raw(["task=miniature/go", f"run.dir={name}"])["run"]["dir"] == name


@pytest.mark.parametrize("values", ["a,b", "1,2", "a b,c", "[a],[b]", "choice(a,b)", "range(1,3)"])
def test_several_values_are_refused(values: str) -> None:
    with pytest.raises(ConfigError, match="has several values and a run takes one"):
        compose_raw(["task=miniature/go", f"run.dir={values}"])


@pytest.mark.parametrize("name", ["lr=0.1", "a (1)", "a(b)=c", r"a\=b"])
def test_names_in_mappings_may_have_what_values_may(name: str) -> None:
    """As variants of a sweep have: ``variants={lr=0.1: […]}``."""
    words = [
        "task=miniature/go",
        "outer_loop=grid",
        f"outer_loop.variants={{{name}: [x=y], b: []}}",
    ]
    variants = compose_raw(words)["outer_loop"]["variants"]
    assert variants == {name.replace("\\", ""): ["x=y"], "b": []}

"""Fault 27: a number in settings that has a unit has a least and a most, wherever it stands; none that is wrong by
orders of magnitude trains without a word."""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Iterator, Mapping
from typing import Any

import pytest
from test_27_sizes import NEEDED, nested, schemas

from understudy.command.cli import main
from understudy.errors import ConfigError
from understudy.options import Option, options_of
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import load

#: Options that are compared with a figure, an option or a field of any unit, or that are looked at where a file is read.
ANY = {
    "at_least": "in a measure's unit",
    "at_most": "in a measure's unit",
    "threshold": "of returns",
    "failed": "an objective",
    "gallery.at": "in a measure's unit",
    "gallery.scale": "between units",
    "stalled.until": "an objective",
    "features.low": "in a measure's unit",
    "features.high": "in a measure's unit",
    "parameters.low": "in an option's unit",
    "parameters.high": "in an option's unit",
    "fidelity.low": "in an option's unit",
    "fidelity.high": "in an option's unit",
    "paper.values": "published",
    "outer_loop/miniature/random.low": "in an option's unit",
    "outer_loop/miniature/random.high": "in an option's unit",
    "memory/redrawn_target.low": "in a field's unit",
    "memory/redrawn_target.high": "in a field's unit",
    "job/harvest.value": "in a field's unit",
    "termination/out_of_bounds.least": "points of a field's unit",
    "termination/out_of_bounds.most": "points of a field's unit",
    "reward/diversity/novelty.found": "features of any unit",
    "knots.decision": "points, looked at where they are joined",
    "knots.episode_limit": "points, looked at where they are joined",
    "curriculum/jumping/accumulated.decision": "points of whole numbers",
    "encoder/pbd/touch.sensors": "points, looked at by the tool's shape",
    "initial_states/chopsticks/open_and_close.arms": "poses, looked at by the arm's ranges",
    "sizes": "of a tool, as many as its kind has: see below",
    "budget.minutes": "a time, at whose end nothing is made",
    "encoder/pbd/touch.face": "a direction of any length",
    "unit": "looked at where a file is read",
    "motion.rate": "looked at where a file is read",
    "size": "of a bound, looked at where it is built",
    "reach": "by axis, looked at where it is built",
    "robot.rest": "by hinge, refused beyond the model's own ranges",
    "run.video_camera": "degrees, round and round",
    "clip": "generated, looked at where it is drawn",
}


def any_is_fine(name: str) -> bool:
    return any(name == a or name.endswith(f".{a}") or name.startswith(f"{a}/") for a in ANY)


def numbers(annotation: Any) -> int | str | None:
    """How many numbers an option takes; 0 where as many as one likes, "dict" by name, None where it takes none."""
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if annotation is float:
        return 1
    if origin is typing.Literal:
        return None
    if origin in (tuple, list):
        if not arguments or numbers(arguments[0]) is None:
            return None
        return len(arguments) if arguments[-1] is not Ellipsis else 0
    if origin is dict or (isinstance(origin, type) and issubclass(origin, Mapping)):
        return "dict" if arguments and numbers(arguments[-1]) == 1 else None
    return next((n for n in map(numbers, arguments) if n is not None), None)


def options_in(
    where: str, schema: Any, above: tuple[Any, ...] = ()
) -> Iterator[tuple[str, Any, Option]]:
    for option in options_of(schema).values():
        if numbers(option.annotation) is not None:
            yield f"{where}.{option.name}", schema, option
        for inner in nested(option.annotation):
            if inner not in above:
                yield from options_in(f"{where}.{option.name}", inner, (*above, inner))


ALL = {
    name: (schema, option)
    for where, factory in schemas(load())
    if where != "root"
    for name, schema, option in options_in(where, factory)
}  # fmt: skip
#: What else an option's dataclass needs to be made.
MORE: dict[str, Any] = {"low": 0.0, "high": 1.0, "samples": 100, "start": 0.1, "end": 0.1, "name": "x", "package": "x",
                        "at": (0.0, 0.0), "until": None, "figure": "x", "least": 1.0, "most": 2.0, "banks": ("x",),
                        "between": {}, "goal": 2, "field": "x", "run": "x", "runs": ("x",)}  # fmt: skip


def test_all_are_found() -> None:
    names = {name for name, (_, option) in ALL.items() if not any_is_fine(name)}
    assert len(names) > 250
    assert {"scene/hand.object.density", "arena.gravity", "reward/jumping/safety.unsafe"} <= names
    assert all(
        any(n == a or n.endswith(f".{a}") or n.startswith(f"{a}/") for n in ALL) for a in ANY
    )


@pytest.mark.parametrize("name", [name for name in ALL if not any_is_fine(name)])
@pytest.mark.parametrize("number", [1e18, -1e18])
def test_it_has_a_least_and_a_most(name: str, number: float) -> None:
    factory, option = ALL[name]
    count = numbers(option.annotation)
    value: Any = (
        number
        if count == 1
        else (number,) * (count or 2)
        if isinstance(count, int)
        else {"x": number}
    )
    if dataclasses.is_dataclass(factory) or hasattr(factory, "Options"):
        schema: Any = factory if dataclasses.is_dataclass(factory) else factory.Options
        fields = dataclasses.fields(schema)
        none = dataclasses.MISSING
        needed = {f.name for f in fields if f.default is none is f.default_factory} | {"trials"}
        needed &= {f.name for f in fields}
        given = {n: v for n, v in {**MORE, **NEEDED}.items() if n in needed}
    else:
        schema, given = (
            getattr(factory, "limits", None),
            {o.name: o.default for o in options_of(factory).values()},
        )
        assert schema is not None, f"{name}: no limits are declared"
    with pytest.raises((ValueError, ConfigError), match=rf"{option.name}\b.* is not possible"):
        schema(**{**given, option.name: value})


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["experiment=chopsticks/relocate", "scene.object.density=1e9"], "scene.object.density=1000000000.0 .* at most 100000"),
        (["experiment=jumping/high", "arena.gravity=1e7"], "arena.gravity=10000000.0 .* at most 10000"),
        (["experiment=miniature/go", "scene.drag=-1"], "scene.drag=-1.0 .* at least 0"),
        (["experiment=miniature/go", "reward.terms.near.scale=-1"], r"reward.terms.near.scale=-1.0 .* at least 1e-09"),
    ],
)  # fmt: skip
def test_it_is_refused_by_its_key_path(words: list[str], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        load_experiment(words)


def test_on_the_command_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert (
        main(
            [
                "train",
                "experiment=jumping/high",
                "+reward.terms.safe={name: jumping/safety, unsafe: 1.5}",
            ]
        )
        == 2
    )
    assert (
        "reward.terms.safe.unsafe=1.5 is not possible: it must be at most 1."
        in capsys.readouterr().err
    )


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["experiment=spacetime/walk", "termination.terms.root.size=40"], "if 40 are degrees, give 0.6981"),
        (["experiment=spacetime/walk", "termination.terms.joints.size=[[0,0.7],[1,40]]"], "if 40 are degrees, give 0.6981"),
        (["experiment=jumping/high", "initial_states.takeoff.alpha=-30"], "if -30 are degrees, give -0.5236"),
        (["experiment=jumping/high", "actuation.margin=30"], "if 30 are degrees, give 0.5236"),
        (["experiment=jumping/high", "+actuation.ranges={chest: [[0, 60]]}"], "if 60 are degrees, give 1.047"),
        (["experiment=jumping/high", "+actuation.rest={chest: [-60]}"], "if 60 are degrees, give 1.047"),
        (["experiment=amorphous/gather", "initial_states.facing=90"], "if 90 are degrees, give 1.571"),
        (["experiment=amorphous/gather", "actuation.tilt=20"], "if 20 are degrees, give 0.3491"),
        (["experiment=morphology/walk", "termination.terms.fallen.limit=45"], "if 45 are degrees, give 0.7854"),
        (["experiment=chopsticks/open_close", "initial_states.amplitude=[7,7]"], "if 7 are degrees, give 0.1222"),
    ],
)  # fmt: skip
def test_an_angle_in_degrees_is_refused_where_it_is_in_rad(words: list[str], said: str) -> None:
    """A bound of 40 rad is never left: the training went on, with one bound less."""
    with pytest.raises(
        ConfigError, match=f"is not possible: it must be at most 6.283 rad, a whole turn; {said}"
    ):
        build_environment(load_experiment(words), num_worlds=1)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["experiment=sitting/sit", "fields.seat.upright=0.78"], "upright=0.78 is not possible: .* if 0.78 are rad, give 44.69"),
        (["experiment=sitting/sit", "fields.seat.facing=1.05"], "facing=1.05 is not possible: .* if 1.05 are rad, give 60.16"),
        (["experiment=sitting/turn_left", "termination.terms.off_course.degrees=0.78"], "if 0.78 are rad, give 44.69"),
    ],
)  # fmt: skip
def test_an_angle_in_rad_is_refused_where_it_is_in_degrees(words: list[str], said: str) -> None:
    """Nothing sat upright to within 0.78 degrees, and the training went on."""
    with pytest.raises(ConfigError, match=said):
        load_experiment(words)

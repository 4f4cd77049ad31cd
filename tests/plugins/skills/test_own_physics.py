"""A policy that acts inside a task of other contacts, self-collision or steps than its own is told of, once for each."""

from __future__ import annotations

import warnings

import pytest

from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment


def told(*overrides: str) -> list[str]:
    """What is said of other physics while a world of sitting/follow is built over a walk."""
    words = ["task=sitting/follow", "actuation.runs=[sitting/walk]", *overrides]
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        build_environment(load_experiment(words), num_worlds=1).environment.close()
    return [text for one in found if "other physics" in (text := str(one.message))]


@pytest.mark.parametrize(
    ("override", "said", "cure"),
    [
        ("scene.self_collision=true", "scene.self_collision is true here and false there", "scene.self_collision=false"),
        ("scene.contact.solref=[0.005,1.0]", "scene.contact.solref is [0.005,1.0] here and null there", "scene.contact.solref=null"),
        ("scene.contact.impratio=10", "scene.contact.impratio is 10.0 here and null there", "scene.contact.impratio=null"),
        ("control.substeps=8", "a step of physics lasts 2.083 ms here and 4.167 ms there", "control.substeps=4"),
    ],
)  # fmt: skip
def test_both_values_are_named_and_what_makes_them_equal(
    override: str, said: str, cure: str
) -> None:
    (sentence,) = told(override)
    assert sentence == (
        f"sitting/walk acts in other physics than that of its own task: {said}. {cure} would make them equal."
    )
    assert told(override, cure) == []


def test_several_are_one_sentence() -> None:
    (sentence,) = told("scene.self_collision=true", "control.substeps=8")
    assert sentence.endswith("scene.self_collision=false control.substeps=4 would make them equal.")


def test_the_same_physics_and_a_trial_in_half_steps_are_not_told_of() -> None:
    assert told() == []
    words = ["task=sitting/follow", "actuation.runs=[sitting/walk]"]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        build_environment(load_experiment(words), num_worlds=1, substeps=8).environment.close()

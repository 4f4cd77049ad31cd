"""What is listed can be composed, or says what it needs; what is said beside a search is used."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest
from stages import above

from understudy.errors import ConfigError, PluginError
from understudy.setup.composition import compose_raw, load_experiment, options
from understudy.setup.plugins import installed

PLUGINS = installed()
LISTED = [(group, name) for group in ("experiment", "search", "ablation")
          for name in options(PLUGINS, group)]  # fmt: skip
LOOPS = [(group, name) for group, name in LISTED if group != "experiment"]
NEED = {
    "experiment=dressing/gown": "scenes.cloth.file",
    "experiment=dressing/gown_gripper": "actuation.run",
    "experiment=dressing/gripper": "actuation.run",
    "experiment=dressing/shirt_sleeve_led": "initial_states.file",
    "experiment=dressing/shirt_finish_led": "initial_states.file",
    "experiment=dressing/shirt_regrip_led": "initial_states.file",
    "experiment=dressing/shirt_sleeve_larger_led": "initial_states.file",
    "experiment=dressing/shirt_sleeve_second_larger_led": "initial_states.file",
    "experiment=dressing/shirt_tuck_second_led": "initial_states.file",
    "experiment=dressing/shirt_sleeve_second_led": "initial_states.file",
    "experiment=dressing/shirt_tuck_led": "initial_states.file",
    "experiment=jumping/from_run_up_gpu": "initial_states.file",
    "experiment=jumping/in_one": "actuation.stages",
    "experiment=miniature/dressing": "initial_states.file",
    "experiment=miniature/in_sequence": "actuation.stages",
    "experiment=miniature/sitting": "actuation.runs",
    "experiment=miniature/sleeve_bank": "job.run",
    "experiment=miniature/styles": "actuation.run",
    "experiment=sitting/ends": "job.run",
    "experiment=sitting/switches": "job.run",
    **{
        f"experiment=sitting/{name}": "initial_states.banks"
        for name in (
            "sit_any_chair", "sit_switched", "sit_tuned", "walk_tuned",
            *(f"turn_{side}_{stage}" for side in ("left", "right")
              for stage in ("slowed", "switched", "tuned")),
        )
    },
    "search=diversity/vault_novel": "outer_loop.search",
    "search=jumping/high_novel": "outer_loop.search",
    "search=jumping/obstacle_novel": "outer_loop.search",
}  # fmt: skip
"""What of those that are listed needs a run or a search, by the key that it is to be given as."""


def test_no_part_of_others_is_listed() -> None:
    assert not any(name.rpartition("/")[2].startswith("_") for _, name in LISTED)
    assert not {"amorphous/small", "sitting/small", "miniature/small"} & {
        name for group, name in LISTED if group == "experiment"
    }


@pytest.mark.parametrize(("group", "name"), LISTED)
def test_it_composes_or_says_what_it_needs(group: str, name: str) -> None:
    chosen, said = f"{group}={name}", ""
    try:
        load_experiment([chosen], PLUGINS)
    except PluginError:  # of something that is not installed here
        return
    except ConfigError as error:
        said = str(error)
    if chosen not in NEED:
        assert said == ""
        return
    assert said.startswith(f"{NEED[chosen]} is not set. It takes ")
    assert "`understudy " in said, "the command that makes it"


@pytest.mark.parametrize(
    "name", [chosen.removeprefix("experiment=") for chosen in NEED if chosen[0] == "e"]
)
def test_it_composes_when_it_is_given_what_it_needs(name: str) -> None:
    """What it needs is missed first, and would hide all other mistakes."""
    load_experiment([f"experiment={name}", *above(name, Path("runs"))], PLUGINS)


def words(options: object) -> set[str]:
    """Every text in nested options."""
    if isinstance(options, Mapping):
        return set().union(*map(words, options.values()))
    if isinstance(options, (list, tuple)):
        return set().union(*map(words, options))
    return {options} if isinstance(options, str) else set()


@pytest.mark.parametrize("name", [name for group, name in LISTED if group == "experiment"])
def test_every_observation_is_read(name: str) -> None:
    """By a network, or by another part of the policy: what no option of it names is computed for nobody. A policy says so
    when it trains; a grip was trained so without its target."""
    try:
        needed = above(name, Path("runs")) if f"experiment={name}" in NEED else ()
        experiment = load_experiment([f"experiment={name}", *needed], PLUGINS)
        policy = experiment.need("policy")
    except (PluginError, ConfigError):  # what is not installed here, and jobs without a policy
        return
    observed = {part.name for part in experiment.many("encoder")}
    assert observed <= words(policy.effective())


@pytest.mark.parametrize("section", PLUGINS.registry.sections)
def test_a_section_is_emptied_by_null(section: str) -> None:
    """As a part is, whether or not anything sets it."""
    for words in ([], [f"{section}.some=1"], ["experiment=spacetime/walk"]):
        assert compose_raw([*words, f"{section}=null"], PLUGINS)[section] is None


@pytest.mark.parametrize("section", PLUGINS.registry.sections)
@pytest.mark.parametrize("value", ["some", "3", "/some/file", "[1]"])
def test_what_a_section_takes_is_said(section: str, value: str) -> None:
    with pytest.raises(ConfigError, match=f"{section}=.* is not possible: it takes a mapping of "):
        load_experiment([f"{section}={value}"], PLUGINS)


@pytest.mark.parametrize(("group", "name"), LOOPS)
def test_an_experiment_beside_it_is_used(group: str, name: str) -> None:
    """It is a default of the file, in the place where an override is, or it is no choice at all."""
    given = [f"{group}={name}", "experiment=miniature/go"]
    if f"{group}={name}" in NEED:
        given.append("outer_loop.search=somewhere")
    assert compose_raw(given, PLUGINS)["task"] == "miniature/go"


@pytest.mark.parametrize(
    ("override", "answer"),
    [
        ("seed= 3", "it takes a whole number"),
        ("seed=3 ", "it takes a whole number"),
        ("num_worlds=\t8", "it takes a whole number"),
        ("learner.gamma=0.9 ", "it takes a number"),
        ("learner.precision= float32", "Did you mean 'float32'"),
        ("policy= mlp", "Did you mean 'mlp'"),
        ("experiment= miniature/go", "Did you mean 'miniature/go'"),
        ("seed =3", "Write seed=3"),
        (" seed=3", "Write seed=3"),
    ],
)
def test_blanks_are_refused(override: str, answer: str) -> None:
    with pytest.raises(ConfigError, match=answer):
        load_experiment(["experiment=miniature/go", override], PLUGINS)


@pytest.mark.parametrize("value", [" walk", "walk ", " a b "])
def test_blanks_of_names_are_kept(value: str) -> None:
    raw = compose_raw(["experiment=spacetime/walk", f"motion.name={value}"], PLUGINS)
    assert raw["motion"]["name"] == value


@pytest.mark.parametrize("value", [" [1, 2]", "[ 1, 2 ] ", "[1, 2]\t"])
def test_blanks_around_structures_mean_nothing(value: str) -> None:
    raw = compose_raw(["experiment=miniature/go", f"policy.hidden={value}"], PLUGINS)
    assert raw["policy"]["hidden"] == [1, 2]

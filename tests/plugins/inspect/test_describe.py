"""What is said about a part."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from understudy.errors import ConfigError, PluginError
from understudy.options import REQUIRED
from understudy.setup.plugins import installed
from understudy_inspect.describe import describe, names


def test_a_learner() -> None:
    text = describe("learner/ppo", installed())
    assert text.startswith("learner/ppo: PPO: clipped, KL penalty, or both\n")
    assert "plugin ppo (understudy " in text
    assert re.search(r"^  gamma=0\.95 +number; discount of a decision", text, re.M)
    assert re.search(
        r"^  rollout_steps=16 +whole number; T, steps per world and iteration$", text, re.M
    )
    assert re.search(r"^  clip=0\.2 +number or null; ε; null leaves it to kl_penalty$", text, re.M)
    assert re.search(r"^  kl_penalty\.target=0\.01 ", text, re.M), "options of an option"
    assert "thesis' (section 3.5)" in text, "where defaults are from"
    assert "learner=spacetime/walk" in text
    assert "arXiv:1707.06347" in text
    assert describe("ppo", installed()) == text


def test_a_term() -> None:
    text = describe("termination/beyond", installed())
    assert re.search(r"^  limit=… +number; in the field's unit$", text, re.M), "it has to be given"
    assert re.search(r'^  outcome="failure" +failure or ', text, re.M)
    assert "Reads: value." in text


@pytest.mark.parametrize(
    ("name", "begins"),
    [("termination/beyond", "def beyond("), ("learner/ppo", "class PPO(")],
)
def test_where_a_part_is_defined(name: str, begins: str) -> None:
    found = re.search(r"^in (.+), line (\d+)$", describe(name, installed()), re.M)
    assert found is not None
    assert begins in Path(found[1]).read_text(encoding="utf-8").splitlines()[int(found[2]) - 1]


def test_a_file_of_options() -> None:
    text = describe("experiment/spacetime/walk", installed())
    assert "(plugin spacetime: experiment/spacetime/walk.yaml)" in text
    assert "samples: 4080000" in text
    assert "rollout_steps=16" in describe("learner/spacetime/walk", installed())


def test_a_group_of_the_kernels() -> None:
    assert re.search(
        r"^  episodes=64 +whole number; of one draw", describe("evaluation", installed()), re.M
    )


def test_all_that_can_be_described() -> None:
    """Each has every option of the part in its text, with the default that is used."""
    plugins = installed()
    for (kind, name), component in plugins.registry.components.items():
        if kind == "command":
            continue
        try:
            text = describe(f"{kind}/{name}", plugins)
        except PluginError:  # an extra that is not installed here
            continue
        for option in component.options.values():
            assert re.search(rf"^  {option.name}(=|\.)", text, re.M), (kind, name, option.name)
            if option.default is REQUIRED:
                assert f"  {option.name}=…" in text
    assert {"learner/ppo", "experiment/spacetime/walk", "evaluation"} <= set(names(plugins))


def test_several_of_one_name() -> None:
    with pytest.raises(
        ConfigError, match=r"^There are several 'bvh': clip_reader/bvh, clip_writer/bvh\.$"
    ):
        describe("bvh", installed())

"""What parts make of the fields that they read, tried before a training: said in a sentence that names the part."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from torch import Tensor

from understudy.command.cli import main
from understudy.errors import ConfigError
from understudy.running.environment import Environment
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy_reinforcement import promised


def go(*words: str) -> Environment:
    return build_environment(
        load_experiment(["experiment=miniature/go", "num_worlds=4", *words])
    ).environment


def shifted(distance: Tensor) -> Tensor:
    return distance.add_(100.0)


def with_reward(function: Callable[..., Any]) -> Environment:
    """The task with a reward of a plugin's own, which reads the distance."""
    environment = go()
    first, *others = environment.parts.rewards
    changed = replace(first, function=function, reads={"distance": "distance"}, options={})
    environment.parts.rewards = [changed, *others]
    return environment


@pytest.mark.parametrize(
    ("function", "sentence"),
    [
        (shifted, "writes into the field 'distance', which others read"),
        (lambda distance: None, "returns a NoneType: it must return a tensor"),
        (lambda distance: distance.numpy(), "returns a ndarray: it must return a tensor"),
        (lambda distance: 1.0, "returns a float: it must return a tensor"),
    ],
)
def test_a_part_that_keeps_no_promise_is_named(function: Callable[..., Any], sentence: str) -> None:
    environment = with_reward(function)
    where = environment.parts.rewards[0].where
    with pytest.raises(ConfigError, match=sentence) as refused:
        promised.begin(environment)
    assert str(refused.value).startswith(where)


def test_what_a_part_raises_of_itself_is_its_own() -> None:
    def broken(distance: Tensor) -> Tensor:
        raise KeyError("a defect")

    with pytest.raises(KeyError, match="a defect"):
        promised.begin(with_reward(broken))


def test_fields_of_another_shape_are_the_users(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "run"
    reads = "encoder.state.reads={offset: distance}"
    assert main(["train", "experiment=miniature/go", reads, f"run.dir={run}"]) == 2
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert "encoder.state cannot use what its reads gives it: distance []." in said
    assert not run.exists()


MISFITS = (
    ("encoder.state.reads={offset: distance}", "encoder.state cannot use what its reads gives it: distance []."),
    ("measure.distance.index=5", "measure.distance cannot use what its reads gives it: distance []."),
)  # fmt: skip


@pytest.mark.parametrize(("word", "sentence"), MISFITS)
@pytest.mark.parametrize(
    "command",
    ["evaluate RUN", "render RUN", "play RUN --video FILM", "describe --observations RUN"],
)
def test_words_that_misfit_what_was_learned_are_the_users(
    built_on: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str, word: str, sentence: str
) -> None:  # fmt: skip
    """Trainings said so; whatever judged, drew or described a run with such words ended in a traceback."""
    shutil.copytree(built_on / "go", tmp_path / "go")
    named = {"RUN": str(tmp_path / "go"), "FILM": str(tmp_path / "film.mp4")}
    assert main([*(named.get(part, part) for part in command.split()), word]) == 2
    assert sentence in capsys.readouterr().err
    assert not (tmp_path / "film.mp4").exists()
    assert not (tmp_path / "go/renders").exists()


@pytest.mark.parametrize(("word", "sentence"), MISFITS)
def test_the_environments_own_reset_says_so(word: str, sentence: str) -> None:
    environment = go(word)
    with pytest.raises(ConfigError) as refused:
        environment.reset()
    assert str(refused.value).startswith(sentence)


def test_it_begins_as_a_reset_does() -> None:
    """Trying the parts changes nothing of what follows."""
    seen = []
    for begin in (Environment.reset, promised.begin):
        environment = go("seed=3")
        first = begin(environment)["state"].clone()
        step = environment.step(torch.full_like(environment.action, 0.3))
        seen.append(torch.cat([first, step.observations["state"], step.rewards[:, None]], dim=1))
    assert torch.equal(*seen)


def test_the_part_that_misfits_is_named_and_not_one_that_reads_of_it() -> None:
    environment = go("fields.offset.reads={target: episode_time}")
    early = SimpleNamespace(compute=lambda far: {}, provides={})
    reader = SimpleNamespace(where="fields.early", reads={"far": "distance"}, part=early)
    environment.parts.fields = [reader, *environment.parts.fields]  # type: ignore[list-item]
    with pytest.raises(ConfigError, match=r"fields\.offset cannot use what its reads gives it"):
        environment.reset()


def test_too_little_memory_is_no_misfit() -> None:
    def large(distance: Tensor) -> Tensor:
        raise torch.OutOfMemoryError("out of memory")

    environment = with_reward(large)
    first, *others = environment.parts.rewards
    environment.parts.rewards = [replace(first, reads={"distance": "episode_time"}), *others]
    with pytest.raises(torch.OutOfMemoryError):
        environment.reset()

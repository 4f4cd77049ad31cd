"""What parts make of the fields that they read, tried before a training: said in a sentence that names the part."""

from __future__ import annotations

import functools
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


def spoiled(environment: Environment, where: str, change: Callable[[Any], Any]) -> None:
    """Have the part at `where` return what `change` makes of what it returns."""
    parts: Any = environment.parts
    part, method = {
        "encoder.state": lambda: (parts.encoders["state"].part, "encode"),
        "actuation": lambda: (parts.actuation.part, "control"),
        "fields.offset": lambda: (next(f.part for f in parts.fields if f.where == "fields.offset"), "compute"),
        "memory.target": lambda: (parts.memories["target"].part, "begin"),
        "memory.target later": lambda: (parts.memories["target"].part, "advance"),
        "initial_states": lambda: (parts.initial_states, "sample"),
        "curriculum": lambda: (parts.curriculum, "begin"),
    }[where]()  # fmt: skip
    own = getattr(part, method)
    setattr(
        part, method, functools.wraps(own)(lambda *given, **fields: change(own(*given, **fields)))
    )


def each(change: Callable[[Any], Any]) -> Callable[[Any], Any]:
    def changed(given: Any) -> Any:
        return (
            {name: change(v) for name, v in given.items()}
            if isinstance(given, dict)
            else change(given)
        )

    return changed


CHANGES: dict[str, tuple[Callable[[Any], Any], str]] = {
    "nothing": (lambda given: None, "a NoneType: "),
    "a list": (each(Tensor.tolist), "a list: "),
    "numpy": (each(Tensor.numpy), "a ndarray: "),
    "complex": (each(lambda value: value.to(torch.complex64)), "torch.complex64, torch.strided, on cpu: "),
    "sparse": (each(Tensor.to_sparse), "torch.float32, torch.sparse_coo, on cpu: "),
    "elsewhere": (each(lambda value: value.to("meta")), "torch.float32, torch.strided, on meta: "),
    "more dimensions": (each(lambda value: value[None]), r" has shape \(1, 4"),
}  # fmt: skip


@pytest.mark.parametrize("what", CHANGES)
@pytest.mark.parametrize(
    "where",
    ["encoder.state", "actuation", "fields.offset", "memory.target", "memory.target later", "initial_states", "curriculum"],
)  # fmt: skip
def test_what_is_no_tensor_of_numbers_is_named(where: str, what: str) -> None:
    """Each was a traceback from within the kernel, or was trained with."""
    if what == "complex" and where in ("initial_states", "curriculum"):
        return  # written into tensors of real numbers, which is said by torch
    environment = go("curriculum={name: linear, samples: 100}")
    change, sentence = CHANGES[what]
    spoiled(environment, where, change)
    with pytest.raises(ConfigError, match=sentence) as refused:
        promised.begin(environment)
    assert where.partition(" ")[0].replace("offset", "") in str(refused.value)


@pytest.mark.parametrize("where", ["encoder.state", "actuation"])
@pytest.mark.parametrize("dtype", [torch.float64, torch.int64, torch.bool])
def test_networks_and_simulators_take_float32(where: str, dtype: torch.dtype) -> None:
    environment = go()
    spoiled(environment, where, lambda value: value.to(dtype))
    with pytest.raises(ConfigError, match=rf"^{where} returns {dtype}; it must return float32"):
        promised.begin(environment)


def test_a_part_that_does_not_take_what_it_reads_is_named() -> None:
    environment = go()
    encoder = environment.parts.encoders["state"]
    environment.parts.encoders = {"state": replace(encoder, reads={})}
    with pytest.raises(
        ConfigError, match="says that it reads no field, and its encode does not take that: missing"
    ):
        promised.begin(environment)


@pytest.mark.parametrize(
    ("given", "why"),
    [(None, "returns a NoneType"), ([1.0], "returns a list"), ({"a": "b"}, "'a' as a str"), ({3: 1.0}, "3 as a float"),
     ({"a": torch.ones(2)}, "'a' as a Tensor"), ({"a": 1j}, "'a' as a complex"), ({"a": None}, "'a' as a NoneType")],
)  # fmt: skip
def test_metrics_are_numbers_by_name(given: Any, why: str) -> None:
    """Each ended a training in a traceback once its row was to be written."""
    with pytest.raises(ConfigError, match=rf"^part .*{why}: it must return numbers by name"):
        promised.figures("part", given)
    assert promised.figures("part", {"a": 2, "b": torch.tensor(0.5)}) == {"a": 2, "b": 0.5}


@pytest.mark.parametrize(
    ("method", "value", "why"),
    [("stage", None, "where it stands by a NoneType"), ("stage", 3, "by a int"), ("decision", "often", "'often' control periods"),
     ("decision", 0, "0 control periods"), ("decision", 1.5, "1.5 control periods"), ("decision", True, "True control")],
)  # fmt: skip
def test_what_a_curriculum_says_of_itself(method: str, value: Any, why: str) -> None:
    curriculum = go("curriculum={name: linear, samples: 100}").parts.curriculum
    promised.check_curriculum(curriculum)
    setattr(curriculum, method, lambda: value)
    with pytest.raises(ConfigError, match=why):
        promised.check_curriculum(curriculum)


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

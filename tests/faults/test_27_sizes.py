"""Fault 27: a number in settings that becomes a size or a count has an end, wherever it stands; a policy
or a task that still asks for too much says so in a sentence, before there is memory for it."""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
from worlds import SMALL

from understudy.command.cli import main
from understudy.errors import ConfigError, PluginError
from understudy.options import Option, options_of
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import Plugins, load
from understudy.setup.root import Root
from understudy.testing.fake import FAKE_TASK
from understudy_bayes.space import Parameter
from understudy_diversity.strategies import Feature
from understudy_reinforcement.policy import build_policy, enough_memory

HUGE = 10**12
#: Options that are neither sizes nor counts of anything that is made or done.
NEITHER = {
    "samples": "a time, at whose end nothing is made",
    "usual_samples": "a time that is shown",
    "every_samples": "a time",
    "index": "an index, compared with what there is",
    "seed": "names random streams",
    "seeds": "name random streams",
    "fields/miniature/body.number": "an index",
    "measure/morphology/normalised.steps": "a divisor",
    "measure/sequencing/completed.number": "an index, compared with what there is",
    "termination/sequencing/overtime.only": "an index, compared with what there is",
    "resolution.substeps": "at most control.substeps",
}


def neither(name: str) -> str:
    return NEITHER.get(name) or NEITHER.get(name.rpartition(".")[2], "")


#: Options without which others are not looked at.
NEEDED: dict[str, Any] = {
    "bank": "bank", "clips": ("clip",), "distinct": 1.0, "feature_field": "x", "file": "file", "features": {"measure": Feature(low=0.0, high=1.0)},
    "high": {"x": 2.0}, "length": 2, "low": {"x": 1.0}, "parameters": {"x": Parameter(low=1.0, high=2.0)},
    "run": "run", "runs": ("run",), "search": "search", "seconds": 1.0, "shape": (3,), "style": "style", "threshold": 1.0,
    "trials": 10,
}  # fmt: skip


def whole(annotation: Any) -> int | None:
    """How many whole numbers an option takes; 0 where as many as one likes, None where it takes none."""
    arguments = typing.get_args(annotation)
    if annotation is int:
        return 1
    if typing.get_origin(annotation) in (tuple, list):
        if not arguments or arguments[0] is not int:
            return None
        return 0 if arguments[-1] is Ellipsis else len(arguments)
    if typing.get_origin(annotation) is typing.Literal:
        return None
    found = [n for n in map(whole, arguments) if n is not None]
    return found[0] if found else None


def schemas(plugins: Plugins) -> Iterator[tuple[str, type]]:
    yield "root", Root
    for option in options_of(Root).values():
        if dataclasses.is_dataclass(option.annotation):
            yield option.name, option.annotation  # type: ignore[misc]
    for name, section in plugins.registry.sections.items():
        yield name, section.options.factory
    for (kind, name), component in sorted(plugins.registry.components.items()):
        try:
            factory: Any = component.factory
        except PluginError:  # not installed here
            continue
        if kind != "command":
            yield f"{kind}/{name}", factory


def nested(annotation: Any) -> Iterator[type]:
    """The dataclasses that an option's value is, or has in it."""
    if dataclasses.is_dataclass(annotation) and isinstance(annotation, type):
        yield annotation
    for argument in typing.get_args(annotation):
        yield from nested(argument)


def options_in(where: str, schema: Any) -> Iterator[tuple[str, Any, Option]]:
    for option in options_of(schema).values():
        if whole(option.annotation) is not None:
            yield f"{where}.{option.name}", schema, option
        for inner in nested(option.annotation) if where != "root" else ():
            yield from options_in(f"{where}.{option.name}", inner)


ALL = [one for where, schema in schemas(load()) for one in options_in(where, schema)]


def test_all_are_found() -> None:
    """So many are known, of parts of every wing; those that are neither exist."""
    names = {name for name, _, _ in ALL}
    assert len(names) > 90
    assert {"policy/mlp.hidden", "control.substeps", "learner/ppo.epochs"} <= names
    assert all(any(word in (n, n.rpartition(".")[2]) for n in names) for word in NEITHER)


@pytest.mark.parametrize(("name", "factory", "option"), ALL, ids=[name for name, _, _ in ALL])
def test_it_has_an_end(name: str, factory: Any, option: Option) -> None:
    schema = factory if dataclasses.is_dataclass(factory) else getattr(factory, "Options", None)
    if reason := neither(name):
        pytest.skip(reason)
    assert isinstance(schema, type), f"{name} has no range: a term's options are not checked"
    own = {f.name for f in dataclasses.fields(schema)}
    given = {key: value for key, value in NEEDED.items() if key in own}
    count = whole(option.annotation) or 0
    fitting = option.annotation is int or count == 1
    value = HUGE if fitting else (HUGE,) * (count or 1)
    if name == "policy/cnn.filters":
        value = (HUGE, HUGE)
    if typing.get_origin(option.annotation) is dict:
        value = {"one": HUGE}
    if option.name == "batch_size" and "minibatches" in own:
        given["minibatches"] = None
    with pytest.raises(ValueError, match=rf"^{option.name}(\.one)?=.* is not possible: "):
        schema(**{**given, option.name: value})


def composed(*overrides: str, plugins: Plugins | None = None) -> Any:
    return load_experiment([*FAKE_TASK, *SMALL, *overrides], plugins)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["policy.hidden=[300000, 300000]"], r"^policy\.hidden=.*the network would be too large"),
        ([f"policy.hidden={[16] * 101}"], r"^policy\.hidden=.*the network would be too large"),
        (["policy.hidden=[50000000]"], "network of layers of .* is too large"),
        (["control.frequency=1e-300"], r"^control\.frequency=1e-300 .* at least 0\.001"),
        (["control.substeps=100000"], r"^control\.substeps=100000 .* at most 10000"),
        (["control.substeps=5000", "control.decision=100"], r"^control\.decision=100 .* 100000 steps of physics"),
        (["episode.seconds=0.001"], r"^episode\.seconds=0\.001 is not possible: a decision lasts 0\.0333"),
        (["evaluation.seconds=0.0999", "control.decision=3"], r"^evaluation\.seconds=0\.0999 .* a decision lasts 0\.1 s"),
        (["evaluation.seconds=1e6", "control.frequency=1000"], r"^evaluation\.seconds=1e\+06 .* 1000000 decisions"),
        (["evaluation.final_episodes=999999"], r"^evaluation\.final_episodes=999999 .* 100000000 decisions"),
        (["evaluation.episodes=1000000", "evaluation.seconds=4"], r"^evaluation\.episodes=1000000 .* 100000000 decisions"),
        (["num_worlds=1e9"], r"^num_worlds=1000000000 .* at most 1e\+06"),
        (["run.video_size=[100000, 100000]"], r"^run\.video_size=.* at most 8192"),
        (["run.video_seconds=1e9"], r"^run\.video_seconds=.* at most 3600"),
    ],
)  # fmt: skip
def test_what_asks_for_too_much(plugins: Plugins, overrides: list[str], message: str) -> None:
    def build() -> None:
        experiment = composed(*overrides, plugins=plugins)
        build_policy(experiment, build_environment(experiment).context)

    with pytest.raises(ConfigError, match=message):
        build()


@pytest.mark.parametrize(
    "error",
    [MemoryError(), RuntimeError("DefaultCPUAllocator: can't allocate memory: you tried to …"),
     RuntimeError("CUDA out of memory. Tried to allocate 360 GiB")],
)  # fmt: skip
def test_memory_that_there_is_not(error: Exception) -> None:
    told = pytest.raises(ConfigError, match="The policy asks for more memory than there is")
    with told, enough_memory("policy"):
        raise error
    with pytest.raises(RuntimeError, match="else"), enough_memory("policy"):
        raise RuntimeError("something else")


def test_sizes_of_a_scene_together() -> None:
    words = ["scene.blocks=100", "scene.block=[100, 100, 100]", "scene.resolution=3"]
    with pytest.raises(ConfigError, match=r"^scene\.blocks=100 .* more than 100000 particles"):
        load_experiment(["experiment=amorphous/gather_small", *words])


def test_a_rollout_that_no_memory_holds_leaves_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each size alone is possible. It ended in a traceback, and left a run."""
    words = ["experiment=miniature/go", "num_worlds=50000", "learner.rollout_steps=100000"]
    words += ["learner.minibatches=null", "learner.batch_size=64"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(torch, "empty", scarce(torch.empty))
        assert main(["train", *words, f"run.dir={tmp_path / 'run'}"]) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    said = "The rollout (num_worlds=50000 times learner.rollout_steps=100000) asks for more memory"
    assert error.startswith(f"understudy: {said}")
    assert not (tmp_path / "run").exists()


def scarce(allocate: Any) -> Any:
    """`allocate` where no more than a tenth of a tebibyte can be had, as an allocator says it."""

    def given(*size: Any, **options: Any) -> torch.Tensor:
        if isinstance(size[0], int) and size[0] > 10**11:
            raise RuntimeError("DefaultCPUAllocator: can't allocate memory: you tried to …")
        return allocate(*size, **options)

    return given


def test_on_the_command_line(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["experiment=miniature/go", "policy.hidden=[300000,300000]"]
    assert main(["train", *words]) == 2
    error = capsys.readouterr().err
    assert error.startswith("understudy: policy.hidden=(300000, 300000) is not possible")
    assert error.count("\n") == 1

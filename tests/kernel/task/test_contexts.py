"""What parts are told of the task that they are built for."""

from __future__ import annotations

import pytest
import torch

from understudy.errors import ConfigError
from understudy.task import Context, box
from understudy.testing import FakeScene


def context() -> Context:
    return Context(
        seed=0, device=torch.device("cpu"), num_worlds=4, control_dt=0.1, substeps=2,
        sections={"motion": [1, 2]},
    )  # fmt: skip


def test_shared_objects_are_built_once() -> None:
    here = context()
    built: list[int] = []
    for _ in range(3):
        assert here.once("a", lambda: built.append(1) or [7]) == [7]
    assert len(built) == 1
    assert here.once("b", lambda: "other") == "other"
    assert context().once("a", lambda: "another task's") == "another task's"


def test_scenes() -> None:
    here = context()
    with pytest.raises(
        ConfigError, match=r"^it needs a scene of type FakeScene, but the task has no scene\."
    ):
        here.need_scene(FakeScene, "it")
    here.scene = FakeScene()
    assert here.need_scene(FakeScene, "it") is here.scene


def test_sections() -> None:
    assert context().need_section("motion", list, "it") == [1, 2]
    for name, kind in (("motion", dict), ("walk", list)):
        with pytest.raises(ConfigError, match=rf"^it needs the config section '{name}'"):
            context().need_section(name, kind, "it")


def test_the_size_of_actions() -> None:
    here = context()
    assert here.action_size == 0
    here.action_space = box(5)
    assert here.action_size == 5

"""Components are imported when they are used; here all of them are, commands and readers too."""

from __future__ import annotations

import dataclasses
import importlib
import typing
from collections.abc import Iterator
from contextlib import suppress
from importlib.util import find_spec
from typing import Any

import pytest

from understudy.errors import PluginError
from understudy.options import options_of
from understudy.setup.plugins import installed
from understudy.setup.root import Root
from understudy.testing import check_component
from understudy.testing.conformance import unsaid
from understudy.testing.sentences import sentences


def test_every_component_can_be_imported_and_every_option_has_a_sentence() -> None:
    broken = {}
    for component in installed().registry.components.values():
        if component.plugin == "mujoco_warp" and find_spec("mujoco_warp") is None:
            continue
        try:
            check_component(component)
        except AssertionError as error:
            broken[f"{component.kind}/{component.name}"] = str(error)
        except PluginError as error:
            missing = getattr(error.__cause__, "name", None) or "understudy"
            if isinstance(error.__cause__, ModuleNotFoundError) and "understudy" not in missing:
                continue  # what an extra brings
            broken[f"{component.kind}/{component.name}"] = str(error)
    assert broken == {}


def short(schema: Any) -> Iterator[str]:
    """The options, those within options too, whose sentence says too little: a unit alone, say."""
    said = sentences(schema)
    for name, option in options_of(schema).items():
        if len(said.get(name, "").split()) < 3:
            yield f"{name}: {said.get(name)}"
        for item in (option.annotation, *typing.get_args(option.annotation)):
            if dataclasses.is_dataclass(item):
                yield from (f"{name}.{inner}" for inner in short(item))


@dataclasses.dataclass(frozen=True)
class Far:
    most: float = 1.0  #: m


@dataclasses.dataclass(frozen=True)
class Near:
    least: float = 1.0  #: m, above 0
    far: Far = Far()  #: what lies beyond


def test_a_unit_alone_is_no_sentence() -> None:
    assert list(short(Near)) == ["far.most: m"]
    schemas = {"": Root, **{n: s.options.factory for n, s in installed().registry.sections.items()}}
    for component in installed().registry.components.values():
        if component.plugin != "mujoco_warp" or find_spec("mujoco_warp"):
            with suppress(PluginError):  # what an extra brings
                schemas[f"{component.kind}/{component.name}"] = component.factory
    assert len(schemas) > 300
    assert {name: found for name, schema in schemas.items() if (found := list(short(schema)))} == {}


def test_so_has_every_option_of_the_kernel_and_of_the_plugins_sections() -> None:
    sections = installed().registry.sections.values()
    for schema in (Root, *(section.options.factory for section in sections)):
        assert list(unsaid(schema)) == []


#: What finds something by searching or by solving equations, and is no component.
SOLVERS = (
    "understudy_gripping.balance:balance", "understudy_gripping.descent:minimise",
    "understudy_gripping.pose:PoseSolver", "understudy_tool_planner.arm:solve",
    "understudy_tool_planner.planner:Planner", "understudy_retarget.solver:solve",
    "understudy_amorphous.inverse_kinematics:follow",
)  # fmt: skip


def test_every_simulator_says_where_it_ends() -> None:
    """In a line of its docstring that begins with *Limits:*."""
    found = installed().registry.components.values()
    simulators = [c for c in found if c.kind == "simulator"]
    assert len(simulators) > 5
    lacking = [
        c.name
        for c in simulators
        if (c.plugin != "mujoco_warp" or find_spec("mujoco_warp"))
        and "*Limits:*" not in (c.factory.__doc__ or "")
    ]
    assert lacking == []


@pytest.mark.parametrize("place", SOLVERS)
def test_every_solver_says_where_it_ends(place: str) -> None:
    module, _, name = place.partition(":")
    if module == "understudy_amorphous.inverse_kinematics":
        pytest.importorskip("mink", reason="inverse kinematics needs mink")
    assert "*Limits:*" in (getattr(importlib.import_module(module), name).__doc__ or "")

"""One spelling of names: the one that is typed."""

from __future__ import annotations

import pytest

from understudy.errors import ConfigError, PluginError
from understudy.setup.plugins import installed
from understudy.setup.registry import Registrar, Registry

DOT = "."


def test_every_name_is_as_it_is_typed() -> None:
    registry = installed().registry
    assert not [name for _, name in registry.components if DOT in name]
    assert not [name for name in registry.tasks if DOT in name]


def test_the_former_spelling_is_answered_with_the_one_that_is_typed() -> None:
    registry = installed().registry
    for kind, name in registry.components:
        if "/" in name:
            with pytest.raises(ConfigError) as refused:
                registry.find(kind, name.replace("/", DOT))
            assert f"Did you mean '{name}'?" in str(refused.value)


@pytest.mark.parametrize("name", [f"mine{DOT}part", f"part{DOT}"])
def test_a_plugin_that_registers_a_dot_is_told_what_to_write(name: str) -> None:
    register = Registrar(Registry(), "mine")
    typed = name.replace(DOT, "/")
    with pytest.raises(PluginError, match=f"Write it as the learner '{typed}'"):
        register.component("learner", name, object)
    with pytest.raises(PluginError, match=f"Write it as the task '{typed}'"):
        register.task(name, "a task")

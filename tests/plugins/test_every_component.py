"""Components are imported when they are used; here all of them are, commands and readers too."""

from __future__ import annotations

from understudy.errors import PluginError
from understudy.setup.plugins import installed


def test_every_component_can_be_imported_and_says_its_options() -> None:
    broken = {}
    for component in installed().registry.components.values():
        try:
            _ = component.factory, component.options
        except PluginError as error:
            missing = getattr(error.__cause__, "name", None) or "understudy"
            if isinstance(error.__cause__, ModuleNotFoundError) and "understudy" not in missing:
                continue  # what an extra brings
            broken[f"{component.kind}/{component.name}"] = str(error)
    assert broken == {}

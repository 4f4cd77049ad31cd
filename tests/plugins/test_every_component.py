"""Components are imported when they are used; here all of them are, commands and readers too."""

from __future__ import annotations

from importlib.util import find_spec

from understudy.errors import PluginError
from understudy.setup.plugins import installed
from understudy.setup.root import Root
from understudy.testing import check_component
from understudy.testing.conformance import unsaid


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


def test_so_has_every_option_of_the_kernel_and_of_the_plugins_sections() -> None:
    sections = installed().registry.sections.values()
    for schema in (Root, *(section.schema() for section in sections)):
        assert list(unsaid(schema)) == []

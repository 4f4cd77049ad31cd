"""Components are imported when they are used; here all of them are, commands and readers too."""

from __future__ import annotations

import contextlib
from importlib.util import find_spec

from understudy.errors import PluginError
from understudy.setup.plugins import installed


def test_every_component_can_be_imported_and_says_its_options() -> None:
    broken = {}
    for component in installed().registry.components.values():
        if component.plugin == "mujoco_warp" and not _has_warp():
            continue
        try:
            _ = component.factory, component.options
        except PluginError as error:
            missing = getattr(error.__cause__, "name", None) or "understudy"
            if isinstance(error.__cause__, ModuleNotFoundError) and "understudy" not in missing:
                continue  # what an extra brings
            broken[f"{component.kind}/{component.name}"] = str(error)
    assert broken == {}


def _has_warp() -> bool:
    """Whether MuJoCo Warp is here; a folder of tests has its name, so the name alone says nothing."""
    with contextlib.suppress(ImportError):
        return find_spec("mujoco_warp._src") is not None
    return False

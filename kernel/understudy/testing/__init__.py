"""For those who write plugins: a simulator without physics, and checks of conformance.

A third party's test is one line: ``check_plugin("my_plugin")`` builds and checks all that it
registers.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from understudy.testing.capture import check_capturable
    from understudy.testing.conformance import (
        check_component,
        check_environment,
        check_plugin,
        check_simulator,
    )
    from understudy.testing.fake import FakeScene, FakeSimulator, fake_plugins

__all__ = [
    "FakeScene",
    "FakeSimulator",
    "check_capturable",
    "check_component",
    "check_environment",
    "check_plugin",
    "check_simulator",
    "fake_plugins",
]

#: Where each name is. They import torch, which who only reads sentences does without.
_MODULES = {
    **dict.fromkeys(("FakeScene", "FakeSimulator", "fake_plugins"), "fake"),
    **dict.fromkeys(("check_component", "check_environment", "check_plugin"), "conformance"),
    "check_simulator": "conformance",
    "check_capturable": "capture",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)

"""For those who write plugins: a simulator without physics, and checks of conformance.

A third party's test is one line: ``check_plugin("my_plugin")`` builds and checks all that it
registers.
"""

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

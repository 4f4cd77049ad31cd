"""Flights from which no controller can go on as the clip does."""

from __future__ import annotations

from dataclasses import replace

import pytest

from understudy.setup.plugins import Plugins
from understudy_characters.character import Character, load_character
from understudy_doctor.findings import Finding
from understudy_doctor.flight_check import check_flights
from understudy_doctor.measurements import Measurements
from understudy_motion.clip import Clip


@pytest.fixture(scope="module")
def humanoid(plugins: Plugins) -> Character:
    return load_character("humanoid", plugins.registry)


def found(clip: Clip, humanoid: Character) -> list[Finding]:
    return list(check_flights(clip, Measurements(clip, humanoid)))


def test_a_flight_that_obeys_gravity_is_none(plugins: Plugins, humanoid: Character) -> None:
    clip: Clip = plugins.registry.find("clip", "backflip").factory()
    assert not found(clip, humanoid)


def test_a_flight_in_slow_motion_cannot_be_flown(plugins: Plugins, humanoid: Character) -> None:
    """At 1.3 times the time a body falls 1.7 times too slowly: it would land long before the clip does."""
    clip: Clip = plugins.registry.find("clip", "backflip").factory()
    slow = replace(clip, times=1.3 * clip.times)
    (finding,) = found(slow, humanoid)
    low = Measurements(slow, humanoid)
    air = low.heights.min(1) - low.ground > 0.03
    assert finding.kind == "flight"
    assert air[finding.first : finding.last + 1].all()
    assert finding.value > 1.0
    assert finding.start > 0.3
    assert "spacetime/evolution" in finding.remedy

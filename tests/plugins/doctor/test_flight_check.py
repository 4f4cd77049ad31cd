"""Flights from which no controller can go on as the clip does, and what is done about them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from understudy.setup.plugins import Plugins
from understudy_characters.character import Character
from understudy_characters.letting_go import let_go
from understudy_doctor.ballistic import flights, mend_flights, straying
from understudy_doctor.examination import examine
from understudy_doctor.findings import Finding
from understudy_doctor.flight_check import check_flights
from understudy_doctor.measurements import Measurements
from understudy_doctor.repair import harm, repair
from understudy_doctor.summary import as_json, let_go_words
from understudy_motion import library
from understudy_motion.clip import Clip
from understudy_motion.reading import ReadOptions


@pytest.fixture(scope="module")
def backflip(plugins: Plugins) -> Clip:
    """The generated one, which obeys gravity."""
    return plugins.registry.find("clip", "backflip").factory()


@pytest.fixture(scope="module")
def slow(backflip: Clip) -> Clip:
    """At 1.3 times the time a body falls 1.7 times too slowly."""
    return replace(backflip, times=1.3 * backflip.times)


def found(clip: Clip, humanoid: Character) -> list[Finding]:
    return list(check_flights(Measurements(clip, humanoid), let_go(clip, humanoid)))


def captured(name: str, plugins: Plugins, humanoid: Character) -> Clip:
    """A clip of DeepMimic's, or a skip without the data."""
    folder = library.data_folder()
    if folder is None or not (folder / "motions" / "deepmimic" / f"{name}.txt").exists():
        pytest.skip(f"{library.DATA_VARIABLE} has no motions/deepmimic")
    return humanoid.posed(library.find(name, plugins.registry, ReadOptions()))


def test_a_flight_that_obeys_gravity_is_none(backflip: Clip, humanoid: Character) -> None:
    assert not found(backflip, humanoid)
    assert let_go(backflip, humanoid).share == 0.0


def test_a_flight_in_slow_motion_cannot_be_flown(slow: Clip, humanoid: Character) -> None:
    """It would land long before the clip does."""
    (finding,) = found(slow, humanoid)
    low = Measurements(slow, humanoid)
    air = low.heights.min(1) - low.ground > 0.01
    assert finding.kind == "flight"
    assert air[finding.first + 1 : finding.last + 1].all()
    assert finding.value > 1.0
    assert finding.start > 0.3
    assert finding.remedy.startswith("--fix")


def test_it_is_told_by_phase(slow: Clip, humanoid: Character) -> None:
    """Bad starts lie in the flight, and nowhere else."""
    gone, told = let_go(slow, humanoid), as_json(examine(slow, humanoid))["let_go"]
    assert told["bad"] == pytest.approx(gone.share, abs=1e-4)
    assert told["by_phase"][0] == told["by_phase"][-1] == 0.0
    assert max(told["by_phase"]) > 0.5
    assert let_go_words(gone).startswith(f"{100 * gone.share:.1f} % of {len(gone.times)} starts")


def test_a_flight_at_another_rate_is_stretched_to_fall_at_g(
    slow: Clip, humanoid: Character
) -> None:
    mended, (words,) = mend_flights(slow, humanoid)
    measured = Measurements(mended, humanoid)
    (flight,) = flights(measured)
    was = flights(Measurements(slow, humanoid))[0]
    lasted = slow.times[was.last] - slow.times[was.first]
    lasts = mended.times[flight.last] - mended.times[flight.first]
    assert float(lasts / lasted) == pytest.approx(1 / 1.3, abs=0.05)
    assert "0.77 times as long" in words
    assert straying(measured, flight) < 0.01
    assert let_go(mended, humanoid).share < 0.03
    assert not harm(examine(slow, humanoid), examine(mended, humanoid))


def test_poses_and_the_ends_of_a_flight_stay(slow: Clip, humanoid: Character) -> None:
    mended, _ = mend_flights(slow, humanoid)
    np.testing.assert_allclose(mended.root_position[0], slow.root_position[0])
    np.testing.assert_allclose(mended.root_position[-1], slow.root_position[-1], atol=1e-9)
    np.testing.assert_allclose(mended.rotations[-1], slow.rotations[-1], atol=1e-9)


def test_bending_a_flight_is_harm(backflip: Clip, humanoid: Character) -> None:
    """Harm is measured against the parabola: off it by 3 cm at the top is refused."""
    measured = Measurements(backflip, humanoid)
    (flight,) = flights(measured)
    position = measured.clip.root_position.clone()
    along = torch.linspace(0, torch.pi, flight.last - flight.first + 1).sin()
    position[flight.frames, 0] += 0.03 * along
    bent = replace(measured.clip, root_position=position)
    assert "bend a flight" in harm(examine(measured.clip, humanoid), examine(bent, humanoid))


@pytest.mark.parametrize(
    ("name", "bad"), [("backflip", 26.7), ("walk", 0), ("run", 0), ("dance_a", 0)]
)
def test_what_captured_clips_have(
    plugins: Plugins, humanoid: Character, name: str, bad: float
) -> None:
    clip = captured(f"humanoid3d_{name}", plugins, humanoid)
    assert 100 * let_go(clip, humanoid).share == pytest.approx(bad, abs=0.1)


@pytest.mark.slow
def test_the_captured_backflip_is_repaired(plugins: Plugins, humanoid: Character) -> None:
    clip = captured("humanoid3d_backflip", plugins, humanoid)
    mended = repair(examine(clip, humanoid))
    assert any("on a parabola" in words for words in mended.done)
    assert 100 * let_go(mended.clip, humanoid).share <= 2.4

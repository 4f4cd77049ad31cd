"""The page's clock."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from understudy_viewer.player import Player

TIMES = np.array([0.0, 0.1, 0.3, 0.6, 1.0])

gaps = st.lists(st.floats(1e-3, 1.0), min_size=1, max_size=20)


def times_of(gaps: list[float]) -> np.ndarray:
    return np.concatenate([[0.0], np.cumsum(gaps)])


def test_shows_each_frame_from_its_time_to_the_next() -> None:
    player = Player(TIMES)
    shown = []
    for _ in range(10):
        shown.append(player.frame)
        player.advance(0.0999)
    assert shown == [0, 0, 1, 1, 2, 2, 2, 3, 3, 3]


def test_plays_at_its_speed() -> None:
    player = Player(TIMES)
    player.speed = 0.5
    player.advance(0.7)
    assert player.time == pytest.approx(0.35)


@given(gaps, st.floats(0.0, 50.0))
def test_a_loop_goes_on_from_the_beginning(gaps: list[float], seconds: float) -> None:
    player = Player(times_of(gaps))
    player.advance(seconds)
    assert player.playing
    assert 0.0 <= player.time < player.duration
    cycles = (seconds - player.time) / player.duration
    assert cycles == pytest.approx(round(cycles), abs=1e-6)


@given(gaps, st.floats(0.0, 50.0))
def test_without_loop_it_stays_at_the_end(gaps: list[float], seconds: float) -> None:
    player = Player(times_of(gaps))
    player.loop = False
    player.advance(seconds)
    assert player.time == min(seconds, player.duration)
    assert player.playing == (seconds < player.duration)
    assert player.playing or player.frame == len(gaps)


def test_play_at_the_end_begins_again() -> None:
    player = Player(TIMES)
    player.loop = False
    player.advance(5.0)
    player.play()
    assert (player.frame, player.playing) == (0, True)


def test_nothing_moves_in_a_pause() -> None:
    player = Player(TIMES)
    player.playing = False
    player.advance(0.5)
    assert player.time == 0.0


@given(gaps, st.floats(-1.0, 30.0))
def test_seeking_shows_the_nearest_frame(gaps: list[float], time: float) -> None:
    player = Player(times_of(gaps))
    player.seek(time)
    distances = np.abs(player.times - time)
    assert distances[player.frame] == distances.min()


@given(gaps, st.lists(st.integers(-3, 3), max_size=10), st.booleans())
def test_stepping_goes_frame_by_frame(gaps: list[float], steps: list[int], loop: bool) -> None:
    player = Player(times_of(gaps))
    player.loop = loop
    expected, count = 0, len(gaps) + 1
    for step in steps:
        player.step(step)
        assert not player.playing
        expected = (expected + step) % count if loop else min(max(expected + step, 0), count - 1)
        assert player.frame == expected

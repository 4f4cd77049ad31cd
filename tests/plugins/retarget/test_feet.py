"""Feet on the floor, on tracks whose contacts are known."""

from __future__ import annotations

import math

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from understudy_retarget.feet import (
    EASE,
    Contacts,
    Sole,
    _carried,
    _intervals,
    contacts,
    find_floor,
    planted,
)
from understudy_tensors import rotations

HEIGHT, LENGTH = 0.05, 0.18
_CORNERS = torch.tensor(
    [[x, y, z] for x in (-0.04, LENGTH - 0.04) for y in (-0.04, 0.04) for z in (-HEIGHT, 0.0)],
    dtype=torch.float64,
)
SOLE = Sole.of(0, torch.zeros(3, dtype=torch.float64), _CORNERS, np.eye(3))
UNTURNED = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64)
UP, LEFT = torch.eye(3, dtype=torch.float64)[2], torch.eye(3, dtype=torch.float64)[1]


def steps(cycles: int = 3, rate: float = 120.0, drift: float = 0.0) -> tuple[torch.Tensor, ...]:
    """Times, ankle, rotation, and whether it stands: a foot that rests for half of each second, then
    swings 0.8 m ahead; while it rests it slides at `drift` m/s."""
    times = torch.arange(int(cycles * rate) + 1, dtype=torch.float64) / rate
    phase, cycle = times % 1.0, times.floor()
    swing = ((phase - 0.5) / 0.5).clamp(0.0, 1.0)
    ahead = 0.8 * (cycle + swing**2 * (3 - 2 * swing)) + drift * phase.clamp(max=0.5)
    up = HEIGHT + 0.2 * torch.sin(math.pi * swing) ** 2
    ankle = torch.stack((ahead, torch.zeros_like(times), up), dim=1)
    return times, ankle, UNTURNED.expand(len(times), 4), swing == 0.0


def test_the_sole_has_its_heel_behind_and_its_toe_ahead() -> None:
    assert SOLE.heel.tolist() == [-0.04, 0.0, -HEIGHT]
    assert torch.allclose(SOLE.toe, torch.tensor([LENGTH - 0.04, 0.0, -HEIGHT]).double())
    assert math.isclose(SOLE.length, LENGTH)


def test_contacts_are_where_it_stands() -> None:
    times, ankle, turn, stands = steps()
    floor = find_floor(times, [(ankle, turn, SOLE)])
    found = contacts(times, ankle, turn, SOLE, floor)
    for touches in (found.heel, found.toe):
        assert ((touches != stands).double().mean()) < 0.1
        assert len(list(_intervals(touches))) == len(list(_intervals(stands)))


@settings(max_examples=30, deadline=None)
@given(st.floats(-0.02, 0.02), st.floats(-0.02, 0.02), st.floats(-1.0, 1.0))
def test_a_sloping_floor_is_found(slope_x: float, slope_y: float, height: float) -> None:
    times, ankle, turn, stands = steps(cycles=6)
    around = torch.stack((times.cos(), times.sin()), dim=1)
    ankle = torch.cat((ankle[:, :1], 2 * around[:, :1], ankle[:, 2:]), dim=1)
    ankle[:, 1] = torch.where(stands, (times.floor() % 2) - 0.5, 0.0)
    slope = torch.tensor([slope_x, slope_y], dtype=torch.float64)
    ankle = ankle + torch.nn.functional.pad((ankle[:, :2] @ slope)[:, None] + height, (2, 0))
    floor = find_floor(times, [(ankle, turn, SOLE)])
    level = ankle[stands, 2] - HEIGHT - floor.at(ankle[stands])
    assert level.abs().max() < 0.008


def test_a_step_is_not_the_floor() -> None:
    times, ankle, turn, _ = steps()
    ankle = ankle.clone()
    ankle[times > 2.0, 2] += 0.3
    floor = find_floor(times, [(ankle, turn, SOLE)])
    assert abs(floor.at(ankle)[0].item()) < 0.01
    found = contacts(times, ankle, turn, SOLE, floor)
    assert not found.any[times > 2.05].any()


@settings(max_examples=30, deadline=None)
@given(
    st.floats(-0.15, 0.15), st.floats(-0.02, 0.02), st.floats(-0.2, 0.2), st.floats(-0.2, 0.2),
    st.floats(-3.0, 3.0),
)  # fmt: skip
def test_a_planted_foot_rests_flat_on_the_floor(
    drift: float, height: float, pitch: float, roll: float, heading: float
) -> None:
    """Sliding, sunk or raised, pitched and rolled, wherever it faces."""
    times, ankle, _, stands = steps(drift=drift)
    whither = rotations.from_heading(torch.tensor(heading, dtype=torch.float64))
    tilt = rotations.multiply(
        rotations.from_axis_angle(LEFT, torch.tensor(pitch, dtype=torch.float64)),
        rotations.from_axis_angle(
            torch.eye(3, dtype=torch.float64)[0], torch.tensor(roll, dtype=torch.float64)
        ),
    )
    turn = rotations.multiply(whither, tilt).expand(len(times), 4)
    ankle = rotations.rotate(whither, ankle) + height * UP
    touching = Contacts(stands, stands)
    where, how = planted(times, ankle, turn, SOLE, touching)
    assert SOLE.lowest(where, how).min() > -1e-9
    for first, last in _intervals(stands):
        rest = slice(first, last + 1)
        for point in (SOLE.heel, SOLE.toe):
            track = where[rest] + rotations.rotate(how[rest], point)
            assert (track - track[0]).abs().max() < 1e-6
            assert track[:, 2].abs().max() < 1e-6
    side = rotations.rotate(how[stands], LEFT)
    assert side[:, 2].abs().max() < 1e-6
    jumps = torch.linalg.vector_norm(where.diff(dim=0) - ankle.diff(dim=0), dim=1) * 120.0
    assert jumps.max() < 1.5 + 20 * abs(height), "m/s that the correction adds"


def test_a_foot_rolls_over_its_toe() -> None:
    """Toe down all the time while the heel comes up: the toe stays, the heel is let go."""
    times = torch.arange(121, dtype=torch.float64) / 120.0
    pitch = (1.2 * (times - 0.5)).clamp(min=0.0)
    turn = rotations.from_axis_angle(LEFT, pitch)
    toe = torch.tensor([0.3, 0.1, 0.0], dtype=torch.float64)
    ankle = toe - rotations.rotate(turn, SOLE.toe) + 0.01 * torch.sin(7 * times)[:, None] * UP
    touching = Contacts(times < 0.5, times > -1.0)
    where, how = planted(times, ankle, turn, SOLE, touching)
    track = where + rotations.rotate(how, SOLE.toe)
    assert (track - track[0]).abs().max() < 1e-6
    late = times > 0.5 + EASE
    assert rotations.angle_between(how[late], turn[late]).max() < 1e-6


def test_without_contacts_only_the_floor_counts() -> None:
    times, ankle, turn, stands = steps()
    none = Contacts(torch.zeros_like(stands), torch.zeros_like(stands))
    where, how = planted(times, ankle - 0.03 * UP, turn, SOLE, none)
    assert rotations.angle_between(how, turn).max() < 1e-9
    assert torch.equal(where[:, :2], ankle[:, :2])
    assert SOLE.lowest(where, how).min() > -1e-9
    aloft = ankle[:, 2] > HEIGHT + 0.03
    torch.testing.assert_close(where[aloft], (ankle - 0.03 * UP)[aloft])


def test_a_foot_without_an_ankle_keeps_its_place_and_turns() -> None:
    shin = torch.nn.functional.normalize(torch.randn(60, 3).double(), dim=1) * 0.05
    peg = Sole.point(0, shin, np.eye(3))
    times, ankle, _, stands = steps(drift=0.1)
    turn = rotations.from_axis_angle(LEFT, 0.3 * times)
    where, how = planted(times, ankle, turn, peg, Contacts(stands, stands))
    assert torch.equal(how, turn)
    assert peg.lowest(where, how)[stands].abs().max() < 1e-9
    for first, last in _intervals(stands):
        rest = where[first : last + 1, :2]
        assert (rest - rest[0]).abs().max() < 1e-6


@settings(max_examples=50, deadline=None)
@given(st.lists(st.integers(1, 40), min_size=2, max_size=8), st.booleans(), st.integers(0, 1000))
def test_what_is_carried_over_is_kept_where_known_and_moves_as_gently(
    runs: list[int], fades: bool, seed: int
) -> None:
    """Known and unknown runs of frames in turn; no frame moves faster than what the bounds between
    the known values and their own speed explain."""
    known = torch.cat([torch.full((n,), bool(i % 2)) for i, n in enumerate(runs)])
    times = torch.arange(len(known), dtype=torch.float64) / 120.0
    generator = torch.Generator().manual_seed(seed)
    values = torch.cumsum(torch.randn(len(known), 1, generator=generator).double() / 120.0, 0)
    carried = _carried(times, values, known, fades=fades)
    assert torch.equal(carried[known], values[known])
    fastest = float(values.diff(dim=0).abs().max()) * 120.0
    longest_way = 2.0 * float(values.abs().max())
    shortest = min(EASE, *(n / 120.0 / 2 for n in runs[::2]))
    bound = 2.0 * fastest + 1.5 * longest_way / shortest
    assert float(carried.diff(dim=0).abs().max()) * 120.0 <= bound + 1e-9


def test_nothing_known_carries_nothing() -> None:
    times, values = torch.arange(5).double(), torch.ones(5, 1).double()
    assert not _carried(times, values, torch.zeros(5, dtype=torch.bool), fades=False).any()

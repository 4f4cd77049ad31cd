"""Laws for every generated clip: supported or falling, planted, smooth, within a body's limits."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from generated_motions import Played, largest_slide
from hypothesis import given, settings
from hypothesis import strategies as st

from understudy.errors import ConfigError
from understudy.options import checked_options
from understudy.setup.plugins import Plugins
from understudy_humanoid import clips as generated
from understudy_motion.clip import Clip, cycle_transform, velocities
from understudy_motion.library import load
from understudy_tensors import rotations

GRAVITY = 9.81
#: By name: what makes the clip, and the largest joint speed it may have, rad/s.
CLIPS: dict[str, tuple[Callable[..., Clip], dict[str, Any], float]] = {
    "walk": (generated.generated_walk, {}, 8.0),
    "slow walk": (generated.generated_walk, {"speed": 0.8, "cycle": 1.2}, 8.0),
    "fast walk": (generated.generated_walk, {"speed": 1.5, "cycle": 0.95}, 8.0),
    "walk left": (generated.generated_walk, {"heading_rate": 0.7}, 8.0),
    "slow run": (generated.generated_run, {"speed": 2.0}, 15.0),
    "run": (generated.generated_run, {}, 15.0),
    "fast run": (generated.generated_run, {"speed": 5.0}, 20.0),
    "hop": (generated.generated_hop, {}, 17.0),
    "high hop": (generated.generated_hop, {"height": 0.3}, 20.0),
    "hop ahead": (generated.generated_hop, {"height": 0.15, "distance": 0.5}, 17.0),
    "hop on the left": (generated.generated_hop, {"height": 0.06, "leg": "left"}, 17.0),
    "turn left": (generated.generated_turn_left, {}, 12.0),
    "turn right": (generated.generated_turn_right, {"angle": math.pi, "seconds": 3.4}, 12.0),
    "sit": (generated.generated_sit, {}, 5.0),
    "sit low": (generated.generated_sit, {"seat_height": 0.35}, 5.0),
    "stand": (generated.generated_stand, {"seat_height": 0.5}, 5.0),
    "cartwheel": (generated.generated_cartwheel, {}, 20.0),
    "backflip": (generated.generated_backflip, {}, 20.0),
}
NAMES = ("walk", "run", "hop", "turn_left", "turn_right", "sit", "stand", "cartwheel", "backflip")


@functools.cache
def make(name: str, **more: Any) -> Clip:
    factory, parameters, _ = CLIPS[name]
    return factory(**parameters, **more)


@pytest.fixture(scope="module", params=CLIPS)
def played(request: pytest.FixtureRequest) -> tuple[str, Played]:
    return request.param, Played(make(request.param, frame_rate=240.0))


def test_nothing_is_in_the_floor(played: tuple[str, Played]) -> None:
    assert played[1].clearance.min() > -0.005


def test_what_is_on_the_floor_does_not_slide(played: tuple[str, Played]) -> None:
    _, motion = played
    for side in ("left", "right"):
        for corner in range(4):
            assert largest_slide(motion.sole(side)[:, corner]) < 0.005
        assert largest_slide(motion.hand(side)) < 0.005


def test_it_is_supported_or_falls_freely(played: tuple[str, Played]) -> None:
    name, motion = played
    flies = ~motion.supported
    assert flies.any() == any(word in name for word in ("run", "hop", "backflip"))
    # Away from the floor by two frames on either side.
    surely = np.convolve(flies, np.ones(5), mode="same") == 5
    step = motion.times[1]
    fall = np.diff(motion.com, n=2, axis=0)[surely[1:-1]] / step**2
    assert np.abs(fall - [0.0, 0.0, -GRAVITY]).max(initial=0.0) < 0.1


def test_joints_stay_within_their_limits_and_speeds(played: tuple[str, Played]) -> None:
    name, motion = played
    for side in ("left", "right"):
        assert motion.angle(f"{side}_knee").min() > 0.0
        assert motion.angle(f"{side}_knee").max() < 2.7
        assert (-motion.angle(f"{side}_elbow")).min() > 0.0
        assert (-motion.angle(f"{side}_elbow")).max() < 2.5
        ankle = motion.angle(f"{side}_ankle")
        assert ankle.min() > -1.05
        assert ankle.max() < 1.2
    _, angular = velocities(motion.clip)
    assert torch.linalg.vector_norm(angular[:, 1:], dim=-1).max() < CLIPS[name][2]


@pytest.mark.parametrize("name", CLIPS)
def test_velocities_are_continuous(name: str) -> None:
    """From frame to frame velocities change the less, the closer the frames are."""
    changes = []
    for rate in (240.0, 480.0):
        linear, angular = velocities(make(name, frame_rate=rate))
        changes.append([linear.diff(dim=0).norm(dim=-1), angular.diff(dim=0).norm(dim=-1)])
    for coarse, fine in zip(*changes, strict=True):
        assert fine.max() < 0.7 * coarse.max() + 1e-9


@pytest.mark.parametrize("name", CLIPS)
def test_loops_close(name: str) -> None:
    clip = make(name)
    assert clip.loop == any(word in name for word in ("walk", "run", "hop", "turn"))
    assert clip.name in NAMES
    if not clip.loop:
        return
    turn = rotations.from_heading(torch.tensor(cycle_transform(clip).heading))
    first = clip.rotations[0].clone()
    first[0] = rotations.multiply(turn.double(), first[0])
    assert rotations.angle_between(first, clip.rotations[-1]).max() < 1e-6
    assert abs(clip.root_position[0, 2] - clip.root_position[-1, 2]) < 1e-9


#: By clip: ranges of parameters, all of which are possible together.
RANGES: dict[Callable[..., Clip], dict[str, tuple[float, float]]] = {
    generated.generated_walk: {"speed": (0.5, 1.4), "cycle": (0.9, 1.1), "heading_rate": (-1, 1)},
    generated.generated_run: {"speed": (2.0, 5.0)},
    generated.generated_hop: {"height": (0.05, 0.3), "distance": (0.0, 0.7)},
    generated.generated_turn_left: {"angle": (0.2, 3.1), "seconds": (3.0, 3.6)},
    generated.generated_turn_right: {"angle": (3.2, 6.2), "seconds": (5.5, 8.0)},
    generated.generated_sit: {"seat_height": (0.35, 0.55), "seconds": (1.2, 3.0)},
    generated.generated_stand: {"seat_height": (0.35, 0.55), "seconds": (1.2, 3.0)},
}


@pytest.mark.parametrize("factory", RANGES)
@settings(deadline=None, max_examples=8)
@given(data=st.data())
def test_every_possible_parameter_makes_a_lawful_clip(
    factory: Callable[..., Clip], data: st.DataObject
) -> None:
    """Nothing sinks or slides, and no knee or elbow bends the wrong way."""
    parameters = {
        name: data.draw(st.floats(*bounds), label=name) for name, bounds in RANGES[factory].items()
    }
    motion = Played(factory(**parameters))
    assert motion.clearance.min() > -0.005
    for side in ("left", "right"):
        assert max(largest_slide(motion.sole(side)[:, corner]) for corner in range(4)) < 0.005
        assert motion.angle(f"{side}_knee").min() > 0.0
        assert motion.angle(f"{side}_elbow").max() < 0.0


def test_frame_rates_are_kept_and_bounded() -> None:
    assert generated.generated_sit(frame_rate=30.0).num_frames == 67
    assert generated.generated_run(frame_rate=120.0).frame_rate == pytest.approx(120.0, rel=0.02)
    for factory in {factory for factory, _, _ in CLIPS.values()}:
        for rate in (0.0, -1.0, 1e9, math.nan):
            with pytest.raises(ConfigError, match="frame_rate"):
                factory(frame_rate=rate)


@pytest.mark.parametrize("name", NAMES)
def test_every_clip_is_registered_with_options(name: str, plugins: Plugins) -> None:
    registry = plugins.registry
    options = registry.find("clip", name).options
    assert "frame_rate" in options
    assert load(name, None, registry, {"frame_rate": 30}).frame_rate < 40.0
    with pytest.raises(ConfigError, match="no option 'frame_rat'"):
        checked_options(options, {"frame_rat": 30}, "motion.parameters")

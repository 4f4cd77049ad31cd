"""Every defect is found, alone, where it is and as large as it is; and the repair removes it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch
from damage import between, bump, frozen, held, paused, raised, slid, turned, walking

from understudy.errors import ConfigError
from understudy_characters.character import Character
from understudy_doctor.clip_checks import find_spikes
from understudy_doctor.examination import examine
from understudy_doctor.findings import Severity
from understudy_doctor.repair import repair
from understudy_humanoid import clips as generated
from understudy_motion.clip import Clip, resample
from understudy_motion.editing import remove_frames, shift

X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
SIDE = torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64)


@dataclass(frozen=True)
class Case:
    """A defect, and the one finding that it makes."""

    damage: Callable[[Clip], Clip]
    kind: str
    severity: str
    seconds: tuple[float, float]  #: where it is, give or take `slack`
    value: float  #: how large it is, within a fifth
    joints: tuple[str, ...] = ()
    repaired: bool = True
    slack: float = 0.06
    loop: bool = False  #: done to one looping cycle instead of three


def _phase(clip: Clip) -> torch.Tensor:
    return clip.times / clip.duration


CASES = {
    "sunk": Case(
        lambda c: raised(c, -0.05), "ground_offset", "major", (0.0, 3.15), -0.05
    ),
    "sunk loop": Case(
        lambda c: raised(c, -0.05), "ground_offset", "major", (0.0, 1.05), -0.05, loop=True
    ),
    "lifted": Case(lambda c: raised(c, 0.02), "ground_offset", "minor", (0.0, 3.15), 0.02),
    "floating": Case(
        lambda c: raised(c, 0.06 * bump(c, 0.8, 2.2)), "float", "minor", (1.15, 1.85), 0.051,
        ("left_ankle",),
    ),
    "one foot sunk": Case(
        lambda c: turned(c, "left_ankle", Y, 0.35 * bump(c, 1.72, 2.0)), "penetration", "major",
        (1.74, 1.98), 0.047, ("left_ankle",),
    ),
    "sliding": Case(
        lambda c: slid(c, "left_ankle", 0.1, 1.62, 2.1, 2.6), "foot_skate", "major", (1.56, 2.21),
        0.1, ("left_ankle",),
    ),
    "spike": Case(
        lambda c: turned(c, "neck", Z, 0.6 * between(c, 90, 90)), "spike", "major", (1.477, 1.477),
        0.6, ("neck",),
    ),
    "small spike of a fast joint": Case(
        lambda c: turned(c, "left_knee", Y, 0.35 * between(c, 90, 90)), "spike", "minor",
        (1.477, 1.477), 0.27, ("left_knee",),
    ),
    "dropout": Case(
        lambda c: turned(c, "right_shoulder", Y, -0.5 * between(c, 100, 104)), "spike", "major",
        (1.641, 1.706), 0.5, ("right_shoulder",),
    ),
    "jump": Case(
        lambda c: turned(c, "neck", Z, 0.5 * between(c, 100, 999)), "spike", "major",
        (1.624, 1.641), 0.5, ("neck",),
    ),
    "root spike": Case(
        lambda c: shift(c, 0.2 * between(c, 80, 80)[:, None] * SIDE), "spike", "major",
        (1.3125, 1.3125), 0.2, ("root",),
    ),
    "open loop": Case(
        lambda c: turned(c, "right_shoulder", Y, 0.4 * _phase(c)), "seam_pose", "major",
        (1.05, 1.05), 0.4, ("right_shoulder",), loop=True,
    ),
    "loop with a kink": Case(
        lambda c: turned(c, "neck", Z, 3.0 * _phase(c) * (1.0 - _phase(c))), "seam_velocity",
        "major", (1.05, 1.05), 5.7, ("neck",), loop=True,
    ),
    "elbow beyond its limit": Case(
        lambda c: turned(c, "left_elbow", (0.0, -1.0, 0.0), -1.0 * bump(c, 1.0, 2.0)),
        "joint_limit", "major", (1.28, 1.80), 0.72, ("left_elbow",),
    ),
    "elbow off its axis": Case(
        lambda c: turned(c, "left_elbow", Z, 0.2 * bump(c, 1.0, 2.0)), "joint_axis", "minor",
        (1.17, 1.83), 0.2, ("left_elbow",), repaired=False,
    ),
    "owl": Case(
        lambda c: turned(c, "neck", Z, 2.0 * bump(c, 0.5, 2.5)), "joint_range", "major",
        (1.1, 1.9), 0.6, ("neck",), repaired=False, slack=0.1,
    ),
    "frozen": Case(
        lambda c: frozen(c, 60, 61), "duplicate_frames", "major", (0.984, 1.0), 2.0
    ),
    "held": Case(
        lambda c: held(c, 60, 62), "held_root", "major", (0.984, 1.017), 3.0, ("root",)
    ),
    "lost frames": Case(
        lambda c: remove_frames(c, [60, 61]), "uneven_frames", "major", (0.968, 1.017), 2.0
    ),
    "jitter": Case(
        lambda c: replace(c, times=c.times + 0.004 * torch.sin(2.0 * c.times / c.times[1])
                          * between(c, 50, 70)),
        "uneven_frames", "minor", (0.80, 1.16), 0.41,
    ),
    "arc": Case(
        lambda c: generated.generated_walk(heading_rate=0.3), "turning", "minor", (0.0, 1.05),
        0.315, repaired=False, loop=True,
    ),
    "unlicensed": Case(
        lambda c: replace(c, licence="unknown"), "licence", "minor", (0.0, 3.15), 0.0,
        repaired=False,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_a_defect_is_found_alone_at_its_place(
    name: str, walk: Clip, walks: Clip, humanoid: Character
) -> None:
    case = CASES[name]
    damaged = case.damage(walk if case.loop else walks)
    examined = examine(damaged, humanoid)
    lines = [finding.line() for finding in examined.findings]
    assert len(lines) == 1, lines
    found = examined.findings[0]
    assert (found.kind, found.severity) == (case.kind, case.severity), lines
    assert found.joints == case.joints
    assert found.value == pytest.approx(case.value, rel=0.2)
    np.testing.assert_allclose((found.start, found.stop), case.seconds, atol=case.slack)
    assert damaged.times[[found.first, found.last]].tolist() == [found.start, found.stop]

    mended = repair(examined)
    remaining = [finding.kind for finding in examine(mended.clip, humanoid).findings]
    assert remaining == ([] if case.repaired else [case.kind])
    assert bool(mended.done) == case.repaired


@pytest.mark.parametrize("name", ["walk", "run", "hop", "turn_left", "sit", "stand"])
def test_clean_clips_have_no_findings_and_stay_as_they_are(name: str, humanoid: Character) -> None:
    clip = getattr(generated, f"generated_{name}")()
    examined = examine(clip, humanoid)
    kinds = {finding.kind for finding in examined.findings}
    assert kinds == ({"turning"} if name == "turn_left" else set())
    mended = repair(examined)
    assert mended.done == ()
    assert mended.clip is clip


@pytest.mark.parametrize("name", ["backflip", "cartwheel"])
def test_fast_motions_have_no_spikes(name: str) -> None:
    clip = getattr(generated, f"generated_{name}")()
    assert find_spikes(clip) == []
    assert find_spikes(resample(clip, 30.0)) == []


def test_too_low_a_frame_rate(walks: Clip, humanoid: Character) -> None:
    examined = examine(resample(walks, 6.0), humanoid)
    found = {finding.kind: finding for finding in examined.findings}
    # With straight lines between six poses a second, feet do slide.
    assert set(found) <= {"frame_rate", "foot_skate"}
    assert found["frame_rate"].severity == Severity.MAJOR
    assert 0.08 < found["frame_rate"].value < 0.2
    for rate in (24.0, 30.0, 120.0):
        assert examine(resample(walks, rate), humanoid).findings == ()


def test_a_wrong_frame_rate(walks: Clip, humanoid: Character) -> None:
    for units, faster in (({"rad/s"}, 10.0), ({"rad/s", "m/s"}, 15.0)):
        found = examine(replace(walks, times=walks.times / faster), humanoid).findings
        too_fast = [f for f in found if f.kind == "speed"]
        assert {f.unit for f in too_fast} == units
        assert all(f.severity == Severity.MAJOR and "--source-rate" in f.remedy for f in too_fast)


def test_frames_per_second_in_place_of_seconds(walks: Clip, humanoid: Character) -> None:
    found = examine(replace(walks, times=walks.times / walks.times[1] * 30.0), humanoid).findings
    (slow,) = (f for f in found if f.kind == "slow_frames")
    assert slow.severity == Severity.MAJOR
    assert slow.value == pytest.approx(30.0)
    assert slow.unit == "s"
    assert "its frames are 30 s apart" in slow.what
    assert "--source-rate 30" in slow.remedy
    quicker = replace(walks, times=walks.times / walks.times[1] * 0.9)
    assert "slow_frames" not in {f.kind for f in examine(quicker, humanoid).findings}


def test_a_pause_is_taken_out(walks: Clip, humanoid: Character) -> None:
    examined = examine(paused(walks, 60, 2), humanoid)
    assert examined.findings[0].kind == "duplicate_frames"
    assert (examined.findings[0].first, examined.findings[0].last) == (61, 62)
    mended = repair(examined).clip
    assert mended.num_frames == walks.num_frames
    torch.testing.assert_close(mended.rotations, walks.rotations)
    torch.testing.assert_close(mended.times, walks.times)


def test_resting_is_no_repetition(walks: Clip, humanoid: Character) -> None:
    sit = generated.generated_sit()
    rest = torch.cat((sit.times, sit.times[-1] + 0.1 * torch.arange(1, 4, dtype=torch.float64)))
    still = replace(
        sit,
        times=rest,
        root_position=torch.cat((sit.root_position, sit.root_position[-1:].expand(3, -1))),
        rotations=torch.cat((sit.rotations, sit.rotations[-1:].expand(3, -1, -1))),
    )
    kinds = {finding.kind for finding in examine(still, humanoid).findings}
    assert "duplicate_frames" not in kinds


def test_walking_in_place_gets_under_way(walk: Clip, walks: Clip, humanoid: Character) -> None:
    still = torch.tensor([0.0, 1.0, 1.0], dtype=torch.float64)
    for clip in (walks, walk):
        in_place = replace(clip, root_position=clip.root_position * still)
        examined = examine(in_place, humanoid)
        assert {finding.kind for finding in examined.findings} == {"foot_skate"}
        assert examined.worst == Severity.MAJOR
        mended = repair(examined).clip
        assert examine(mended, humanoid).findings == ()
        assert mended.loop == clip.loop
        torch.testing.assert_close(
            mended.root_position[:, 0] - mended.root_position[0, 0],
            clip.root_position[:, 0] - clip.root_position[0, 0],
            atol=0.05,
            rtol=0.0,
        )


def test_several_defects_at_once(walks: Clip, humanoid: Character) -> None:
    clip = turned(walks, "neck", Z, 0.6 * between(walks, 40, 40))
    clip = slid(clip, "left_ankle", 0.1, 1.62, 2.1, 2.6)
    clip = turned(raised(clip, 0.04), "chest", X, 0.4 * between(clip, 150, 152))
    examined = examine(clip, humanoid)
    assert {f.kind for f in examined.findings} == {"spike", "foot_skate", "ground_offset"}
    assert examine(repair(examined).clip, humanoid).findings == ()


def test_provenance_is_kept(walks: Clip, humanoid: Character) -> None:
    origin = {"source": "there.bvh", "licence": "CC-BY-4.0", "sha256": "0" * 64}
    origin |= {"url": "https://example.org/there.bvh", "attribution": "somebody"}
    clip = replace(raised(frozen(walks, 60, 61), -0.05), **origin)
    mended = repair(examine(clip, humanoid)).clip
    assert {key: getattr(mended, key) for key in origin} == origin
    assert mended.skeleton is clip.skeleton


@pytest.mark.parametrize("frames", [2, 3, 5])
@pytest.mark.parametrize("loop", [False, True])
def test_the_shortest_clips(frames: int, loop: bool, walk: Clip, humanoid: Character) -> None:
    short = replace(
        walk,
        times=walk.times[:frames],
        root_position=walk.root_position[:frames],
        rotations=walk.rotations[:frames],
        loop=loop,
    )
    examined = examine(short, humanoid)
    examine(repair(examined).clip, humanoid)


@pytest.mark.parametrize("loop", [False, True])
def test_noise_is_examined_and_repaired_without_an_error(
    loop: bool, walk: Clip, humanoid: Character
) -> None:
    rng = torch.Generator().manual_seed(0)
    anyhow = torch.randn(walk.rotations.shape, generator=rng, dtype=torch.float64)
    noise = replace(
        walk,
        rotations=torch.nn.functional.normalize(anyhow, dim=-1),
        root_position=torch.randn(walk.root_position.shape, generator=rng, dtype=torch.float64),
        loop=loop,
    )
    examined = examine(noise, humanoid)
    assert examined.worst == Severity.MAJOR
    repair(examined)


def test_one_lost_hour_is_refused_not_allocated(walks: Clip, humanoid: Character) -> None:
    late = torch.cat((walks.times[:-1], walks.times[-2:-1] + 3600.0))
    with pytest.raises(ConfigError, match=r"frames of .* are too many"):
        examine(replace(walks, times=late), humanoid)


def test_a_repaired_loop_still_closes(walk: Clip, humanoid: Character) -> None:
    damaged = turned(
        raised(walk, 0.03 * bump(walk, 0.2, 0.9)), "left_elbow", Y, 1.5 * bump(walk, 0.1, 0.9)
    )
    mended = repair(examine(damaged, humanoid)).clip
    assert mended.loop
    assert examine(mended, humanoid).findings == ()
    assert walking(mended).num_frames == 3 * (walk.num_frames - 1) + 1

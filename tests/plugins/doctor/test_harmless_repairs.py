"""Repairs do no harm: they add nothing, keep flights ballistic, and know a body of another size."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from understudy.setup.plugins import installed
from understudy_characters.character import Character
from understudy_doctor import repair as repairs
from understudy_doctor.character_checks import LASTING, check_on_character
from understudy_doctor.examination import Examination, examine
from understudy_doctor.findings import Severity, intervals
from understudy_doctor.measurements import Measurements
from understudy_doctor.proportions import scaled
from understudy_doctor.repair import harm, repair, straying
from understudy_humanoid.clips import generated_walk
from understudy_motion import library
from understudy_motion.clip import Clip
from understudy_motion.library import DATA_VARIABLE, data_folder
from understudy_retarget.retarget import retarget

AIRBORNE = 0.01
"""m: how far a flight may be off its parabola."""
JUMPS = {
    "hop": {"distance": 0.6}, "backflip": {}, "run": {"speed": 4.0}, "cartwheel": {},
}  # fmt: skip


def majors(examined: Examination) -> Counter[str]:
    return Counter(f.kind for f in examined.findings if f.severity == Severity.MAJOR)


def off_parabolas(measured: Measurements) -> float:
    """m: how far the centre of mass is from falling freely, in the flights."""
    most = 0.0
    for first, last in measured.flights:
        times = measured.clip.times.numpy()[first : last + 1] - measured.clip.times[first].item()
        fallen = measured.centre[first : last + 1, 2] + 0.5 * 9.81 * times**2
        line = np.polynomial.Polynomial.fit(times, fallen, 1)
        most = max(most, float(np.abs(fallen - line(times)).max()))
    return most


def generated(name: str) -> Clip:
    return library.load(name, None, installed().registry, JUMPS[name])


def of_a_body(clip: Clip, legs: float) -> Clip:
    """`clip`, as it would be of a body whose legs are `legs` times as long."""
    return scaled(clip, legs)


# ---------------------------------------------------------------------- another body


@pytest.mark.parametrize(
    ("name", "legs"),
    [("hop", 0.77), ("hop", 1.25), ("run", 0.77), ("cartwheel", 1.25), ("backflip", 0.77)],
)
def test_a_jump_of_another_body_is_scaled(name: str, legs: float, humanoid: Character) -> None:
    clip = generated(name)
    examined = examine(of_a_body(clip, legs), humanoid)
    (found,) = (f for f in examined.findings if f.kind == "proportions")
    assert found.value == pytest.approx(1.0 / legs, rel=0.02)
    longer = "shorter" if legs > 1.0 else "longer"
    assert f"legs are {abs(1.0 / legs - 1.0):.0%}".replace("%", " %") in found.what
    assert f"{longer} than the clip's (scale {1.0 / legs:.2f})" in found.what
    assert majors(examined) - Counter(["proportions"]) == majors(examine(clip, humanoid))
    mended = repair(examined).clip
    after = examine(mended, humanoid)
    assert not majors(after) - majors(examined)
    assert "proportions" not in majors(after)
    torch.testing.assert_close(mended.root_position, clip.root_position, atol=0.03, rtol=0.03)
    torch.testing.assert_close(mended.times, clip.times, atol=0.0, rtol=0.02)
    assert after.measured is not None
    assert off_parabolas(after.measured) < AIRBORNE


def test_what_is_said_of_frames_is_of_the_clip_that_was_asked_about(humanoid: Character) -> None:
    clip = of_a_body(generated("backflip"), 0.77)
    examined = examine(clip, humanoid)
    (found,) = (f for f in examined.findings if f.kind == "torque" and f.severity == "major")
    assert found.start == pytest.approx(clip.times[found.first].item())
    assert examined.measured is not None
    assert examined.measured.times[-1] == pytest.approx(clip.duration)


@pytest.mark.parametrize("legs", [0.96, 1.0, 1.05])
def test_nearly_the_same_legs_are_the_same(legs: float, humanoid: Character) -> None:
    examined = examine(of_a_body(generated_walk(), legs), humanoid)
    assert "proportions" not in {f.kind for f in examined.findings}


def test_a_flip_does_not_float(humanoid: Character) -> None:
    """Nor on a body whose centre of mass is elsewhere, where it seems to be pushed around."""
    clip = generated("backflip")
    for legs in (0.77, 1.3):
        moving = of_a_body(clip, legs)
        measured = Measurements(moving, humanoid)
        high = measured.heights.min(1) - measured.ground > 0.3
        assert high.sum() > 10
        lasting = intervals(measured.supported & high, least=round(LASTING / measured.dt))
        assert not lasting
        for found in check_on_character(moving, measured):
            assert found.kind != "float" or not high[found.first : found.last + 1].any()


def test_what_hangs_in_the_air_floats_still(humanoid: Character) -> None:
    times = torch.arange(61, dtype=torch.float64) / 60
    qpos = torch.tensor(humanoid.model.qpos0, dtype=torch.float64).repeat(61, 1)
    qpos[20:40, 2] += 0.1
    found = examine(humanoid.clip(qpos, times, name="hung"), humanoid).findings
    assert "float" in {f.kind for f in found}


# ---------------------------------------------------------------------- travel


def standing(humanoid: Character, speed: float) -> Clip:
    """The zero pose, sliding over the floor for two seconds."""
    times = torch.arange(121, dtype=torch.float64) / 60
    qpos = torch.tensor(humanoid.model.qpos0, dtype=torch.float64).repeat(121, 1)
    qpos[:, 2] -= humanoid.clearance(qpos[:1]).min()
    qpos[:, 0] += speed * times
    return humanoid.clip(qpos, times, name="sliding")


@pytest.mark.parametrize("speed", [0.4, -0.4])
def test_a_slide_is_given_no_drift(speed: float, humanoid: Character) -> None:
    clip = standing(humanoid, speed)
    examined = examine(clip, humanoid)
    assert "foot_skate" in majors(examined)
    mended = repair(examined)
    assert not any("going" in what for what in mended.done)
    assert torch.equal(mended.clip.root_position[:, :2], clip.root_position[:, :2])


@pytest.mark.parametrize("share", [0.8, 1.25])
def test_travel_that_is_off_keeps_its_direction(share: float, humanoid: Character) -> None:
    """A walk whose feet slide, forward or back, since its root goes too far or not far enough."""
    walk = generated_walk()
    off = torch.tensor([share, 1.0, 1.0], dtype=torch.float64)
    mended = repair(examine(replace(walk, root_position=walk.root_position * off), humanoid)).clip
    gone = (mended.root_position[-1, 0] - mended.root_position[0, 0]).item()
    meant = (walk.root_position[-1, 0] - walk.root_position[0, 0]).item()
    assert min(share, 1.0) * meant - 0.05 < gone < max(share, 1.0) * meant + 0.05


# ---------------------------------------------------------------------- no harm


def test_a_repair_that_would_add_findings_is_not_made(
    humanoid: Character, monkeypatch: pytest.MonkeyPatch
) -> None:
    def sink(clip: Clip, measured: Measurements) -> tuple[Clip, list[str]]:
        down = torch.tensor([0.0, 0.0, -0.2], dtype=torch.float64)
        return replace(clip, root_position=clip.root_position + down), ["sank it"]

    clip = replace(generated_walk(), licence="unknown")
    step = repairs._Step(frozenset({"licence"}), sink)
    monkeypatch.setattr(repairs, "_FIRST", (step,))
    mended = repair(examine(clip, humanoid))
    assert mended.done == ()
    assert torch.equal(mended.clip.root_position, clip.root_position)
    (left,) = mended.left
    assert left.startswith("not sank it: it would make")


def test_a_flight_is_not_bent(humanoid: Character) -> None:
    """A jump, 4 cm into the floor on landing alone: the root rises, but not in the air."""
    clip = replace(generated("hop"), loop=False)
    flight = examine(clip, humanoid).measured.flights[0]  # type: ignore[union-attr]
    lower = torch.zeros(clip.num_frames, 3, dtype=torch.float64)
    for frame in range(clip.num_frames):
        since = (frame - flight[0]) / (flight[1] - flight[0])
        lower[frame, 2] = -0.04 * min(max(since, 0.0), 1.0)
    before = examine(replace(clip, root_position=clip.root_position + lower), humanoid)
    mended = repair(before)
    assert mended.done
    after = examine(mended.clip, humanoid)
    assert straying(before, after) < AIRBORNE
    bent = mended.clip.root_position.clone()
    bent[:, 2] += 0.05 * torch.sin(torch.arange(clip.num_frames) / 3.0)
    worse = examine(replace(mended.clip, root_position=bent), humanoid)
    assert straying(before, worse) > 2.0 * AIRBORNE
    assert harm(before, worse)


def real_clips() -> Iterator[Path]:
    folder = data_folder()
    for place in ("deepmimic", "runup", "cmu"):
        for path in sorted((folder or Path("/nowhere")).glob(f"motions/{place}/*.[ta][xm][tc]")):
            if not path.stem.endswith("character"):
                yield path


def check_harmless(clip: Clip, humanoid: Character) -> None:
    before = examine(clip, humanoid)
    after = examine(repair(before).clip, humanoid)
    assert not majors(after) - majors(before)
    assert straying(before, after) <= AIRBORNE


#: Whose repairs did harm, or nearly, when they were made without looking at what comes of them.
HARD = ("dance_spin", "backflip", "roll", "run_jump", "VC5_Run_jumpToBox_01")


@pytest.mark.parametrize("name", HARD)
def test_hard_clips_gain_nothing(name: str, humanoid: Character) -> None:
    found = [path for path in real_clips() if path.stem.endswith(name)]
    if not found:
        pytest.skip(f"${DATA_VARIABLE} has no motions/*/*{name}.txt")
    check_harmless(library.find(str(found[0]), installed().registry), humanoid)


@pytest.mark.slow
@pytest.mark.timeout(1800)  # a clip of 40 s may be examined 30 times
@pytest.mark.parametrize("path", list(real_clips()), ids=lambda path: path.stem)
def test_no_clip_gains_a_major_finding(path: Path, humanoid: Character) -> None:
    clip = library.find(str(path), installed().registry)
    if path.suffix == ".amc":
        clip = retarget(clip, humanoid)[0]
    check_harmless(clip, humanoid)


@pytest.mark.slow
@pytest.mark.timeout(1800)  # a clip of 40 s may be examined 30 times
@pytest.mark.parametrize("legs", [0.77, 1.3])
@pytest.mark.parametrize("path", list(real_clips()), ids=lambda path: path.stem)
def test_no_clip_of_another_body_gains_one(path: Path, legs: float, humanoid: Character) -> None:
    if path.suffix == ".amc":
        pytest.skip("retargeting has made it this body's")
    check_harmless(of_a_body(library.find(str(path), installed().registry), legs), humanoid)

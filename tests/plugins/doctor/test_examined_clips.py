"""What the doctor says of real clips, as counts of major findings; skipped without the data."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

import pytest
import torch

from understudy_characters.character import Character
from understudy_doctor.examination import Examination, examine
from understudy_doctor.findings import Finding, Severity
from understudy_doctor.repair import make_loop, repair
from understudy_motion.clip import Clip, cycle_transform
from understudy_motion.library import DATA_VARIABLE, data_folder
from understudy_motion.readers.deepmimic import DeepMimicReader

EXPECTED = """
[deepmimic]
humanoid3d_backflip foot_skate=2 frame_rate=1 seam_pose=1
humanoid3d_cartwheel penetration=1 seam_pose=1
humanoid3d_crawl penetration=6 seam_pose=1
humanoid3d_dance_a seam_pose=1
humanoid3d_dance_b float=1 foot_skate=3 penetration=1 seam_pose=1
humanoid3d_dance_spin
humanoid3d_getup_facedown penetration=1
humanoid3d_jog seam_pose=1
humanoid3d_jump seam_pose=1 torque=1
humanoid3d_kick joint_range=1 penetration=1
humanoid3d_punch foot_skate=2 ground_offset=1
humanoid3d_ready_to_walk_mirror foot_skate=1 penetration=3
humanoid3d_roll foot_skate=3 held_root=1 penetration=2 seam_pose=1 torque=1 uneven_frames=1
humanoid3d_run foot_skate=1 penetration=2 seam_pose=1
humanoid3d_run_jump penetration=1 unsupported=1
humanoid3d_spinkick joint_limit=1 seam_pose=1
humanoid3d_stealthy_walk foot_skate=3 penetration=2
humanoid3d_walk foot_skate=1 seam_pose=1 spike=1
humanoid3d_walk_to_ready_mirror foot_skate=2
humanoid3d_zombie_walk seam_pose=1
[pose_manifold]
02_01 ground_offset=1 penetration=2
02_02 ground_offset=1 penetration=1
02_03 ground_offset=1
02_04 ground_offset=1
06_09 ground_offset=1 penetration=1
07_03 penetration=1
07_05 penetration=2
07_06 penetration=2
07_07 penetration=2
07_11 penetration=2
08_07 foot_skate=3 penetration=1 unsupported=2
09_02 ground_offset=1
09_04 ground_offset=1
09_06 ground_offset=1
09_07 ground_offset=1
10_05 ground_offset=1 penetration=2 spike=1 torque=1
10_06 ground_offset=1 joint_range=1 penetration=3 torque=1
11_01 foot_skate=1 ground_offset=1 penetration=1 torque=1
127_03 ground_offset=1
127_04 ground_offset=1
127_05
127_06 ground_offset=1
127_07 ground_offset=1 penetration=1
127_08 foot_skate=1 ground_offset=1 penetration=1
127_09 ground_offset=1
127_10 ground_offset=1
127_15 ground_offset=1
127_16 ground_offset=1 penetration=1
127_17 ground_offset=1
127_21 foot_skate=1 ground_offset=1 penetration=1 torque=1
127_22 ground_offset=1 penetration=2
127_23 ground_offset=1 penetration=12 torque=1 unsupported=1
127_24 ground_offset=1 joint_range=1 penetration=12
127_25 ground_offset=1 penetration=1 unsupported=1
127_26 ground_offset=1 penetration=1
127_27 ground_offset=1 torque=1
127_28 ground_offset=1 penetration=1
127_29 foot_skate=1 ground_offset=1 penetration=2
127_30 ground_offset=1 penetration=1
127_31 foot_skate=1 ground_offset=1 joint_range=1 penetration=1
127_32 ground_offset=1 penetration=1 spike=2
127_37 ground_offset=1 torque=1
127_38 ground_offset=1
139_16 joint_range=1 penetration=7
139_17 joint_range=1 penetration=8
13_11 torque=1
13_13 ground_offset=1 torque=1
13_19 foot_skate=1 ground_offset=1 torque=1
13_39 ground_offset=1 torque=1
13_40 ground_offset=1
13_41 ground_offset=1
13_42 ground_offset=1
140_01 penetration=4
140_02 float=1 joint_range=2
140_03 float=1 foot_skate=1 joint_range=2 penetration=6
16_07 ground_offset=1
16_08 ground_offset=1
16_35 ground_offset=1
16_38 ground_offset=1
16_39 ground_offset=1
16_40 ground_offset=1
16_48 ground_offset=1
16_49 ground_offset=1
16_52 ground_offset=1
43_02 float=4 foot_skate=9 ground_offset=1 penetration=13 spike=2
43_03 float=4 foot_skate=7 ground_offset=1 penetration=26 spike=1
49_02 ground_offset=1 joint_range=1 torque=5
49_04 ground_offset=1 spike=1 torque=2 unsupported=1
49_05 ground_offset=1 torque=2 unsupported=1
49_06 penetration=5 torque=1
49_07 joint_range=1 penetration=5 torque=1
49_08 joint_range=2 penetration=10 spike=1
85_01 foot_skate=3 penetration=3 torque=4 unsupported=1
85_02 float=1 joint_range=2 penetration=3 torque=2 unsupported=1
85_05 float=1 joint_range=1 penetration=13 torque=3 unsupported=1
85_06 float=1 foot_skate=1 joint_range=2 penetration=1 torque=1
85_07 float=1 joint_range=1 penetration=2 spike=1 torque=1 unsupported=2
85_08 float=1 joint_range=1 penetration=6 spike=3
88_06 foot_skate=1 frame_rate=1 ground_offset=1 joint_range=1 penetration=1 spike=1 torque=6 unsupported=1
88_08 ground_offset=1 joint_range=3 penetration=3 torque=4
88_09 foot_skate=1 joint_range=1 penetration=4 torque=7 unsupported=2
90_05 foot_skate=2 ground_offset=1 penetration=1 spike=1 torque=1 unsupported=1
90_16 ground_offset=1 penetration=8 unsupported=1
90_17 foot_skate=1 ground_offset=1 penetration=9 spike=1
humanoid3d_backflip foot_skate=2 frame_rate=1 seam_pose=1
humanoid3d_bridge joint_range=2
humanoid3d_crawl penetration=6 seam_pose=1
humanoid3d_dance_a seam_pose=1
humanoid3d_dance_b float=1 foot_skate=3 penetration=1 seam_pose=1
humanoid3d_roll foot_skate=3 held_root=1 penetration=2 seam_pose=1 torque=1
humanoid3d_run foot_skate=1 penetration=2 seam_pose=1
humanoid3d_run_jump penetration=1 unsupported=1
humanoid3d_run_roll foot_skate=1 penetration=5 seam_pose=1
humanoid3d_spinkick joint_limit=1 seam_pose=1
[runup]
VC5_Run_jumpToBox_01 float=1 ground_offset=1 penetration=1 torque=1
VC5_sprint__curves_03 ground_offset=1 torque=8
"""


def listing() -> Iterator[tuple[str, dict[str, int]]]:
    """Clips, by folder and stem, with their counts."""
    folder = ""
    for line in EXPECTED.split("\n"):
        if line.startswith("["):
            folder = line.strip("[]")
        elif line:
            stem, *counts = line.split()
            pairs = (count.split("=") for count in counts)
            yield f"{folder}/{stem}", {kind: int(number) for kind, number in pairs}


CLIPS = dict(listing())


def read(name: str) -> Clip:
    folder = data_folder()
    path = folder and folder / "motions" / f"{name}.txt"
    if path is None or not path.is_file():
        pytest.skip(f"${DATA_VARIABLE} has no motions/{name}.txt")
    return DeepMimicReader().read(path)


#: Some clips of every sort, which two tests look at.
SOME = tuple(CLIPS)[::8]
_examined: dict[str, Examination] = {}


def examined_once(name: str, humanoid: Character) -> Examination:
    """What is found in one of those, and in any other clip anew."""
    found = _examined.get(name) or examine(read(name), humanoid)
    if name in SOME:
        _examined[name] = found
    return found


def majors(findings: tuple[Finding, ...]) -> Counter[str]:
    return Counter(f.kind for f in findings if f.severity == Severity.MAJOR)


@pytest.mark.parametrize("name", CLIPS)
def test_major_findings(name: str, humanoid: Character) -> None:
    assert majors(examined_once(name, humanoid).findings) == CLIPS[name]


def test_every_clip_is_listed() -> None:
    folder = data_folder()
    if folder is None:
        pytest.skip(f"${DATA_VARIABLE} is not a folder")
    found = {
        f"{path.parent.name}/{path.stem}"
        for path in folder.glob("motions/*/*.txt")
        if not path.stem.endswith("character")
    }
    assert found <= set(CLIPS)


def test_the_captured_walk_is_repaired(humanoid: Character) -> None:
    clip = read("deepmimic/humanoid3d_walk")
    examined = examine(clip, humanoid)
    found = {f.kind: f for f in examined.findings}
    assert found["seam_pose"].value == pytest.approx(0.5, abs=0.02)
    assert found["seam_pose"].joints == ("right_shoulder",)
    assert (found["spike"].first, found["spike"].last) == (18, 19)  # the other shoulder
    assert found["turning"].value == pytest.approx(0.119, abs=0.005)
    mended = repair(examined).clip
    assert {f.kind for f in examine(mended, humanoid).findings} <= {"turning"}
    assert mended.loop
    assert mended.licence == clip.licence


@pytest.mark.parametrize(
    ("name", "seconds", "stride"),
    [("pose_manifold/02_01", 1.1, 1.33), ("pose_manifold/02_03", 0.77, 1.9)],
)
def test_one_gait_cycle_is_cut_out_of_a_long_clip(
    name: str, seconds: float, stride: float, humanoid: Character
) -> None:
    """A walk and a run of CMU's subject 2: one cycle, which then closes and loops."""
    mended = repair(examine(read(name), humanoid)).clip
    loop = make_loop(mended, humanoid).clip
    assert loop.loop
    assert loop.duration == pytest.approx(seconds, abs=0.04)
    assert cycle_transform(loop).displacement.norm().item() == pytest.approx(stride, abs=0.15)
    examined = examine(loop, humanoid)
    assert not majors(examined.findings)
    assert not {f.kind for f in examined.findings} & {"seam_pose", "seam_velocity"}
    assert examined.measured is not None
    feet = torch.from_numpy(examined.measured.touching[:-1, examined.measured.feet]).int()
    landings = (torch.roll(feet, -1, dims=0) - feet == 1).sum(0)
    assert landings.tolist() == [1, 1]


def test_repairs_make_real_clips_better(humanoid: Character) -> None:
    """Over some clips of every sort: hardly anything that can be repaired is left."""
    repairable = {"ground_offset", "penetration", "seam_pose", "seam_velocity", "spike",
                  "joint_limit", "uneven_frames", "foot_skate"}  # fmt: skip
    before, after = Counter[str](), Counter[str]()
    for name in SOME:
        examined = examined_once(name, humanoid)
        before += Counter(f.kind for f in examined.findings)
        mended = examine(repair(examined).clip, humanoid)
        after += Counter(f.kind for f in mended.findings)
    assert sum(before[kind] for kind in repairable) > 50
    assert sum(after[kind] for kind in repairable) < 0.3 * sum(before[k] for k in repairable)

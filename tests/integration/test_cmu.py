"""CMU's clips through the whole chain: read, checked, retargeted, checked again, repaired, looped."""

from __future__ import annotations

import functools
from collections import Counter
from pathlib import Path

import pytest

from understudy.setup.plugins import installed
from understudy_characters.character import Character, load_character
from understudy_doctor.examination import examine
from understudy_doctor.findings import Finding, Severity
from understudy_doctor.repair import make_loop, repair
from understudy_motion.clip import Clip
from understudy_motion.library import DATA_VARIABLE, data_folder, find
from understudy_retarget.retarget import Report, retarget

#: By clip: major findings as recorded (without a character), and on the humanoid. 01 climbs and 03
#: walks over uneven ground, so that no flat floor suits them.
EXPECTED: dict[str, tuple[dict[str, int], dict[str, int]]] = {
    "01_01": ({"spike": 1}, {}),
    "01_08": (
        {"spike": 30},
        {"ground_offset": 1, "penetration": 15, "spike": 2, "foot_skate": 4, "float": 4},
    ),
    "01_14": (
        {"spike": 14},
        {"float": 11, "joint_range": 1, "spike": 2, "torque": 1},
    ),
    "02_01": ({}, {}),
    "02_03": ({"spike": 1}, {"torque": 2}),
    "02_04": ({}, {}),
    "02_05": ({"spike": 1}, {}),
    "02_06": ({}, {}),
    "02_07": ({"spike": 3}, {}),
    "02_10": ({}, {}),
    "03_01": ({"spike": 1}, {"float": 1, "ground_offset": 1, "foot_skate": 1, "penetration": 3}),
    "03_03": ({"spike": 18}, {"float": 13, "ground_offset": 1, "penetration": 30, "foot_skate": 5}),
}


@functools.cache
def humanoid() -> Character:
    return load_character("humanoid", installed().registry)


@functools.cache
def read(stem: str) -> Clip:
    folder = data_folder()
    path = folder and folder / "motions" / "cmu" / f"{stem}.amc"
    if path is None or not path.is_file():
        pytest.skip(f"${DATA_VARIABLE} has no motions/cmu/{stem}.amc")
    return find(str(path), installed().registry)


@functools.cache
def moved_onto_the_humanoid(stem: str) -> tuple[Clip, Report]:
    return retarget(read(stem), humanoid())


def majors(findings: tuple[Finding, ...]) -> Counter[str]:
    return Counter(f.kind for f in findings if f.severity == Severity.MAJOR)


def test_every_clip_is_listed() -> None:
    folder = data_folder()
    if folder is None:
        pytest.skip(f"${DATA_VARIABLE} is not a folder")
    assert {path.stem for path in Path(folder).glob("motions/cmu/*.amc")} <= set(EXPECTED)


@pytest.mark.parametrize("stem", EXPECTED)
def test_major_findings(stem: str) -> None:
    recorded, on_humanoid = EXPECTED[stem]
    clip = read(stem)
    assert majors(examine(clip, None).findings) == recorded
    moved, report = moved_onto_the_humanoid(stem)
    assert report.mean_error < 0.02
    assert majors(examine(moved, humanoid()).findings) == on_humanoid


@pytest.mark.parametrize("stem", ["02_01", "02_03"])
def test_a_gait_cycle_stands_on_the_floor(stem: str) -> None:
    """Repaired, it goes nowhere more than 1 cm into the floor; cut to a cycle, neither."""
    figure = humanoid()
    moved, _ = moved_onto_the_humanoid(stem)
    mended = repair(examine(moved, figure)).clip
    loop = make_loop(mended, figure).clip
    for clip in (mended, loop):
        assert figure.clearance(figure.qpos(clip)).min() > -0.01
    assert loop.loop
    assert not {f.kind for f in examine(loop, figure).findings} & {"seam_pose", "seam_velocity"}
    assert loop.licence == moved.licence

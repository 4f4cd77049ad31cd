"""A grip that is found, held, written and read; and files that are none."""

from __future__ import annotations

import json
import math
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from understudy.command.cli import main
from understudy.errors import ConfigError, FileError
from understudy.setup.plugins import load
from understudy_gripping.balance import balance
from understudy_gripping.finding import find_grip, search_grip
from understudy_gripping.grip import (
    Grip,
    brush,
    large,
    load_grip,
    long,
    standard,
    t_pose,
    tongs,
    tongs_wide,
    tri_finger,
)
from understudy_gripping.hold import Held, placed
from understudy_gripping.holding import holding
from understudy_gripping.pose import PoseSolver
from understudy_gripping.section import _kept
from understudy_gripping.styles import NAMED
from understudy_hand.scene import FIRM, HandScene
from understudy_hand.table import ARM_POSE
from understudy_mujoco.contact import Contact
from understudy_tool_planner.gripper import Jaws


def scene(**options: Any) -> HandScene:
    return HandScene(HandScene.Options(**options))


@pytest.fixture(scope="module")
def grip() -> Grip:
    return load_grip(standard())


def test_the_standard_grip_holds_for_ten_seconds(grip: Grip) -> None:
    """Less than 1 mm of drift, less than 0.5 mm of penetration at 5 ms, all seven links touching, at
    every angle."""
    made = scene()
    assert made.model.opt.timestep == 0.005
    for row in range(len(grip.angles)):
        held = grip.held(made, row, seconds=10.0, settle=1.0)
        assert held.fell is None
        assert held.drift.max() < 1e-3
        assert held.depth < 0.5e-3
        assert held.links == {
            "thumb_distal", "index_distal", "middle_distal", "ring_distal",
            "thumb_middle", "index_metacarpal", "index_proximal",
        }  # fmt: skip


def test_the_engines_default_contacts_hold_nothing(grip: Grip) -> None:
    """So it is the settings that hold, and the test above can fail."""
    soft = Contact("discrete", "pyramidal", 1.0, solref=(0.02, 1.0), solimp=(0.9, 0.95, 0.001))
    fell = grip.held(scene(contact=soft), 0, seconds=3.0).fell
    assert fell is not None
    assert fell < 1.0


def test_firm_contacts_bear_noise_under_the_discrete_integrator_alone(grip: Grip) -> None:
    """20 mrad on the hand's targets and 2 on the arm's, which stiff servos under ``implicitfast`` turn
    into a shaking that throws the sticks out."""
    for integrator, holds in (("discrete", True), ("implicitfast", False)):
        made = scene(contact=replace(FIRM, integrator=integrator))
        data = placed(made, np.array(ARM_POSE), grip.poses[0], grip.upper[0], grip.lower)
        first = data.body("lower_stick").xpos - data.body("palm").xpos
        generator, far = np.random.default_rng(0), 0.0
        for _ in range(150):
            noise = generator.normal(size=36) * np.array([0.002] * 7 + [0.02] * 29)
            data.ctrl[:] = np.array([*ARM_POSE, *grip.targets[0]]) + noise
            for _ in range(2):
                mujoco.mj_step(made.model, data)
            now = data.body("lower_stick").xpos - data.body("palm").xpos
            far = max(far, float(np.linalg.norm(now - first)))
            if not far < 0.03:
                break
        assert (far < 0.03) == holds, integrator


def test_forces_balance_both_sticks(grip: Grip) -> None:
    made = scene()
    data = placed(made, np.array(ARM_POSE), grip.poses[0], grip.upper[0], grip.lower)
    found = balance(made, data, grip.style, 3.0, 1.0)
    assert found.error < 0.05
    assert min(found.forces.values()) >= 1.0 - 1e-6
    np.testing.assert_allclose(found.targets[7:], grip.targets[0], atol=1e-3)


def test_it_is_found_from_the_t_pose_as_packaged(grip: Grip) -> None:
    """What costs nothing, such as a little finger a little elsewhere, need not be the same."""
    found = find_grip(scene(), NAMED["standard"], grip.places)
    np.testing.assert_allclose(found.lower[:3], grip.lower[:3], atol=3e-3)
    held = found.held(scene(), 0, seconds=5.0, settle=1.0)
    assert held.drift.max() < 1e-3
    assert held.depth < 0.5e-3
    assert len(held.links) == 7


def test_what_is_written_is_read(grip: Grip, tmp_path: Path) -> None:
    grip.save(tmp_path / "grip.json")
    read = load_grip(tmp_path / "grip.json")
    assert (read.measures, read.style, read.places, read.hinges) == (
        grip.measures, grip.style, grip.places, grip.hinges,
    )  # fmt: skip
    for name in ("lower", "angles", "poses", "targets"):
        np.testing.assert_array_equal(getattr(read, name), getattr(grip, name))


def test_a_pose_whose_sticks_fall_is_no_grip(grip: Grip) -> None:
    """Reached, balanced, and let go by contacts as soft as the engine's default."""
    soft = Contact(None, "pyramidal", 1.0, solref=(0.02, 1.0), solimp=(0.9, 0.95, 0.001))
    with pytest.raises(
        ConfigError, match=r"does not hold the sticks: at an angle of 0 rad one falls"
    ):
        find_grip(scene(contact=soft), NAMED["standard"], grip.places, iterations=80)


def test_fingers_that_cannot_keep_apart_are_said(
    grip: Grip, monkeypatch: pytest.MonkeyPatch
) -> None:
    near = (-0.0032, ("ring_distal", "little_distal"))
    monkeypatch.setattr("understudy_gripping.finding.nearest_fingers", lambda *_: near)
    said = "ring distal and little distal are 3.2 mm in each other, and 0.5 mm were asked for"
    with pytest.raises(ConfigError, match=said):
        find_grip(scene(), NAMED["standard"], grip.places, iterations=80, finger_clearance=5e-4)


@pytest.mark.parametrize("options", [{"fingers": 4}, {"size": 2.0}, {"finger_length": 2.0}])
def test_a_grip_of_another_hand_is_refused(grip: Grip, options: dict[str, Any]) -> None:
    with pytest.raises(
        ConfigError, match="is one of a hand with 5 fingers, finger_length 1 and size 1"
    ):
        grip.need(scene(**options))


def test_tongs_take_no_grip_of_sticks(grip: Grip) -> None:
    with pytest.raises(ConfigError, match="the scene has tongs"):
        grip.need(scene(tool="tongs"))


def change(key: str, value: Any) -> str:
    values = json.loads(standard().read_text(encoding="utf-8"))
    values[key] = value
    return json.dumps(values)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "is no grip"),
        ("[]", "it is not of version 1"),
        ('{"version": 2}', "it is not of version 1"),
        ('{"version": 1}', "it has no 'hand'"),
        (change("hand", {"fingers": 9, "finger_length": 1, "size": 1}), "fingers=9"),
        (change("hand", {"fingers": math.inf, "finger_length": 1, "size": 1}), "is no grip"),
        (change("hand", {"fingers": 5, "finger_length": 10**400, "size": 1}), "is no grip"),
        (change("hand", [1]), "is no grip"),
        (change("style", "12112"), "cross"),
        (change("tool", "fork"), "there is no tool 'fork'"),
        (change("tool", []), "is no grip"),
        (change("holds", 1), "holds is neither true nor false"),
        (change("places", [0.1]), "places are not 4 finite numbers"),
        (change("lower", [0, 0, 0, 2, 0, 0, 0]), "no unit quaternion"),
        (change("lower", [0, 0, 0, "x", 0, 0, 0]), "lower are not 7 finite numbers"),
        (change("angles", [0.0, 0.0, 0.1, 0.12, 0.15]), "two or more that rise"),
        (change("angles", 7), "is no grip"),
        (change("poses", [[float("nan")] * 29] * 5), "poses are not 5 × 29 finite numbers"),
        (change("targets", [[1e9] * 29] * 5), "larger than any"),
        (change("hinges", ["a", "a"]), "not named each once"),
        ("[" * 100_000, "is no grip"),
        ("x" * (1 << 21), "larger than 1 MiB"),
    ],
)
def test_files_that_are_none_are_refused(text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "grip.json").write_text(text, encoding="utf-8")
    with pytest.raises(FileError, match="is no grip") as error:
        load_grip(tmp_path / "grip.json")
    assert said in str(error.value)


def test_a_grip_with_other_hinges_is_not_of_the_hand(grip: Grip) -> None:
    """As a file may name them; they are those of every grip that comes with the plugin."""
    grip.need(scene())
    fewer = replace(grip, hinges=grip.hinges[:-1], poses=grip.poses[:, :-1])
    for one in (fewer, replace(grip, hinges=grip.hinges[::-1])):
        with pytest.raises(ConfigError, match="11120 names other hinges than the scene's hand"):
            one.need(scene())


@pytest.mark.timeout(20)
def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "grip.json")
    with pytest.raises(FileError, match="it is no file"):
        load_grip(tmp_path / "grip.json")


def test_a_run_that_keeps_no_grip_is_refused(tmp_path: Path) -> None:
    (tmp_path / "against.txt").write_text(json.dumps({"grip": "it falls"}))
    with pytest.raises(FileError, match="it leaves none"):
        _kept(tmp_path, ["grip"])


def test_a_missing_file_is_said(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"There is no grip at nowhere\.json"):
        load_grip(Path("nowhere.json"))
    with pytest.raises(FileError, match=r"is no grip: Is a directory\.$"):
        load_grip(tmp_path)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["12112"], "cross"),
        (["11120", "--fingers", "3"], "5 entries and the hand 3 fingers"),
        (["11120", "--places", "35"], "--places takes 4 numbers"),
        (["11120", "--places", "35", "2", "-9", "nan"], "between -130 and 130"),
        (["11120", "--size", "0"], "--size=0.0 is not possible"),
        (["11120", "--tool", "fork"], "No hand holds 'fork'. There are: sticks, tongs, brush."),
        (["11120", "--tool", "tongs"], "tongs are held otherwise. A hand of 5 fingers has: 21100."),
        (["11120", "--tries", "-1"], "--tries is a number from 0 to 1000"),
        (["11120", "--finger-clearance", "-1"], "--finger-clearance -1 is not from 0 to 2 mm"),
        (["11120", "--finger-clearance", "nan"], "--finger-clearance nan is not from 0 to 2 mm"),
        (["11120", "--force", "0"], "--force 0 is not from 0.1 to 10 N"),
        (["11120", "--places", "120", "-120", "120", "-120"], "has no pose"),
    ],
)
def test_bad_words_are_one_sentence_and_nothing_is_written(
    words: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "grip.json"
    assert main(["grip", words[0], str(file), *words[1:]]) == 2
    printed = capsys.readouterr().err
    assert said in printed
    assert len(printed.strip().splitlines()) == 1
    assert not file.exists()


@pytest.mark.parametrize(
    ("fell", "told"),
    [
        ((None, None, None, None, None), "slip by 1.00 and 2.00 mm in 9 s at the worst of 5 angles"),
        ((None, 3.2, None, None, 1.5), "not for ten: at 2 of 5 angles a part falls, first after 1.50 s (at 0.15 rad)"),
    ],
)  # fmt: skip
def test_a_grip_that_lets_go_after_a_second_says_so(
    fell: tuple[float | None, ...], told: str, grip: Grip, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    """How far parts slip until one falls is no slip of nine seconds."""

    def held(self: Grip, scene: HandScene, row: int, *seconds: float) -> Held:
        return Held(fell[row], np.array([1e-3, 2e-3]), np.zeros(2), 0.0, np.zeros(1), frozenset())

    monkeypatch.setattr("understudy_gripping.command.find_grip", lambda *_, **__: grip)
    monkeypatch.setattr(Grip, "held", held)
    assert main(["grip", "11120", str(tmp_path / "grip.json")]) == 0
    assert told in capsys.readouterr().out


@pytest.mark.parametrize("file", ["nosuch/grip.json", "."])
def test_a_file_that_cannot_be_written_is_told_before_the_search(
    file: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("understudy_gripping.command.find_grip", None)
    assert main(["grip", "11120", file]) == 2
    assert "cannot be written: it is a folder, or in none" in capsys.readouterr().err


# ------------------------------------------------------------------ other tools


#: By name: the file, the tool, and how far it may slip in ten seconds, m; the wide tongs slip by 1.10 mm at 0.14 rad.
OTHER_TOOLS = {
    "tongs": (tongs(), "tongs", 1e-3),
    "tongs_wide": (tongs_wide(), "tongs", 1.2e-3),
    "brush": (brush(), "brush", 1e-3),
}
OTHER_HANDS: dict[str, tuple[Path, dict[str, Any]]] = {
    "long": (long(), {"finger_length": 2.0}),
    "large": (large(), {"size": 2.0}),
    "tri_finger": (tri_finger(), {"fingers": 3}),
}


def test_every_packaged_grip_is_held_here() -> None:
    assert {"standard", "t_pose", "adroit", *OTHER_TOOLS, *OTHER_HANDS} == set(
        load().registry.names("grip")
    )


def test_the_t_pose_touches_nothing_lets_the_sticks_fall_and_says_so(tmp_path: Path) -> None:
    """Figure 5.6: all of its angles are one pose, that from which grips are searched."""
    found, made = load_grip(t_pose()), scene()
    found.need(made)
    rest = PoseSolver(made).rest(found.style)
    assert found.poses == pytest.approx(rest.expand(len(found.angles), -1).numpy(), abs=1e-6)
    assert not found.holds
    data = placed(made, np.array(ARM_POSE), found.poses[0], found.upper[0], found.lower)
    assert data.ncon == 0
    fell = found.held(made, 0, seconds=1.0).fell
    assert fell is not None
    found.save(tmp_path / "grip.json")
    assert not load_grip(tmp_path / "grip.json").holds
    assert load_grip(standard()).holds


@pytest.mark.parametrize("name", OTHER_TOOLS)
def test_grips_of_other_tools_hold_for_ten_seconds(name: str) -> None:
    """As the standard grip does, at every angle, by the fingers that its style names and no other. Of the wide tongs the middle finger has left
    the bar where they are closed furthest; thumb and index finger hold them there."""
    path, tool, slip = OTHER_TOOLS[name]
    found = load_grip(path)
    assert (found.tool, found.style[3:]) == (tool, (0, 0))
    found.need(made := scene(tool=tool))
    for angle, row in zip(found.angles, range(len(found.angles)), strict=True):
        held = found.held(made, row, seconds=10.0, settle=1.0)
        assert held.fell is None
        assert held.drift.max() < slip
        assert held.depth < 0.5e-3
        pinched = {"thumb_distal", "index_distal"}
        assert {link for link in held.links if link.endswith("_distal")} == (
            pinched if name == "tongs_wide" and angle > 0.15 else {*pinched, "middle_distal"}
        )


def test_the_wide_tongs_close_upon_a_sphere_of_2_cm_and_the_others_do_not() -> None:
    """What they are packaged for: between the bars are less than 20 mm at their last angle, and more at their first."""
    jaws = Jaws("tongs")
    wide, narrow = (load_grip(path).angles for path in (tongs_wide(), tongs()))
    assert jaws.room(float(wide[-1])) < 0.02 < jaws.room(float(wide[0]))
    assert jaws.room(float(narrow[-1])) == pytest.approx(0.036, abs=1e-3)


@pytest.mark.parametrize("name", OTHER_HANDS)
def test_grips_of_other_hands_hold(name: str) -> None:
    """Three seconds at both ends of their angles, on both sticks; of other hands they are refused."""
    path, hand = OTHER_HANDS[name]
    found = load_grip(path)
    found.need(made := scene(**hand))
    for row in (0, len(found.angles) - 1):
        held = found.held(made, row, seconds=3.0)
        assert held.fell is None
        assert held.drift.max() < 1e-3
        assert held.depth < 0.5e-3
    with pytest.raises(ConfigError, match="is one of a hand with"):
        found.need(scene())


@pytest.mark.parametrize("path", [tongs(), tongs_wide()], ids=["tongs", "tongs_wide"])
def test_a_grip_of_tongs_presses_against_their_spring(path: Path) -> None:
    """The torque of thumb's force about the hinge is 20 N m/rad times how far the bars are closed."""
    made, found = scene(tool="tongs"), load_grip(path)
    for row, angle in enumerate(found.angles):
        data = placed(made, np.array(ARM_POSE), found.poses[row], found.upper[row], found.lower)
        assert float(data.joint("opening").qpos[0]) == pytest.approx(0.2 - angle, abs=1e-6)
        balanced = balance(made, data, found.style, 3.0, 1.0)
        if (
            path == tongs()
        ):  # no forces of three fingers balance the wide ones, which turn as they settle
            assert balanced.error < 0.3
        lever = 0.13 - found.places[0]
        assert balanced.forces["thumb_distal"] * lever == pytest.approx(20.0 * angle, rel=0.35)


def test_a_search_takes_the_first_guess_where_no_other_is_drawn() -> None:
    """One try is the tool's own place, so that a search is never worse than none."""
    made = scene(tool="brush")
    places = holding("brush").first_guess((1, 1, 1, 0, 0))
    found = search_grip(made, (1, 1, 1, 0, 0), places, tries=1, iterations=60)
    assert found.places == pytest.approx(places)
    assert found.held(made, 0, 3.0).drift.max() < 1e-3


def test_a_search_that_finds_none_says_how_far_it_came() -> None:
    with pytest.raises(
        ConfigError, match=r"None of 1 places of the style 11100 holds; the fingers reach 0"
    ):
        search_grip(
            scene(tool="brush"), (1, 1, 1, 0, 0), (0.12, -0.12, 0.12), tries=1, iterations=30
        )

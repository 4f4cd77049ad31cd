"""The skills that come with the package: they stand, can be pushed, and are small and whole."""

from __future__ import annotations

import dataclasses
import json
import math
import re
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from page_requests import check_nonsense, check_page, visitor

from understudy.command.cli import main
from understudy.errors import ConfigError, RunError
from understudy.records import checkpoint
from understudy.records.runs import open_run
from understudy.running.training import Training
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import installed
from understudy_motion.library import data_folder
from understudy_play.command import clip_of, record
from understudy_play.player import Player
from understudy_skills import skill as skills
from understudy_skills.as_run import unpack
from understudy_skills.pack import pack
from understudy_skills.skill import open_skill


def file_of(name: str) -> Path:
    """Of the skill `name`, without its suffixes."""
    return installed().registry.find("skill", name).factory()


def stages(name: str) -> list[str]:
    """The skills that `name` plays one after the other."""
    actuation = open_skill(name).card["config"].get("actuation") or {}
    return [stage["run"] for stage in actuation.get("stages", [])]


#: By the skill that is a stage, the one that plays it: there alone it begins where it learned to.
PLAYED_BY = {stage: name for name in skills.names() for stage in stages(name)}


@pytest.fixture(scope="module")
def walk() -> skills.Skill:
    return open_skill("spacetime/walk")


@pytest.fixture
def player(walk: skills.Skill) -> Iterator[Player]:
    player = Player(walk)
    yield player
    player.close()


@pytest.mark.parametrize("name", [name for name in skills.names() if name not in PLAYED_BY])
def test_a_skill_plays_two_seconds_without_falling(name: str) -> None:
    skill = open_skill(name)
    clip = clip_of(skill.card)
    if clip and not list((data_folder() or Path()).glob(f"motions/*/{clip}.*")):
        pytest.skip(f"no clip {clip}: UNDERSTUDY_DATA is not set, or has none of that name")
    player = Player(skill)
    try:
        tracks = record(player, 2.0)
    finally:
        player.close()
    assert player.falls == 0
    moving = tracks["particle_position" if name.startswith("amorphous/") else "qpos"]
    assert len(moving) == round(2.0 / player.dt)
    # It moves by metres, or turns in place: by 50 degrees, which is 0.4 in the root's quaternion.
    # A hand stands, and its fingers move by 8 degrees.
    least = 0.14 if name.startswith("chopsticks/") else 0.4
    assert np.ptp(moving, axis=0).max() > least


@pytest.mark.parametrize("name", skills.names())
def test_a_skill_is_small_and_has_a_card(name: str) -> None:
    path = file_of(name)
    assert path.with_suffix(".safetensors").stat().st_size < 1e6
    card = open_skill(name).card
    if "motion" in card["config"]:
        assert card["config"]["motion"]["file"] is None  # a clip by name
        assert "/" not in card["sources"]["motion"]["source"]
    assert any(word.startswith("experiment=") for word in card["overrides"])  # can be unpacked
    assert card["samples"] > 0 or stages(name)  # what plays others has learned nothing itself
    judged = open_skill(PLAYED_BY.get(name, name)).card["evaluation"]
    assert judged["success_rate"] >= 0.9
    assert "/" not in json.dumps(card["config"]["run"])


def test_a_push_moves_the_character(player: Player) -> None:
    player.step()
    simulator = player.environment.parts.simulator
    before = simulator.read("qvel").clone()
    told = simulator.read("ctrl").clone()
    player.push((0.0, 9.0, 0.0))
    assert torch.equal(simulator.read("ctrl"), told), "servos know nothing of it"
    after = simulator.read("qvel")
    mass = float(player.scene.model.body_mass.sum())  # type: ignore[attr-defined]
    expected = before.clone()
    expected[:, 1] += 9.0 / mass
    torch.testing.assert_close(after, expected)
    player.step()
    assert player.falls == 0


def test_a_hard_push_makes_it_fall_and_it_begins_again(player: Player) -> None:
    for _ in range(20):
        player.step()
    player.push((0.0, 150.0, 0.0))
    for _ in range(60):
        player.step()
    assert player.falls >= 1
    assert player.shown()["qpos"][2] > 0.5


def test_on_the_floor_alone_the_character_stays_with_its_clip(player: Player) -> None:
    player.environment.table["qpos"][0, 0] += 0.15
    player._set(player._state())
    before = player.shown()["qpos"]
    player._take_reference_along()
    away = player.environment.table["qpos"] - player.environment.table["reference_qpos"]
    assert float(away[0, :2].norm()) < 0.09
    torch.testing.assert_close(player.shown()["qpos"], before)  # shown where it really is


def test_beside_a_chair_the_character_stays_where_it_is() -> None:
    """Taken back to its clip it would be moved over the seat, and be shown beside it."""
    player = Player(open_skill("sitting/sit"))
    try:
        for _ in range(round(5.0 / player.dt)):
            player.step()
        assert float(player.environment.table["seated"][0]) == 1.0
        away = player.shown()["qpos"][:2] - player.environment.table["seat_position"][0, :2]
        assert float(away.norm()) < 0.3
    finally:
        player.close()


def test_a_long_decision_is_shown_by_its_control_periods(tmp_path: Path) -> None:
    run = tmp_path / "run"
    assert main(["play", "sitting/sit", "--unpack", str(run)]) == 0
    player = Player(open_skill(str(run), ["control.decision=5"]))
    try:
        seen = torch.stack([shown["qpos"] for shown in player.step()])
        assert len(seen) == 5
        assert bool((seen[1:] != seen[:-1]).any(dim=1).all())
        torch.testing.assert_close(seen[-1], player.shown()["qpos"])
        assert record(player, 0.2)["qpos"].shape[0] == round(0.2 / player.dt)
    finally:
        player.close()


def test_an_unpacked_skill_still_says_whose_motion_it_is(tmp_path: Path) -> None:
    assert main(["play", "spacetime/hop", "--unpack", str(tmp_path / "run")]) == 0
    card = open_skill(str(tmp_path / "run"), ["scene.contact.solref=[0.01,1.0]"]).card
    assert card["sources"] == open_skill("spacetime/hop").card["sources"]
    assert card["sources"]["motion"]["licence"]


def test_the_page_shows_the_chair_where_the_episode_has_it() -> None:
    pytest.importorskip("viser", reason="viser is not installed (the extra 'view')")
    from understudy_play.page import Page
    from understudy_viewer.page import free_port

    page = Page(Player(open_skill("sitting/sit")), "127.0.0.1", free_port("127.0.0.1", 0))
    try:
        drawn = list(page._things)
        assert {thing.name.split("/")[-2] for thing in drawn} == {"chair"}
        chair = page._player.shown()["chair_position"].numpy()
        for thing in drawn:
            assert np.allclose(thing.position, chair, atol=1e-6)
        page.advance()
        assert page._things == drawn  # it stands still
        page._controls.again = True
        page.advance()
        assert np.allclose(page._things[0].position, page._player.shown()["chair_position"])
        check_page(page.url)  # which answers its own address alone
    finally:
        page.close()


def test_the_page_shows_any_other_scene() -> None:
    """A hand with two sticks: its geoms where MuJoCo has them, some 30 times a second."""
    pytest.importorskip("viser", reason="viser is not installed (the extra 'view')")
    import mujoco

    from understudy_play.scene_page import ScenePage
    from understudy_viewer.page import free_port

    player = Player(open_skill("chopsticks/standard"))
    page = ScenePage(player, "127.0.0.1", free_port("127.0.0.1", 0))
    try:
        model = player.scene.shown().compile()  # type: ignore[attr-defined]
        data = mujoco.MjData(model)
        before = [place for place, _ in page.places()]
        assert len(before) == model.ngeom
        for _ in range(21):
            page.advance()
        data.qpos[:] = player.shown()["qpos"]
        mujoco.mj_kinematics(model, data)
        found = [place for place, _ in page.places()]
        np.testing.assert_allclose(found, data.geom_xpos, atol=1e-6)
        assert not np.allclose(found, before, atol=1e-4)
        assert player.fallen == "no failure", "a hand does not fall"
        with pytest.raises(ConfigError, match="no character that can be pushed"):
            player.push((0.0, 1.0, 0.0))
        page._controls.again = True
        page.advance()
        assert not np.allclose([place for place, _ in page.places()], found, atol=1e-5)
        check_page(page.url)
    finally:
        page.close()


def test_a_target_is_dragged_and_the_object_brought_there() -> None:
    """One beyond reach is red, and the hand waits; one within reach is green, and its plan is drawn. An object that is nudged is planned for anew."""
    pytest.importorskip("viser", reason="viser is not installed (the extra 'view')")
    from understudy_play.scene_page import ScenePage
    from understudy_viewer.page import free_port

    player = Player(open_skill("chopsticks/relocate", ["scene.object.rolling=0.0005"]), seed=3)
    page = ScenePage(player, "127.0.0.1", free_port("127.0.0.1", 0))
    table = player.environment.table

    def until(done: Callable[[], bool], steps: int) -> None:
        for _ in range(steps):
            page.advance()
            if done():
                return
        raise AssertionError("not within the steps")

    def wait(done: Callable[[], bool]) -> None:
        due = time.monotonic() + 20.0
        while not done() and time.monotonic() < due:
            time.sleep(0.02)
        assert done(), "not within the time"

    leads = player.leads
    assert leads is not None
    try:
        first = player.way()[-1]
        assert page.target == (pytest.approx(tuple(first)), True)
        page.send(0.6, 0.2)
        page.advance()
        page.advance()
        np.testing.assert_array_equal(player.way()[-1], first, "what has begun is ended first")
        until(lambda: bool(leads.refused), 400)
        for _ in range(3):
            page.advance()
        assert "the arm is too short, by" in leads.refused
        assert not page.target[1]
        hinges = table["qpos"][0, :7].clone()
        for _ in range(12):
            page.advance()
        assert (table["qpos"][0, :7] - hinges).abs().max() < 0.02, "it waits"
        assert player.falls == 0, "an episode goes on where it would have ended"

        with visitor(page.url) as send:  # a browser's messages, over a socket
            turn, goal = (1.0, 0.0, 0.0, 0.0), (0.05, -0.02, 0.01)
            send("TransformControlsDragStartMessage", name="/target")
            for place in ((0.2, 0.1, 0.01), goal):
                send("TransformControlsUpdateMessage", name="/target", wxyz=turn, position=place)
            wait(lambda: page.target[0] == pytest.approx(goal))
            page.advance()
            assert leads.refused, "it goes nowhere before the drag has ended"
            send("TransformControlsDragEndMessage", name="/target")
            wait(lambda: page._sent is not None)
        until(lambda: bool((player.way()[-1, :2] == np.float32([0.05, -0.02])).all()), 5)
        for _ in range(3):
            page.advance()
        assert page.target == (pytest.approx((0.05, -0.02, 0.01), abs=1e-6), True)
        until(lambda: bool(table["plan_over"][0]), 400)
        assert float((table["qpos"][0, 50:52] - torch.tensor([0.05, -0.02])).norm()) < 0.005

        with visitor(page.url) as send:
            held = (0.1, 0.03, 0.01)
            send("TransformControlsDragStartMessage", name="/target")
            send("TransformControlsUpdateMessage", name="/target", wxyz=turn, position=held)
            wait(lambda: page.target[0] == pytest.approx(held))
            for _ in range(2):  # one leaves it within 5 mm of the goal
                page.nudge(1.0, 0.0)
            until(lambda: float(table["replans"][0]) == 1.0, 250)
            for _ in range(3):
                page.advance()
            assert page.target[0] == pytest.approx(held), "a new plan leaves what is dragged"
        np.testing.assert_array_equal(player.way()[-1, :2], np.float32([0.05, -0.02]))
        lies = table["qpos"][0, 50:52].numpy()
        np.testing.assert_allclose(player.way()[0, :2], lies, atol=1e-3)
        assert player.falls == 0
        target = page.target
        check_nonsense(page.url, page._server)
        assert page.target == target
    finally:
        page.close()


def test_nobody_leads_where_nothing_can_be_led(player: Player) -> None:
    assert player.leads is None


def test_what_comes_with_the_package_can_be_judged_and_packed_anew(tmp_path: Path) -> None:
    """A packed skill has no critic, and its evaluation needs none."""
    file = tmp_path / "sit.json"
    words = ["evaluation.final_episodes=2", "evaluation.seconds=0.2"]
    assert main(["play", "sitting/sit", *words, "--pack", str(file)]) == 0
    before, after = open_skill("sitting/sit"), open_skill(str(file))
    assert after.card["evaluation"]["episodes"] == 32, "two tell nothing of what rounding costs"
    assert after.card["weights"]["bits"] == 8
    assert after.policy.keys() == before.policy.keys()
    for name, value in after.policy.items():
        torch.testing.assert_close(value, before.policy[name], rtol=0.01, atol=1e-3)


def test_a_packed_skill_names_no_folder_of_its_makers(walk: skills.Skill, tmp_path: Path) -> None:
    sources = {
        "motion": {"source": "/home/me/clips/walk.bvh", "licence": "CC0-1.0"},
        "start": {"run": "/home/me/runs/before", "samples": 1000},
    }
    made = replace(walk, card={**walk.card, "sources": sources})
    pack(made, tmp_path / "walk", {})
    found = open_skill(str(tmp_path / "walk.json")).card["sources"]
    assert found["motion"]["source"] == "walk.bvh"
    assert found["start"] == {"run": "before", "samples": 1000}


def test_a_packed_skill_names_clips_and_models_of_no_folder(
    walk: skills.Skill,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Whoever plays it has them elsewhere, and is asked for them."""
    monkeypatch.chdir(tmp_path)
    clip, model = "/home/me/my clips/walk.bvh", "/home/me/robot.xml"
    words = [f"motion.file={clip}", f"+x=[a,'{clip}']", "motion.file=/old/b.bvh"]
    words = [*walk.card["overrides"], f"scene.character={model}", *words]
    config = dict(walk.card["config"])
    config["motion"] = {**config["motion"], "name": None, "file": clip}
    config["scene"] = {**config["scene"], "character": model}
    made = replace(walk, card={**walk.card, "overrides": words, "config": config})
    pack(made, tmp_path / "walk", {})
    card = open_skill(str(tmp_path / "walk.json")).card
    assert card["config"]["motion"]["file"] == "walk.bvh"
    assert card["config"]["scene"]["character"] == "robot.xml"
    assert card["overrides"][-4:] == [
        "scene.character=robot.xml", "motion.file=walk.bvh", "+x=[a,'walk.bvh']", "motion.file=b.bvh",
    ]  # fmt: skip
    assert main(["play", str(tmp_path / "walk.json"), "--video", str(tmp_path / "a.mp4")]) == 2
    assert "no copies of them: give yours, motion.file=PATH." in capsys.readouterr().err
    for file in ("a.onnx", "a.glb"):  # commands that take no overrides
        assert main(["export", str(tmp_path / "walk.json"), str(tmp_path / file)]) == 2
        told = f"`understudy play {tmp_path}/walk.json motion.file=PATH --unpack FOLDER`"
        assert told in capsys.readouterr().err


@pytest.mark.parametrize("ending", ["", ".safetensors"])
def test_a_pack_without_its_ending_is_named(
    walk: skills.Skill, tmp_path: Path, ending: str
) -> None:
    pack(walk, tmp_path / "my.walk", {})
    with pytest.raises(ConfigError, match=rf"Did you mean '{tmp_path}/my\.walk\.json'\?"):
        open_skill(str(tmp_path / f"my.walk{ending}"))


def test_packing_again_changes_nothing(walk: skills.Skill, tmp_path: Path) -> None:
    pack(walk, tmp_path / "again", walk.card["evaluation"])
    again = open_skill(str(tmp_path / "again.json"))
    assert again.samples == walk.samples
    for name, value in walk.policy.items():
        torch.testing.assert_close(again.policy[name], value)


def test_a_pack_that_does_not_fit_leaves_the_one_before(
    walk: skills.Skill, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The tensors fit onto the disk, and the card does not any more."""
    pack(walk, tmp_path / "kept", {"success_rate": 1.0})
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    half = replace(walk, policy={name: 0.5 * value for name, value in walk.policy.items()})
    write = checkpoint.write_atomically

    def full(path: Path, data: bytes) -> None:
        if path.suffix == ".json":
            raise RunError(f"{path} could not be written: No space left on device.")
        write(path, data)

    monkeypatch.setattr(checkpoint, "write_atomically", full)
    for name in ("kept", "new"):
        with pytest.raises(RunError, match=rf"/{name}\.json could not be written: No space"):
            pack(half, tmp_path / name, {})
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
    monkeypatch.undo()
    pack(half, tmp_path / "kept", {})
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(before)
    assert (tmp_path / "kept.safetensors").read_bytes() != before["kept.safetensors"]
    assert open_skill(str(tmp_path / "kept.json")).card["evaluation"] == {}


def test_a_changed_byte_is_noticed(walk: skills.Skill, tmp_path: Path) -> None:
    pack(walk, tmp_path / "bad", {})
    file = tmp_path / "bad.safetensors"
    data = bytearray(file.read_bytes())
    data[-1] ^= 1
    file.write_bytes(data)
    with pytest.raises(RunError, match="digest"):
        open_skill(str(tmp_path / "bad.json"))


@pytest.mark.parametrize(
    "card",
    [
        {"samples": None}, {"samples": "many"}, {"samples": True}, {"samples": -1}, {"samples": 2**63}, {"config": None}, {"config": []}, {"config": 3},
        {"sources": "abc"}, {"evaluation": "abc"}, {"evaluation": [1]},
    ],
    ids=str,
)  # fmt: skip
def test_a_damaged_card_is_refused_in_a_sentence(
    card: dict[str, object], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    state, own = checkpoint.load(file_of("sitting/sit"))
    checkpoint.save(tmp_path / "bad", state, {**own, **card})
    for words in (["--unpack", str(tmp_path / "run")], ["--pack", str(tmp_path / "again")]):
        assert main(["play", str(tmp_path / "bad.json"), *words]) == 2
    assert capsys.readouterr().err.startswith("understudy: ")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["bad.json", "bad.safetensors"]


@pytest.mark.parametrize("scale", [torch.ones(3), torch.ones(10**6), torch.ones(2, 2)])
def test_scales_that_do_not_fit_are_refused(scale: torch.Tensor, tmp_path: Path) -> None:
    """One row of a million weights by a million scales would be a terabyte."""
    state, card = checkpoint.load(file_of("sitting/sit"))
    name = next(k for k, v in state["policy"].items() if isinstance(v, dict))
    state["policy"][name] = {"rows": torch.ones(1, 10**6, dtype=torch.int8), "scale": scale}
    checkpoint.save(tmp_path / "bad", state, card)
    with pytest.raises(RunError, match="do not fit"):
        open_skill(str(tmp_path / "bad.json"))


@pytest.mark.parametrize(
    "kind", [torch.float8_e4m3fn, torch.complex64, torch.bool, torch.int64], ids=str
)
@pytest.mark.parametrize("of", ["rows", "scale", "whole"])
def test_numbers_of_another_kind_are_refused(kind: torch.dtype, of: str, tmp_path: Path) -> None:
    """Nothing is computed with them, nor are they rounded to a policy's without a word."""
    state, card = checkpoint.load(file_of("sitting/sit"))
    policy = state["policy"]
    name = next(k for k, v in policy.items() if isinstance(v, dict) == (of != "whole"))
    held = policy if of == "whole" else policy[name]
    held[name if of == "whole" else of] = torch.ones(held[name if of == "whole" else of].shape).to(
        kind
    )
    checkpoint.save(tmp_path / "bad", state, card)
    with pytest.raises(
        RunError, match=rf"no packed skill: .* {kind}|does not fit .*: {name} differs"
    ):
        unpack(open_skill(str(tmp_path / "bad.json")), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_numbers_that_are_none_are_refused(tmp_path: Path) -> None:
    skill = open_skill("sitting/sit")
    bad = {name: value * math.nan for name, value in skill.policy.items()}
    with pytest.raises(RunError, match="not finite"):
        Player(dataclasses.replace(skill, policy=bad))


def test_a_name_with_dots_is_its_own_file(walk: skills.Skill, tmp_path: Path) -> None:
    pack(walk, tmp_path / "walk-1.json", {"which": "one"})
    pack(open_skill("spacetime/run"), tmp_path / "walk-1.5.json", {"which": "other"})
    assert open_skill(str(tmp_path / "walk-1.json")).card["evaluation"] == {"which": "one"}
    assert open_skill(str(tmp_path / "walk-1.5.json")).card["evaluation"] == {"which": "other"}
    assert main(["play", "sitting/sit", "--pack", "."]) == 2


@pytest.mark.parametrize("words", [["--seconds", "nan"], ["--seconds", "0"], ["--port", "-5"]])
def test_impossible_arguments_are_refused(words: list[str], tmp_path: Path) -> None:
    assert main(["play", "sitting/sit", "--video", str(tmp_path / "x.mp4"), *words]) == 2


@pytest.mark.parametrize(
    ("file", "text"), [("evaluation.json", "{bad"), ("run.json", None), ("metrics.jsonl", "[" * 10**5)]
)  # fmt: skip
def test_a_damaged_run_is_played_or_refused_in_a_sentence(
    file: str, text: str | None, tmp_path: Path
) -> None:
    run = tmp_path / "run"
    assert main(["play", "sitting/sit", "--unpack", str(run)]) == 0
    if text is None:
        info = json.loads((run / file).read_text())
        (run / file).write_text(json.dumps({**info, "overrides": [1]}))
        assert main(["play", str(run), "seed=1", "--unpack", str(tmp_path / "other")]) == 2
    else:
        (run / file).write_text(text)
        assert open_skill(str(run)).samples > 0
        assert main(["evaluate", str(run), "num_worlds=2", "episodes=2", "seconds=0.1"]) == 0


def test_a_skill_that_is_not_there_is_refused_with_the_ones_that_are() -> None:
    with pytest.raises(ConfigError, match=r"Did you mean 'spacetime/walk'"):
        open_skill("spacetime/wlk")


def test_without_a_name_it_lists_what_there_is(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["play"]) == 0
    listed = capsys.readouterr().out
    assert "spacetime/walk: 364,544 samples" in listed
    backflip = next(line for line in listed.splitlines() if line.startswith("spacetime/backflip"))
    assert backflip.endswith("; needs the clip humanoid3d_backflip")


@pytest.mark.parametrize("damage", ["cut", "another's card", "gone"])
def test_a_damaged_skill_of_a_plugin_is_named_and_left_out_of_the_list(
    damage: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    state, card = checkpoint.load(file_of("sitting/sit"))
    checkpoint.save(tmp_path / "bad", state, {**card, "samples": "many"})
    file = tmp_path / "bad.json"
    if damage == "cut":
        file.write_bytes(file.read_bytes()[:100])
    elif damage == "gone":
        file.unlink()
    registry = installed().registry
    skill = registry.components["skill", "sitting/sit"]
    monkeypatch.setitem(
        registry.components,
        ("skill", "sitting/sit"),
        replace(skill, target=lambda: tmp_path / "bad"),
    )
    assert main(["play"]) == 0
    listed, said = capsys.readouterr()
    assert "sitting/turn_left: " in listed
    assert "sitting/sit: " not in listed
    assert re.search(r"^understudy: sitting/sit is left out: .*bad", said, re.MULTILINE)


def test_a_skill_whose_clip_is_not_here_says_where_clips_come_from(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("UNDERSTUDY_DATA", str(tmp_path))
    assert main(["play", "spacetime/backflip", "--video", str(tmp_path / "x.mp4")]) == 2
    error = capsys.readouterr().err
    assert "No motion clip 'humanoid3d_backflip'" in error
    assert "`understudy motion fetch`" in error
    assert not (tmp_path / "x.mp4").exists()


def test_an_unpacked_skill_is_a_run_that_acts_as_the_skill_does(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "sit"
    assert main(["play", "sitting/sit", "--unpack", str(run)]) == 0
    few = ("num_worlds=4", "episodes=4", "seconds=1")
    assert main(["evaluate", str(run), *few]) == 0
    assert main(["evaluate", str(run), *few, "initial_states.degrees=0"]) == 0  # composed anew
    skill, again = open_skill("sitting/sit"), open_skill(str(run))
    assert again.samples == skill.samples
    assert again.experiment.sections == skill.experiment.sections
    for name, value in skill.policy.items():
        torch.testing.assert_close(again.policy[name], value)
    assert main(["play", "sitting/sit", "--unpack", str(run)]) == 2
    assert "already holds a run" in capsys.readouterr().err
    assert main(["resume", str(run)]) == 2
    said = capsys.readouterr().err
    assert f"start.run={run}" in said
    assert said.count("\n") == 1


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_a_skill_of_a_gpu_is_unpacked_without_one(tmp_path: Path) -> None:
    """The run says where it was trained; nothing is tried."""
    run = tmp_path / "sit"
    assert main(["play", "sitting/sit", "device=cuda", "--unpack", str(run)]) == 0
    assert open_run(run).config["device"] == "cuda"
    skill, again = open_skill("sitting/sit"), open_skill(str(run))
    for name, value in skill.policy.items():
        torch.testing.assert_close(again.policy[name], value)


def test_a_skill_packed_without_its_overrides_is_not_unpacked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    skill = open_skill("spacetime/walk")
    card = {key: value for key, value in skill.card.items() if key != "overrides"}
    pack(dataclasses.replace(skill, card=card), tmp_path / "old", card["evaluation"])
    assert main(["play", str(tmp_path / "old.json"), "--unpack", str(tmp_path / "walk")]) == 2
    assert "Pack it again" in capsys.readouterr().err
    assert not (tmp_path / "walk").exists()


@pytest.mark.parametrize("overrides", ["seed=1", [1], {"seed": 1}])
def test_a_skill_whose_overrides_are_no_words_is_refused(overrides: object, tmp_path: Path) -> None:
    skill = open_skill("sitting/walk")
    bad = dataclasses.replace(skill, card={**skill.card, "overrides": overrides})
    with pytest.raises(RunError, match="no list of words"):
        unpack(bad, tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("word", "said"),
    [
        ("seed=${oc.env:SECRET}", "would be read from this machine"),
        ("+run={dir: '${oc.decode:${oc.env:SECRET}}'}", "would be read from this machine"),
        ("hydra.searchpath=[pkg://os]", "cannot be configured"),
        ("experiment=../../secret", "names no option"),
        ("a=" + "[" * 2000 + "]" * 2000, "cannot be read"),
        ("+scene._target_=os.getcwd", "_target_"),
        (f"policy.hidden={[16] * 10_000}", "characters, and at most 10000 are read"),
    ],
)
def test_words_of_a_strangers_skill_read_and_run_nothing(
    word: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SECRET", "4711")
    skill = open_skill("sitting/walk")
    card = {**skill.card, "overrides": [*skill.card["overrides"], word]}
    pack(dataclasses.replace(skill, card=card), tmp_path / "bad", {})
    with pytest.raises(ConfigError, match=said) as error:
        open_skill(str(tmp_path / "bad.json"), ["control.decision=1"])
    assert "4711" not in str(error.value)
    assert len(str(error.value)) < 1000


def test_packing_keeps_the_overrides_that_made_a_run_and_no_folder(tmp_path: Path) -> None:
    run = tmp_path / "run"
    assert main(["play", "sitting/walk", "--unpack", str(run)]) == 0
    skill = open_skill(str(run), ["seed=3"])
    assert "experiment=sitting/walk" in skill.card["overrides"]
    assert "seed=3" in skill.card["overrides"]
    assert not any("run.dir" in word for word in skill.card["overrides"])


def test_a_packed_skill_takes_overrides_as_a_run_does(capsys: pytest.CaptureFixture[str]) -> None:
    """One that learned on a GPU is played without."""
    words = ["device=cpu", "seed=3", "episode.seconds=2.0"]
    skill = open_skill("spacetime/walk", words)
    assert skill.experiment.root.seed == 3
    assert skill.card["overrides"][-3:] == words
    assert skill.card["evaluation"] is None  # of another task
    assert main(["play", "spacetime/walk", "scene.character=other"]) == 2
    assert "other" in capsys.readouterr().err
    assert main(["play", "spacetime/walk", "learner.gamma=0.5"]) == 2
    told = "learner.gamma=0.5 changes a training, and nothing of what is played: leave it out."
    assert told in capsys.readouterr().err  # it was taken, and made no difference


@pytest.mark.parametrize("words", [["--video", "x.mp4"], ["--pack", "x"], ["--unpack", "x"]])
def test_what_is_of_a_skill_asks_for_one(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:  # fmt: skip
    """All skills were listed, and nothing was made."""
    monkeypatch.chdir(tmp_path)
    assert main(["play", *words]) == 2
    assert f"{words[0]} needs a skill. Name one" in capsys.readouterr().err
    assert not any(tmp_path.iterdir())


def test_an_unpacked_skill_is_harvested_where_its_curriculum_begins(tmp_path: Path) -> None:
    """It says nothing of how far that came."""
    run = tmp_path / "walk"
    assert main(["play", "sitting/walk", "--unpack", str(run)]) == 0
    words = ["experiment=sitting/ends", f"job.run={run}", "num_worlds=2", "simulator=mujoco"]
    training = Training(load_experiment(words)).prepare()
    table = training.job.environment.table  # type: ignore[attr-defined]
    start = json.loads((run / "run.json").read_text())["config"]["curriculum"]["start"]
    assert table["difficulty"].tolist() == [start, start]
    training.close()


def test_one_who_lies_down_is_no_success(player: Player) -> None:
    """Where the task ends nothing, what is seen is said."""
    assert player.fallen == "no fall"
    state = player._state()
    state["qpos"][:, 2] = 0.15
    player._set(state)
    assert player.fallen.startswith("down: its root is at 0.15 m, and was at 0.")
    player.restart()
    assert player.fallen == "no fall"


def test_what_is_packed_says_on_what_terms(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from understudy_play import command

    found: list[Any] = []
    monkeypatch.setattr(
        command, "_pack", lambda skill, path: found.append(skill.card["licence"]) or 0
    )
    assert main(["play", "spacetime/walk", "--pack", str(tmp_path / "walk.json")]) == 0
    assert found[0]["commercial"] == []
    assert "clip walk" in [item["what"] for item in found[0]["items"]]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--push", "3"], "--push is for videos. Add --video FILE"),
        (["--seconds", "3"], "--seconds is for videos. Add --video FILE"),
        (["--video", "v.mp4", "--push", "nan"], "nan is not a finite number"),
        (["--video", "v.mp4", "--push=-inf"], "-inf is not a finite number"),
        (["--video", "v.mp4", "--push", "strong"], "'strong' is no number"),
        (["--video", "v.mp4", "--seconds", "1e9"], "1e9 is not above 0 and at most 3600 s"),
        (["--video", "v.mp4", "--seconds", "nan"], "nan is not above 0"),
        (["--video", "v.mp4", "--seconds", "0"], "0 is not above 0"),
        *((["--video", name], "such as walk.mp4") for name in ("v.txt", "v", "v.gif", "v.mp4.bak")),
    ],
)  # fmt: skip
def test_a_video_of_no_possible_kind_is_refused(
    words: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:  # fmt: skip
    """A push of nan pushed nothing, an hour's hours had no end, and v.txt was a video."""
    monkeypatch.chdir(tmp_path)
    for command in (["play", "spacetime/walk"], ["sitting", "follow"]):
        if command[0] == "play" or "--push" not in " ".join(words):
            assert main([*command, *words]) == 2
            assert said in capsys.readouterr().err
    assert not any(tmp_path.iterdir())

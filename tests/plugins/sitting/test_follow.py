"""Finished skills go where a click on the page's floor sends them."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from page_requests import visitor

from understudy.command.cli import main
from understudy.errors import ConfigError
from understudy_sitting.follow import LEFT, RIGHT, WALK, Follower

HOST = "127.0.0.1"
TINY = (
    "num_worlds=2", "learner.rollout_steps=64", "learner.minibatches=2", "budget.samples=128",
    "evaluation.episodes=2", "evaluation.final_episodes=2", "evaluation.seconds=0.1",
)  # fmt: skip


@pytest.fixture(scope="module")
def skill(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A run of walking that has learned next to nothing."""
    run = tmp_path_factory.mktemp("skills") / "walk"
    assert main(["train", "experiment=sitting/walk", *TINY, f"run.dir={run}"]) == 0
    return str(run)


@pytest.fixture
def world(skill: str) -> Iterator[Follower]:
    world = Follower([skill])
    yield world
    world.close()


def test_the_target_is_what_the_skill_sees(world: Follower) -> None:
    table = world.environment.table
    for target, sine in (((0.0, 50.0), 1.0), ((0.0, -50.0), -1.0)):
        world.target = target
        world.step()
        assert table["target"][0].tolist() == pytest.approx(target)
        yaw = float(table["torso_yaw"][0])
        assert float(table["goal_direction"][0, 0]) == pytest.approx(sine * math.cos(yaw), abs=0.05)


def test_turns_act_where_the_target_is_behind(skill: str) -> None:
    world = Follower([skill] * 3)
    try:
        seen = []
        for azimuth, distance in (
            (0.5, 3.0), (1.4, 3.0), (1.0, 3.0), (0.4, 3.0), (1.0, 3.0), (-1.4, 3.0), (-0.2, 3.0),
            (0.1, 0.3), (1.0, 0.7), (0.1, 0.9),
        ):  # fmt: skip
            world._choose(azimuth, distance)
            seen.append(world.switch)
    finally:
        world.close()
    assert seen == [WALK, LEFT, LEFT, WALK, WALK, RIGHT, WALK, LEFT, LEFT, WALK]


def test_two_runs_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ConfigError, match="walk, turn_left and turn_right"):
        Follower(["a", "b"])
    assert main(["sitting", "follow", "sitting/walk", "sitting/walk"]) == 2
    assert "Give the run of walk, or those of" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("runs", "said"),
    [
        (["sitting/sit"], "sitting/sit does not see where it is to go"),
        (["sitting/meta"], "sitting/meta does not see where it is to go"),
        (["sitting/turn_left_mirrored", "sitting/walk", "sitting/turn_right_learned"], "so it cannot be the walk"),
        (["sitting/walk", "spacetime/walk", "spacetime/run"], "spacetime/walk decides 30 times a second"),
        (["sitting/walk", "sitting/meta", "sitting/meta"], "sitting/meta decides in every 30. control period"),
        (["sitting/walk", "sitting/sit", "sitting/sit"], "actuation needs the state field 'chair_state'"),
        (["amorphous/flip_small"], "amorphous/flip_small does not see"),
    ],
)  # fmt: skip
def test_what_cannot_follow_is_said_and_what_can(
    runs: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It was told to set what this command cannot be given, or it turned where it should have walked."""
    assert main(["sitting", "follow", *runs, "--video", str(tmp_path / "x.mp4")]) == 2
    told = capsys.readouterr().err
    assert said in told
    assert "Give first what experiment=sitting/walk learned" in told
    assert not re.search("Set |would come|Train ", told)
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("runs", "said"),
    [
        (["sitting/turn_right", "sitting/turn_left"], "sitting/turn_right turns to the right, 304° in its clip"),
        (["sitting/walk", "sitting/turn_left"], "sitting/turn_left turns to the left, 304° in its clip"),
    ],
)  # fmt: skip
def test_exchanged_turns_are_refused(
    runs: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It turned the long way round, or for good."""
    film = ["--video", str(tmp_path / "x.mp4")]
    assert main(["sitting", "follow", "sitting/walk", *runs, *film]) == 2
    told = capsys.readouterr().err
    assert said in told
    assert "The order is walk, turn_left, turn_right." in told
    assert not any(tmp_path.iterdir())
    Follower(["sitting/walk", "sitting/turn_left", "sitting/turn_right"]).close()


def test_a_name_with_a_quotation_mark_is_read(capsys: pytest.CaptureFixture[str]) -> None:
    for runs in (["it's [mine]"], ["sitting/walk", "it's [mine]", "sitting/turn_right"]):
        assert main(["sitting", "follow", *runs]) == 2
        assert "There is no skill 'it's [mine]'" in capsys.readouterr().err


@pytest.mark.parametrize("seconds", ["nan", "inf", "0", "-1"])
def test_a_video_lasts_for_a_while(
    tmp_path: Path, seconds: str, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["sitting", "follow", "--video", str(tmp_path / "x.mp4"), f"--seconds={seconds}"]
    assert main(words) == 2
    assert f"{seconds} is not above 0" in capsys.readouterr().err


def test_a_click_in_the_browser_sends_it(skill: str) -> None:
    """A visitor's message, over a socket: the ray from the camera through the pixel that was clicked."""
    pytest.importorskip("viser", reason="viser is not installed (the extra 'view')")
    from understudy_play.page import Page
    from understudy_viewer.page import free_port

    world = Follower([skill])
    page = Page(world, HOST, free_port(HOST, 0))
    try:
        page.advance()
        x, y = (float(v) for v in world.shown()["qpos"][:2])
        with visitor(page.url) as send:
            camera = {
                "wxyz": (1, 0, 0, 0), "position": (0, 0, 4), "fov": 1.0, "near": 0.1, "far": 99.0,
                "image_height": 100, "image_width": 100, "look_at": (0, 0, 0), "up_direction": (0, 0, 1),
            }  # fmt: skip
            click = {
                "event_type": "click", "ray_origin": (0.0, 0.0, 4.0), "ray_direction": (0.5, -0.25, -1.0),
                "screen_pos": ((0.5, 0.5),), "modifier": None,
            }  # fmt: skip
            send("ViewerCameraMessage", **camera)
            send("ScenePointerMessage", **click)
            due = time.monotonic() + 20
            while page._sent is None and time.monotonic() < due:
                time.sleep(0.02)
        page.advance()
        assert world.target == pytest.approx((x + 2.0, y - 1.0), abs=1e-5)
        assert world.environment.table["target"][0].tolist() == pytest.approx(world.target)
        assert tuple(page._flag.position) == pytest.approx((x + 2.0, y - 1.0, 0.0), abs=1e-5)
        assert page._flag.visible
    finally:
        page.close()


def test_without_runs_the_skills_of_the_package_go_around_a_square(tmp_path: Path) -> None:
    video = tmp_path / "square.mp4"
    names = ("walk", "turn_left_mirrored", "turn_right_learned")
    world = Follower([f"sitting/{name}" for name in names])
    try:
        for place in ((2.0, 0.0), (2.0, 2.0)):
            world.target = place
            away = []
            for _ in range(round(5.0 / world.dt)):
                world.step()
                there = world.environment.table["torso_position"][0, :2].tolist()
                away.append(math.dist(there, place))
            assert min(away) < 0.4, "it was at the target, and does not stand still there"
        assert world.falls == 0
    finally:
        world.close()
    assert main(["sitting", "follow", "--video", str(video), "--seconds", "1"]) == 0
    assert video.stat().st_size > 0

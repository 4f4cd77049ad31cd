"""The page: what a browser is told, what it tells, and what it shows."""

from __future__ import annotations

import io
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browsers import opened
from page_requests import check_nonsense, check_page

from understudy.errors import ConfigError
from understudy.setup import plugins
from understudy_characters.character import Character
from understudy_characters.overlay import Gauge, Region
from understudy_humanoid.character import build_spec
from understudy_motion.clip import Clip
from understudy_motion.writing import write_clip
from understudy_viewer import panel
from understudy_viewer.stage import COLOURS, Scene, Stage, Subject, build

pytest.importorskip("viser", reason="viser is not installed (the extra 'view')")

from understudy_viewer.page import Page, free_port

HOST = "127.0.0.1"
PLUGINS = "tensors,characters,doctor,humanoid,motion,mujoco,report,viewer"
EVIL = "<img src=x onerror=document.title='taken'>"
SOFTWARE_OPENGL = ("--use-gl=angle", "--use-angle=swiftshader")


@pytest.fixture(scope="module")
def stage(humanoid: Character, walk: Clip) -> Stage:
    frames = walk.num_frames
    centres = walk.root_position.numpy()[:, None]
    points = centres + np.linspace(0.0, 0.4, frames)[:, None, None] * np.array([1.0, 0.0, 0.0])
    marks = [
        Gauge("away", np.linspace(0.0, 0.4, frames), np.full(frames, 0.2), "m"),
        Region("root", "box", centres, np.full(frames, 0.2), points),
    ]
    reference = replace(walk, name="walk-reference")
    subjects = [Subject(walk, humanoid, role="learned"), Subject(reference, humanoid)]
    return build(Scene(subjects, marks))


@pytest.fixture
def page(stage: Stage) -> Iterator[Page]:
    page = Page(stage, HOST, free_port(HOST, 0))
    yield page
    page.close()


class Event:
    """What viser tells of a visitor's action."""

    client = object()


def happens(handle: Any, value: Any = None) -> None:
    """Have `handle` changed, or clicked, as by a visitor."""
    if value is not None:
        handle._impl.value = value
    for callback in handle._impl.update_cb:
        callback(Event())


def test_figures_are_where_the_frame_has_them(page: Page, stage: Stage) -> None:
    for frame in (0, 30):
        page._draw(frame)
        for drawn, actor in zip(page._figures, stage.actors, strict=True):
            for part, place, turn in zip(
                drawn.parts,
                actor.figure.positions[frame],
                actor.figure.rotations[frame],
                strict=True,
            ):
                np.testing.assert_allclose(part.position, place, atol=1e-9)
                np.testing.assert_allclose(part.wxyz, turn, atol=1e-9)
        learned, reference = (drawn.root.position for drawn in page._figures)
        np.testing.assert_allclose(reference - learned, [0.0, page._apart.value, 0.0])


def test_feet_are_coloured_in_contact(page: Page, stage: Stage) -> None:
    figure = stage.actors[0].figure
    assert set(map(tuple, figure.contacts.tolist())) >= {(True, False), (False, True)}
    for show in (True, False):
        page._contacts.value = show
        for frame in range(0, len(stage.times), 4):
            page._draw(frame)
            for part, down in zip(figure.foot_parts, figure.contacts[frame], strict=True):
                expected = panel.CONTACT if down and show else COLOURS[0]
                assert tuple(page._figures[0].parts[part].color) == expected
        assert page._figures[0].prints.visible == show


def test_regions_turn_red_when_the_point_is_outside(page: Page, stage: Stage) -> None:
    (drawn,) = page._regions
    for frame, colour in ((0, panel.INSIDE), (31, panel.INSIDE), (33, panel.OUTSIDE)):
        page._draw(frame)
        assert tuple(drawn.bodies[0].color) == colour
        assert drawn.bodies[0].scale == pytest.approx(0.2)
        np.testing.assert_allclose(drawn.bodies[0].position, stage.regions[0].centres[frame, 0])
        np.testing.assert_allclose(drawn.points[0].position, stage.regions[0].points[frame, 0])
    page._bounds.value = False
    page._draw(0)
    assert not drawn.bodies[0].visible
    assert not drawn.points[0].visible


def test_following_keeps_the_figures_in_the_middle(page: Page, stage: Stage) -> None:
    page._draw(60)
    np.testing.assert_allclose(page._node.position[:2], -stage.focus[60])
    line = (page._ground.position[:2] - page._node.position[:2]) % 5.0
    assert np.minimum(line, 5.0 - line).max() < 1e-9, "the squares stay on the ground"
    page._follow.value = False
    page._draw(0)
    np.testing.assert_allclose(page._node.position[:2], -stage.focus[60])


def test_a_visitor_plays_pauses_seeks_and_steps(page: Page, stage: Stage) -> None:
    player = page._player
    threading.Thread(target=page.run, daemon=True).start()
    happens(page._play)
    assert not player.playing
    happens(page._time, 0.5)
    assert stage.times[player.frame] == pytest.approx(0.5, abs=0.01)
    deadline = time.monotonic() + 5.0
    while abs(page._figures[0].parts[0].position - stage.actors[0].figure.positions[player.frame, 0]).max() > 1e-9:  # fmt: skip
        assert time.monotonic() < deadline, "the page does not show it"
        time.sleep(0.01)
    happens(page._play)
    before = player.time
    deadline = time.monotonic() + 5.0
    while player.time == before:
        assert time.monotonic() < deadline, "it does not play"
        time.sleep(0.01)
    assert abs(player.time - before) < 0.4, "the pause was not played"


def test_drawing_is_fast_enough_for_two_figures(page: Page, stage: Stage) -> None:
    began = time.process_time()
    for frame in range(60):
        page._draw(frame)
    assert (time.process_time() - began) / 60 < 1 / 30


def test_a_taken_port_leads_to_the_next_one() -> None:
    with socket.create_server((HOST, 0)) as taken:
        port = taken.getsockname()[1]
        assert port < free_port(HOST, port) <= port + 100


def test_an_address_of_another_machine_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"cannot be served at 192\.0\.2\.1"):
        free_port("192.0.2.1", 8080)


@pytest.mark.parametrize("host", ["a\0b", "x" * 300, "localhost:80", " "])
def test_what_is_no_address_is_refused_at_once(host: str, monkeypatch: pytest.MonkeyPatch) -> None:
    tried: list[object] = []
    create = socket.create_server
    monkeypatch.setattr(
        socket, "create_server", lambda *a, **k: (tried.append(a), create(*a, **k))[1]
    )
    with pytest.raises(ConfigError, match=r"port 8080 \(--host, --port\): [^(]*\.$"):
        free_port(host, 8080)
    assert len(tried) == 1


def test_no_address_is_not_all_of_them() -> None:
    with pytest.raises(ConfigError, match="--host names no address"):
        free_port("", 0)


# ---------------------------------------------------------------------- in a browser


@pytest.fixture
def browser() -> Iterator[Any]:
    yield from opened(*SOFTWARE_OPENGL)


@pytest.fixture
def served(walk: Clip, tmp_path: Path) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """`understudy motion view` of the walk beside a clip of a malicious name, and its address."""
    model, other = tmp_path / "biped.xml", tmp_path / "other.npz"
    model.write_text(build_spec().to_xml())
    write_clip(replace(walk, name=EVIL), other, plugins.load(only=["motion"]).registry)
    command = [sys.executable, "-m", "understudy.command.cli", "motion", "view", "walk", str(other)]
    command += ["--character", str(model), "--no-browser", "--port", str(free_port(HOST, 0))]
    environment = {**os.environ, "UNDERSTUDY_PLUGINS": PLUGINS, "OMP_NUM_THREADS": "1"}
    process = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        line = process.stdout.readline()
        assert line.startswith("http://127.0.0.1:"), line
        yield process, line.split()[0]
    finally:
        process.kill()
        process.wait()


def picture(page: Any) -> np.ndarray:
    """(H, W, 3): what the canvas shows once it shows the same for a second."""
    image = pytest.importorskip("PIL.Image")
    before = b""
    for _ in range(20):
        png = page.locator("canvas").first.screenshot()
        if png == before:
            break
        before = png
        time.sleep(1.0)  # software rendering draws few pictures a second
    return np.asarray(image.open(io.BytesIO(before)).convert("RGB")).astype(int)


def share_of(colour: tuple[int, int, int], pixels: np.ndarray) -> float:
    """Of the pixels, those of about the hue of `colour` and not grey."""
    wanted = np.array(colour) / np.linalg.norm(colour)
    alike = pixels @ wanted / np.maximum(np.linalg.norm(pixels, axis=-1), 1.0)
    return float(((alike > 0.985) & (np.ptp(pixels, axis=-1) > 40)).mean())


@pytest.mark.timeout(180)
def test_a_browser_shows_the_figures_and_moves_them_with_the_slider(
    browser: Any, served: tuple[subprocess.Popen[str], str]
) -> None:
    process, url = served
    page = browser.new_page(viewport={"width": 900, "height": 600})
    problems: list[str] = []
    page.on("console", lambda said: problems.append(said.text) if said.type == "error" else None)
    page.on("pageerror", lambda error: problems.append(str(error)))
    requested: list[str] = []
    page.on("request", lambda request: requested.append(request.url))
    page.goto(url)
    page.get_by_role("button", name="Pause").click(timeout=60_000)
    page.get_by_role("button", name="Play").wait_for(timeout=20_000)

    def shown_at(seconds: str, frame: str) -> np.ndarray:
        box = page.get_by_role("textbox").first  # the slider's
        box.fill(seconds)
        box.press("Enter")
        page.get_by_text(frame).wait_for(timeout=20_000)
        return picture(page)

    shown_at("0.3", "frame 18 of 64")
    page.get_by_role("slider").first.press("Home")
    page.get_by_text("frame 0 of 64").wait_for(timeout=20_000)
    page.get_by_role("button", name="frame ▶").click()
    page.get_by_text("frame 1 of 64").wait_for(timeout=20_000)
    first = shown_at("0.0", "frame 0 of 64")
    for colour in COLOURS:
        assert share_of(colour, first) > 0.004, "the figure is not seen"
    later = shown_at("0.5", "frame 30 of 64")
    again = shown_at("0.0", "frame 0 of 64")
    moved = (np.abs(later - first).max(axis=-1) > 30).mean()
    still = (np.abs(again - first).max(axis=-1) > 30).mean()
    assert moved > 0.02 > 2 * still
    assert page.locator("img[src=x]").count() == 0
    assert page.title() != "taken"
    assert page.get_by_text(EVIL).count() == 1
    assert problems == []
    outside = [r for r in requested if not r.startswith((url, "data:", "blob:"))]
    assert outside == [], "the page needs the network"

    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=20) == 0


def test_answers_its_own_address_alone(page: Page) -> None:
    check_page(page.url)


def test_what_no_browser_says_changes_nothing(
    page: Page, capfd: pytest.CaptureFixture[str]
) -> None:
    page._player.playing = False  # the time that is shown goes on by itself
    playing = threading.Thread(target=page.run, daemon=True)
    playing.start()
    check_nonsense(page.url, page._server)
    assert playing.is_alive(), "the page goes on"
    assert capfd.readouterr() == ("", "")

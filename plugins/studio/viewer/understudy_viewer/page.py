"""The page itself: a viser server that draws a stage and lets it be played."""

from __future__ import annotations

import errno
import math
import socket
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh
import viser

from understudy.errors import ConfigError
from understudy_characters.overlay import Region
from understudy_viewer import panel
from understudy_viewer.panel import CONTACT, INSIDE, OUTSIDE
from understudy_viewer.player import Player
from understudy_viewer.server import open_server, stop_server
from understudy_viewer.stage import Actor, Colour, Stage

__all__ = ["free_port"]

#: Pictures per second at most, and of the side panel, whose updates cost the browser more.
FRAME_RATE, PANEL_RATE = 60.0, 12.0
#: Between two figures: at first, as a share of their reach, and at most, m.
APART, FARTHEST = 1.2, 3.0

_SPEEDS = {"0.1 ×": 0.1, "0.25 ×": 0.25, "0.5 ×": 0.5, "1 ×": 1.0, "2 ×": 2.0}
_BACK, _FORTH, _START = "◀ frame", "frame ▶", "|◀"
_FLOOR: Colour = (238, 241, 245)
_LINES: Colour = (205, 211, 219)
_SKY: Colour = (255, 255, 255)
_ACCENT: Colour = (37, 99, 235)
_SEE_THROUGH = 0.18
#: m: side of the ground's squares, and from one bolder line to the next.
_SQUARE, _SECTION = 1.0, 5.0


def free_port(host: str, port: int) -> int:
    """`port`, or the next one above it that is free on `host`; any if it is 0.

    Raises
    ------
    ConfigError
        this machine has no such address, or no port of it is free.
    """
    if not host:  # which would be all addresses that this machine has
        raise ConfigError(
            "--host names no address, as of an empty variable. Leave it out, or write 0.0.0.0 for all "
            "that this machine has."
        )
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    reason = "it is no name of a machine"
    for candidate in range(port, min(port + 100, 2**16)):
        try:
            with socket.create_server((host, candidate), family=family) as found:
                return int(found.getsockname()[1])
        except OSError as error:
            reason = str(error.strerror).partition(" (while")[0]  # as it tried to bind what
            if error.errno not in (errno.EADDRINUSE, errno.EACCES):
                break  # no other port is free either
        except (UnicodeError, TypeError):
            break
    raise ConfigError(
        f"The page cannot be served at {host}, port {port} (--host, --port): {reason}."
    )


@dataclass
class _DrawnFigure:
    actor: Actor
    root: viser.FrameHandle
    parts: list[viser.MeshHandle]
    prints: viser.MeshHandle


@dataclass
class _DrawnRegion:
    """A body, and a point that should be in it, for each thing that the region holds for."""

    region: Region
    bodies: list[viser.MeshHandle]
    points: list[viser.MeshHandle]


class Page:
    """Serves `stage` at ``url`` until it is closed."""

    def __init__(self, stage: Stage, host: str, port: int) -> None:
        self._stage, self._player = stage, Player(stage.times)
        self._lock = threading.Lock()  # of the player, which the browser's events change too
        self._changed = threading.Event()
        self._closed = False
        self._centre = np.zeros(2)
        self._panel_due = 0.0
        self._server, self.url = open_server(host, port)
        self._dress()
        self._figures = [self._add_figure(i, actor) for i, actor in enumerate(stage.actors)]
        self._regions = [self._add_region(i, region) for i, region in enumerate(stage.regions)]
        self._add_controls()
        self._draw(0)

    def run(self) -> None:
        """Play until the page is closed."""
        shown, last = 0, time.monotonic()
        while not self._closed:
            playing = self._player.playing
            changed = self._changed.wait(1.0 / FRAME_RATE if playing else None)
            if changed:
                self._changed.clear()
            now = time.monotonic()
            with self._lock:
                if playing:
                    self._player.advance(now - last)
                frame = self._player.frame
            last = now
            if changed or frame != shown:
                self._draw(frame)
                shown = frame

    def close(self) -> None:
        """Stop playing and serving."""
        self._closed = True
        self._changed.set()
        stop_server(self._server)

    # ------------------------------------------------------------------ what is there

    def _dress(self) -> None:
        scene, reach = self._server.scene, self._stage.reach
        scene.configure_environment_map(None)  # it would be fetched from the network
        scene.add_light_hemisphere("/sky", sky_color=_SKY, ground_color=_FLOOR, intensity=1.2)
        self._node = scene.add_frame("/stage", show_axes=False)
        self._ground = scene.add_grid(
            "/ground",
            width=60.0,
            height=60.0,
            cell_size=_SQUARE,
            section_size=_SECTION,
            cell_color=_LINES,
            section_color=_LINES,
            fade_distance=25.0 * max(1.0, reach),
            shadow_opacity=0.25,
            plane_color=_FLOOR,
            plane_opacity=1.0,
        )
        width = self._apart_at_first() * (len(self._stage.actors) - 1)
        aim = np.array([0.0, 0.0, 0.75 * reach])
        away = np.array([0.47, -0.83, 0.25])
        camera = self._server.initial_camera
        camera.look_at = aim
        camera.position = aim + away * (3.3 * reach + width)
        camera.fov = np.radians(45.0)

    def _apart_at_first(self) -> float:
        return round(min(APART * self._stage.reach, FARTHEST), 1)

    def _add_figure(self, index: int, actor: Actor) -> _DrawnFigure:
        name, scene = f"/stage/figure{index}", self._server.scene
        root = scene.add_frame(name, show_axes=False)
        parts = [
            scene.add_mesh_simple(f"{name}/part{i}", part.vertices, part.faces, color=actor.colour)
            for i, part in enumerate(actor.figure.parts)
        ]
        prints = scene.add_mesh_simple(
            f"{name}/footprints",
            actor.figure.footprints.vertices,
            actor.figure.footprints.faces,
            color=actor.colour,
            opacity=0.7,
            cast_shadow=False,
        )
        return _DrawnFigure(actor, root, parts, prints)

    def _add_region(self, index: int, region: Region) -> _DrawnRegion:
        """Regions are around the reference, which is the last figure."""
        name, scene = f"{self._figures[-1].root.name}/region{index}", self._server.scene
        make = trimesh.creation
        body = make.box([2.0] * 3) if region.shape == "box" else make.icosphere(subdivisions=3)
        dot = make.icosphere(subdivisions=2, radius=0.025 * self._stage.reach)

        def add(kind: str, mesh: trimesh.Trimesh, opacity: float | None) -> list[viser.MeshHandle]:
            return [
                scene.add_mesh_simple(
                    f"{name}/{kind}{k}",
                    mesh.vertices,
                    mesh.faces,
                    opacity=opacity,
                    cast_shadow=False,
                    receive_shadow=False,
                )
                for k in range(region.centres.shape[1])
            ]

        return _DrawnRegion(region, add("body", body, _SEE_THROUGH), add("point", dot, None))

    def _add_controls(self) -> None:
        gui, stage, player = self._server.gui, self._stage, self._player
        gui.configure_theme(show_logo=False, show_share_button=False, brand_color=_ACCENT)
        gui.main_panel.dock_right()
        gui.add_html(panel.heading(stage))
        end = math.ceil(1000.0 * stage.duration) / 1000.0
        self._time = gui.add_slider("Time", 0.0, end, 0.001, 0.0)
        self._clock = gui.add_html("")
        self._play = gui.add_button("Pause")
        steps = gui.add_button_group("Step", [_START, _BACK, _FORTH])
        speed = gui.add_dropdown("Speed", tuple(_SPEEDS), initial_value="1 ×")
        loop = gui.add_checkbox("Loop", player.loop)
        self._follow = gui.add_checkbox(
            "Follow", True, hint="the camera goes where the figure goes"
        )
        self._apart = gui.add_slider(
            "Apart", 0.0, FARTHEST, 0.1, self._apart_at_first(),
            visible=len(stage.actors) > 1, hint="metres between the figures",
        )  # fmt: skip
        feet = any(actor.figure.feet for actor in stage.actors)
        with gui.add_folder("Bounds", visible=bool(stage.gauges or stage.regions)):
            self._bounds = gui.add_checkbox("Show", True)
            self._gauges = gui.add_html("")
        with gui.add_folder("Contacts", visible=feet):
            self._contacts = gui.add_checkbox("Show", True, hint="coloured feet, and footprints")
            self._strips = gui.add_html("")

        def back() -> None:
            player.step(-1)

        def forth() -> None:
            player.step(1)

        def toggle() -> None:
            if player.playing:
                player.playing = False
            else:
                player.play()

        def step() -> None:
            {_START: lambda: player.seek(0.0), _BACK: back, _FORTH: forth}[steps.value]()

        def seek() -> None:
            player.playing = False
            player.seek(self._time.value)

        def set_speed() -> None:
            player.speed = _SPEEDS[speed.value]

        def set_loop() -> None:
            player.loop = loop.value

        self._play.on_click(self._then(toggle))
        steps.on_click(self._then(step))
        self._time.on_update(self._then(seek))
        speed.on_update(self._then(set_speed))
        loop.on_update(self._then(set_loop))
        for shown in (self._follow, self._apart, self._contacts, self._bounds):
            shown.on_update(self._then(lambda: None))
        command = gui.add_command
        command("Play or pause", hotkey="space").on_trigger(self._then(toggle))
        command("One frame back", hotkey="arrowleft").on_trigger(self._then(back))
        command("One frame on", hotkey="arrowright").on_trigger(self._then(forth))

    def _then(self, action: Callable[[], None]) -> Callable[[Any], None]:
        """What to do at an event of a browser; viser reports the page's own assignments too."""

        def handle(event: Any) -> None:
            if event.client is None:
                return
            with self._lock:
                action()
            self._changed.set()

        return handle

    # ------------------------------------------------------------------ what changes

    def _draw(self, frame: int) -> None:
        if self._follow.value:
            self._centre = self._stage.focus[frame]
        with self._server.atomic():
            # The world moves and not the camera, so that the visitor can turn it meanwhile.
            self._node.position = (-self._centre[0], -self._centre[1], 0.0)
            shift = -np.mod(self._centre, _SECTION)
            self._ground.position = (shift[0], shift[1], 0.0)
            for index, drawn in enumerate(self._figures):
                self._draw_figure(index, drawn, frame)
            for drawn in self._regions:
                self._draw_region(drawn, frame)
        now = time.monotonic()
        if now >= self._panel_due or not self._player.playing:
            self._panel_due = now + 1.0 / PANEL_RATE
            with self._server.atomic():
                self._draw_panel(frame)

    def _draw_figure(self, index: int, drawn: _DrawnFigure, frame: int) -> None:
        actor, figure = drawn.actor, drawn.actor.figure
        left = (index - 0.5 * (len(self._figures) - 1)) * self._apart.value
        drawn.root.position = (-actor.subject.origin[0], left - actor.subject.origin[1], 0.0)
        places, turns = figure.positions[frame], figure.rotations[frame]
        for part, place, turn in zip(drawn.parts, places, turns, strict=True):
            part.position, part.wxyz = place, turn
        show = self._contacts.value
        drawn.prints.visible = show
        for part, down in zip(figure.foot_parts, figure.contacts[frame], strict=True):
            drawn.parts[part].color = CONTACT if down and show else actor.colour

    def _draw_region(self, drawn: _DrawnRegion, frame: int) -> None:
        region, show = drawn.region, self._bounds.value
        size = float(region.sizes[frame])
        norm = np.inf if region.shape == "box" else 2
        learned = self._figures[0].actor.colour
        for k, (body, point) in enumerate(zip(drawn.bodies, drawn.points, strict=True)):
            centre, place = region.centres[frame, k], region.points[frame, k]
            inside = np.linalg.norm(place - centre, ord=norm) <= size
            body.visible = point.visible = show
            body.position, point.position = centre, place
            body.color = INSIDE if inside else OUTSIDE
            point.color = learned if inside else OUTSIDE
            body.scale = max(size, 1e-4)

    def _draw_panel(self, frame: int) -> None:
        stage, now = self._stage, round(float(self._stage.times[frame]), 3)
        if self._time.value == now:  # only changes are sent, and what was sent before may come late
            self._time.value = 0.0 if now > 0.0 else self._time.max
        self._time.value = now
        self._clock.content = panel.clock(stage, frame)
        self._play.label = "Pause" if self._player.playing else "Play"
        self._strips.content = panel.contact_strips(stage, frame)
        self._gauges.content = panel.gauges(stage, frame)

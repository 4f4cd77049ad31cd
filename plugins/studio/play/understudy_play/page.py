"""The page on which a policy acts while one watches, pushes and leads: a viser server and one world."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from html import escape

import numpy as np
import torch
import viser

from understudy.errors import ConfigError
from understudy_characters.character import Character
from understudy_characters.scene import CharacterScene
from understudy_characters.shapes import shapes
from understudy_motion.kinematics import forward_kinematics
from understudy_play.controls import Controls
from understudy_play.following import Following
from understudy_play.player import World
from understudy_viewer.server import open_server, stop_server
from understudy_viewer.stage import COLOURS, Colour

_SKY: Colour = (255, 255, 255)
_FLOOR: Colour = (238, 241, 245)
_LINES: Colour = (205, 211, 219)
_FLAG: Colour = (220, 38, 38)
#: m: after so far the ground's squares repeat.
_SQUARE = 5.0
#: Fields of the character and its clip; the others say where its surroundings are.
_OWN = {"qpos", "reference_qpos", "phase"}
#: Directions of pushes in the world, by their button.
_WAYS = {"← left": (0.0, 1.0), "right →": (0.0, -1.0), "forward": (1.0, 0.0), "back": (-1.0, 0.0)}


class Page:
    """Serves `world` at ``url`` until it is closed, and closes it then. Where it has a target, a click on
    the floor is the next one; `following` says what there is beside of the run that it plays.

    Raises
    ------
    ConfigError
        if the task's scene is no character.
    """

    def __init__(
        self, world: World, host: str, port: int, following: Following | None = None
    ) -> None:
        self._player, self._following = world, following
        scene = self._player.scene
        if not isinstance(scene, CharacterScene):
            self._player.close()
            raise ConfigError(
                f"{world.name} is not the task of a character, which the page draws. Use --video FILE."
            )
        self._scene = scene
        self._character = Character(scene.character.name, scene.shown().compile())
        # of what the browser's events change: the world is the loop's
        self._lock = threading.Lock()
        self._pushes: list[tuple[float, float, float]] = []
        self._sent: tuple[float, float] | None = None
        self._controls = Controls()
        self._server, self.url = open_server(host, port)
        self._things: list[viser.MeshHandle] = []
        self._around: dict[str, torch.Tensor] | None = None  # what says where those are
        self._dress(world.name)
        self._draw(world.shown())

    def run(self) -> None:
        """Act in real time until the page is closed."""
        self._controls.run(self._player.dt, self.advance)

    def advance(self, after_each: Callable[[], None] = lambda: None) -> None:
        """One decision, after what the visitor asked for; `after_each` of the control periods drawn."""
        if self._following is not None:
            self._following.advance()
        with self._lock:
            pushes, sent = self._pushes, self._sent
            self._pushes, self._sent = [], None
        if self._controls.taken_again():
            self._player.restart()
        for impulse in pushes:
            self._player.push(impulse)
        if sent is not None:
            self._player.target = sent
        for shown in self._player.step():
            self._draw(shown)
            after_each()

    def push(self, x: float, y: float) -> None:
        """Push at the next decision, N s along the world's axes."""
        with self._lock:
            self._pushes.append((x, y, 0.0))

    def send(self, x: float, y: float) -> None:
        """Send the character to this place of the world, m, from the next decision on."""
        with self._lock:
            self._sent = x, y

    def close(self) -> None:
        self._controls.closed = True
        stop_server(self._server)
        self._player.close()

    def _dress(self, name: str) -> None:
        scene, gui, length = self._server.scene, self._server.gui, self._character.length
        scene.configure_environment_map(None)  # it would be fetched from the network
        scene.add_light_hemisphere("/sky", sky_color=_SKY, ground_color=_FLOOR, intensity=1.2)
        self._node = scene.add_frame("/stage", show_axes=False)
        self._ground = scene.add_grid(
            "/ground", width=60.0, height=60.0, cell_size=1.0, section_size=_SQUARE,
            cell_color=_LINES, section_color=_LINES, fade_distance=25.0, shadow_opacity=0.25,
            plane_color=_FLOOR, plane_opacity=1.0,
        )  # fmt: skip
        self._figures = [
            [
                (
                    self._character.joint_names.index(shape.joint),
                    scene.add_mesh_simple(
                        f"/stage/{name}/{i}",
                        shape.vertices,
                        shape.faces,
                        color=colour,
                        opacity=opacity,
                    ),
                )
                for i, shape in enumerate(shapes(self._character))
            ]
            for name, colour, opacity in zip(
                ("learned", "reference"), COLOURS, (None, 0.35), strict=True
            )
        ]
        self._flag = scene.add_icosphere(
            "/stage/target", radius=0.06 * length, color=_FLAG, visible=False, cast_shadow=False
        )
        camera = self._server.initial_camera
        camera.look_at = np.array([0.0, 0.0, 0.5 * length])
        camera.position = camera.look_at + length * np.array([0.85, -1.5, 0.3])
        gui.configure_theme(show_logo=False, show_share_button=False, brand_color=COLOURS[0])
        gui.main_panel.dock_right()
        gui.add_html(f"<div style='margin:0 .75em'><b>{escape(name)}</b></div>")
        self._told = gui.add_html("")
        strength = gui.add_slider("Push, N s", 0.0, 40.0, 1.0, 12.0)
        way = gui.add_button_group("Direction", tuple(_WAYS))
        self._ghost = gui.add_checkbox("Reference", False, hint="where the clip is now")
        self._controls.add_to(gui)
        if self._following is not None:
            self._following.add_to(gui)
        if self._player.target is not None:
            gui.add_html("<div style='margin:0 .75em'>Click on the floor to send it there.</div>")
            scene.on_click()(self._clicked)

        @way.on_click
        def _(_: object) -> None:
            x, y = _WAYS[way.value]
            self.push(strength.value * x, strength.value * y)

    def _clicked(self, event: viser.SceneClickEvent) -> None:
        hit = on_floor(event.ray_origin, event.ray_direction)
        if hit is not None:
            self.send(hit[0] - self._node.position[0], hit[1] - self._node.position[1])

    def _draw(self, shown: Mapping[str, torch.Tensor]) -> None:
        tracks = [shown["qpos"], shown.get("reference_qpos")]
        centre = shown["qpos"][:2].numpy()
        with self._server.atomic():
            self._surround(shown)
            # The world moves and not the camera, so that the visitor can turn it meanwhile.
            self._node.position = (-centre[0], -centre[1], 0.0)
            shift = -np.mod(centre, _SQUARE)
            self._ground.position = (shift[0], shift[1], 0.0)
            for parts, qpos, visible in zip(
                self._figures, tracks, (True, self._ghost.value), strict=True
            ):
                self._place(parts, qpos if visible else None)
            target = self._player.target
            self._flag.visible = target is not None
            if target is not None:
                self._flag.position = (*target, 0.0)
            self._told.content = (
                "<div style='margin:0 .75em;font-size:.85em;color:#667080'>"
                f"{self._player.fallen}</div>"
            )

    def _surround(self, shown: Mapping[str, torch.Tensor]) -> None:
        """Chairs, bars and rooms, which stay where they are for an episode."""
        around = {name: value for name, value in shown.items() if name not in _OWN}
        before, self._around = self._around, around
        if before is not None and all(torch.equal(before[n], around[n]) for n in around):
            return
        for thing in self._things:
            thing.remove()
        self._things = []
        tracks = {name: value.numpy()[None] for name, value in shown.items()}
        for thing in self._scene.surroundings(tracks):
            for i, shape in enumerate(thing.shapes):
                red, green, blue, opacity = shape.colour
                self._things.append(
                    self._server.scene.add_mesh_simple(
                        f"/stage/around/{thing.name}/{i}",
                        shape.vertices,
                        shape.faces,
                        color=np.array([red, green, blue]),
                        opacity=None if opacity == 1.0 else opacity,
                        position=thing.positions[0],
                        wxyz=thing.rotations[0],
                    )
                )

    def _place(self, parts: list[tuple[int, viser.MeshHandle]], qpos: torch.Tensor | None) -> None:
        if qpos is None:
            for _, part in parts:
                part.visible = False
            return
        twice = qpos.double().repeat(2, 1)  # a clip has two frames at least
        clip = self._character.clip(
            twice, torch.tensor([0.0, 1.0]).double(), name="now", loop=False
        )
        places, turns = forward_kinematics(clip)
        for joint, part in parts:
            part.position, part.wxyz = places[0, joint].numpy(), turns[0, joint].numpy()
            part.visible = True


def on_floor(origin: Sequence[float], direction: Sequence[float]) -> tuple[float, float] | None:
    """Where the ray from `origin` along `direction`, both (3,), meets the floor z = 0, m; None if it goes
    up or nowhere near."""
    if direction[2] >= -1e-3:
        return None
    along = -origin[2] / direction[2]
    return origin[0] + along * direction[0], origin[1] + along * direction[1]

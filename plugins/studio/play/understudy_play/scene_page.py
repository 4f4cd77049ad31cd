"""The page on which a policy acts in any other MuJoCo scene: it draws the scene's geoms, and has the means to wait."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from html import escape

import mujoco
import numpy as np
import trimesh
import viser
from torch import Tensor

from understudy_mujoco.scene import MujocoScene
from understudy_play.controls import Controls
from understudy_play.following import Following
from understudy_play.player import World
from understudy_viewer.server import open_server, stop_server

#: m: half the side of a plane that has none.
_ENDLESS = 5.0
#: Frames a second, at most: what more costs would slow down what acts.
_FRAMES = 34.0
#: Of a target that is reached, one that is not, and of the way there.
_GOOD, _BAD, _WAY = (22, 163, 74), (220, 38, 38), (37, 99, 235)
#: m/s of a nudge; by its button, along the world's axes.
_NUDGE = 0.15
_WAYS = {"←": (-1.0, 0.0), "→": (1.0, 0.0), "↑": (0.0, 1.0), "↓": (0.0, -1.0)}


class ScenePage:
    """Serves `world`, whose scene is a :class:`MujocoScene`, at ``url`` until it is closed, and closes it then."""

    def __init__(
        self, world: World, host: str, port: int, following: Following | None = None
    ) -> None:
        assert isinstance(world.scene, MujocoScene)
        self._world, self._following = world, following
        self._model = world.scene.shown().compile()
        self._data = mujoco.MjData(self._model)
        self._controls = Controls()
        # of what the browser's events change: the world is the loop's
        self._lock = threading.Lock()
        self._sent: tuple[float, float] | None = None
        self._dragged = False
        self._nudges: list[tuple[float, float]] = []
        self._steps, self._every = 0, max(1, round(1.0 / (_FRAMES * world.dt)))
        self._server, self.url = open_server(host, port)
        self._dress()
        self._draw(world.shown())

    def run(self) -> None:
        """Act in real time until the page is closed."""
        self._controls.run(self._world.dt, self.advance)

    def advance(self, after_each: Callable[[], None] = lambda: None) -> None:
        """One decision, after what the visitor asked for; `after_each` of the control periods drawn."""
        if self._following is not None:
            self._following.advance()
        if self._controls.taken_again():
            self._world.restart()
            self._steps = -1
        with self._lock:
            (sent, nudges), self._sent, self._nudges = (self._sent, self._nudges), None, []
        if self._world.leads is not None:
            if sent is not None:
                self._world.leads.send(*sent)
            for x, y in nudges:
                self._world.nudge(_NUDGE * x, _NUDGE * y)
        for shown in self._world.step():
            self._steps += 1
            if self._steps % self._every == 0:
                self._draw(shown)
            after_each()

    def send(self, x: float, y: float) -> None:
        """Have what is led brought to this place, m, from the next decision on."""
        with self._lock:
            self._sent = x, y

    def nudge(self, x: float, y: float) -> None:
        """Push what is led at the next decision; along the world's axes."""
        with self._lock:
            self._nudges.append((x, y))

    @property
    def target(self) -> tuple[tuple[float, float, float], bool]:
        """Where the target that is drawn is, m, and whether it is one that a plan reaches."""
        x, y, z = (float(part) for part in self._handle.position)
        return (x, y, z), tuple(self._flag.color) == _GOOD

    def close(self) -> None:
        self._controls.closed = True
        stop_server(self._server)
        self._world.close()

    def places(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Of each geom that is drawn: (3,) m and its rotation (4,)."""
        return [(np.array(p.position), np.array(p.wxyz)) for _, p in self._parts]

    def _dress(self) -> None:
        model, scene, gui = self._model, self._server.scene, self._server.gui
        scene.configure_environment_map(None)  # it would be fetched from the network
        scene.add_light_hemisphere("/sky", intensity=1.2)
        self._parts: list[tuple[int, viser.MeshHandle]] = []
        for geom in range(model.ngeom):
            mesh = geom_mesh(model, geom)
            if mesh is None or model.geom_rgba[geom, 3] == 0.0:
                continue
            self._parts.append((geom, self._add(geom, mesh)))
        camera, extent = self._server.initial_camera, float(model.stat.extent)
        camera.look_at = np.array(model.stat.center)
        camera.position = camera.look_at + extent * np.array([-0.5, 0.7, 0.4])
        gui.configure_theme(show_logo=False, show_share_button=False)
        gui.main_panel.dock_right()
        gui.add_html(f"<div style='margin:0 .75em'><b>{escape(self._world.name)}</b></div>")
        self._told = gui.add_html("")
        if self._world.leads is not None:
            self._lead(self._world.leads.body)
        self._controls.add_to(gui)
        if self._following is not None:
            self._following.add_to(gui)

    def _add(self, geom: int, mesh: trimesh.Trimesh) -> viser.MeshHandle:
        *colour, opacity = (float(part) for part in self._model.geom_rgba[geom])
        return self._server.scene.add_mesh_simple(
            f"/scene/{geom}", mesh.vertices, np.asarray(mesh.faces), color=np.array(colour),
            opacity=None if opacity == 1.0 else opacity,
        )  # fmt: skip

    def _reshape(self, shown: Mapping[str, Tensor]) -> None:
        """Show of geoms in which worlds differ those that this world has, as large as they are in it."""
        for row, (geom, part) in enumerate(self._parts):
            name = self._model.geom(geom).name
            if f"active/{name}" not in shown:
                continue
            size = shown[f"geom_size/{name}"].double().numpy()
            if not np.array_equal(size, self._model.geom_size[geom]):
                self._model.geom_size[geom] = size
                mesh = geom_mesh(self._model, geom)
                assert mesh is not None
                part = self._add(geom, mesh)
                self._parts[row] = geom, part
            part.visible = bool(shown[f"active/{name}"] > 0)

    def _lead(self, body: str) -> None:
        """A target to drag, the planned way to it, and buttons for nudges."""
        scene, gui = self._server.scene, self._server.gui
        sizes = self._model.geom_size[self._model.geom_bodyid == self._model.body(body).id]
        size = float(np.min(sizes[sizes > 0]))
        self._handle = scene.add_transform_controls(
            "/target", scale=8.0 * size, active_axes=(True, True, False), disable_rotations=True,
            depth_test=False,
        )  # fmt: skip
        self._flag = scene.add_icosphere("/target/flag", 1.1 * size, _GOOD, opacity=0.5)
        self._way = scene.add_line_segments("/way", np.zeros((1, 2, 3)), _WAY, thickness=0.002)
        self._drawn = np.zeros((0, 3))
        gui.add_html("<div style='margin:0 .75em'>Drag the target to have it brought there.</div>")
        nudge = gui.add_button_group("Nudge", tuple(_WAYS))

        @self._handle.on_update
        async def _(event: viser.TransformControlsEvent) -> None:  # so they come in their order
            self._dragged = event.phase != "end"
            if not self._dragged:
                x, y, _ = self._handle.position
                self.send(float(x), float(y))

        @nudge.on_click
        def _(_: object) -> None:
            self.nudge(*_WAYS[nudge.value])

    def _draw_way(self) -> str:
        """The plan as it is now, if it is another one; why there is none."""
        leads = self._world.leads
        assert leads is not None
        way = self._world.way()
        if not np.array_equal(way, self._drawn):
            self._drawn = way
            self._way.points = np.stack([way[:-1], way[1:]], axis=1)
            if not self._dragged and (leads.target is None or not leads.refused):
                self._handle.position = way[-1]
        self._flag.color = _BAD if leads.refused else _GOOD
        self._way.visible = not leads.refused
        return leads.refused

    def _draw(self, shown: Mapping[str, Tensor]) -> None:
        self._data.qpos[:] = shown["qpos"].double().numpy()
        mujoco.mj_kinematics(self._model, self._data)
        turn, told = np.zeros(4), ""
        with self._server.atomic():
            self._reshape(shown)
            if self._world.leads is not None:
                told = self._draw_way()
            for geom, part in self._parts:
                mujoco.mju_mat2Quat(turn, self._data.geom_xmat[geom])
                part.position, part.wxyz = self._data.geom_xpos[geom].copy(), turn.copy()
            self._told.content = (
                "<div style='margin:0 .75em;font-size:.85em;color:#667080'>"
                f"{escape(told) or self._world.fallen}</div>"
            )


def geom_mesh(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh | None:
    """The geom as triangles in its own frame, m; None for those that have no simple shape."""
    kind, size = mujoco.mjtGeom(int(model.geom_type[geom])), model.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return trimesh.creation.box(2.0 * size)
    if kind == mujoco.mjtGeom.mjGEOM_PLANE:
        x, y = (2.0 * (s or _ENDLESS) for s in size[:2])
        return trimesh.creation.box([x, y, 1e-3])
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        mesh = trimesh.creation.capsule(2.0 * size[1], size[0], count=[12, 12])
        return mesh
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return trimesh.creation.cylinder(size[0], 2.0 * size[1], sections=24)
    if kind in (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_ELLIPSOID):
        ball = trimesh.creation.icosphere(2)
        ball.apply_scale(size if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID else size[0])
        return ball
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        v, f = int(model.mesh_vertadr[mesh]), int(model.mesh_faceadr[mesh])
        vertices = model.mesh_vert[v : v + model.mesh_vertnum[mesh]]
        return trimesh.Trimesh(vertices, model.mesh_face[f : f + model.mesh_facenum[mesh]])
    return None

"""N worlds of one garment on one device: the state as torch views of Warp's arrays."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import torch
import warp as wp
from torch import Tensor

from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.task import Context, Shape
from understudy_cloth.checking import check_mesh
from understudy_cloth.mesh import (
    SHARED_VERTICES,
    WEIGHTED_VERTICES,
    Hinges,
    distances_of,
    edges_of,
    faces_of_vertices,
    hinges_of,
    neighbours_along,
    vertex_areas,
)
from understudy_cloth.scene import ClothModel, ClothScene
from understudy_cloth.solver import build_kernels
from understudy_cloth.weight import compliance_of
from understudy_cloth.world import MOST_SHAPES, Cloth, Features
from understudy_warp_torch.shapes import build_tools, tool_views
from understudy_warp_torch.simulator import WarpSimulator
from understudy_warp_torch.world_state import WorldState

__all__ = ["ClothSimulator"]

#: Beyond these a position (m) or a velocity (m/s) is one of a simulation that diverged.
_EXTENT, _SPEED = 1e3, 1e3
#: Of the mean edge: so thick is a layer, unless the fabric says otherwise. Vertices of one layer then
#: leave no gap through which one of another fits.
_THICKNESS = 0.9
#: Sweeps over hinges are at most so far apart, s; and (ω Δt)² of the stiffest hinge over that time is at most this.
_BENDING_SECONDS, _SOFT = 0.002, 0.25
#: Threads of a block are not fewer and not more, unless it is said.
_THREADS = (128, 512)


class ClothSimulator(WarpSimulator):
    """A garment by extended position-based dynamics in small steps (Macklin et al. 2019): a control
    period is so many sub-steps, each one sweep over constraints in colours, then layers, then bodies.

    A control (N, 6·T + G) is the pose that each of T tools has when the period ends, position (m) and
    rotation vector (axis × angle, rad) in the world frame, and for each of G grips whether it is closed,
    above 0.5. Tools move evenly on the way. Nothing can stop a tool; grips close and open at once.

    ===========================================  =========================================
    field                                        shape; T leads only if there are several tools
    ===========================================  =========================================
    ``cloth_position``, ``cloth_velocity``       (V, 3) m, m/s
    ``contact_force``                            (V, 3) N, of bodies on each vertex, mean over the
                                                 control period
    ``contact_side``                             (V,) 1 touched from inside, where the force is along the
                                                 outward normal; −1 from outside; 0 untouched
    ``grip_closed``                              (G,) 1 closed
    ``tool_position``, ``tool_orientation``      (3,) m, (4,) wxyz
    ``tool_velocity``, ``tool_angular_velocity``  (3,) m/s, rad/s, in the last sub-step
    ===========================================  =========================================

    Worlds may differ in ``gravity`` (3,), ``friction`` (), ``density`` () kg/m², ``stretch`` and ``shear`` ()
    N/m, ``bending`` () N m, unless the fabric has none: then it costs nothing.

    *Limits:* one garment and at most 31 shapes, which feel nothing of it. Sub-steps are the
    stiffness. Layers touch by vertices, and nothing untangles those that went through each
    other; cloth that cannot yield is pierced.
    """

    @dataclass(frozen=True)
    class Options:
        self_contact: bool = True  #: whether layers keep apart; on a GPU 1.7 times the time
        #: sub-steps between searches for what may touch, of which each control period begins with one
        every: int = 10
        #: sub-steps of a control period from one sweep over hinges to the next, in which they act for all of these at once; null:
        #: as many as bending is soft enough for, within 2 ms (it costs most of a sub-step)
        bending_every: int | None = None
        #: M, vertices of other layers that one may touch until the next search
        candidates: int = 32
        #: `block` keeps a world on one multiprocessor; `launches` has a kernel for each phase
        traversal: Literal["block", "launches"] = "block"
        #: of a block; null: a quarter of the vertices, 128 to 512, since those of a colour are fewer
        threads: int | None = None

        def __post_init__(self) -> None:
            check_range(self, "every", "bending_every", "candidates", "threads", least=1)
            check_range(self, "threads", most=1024)

    def __init__(self, options: Options, context: Context) -> None:
        scene = context.need_scene(ClothScene, "simulator 'cloth'")
        self.model = model = scene.model()
        self._options, self._finer = options, scene.finer
        super().__init__(context)
        with self._warp.scope():
            self._cloth, self._features, self._first = self._build(model)
            self._kernels = build_kernels(self._features)
            wp.synchronize_device()  # torch's streams wait for nobody
        c, v, self._tools = self._cloth, self._cloth.vertices, self._cloth.tools
        t, g = len(model.tools), len(model.grips)
        self.control_size = 6 * t + g
        views = {
            "cloth_position": (wp.to_torch(c.position), (v, 3)),
            "cloth_velocity": (wp.to_torch(c.velocity), (v, 3)),
            "contact_force": (wp.to_torch(c.force), (v, 3)),
            "contact_side": (wp.to_torch(c.side), (v,)),
        }
        hidden: dict[str, tuple[Tensor, Shape]] = {"substep": (wp.to_torch(c.substep), ())}
        if self._features.self_contact:
            hidden["anchor"] = (wp.to_torch(c.anchor), (v, 3))
        if self._features.shapes:
            hidden["near"] = (wp.to_torch(c.near), (v,))
            hidden["face_near"] = (wp.to_torch(c.face_near), (c.faces,))
        views |= tool_views(c.tools)
        if g:
            views["grip_closed"] = (wp.to_torch(c.closed), (g,))
            hidden["holder"] = (wp.to_torch(c.holder), (c.grip_vertices,))
            hidden["held_at"] = (wp.to_torch(c.held_at), (c.grip_vertices, 3))
        self.fields: Mapping[str, Shape] = {name: shape for name, (_, shape) in views.items()}
        state = {
            name: view.view(self._n, *shape) for name, (view, shape) in {**views, **hidden}.items()
        }
        self.state_fields = ("cloth_position", "cloth_velocity")
        if t:
            self.state_fields += ("tool_position", "tool_orientation")
        stiffness = wp.to_torch(c.stiffness)
        parameters = {
            "gravity": wp.to_torch(c.gravity),
            "friction": wp.to_torch(c.friction),
            "density": wp.to_torch(c.density),
            "stretch": stiffness[:, 0],
            "shear": stiffness[:, 1],
            **({"bending": stiffness[:, 2]} if model.fabric.bending else {}),
        }
        self.parameters: Mapping[str, Shape] = {
            name: tuple(view.shape[1:]) for name, view in parameters.items()
        }
        # torch makes no view of an array without elements on a GPU
        self._control = (
            wp.to_torch(c.control)
            if self.control_size
            else torch.zeros(self._n, 0, device=self._device)
        )
        self._counted = ("candidates_left_out", wp.to_torch(c.left_out))
        self._worlds = WorldState(
            "cloth",
            views={name: state[name] for name in views},
            state=state,
            initial={name: view[:1].clone() for name, view in state.items()},
            set_by=self.state_fields,
            parameters=parameters,
            extent=_EXTENT,
            speed=_SPEED,
        )

    def _build(self, model: ClothModel) -> tuple[Any, Features, tuple[np.ndarray, np.ndarray]]:
        """The cloth on Warp's present device, what its kernels have to know, and where colours begin."""
        n, fabric = self._n, model.fabric
        positions, faces = np.asarray(model.positions, float), np.asarray(model.faces)
        check_mesh(positions, faces, "The scene's cloth")
        v, f = len(positions), len(faces)
        rest = positions if model.rest is None else np.asarray(model.rest, float)
        corners = rest[faces] if rest.shape == (v, 3) else rest
        if corners.shape not in ((f, 3, 2), (f, 3, 3)) or not np.isfinite(corners).all():
            raise ConfigError(
                f"The cloth's rest shape is {rest.shape}: it takes ({v}, 3) vertices or the ({f}, 3, 2) "
                "corners of its triangles."
            )
        area = vertex_areas(faces, corners, v)
        if (area <= 0).any():
            raise ConfigError("A vertex of the cloth is in no triangle with an area at rest.")
        pinned = _indices(model.pinned, v, "pinned")
        members = [_indices(grip.vertices, v, f"of grip {k}") for k, grip in enumerate(model.grips)]
        self._check(model, pinned, members)
        self._compliance = compliance_of(model, self._dt, self._finer)
        self._compliance.check(float(np.linalg.norm(model.gravity)), self._dt)
        threads, bent = self._device.type == "cuda", f if fabric.bending else 0
        found = distances_of(faces, corners, threads)
        hinges = hinges_of(faces[:bent], corners[:bent], threads)
        edges, index = edges_of(faces)
        sides = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        length = np.zeros(len(edges))
        length[index.ravel()] = sides.ravel()
        thickness = fabric.thickness or _THICKNESS * float(length.mean())
        inverse = 1.0 / area
        inverse[pinned] = 0.0
        options, c = self._options, Cloth()

        def one_each(value: Any, dtype: Any = float) -> Any:
            kind = np.float32 if dtype in (float, wp.vec3, wp.vec4) else np.int32
            return wp.array(np.ascontiguousarray(value, kind), dtype=dtype)

        def each_world(value: Any, dtype: Any = float) -> Any:
            value = np.asarray(value, np.float32)
            return wp.array(np.tile(value, (n, *[1] * value.ndim)), dtype=dtype)

        c.position = wp.array(np.tile(positions.astype(np.float32), (n, 1)), dtype=wp.vec3)
        c.velocity, c.force = wp.zeros(n * v, dtype=wp.vec3), wp.zeros(n * v, dtype=wp.vec3)
        c.side, c.substep = wp.zeros(n * v, dtype=float), wp.zeros(n, dtype=int)
        c.tools = build_tools(model.tools, n)
        c.control = wp.zeros((n, 6 * len(model.tools) + len(members)), dtype=float)
        c.vertices, c.faces = v, f
        c.pair, c.rest, c.unit = (
            one_each(found.pairs, wp.vec2i),
            one_each(found.rest),
            one_each(found.unit),
        )
        c.first, c.kind, c.colours = (
            one_each(found.first, int),
            one_each(found.kind, int),
            len(found.kind),
        )
        c.inverse_area, c.face = one_each(inverse), one_each(faces, wp.vec3i)
        c.quad, c.quad_weight = one_each(hinges.quads, wp.vec4i), one_each(hinges.weights, wp.vec4)
        c.quad_unit, c.quad_first = one_each(hinges.unit), one_each(hinges.first, int)
        c.quad_colours = len(hinges.first) - 1
        start, corner = faces_of_vertices(faces, v)
        c.corner_start, c.corner = one_each(start, int), one_each(corner, int)

        held = np.unique(np.concatenate([*members, np.zeros(0, int)])).astype(int)
        holds = (
            np.stack([np.isin(held, m) for m in members], axis=1) if members else np.zeros((0, 0))
        )
        c.grips, c.grip_vertices = len(members), len(held)
        c.grip_tool = one_each([grip.tool for grip in model.grips], int)
        c.grip_vertex = one_each(held, int)
        c.grip_holds = wp.array(holds.astype(np.int32), dtype=int, shape=holds.shape)
        c.closed = wp.zeros((n, len(members)), dtype=float)
        c.holder = wp.full((n, len(held)), -1, dtype=int)
        c.held_at = wp.zeros((n, len(held)), dtype=wp.vec3)

        c.gravity = each_world(model.gravity, wp.vec3)
        c.friction, c.density = each_world(fabric.friction), each_world(fabric.density)
        c.stiffness = each_world([fabric.stretch, fabric.shear, fabric.bending])
        c.damping, c.gap = fabric.damping, fabric.gap
        c.thickness, c.room = thickness, options.candidates
        c.dt, c.substeps, c.every = self._dt, self._substeps, min(options.every, self._substeps)
        c.bending_every = options.bending_every or self._bending_every(hinges, inverse)

        s, layers = c.tools.shapes, options.self_contact
        some_v, some_f = (v if layers else 0), (f if s else 0)
        c.anchor, c.near = wp.zeros(n * some_v, dtype=wp.vec3), wp.zeros(n * v, dtype=int)
        c.weight = wp.array(np.tile(inverse.astype(np.float32), n), dtype=float)
        c.start = wp.clone(c.position)
        c.way, c.middle = wp.zeros((n, s), dtype=float), wp.zeros((n, s), dtype=wp.vec3)
        c.face_near = wp.zeros((n, some_f), dtype=int)
        c.corner_push = wp.zeros(n * 3 * some_f, dtype=wp.vec4)
        c.corner_shift = wp.zeros(n * 3 * some_f, dtype=wp.vec3)
        c.buckets = 1 << (2 * v - 1).bit_length() if layers else 0
        c.head, c.next = wp.zeros(n * c.buckets, dtype=int), wp.zeros(n * some_v, dtype=int)
        if self._device.type == "cuda":  # threads side by side read numbers side by side
            c.candidate = wp.zeros((n, c.room, some_v), dtype=int).transpose((0, 2, 1))
        else:
            c.candidate = wp.zeros((n, some_v, c.room), dtype=int)
        c.candidates, c.crowd = wp.zeros(n * some_v, dtype=int), wp.zeros(n * some_v, dtype=float)
        c.push, c.shift = wp.zeros(n * some_v, dtype=wp.vec3), wp.zeros(n * some_v, dtype=wp.vec3)
        c.left_out = wp.zeros(n * v, dtype=int)
        if layers:
            near, which = neighbours_along(edges, length, v, thickness)
            c.apart_start, c.apart = one_each(near, int), one_each(which, int)

        on_gpu = self._device.type == "cuda"
        threads = options.threads or min(max(v // 4, _THREADS[0]), _THREADS[1])
        threads = 32 * math.ceil(min(v, threads) / 32)
        rounded = 256 * math.ceil(v / 256)  # so that garments of similar size share kernels
        shared = v <= SHARED_VERTICES and on_gpu and options.traversal == "block"
        weighted = shared and v <= WEIGHTED_VERTICES
        room = WEIGHTED_VERTICES if weighted else SHARED_VERTICES
        features = Features(
            shapes=s > 0,
            grips=bool(members),
            self_contact=layers,
            shared=min(rounded, room) if shared else 0,
            weighted=weighted,
            threads=threads if on_gpu else 1,
        )
        return c, features, (found.first, hinges.first)

    def _bending_every(self, hinges: Hinges, inverse: np.ndarray) -> int:
        """As of an oscillator that is pushed every m sub-steps: (m ω Δt)² stays far below 4."""
        if not len(hinges.quads):
            return 1
        fabric = self.model.fabric
        stiff = (inverse[hinges.quads] * hinges.weights**2).sum(axis=1) / hinges.unit
        square = float(stiff.max()) * fabric.bending * self._dt**2 / fabric.density
        most = math.sqrt(_SOFT / max(square, 1e-12))
        return max(1, min(int(most), int(_BENDING_SECONDS / self._dt + 1e-6)))

    @staticmethod
    def _check(model: ClothModel, pinned: np.ndarray, members: Sequence[np.ndarray]) -> None:
        shapes = sum(len(tool.shapes) for tool in model.tools)
        if shapes > MOST_SHAPES:
            raise ConfigError(
                f"The scene's tools have {shapes} shapes together; cloth can meet {MOST_SHAPES}."
            )
        for number, (grip, vertices) in enumerate(zip(model.grips, members, strict=True)):
            if not 0 <= grip.tool < len(model.tools):
                raise ConfigError(f"Grip {number} is of tool {grip.tool}, which the scene has not.")
            if np.isin(vertices, pinned).any():
                raise ConfigError(f"Grip {number} holds a vertex that is pinned: leave it to one.")

    def _carrying(self) -> Tensor:
        found = super()._carrying()
        for number, grip in enumerate(self.model.grips):
            found[:, grip.tool] |= self.read("grip_closed")[:, number] > 0.5
        return found

    def _advance(self, count: int) -> None:
        c, kernels, features = self._cloth, self._kernels, self._features
        if self._options.traversal == "block":
            wp.launch_tiled(
                kernels.block, dim=[self._n], inputs=[c, count], block_dim=features.threads
            )
            return
        n, s = self._n, c.tools.shapes
        vertices, faces = (n, c.vertices), (n, c.faces)
        everything = (n, max(c.vertices, c.buckets, s))
        either = (n, max(c.vertices, c.faces))
        for substep in range(count):
            resuming = [True] if features.self_contact and substep == 0 else []
            for resumes in (*resuming, False) if features.self_contact or s else ():
                wp.launch(kernels.begin, dim=everything, inputs=[c, resumes])
                wp.launch(kernels.insert, dim=either, inputs=[c, resumes])
                wp.launch(kernels.search, dim=vertices, inputs=[c, resumes])
            if s or c.grips:
                wp.launch(kernels.tools, dim=n, inputs=[c])
            if c.grips:
                wp.launch(kernels.grip, dim=(n, c.grip_vertices), inputs=[c])
            wp.launch(kernels.predict, dim=vertices, inputs=[c])
            for kernel, begins in zip((kernels.edges, kernels.hinges), self._first, strict=True):
                for colour in range(len(begins) - 1):
                    first, last = int(begins[colour]), int(begins[colour + 1])
                    wp.launch(kernel, dim=(n, last - first), inputs=[c, colour, first])
            if features.self_contact:
                wp.launch(kernels.find_layers, dim=vertices, inputs=[c])
                wp.launch(kernels.part_layers, dim=vertices, inputs=[c])
            if s:
                wp.launch(kernels.touch, dim=faces, inputs=[c])
            wp.launch(kernels.finish, dim=vertices, inputs=[c])
            wp.launch(kernels.count, dim=n, inputs=[c])
        wp.launch(kernels.judge, dim=vertices, inputs=[c])


def _indices(vertices: Any, count: int, name: str) -> np.ndarray:
    found = np.asarray(vertices, dtype=np.int64).reshape(-1)
    if ((found < 0) | (found >= count)).any():
        raise ConfigError(f"The vertices {name} are numbers from 0 to {count - 1}.")
    if len(np.unique(found)) != len(found):
        raise ConfigError(f"One of the vertices {name} is named twice.")
    return found

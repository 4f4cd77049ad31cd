"""The GPU simulator: N worlds of one MuJoCo model in MuJoCo Warp."""

from __future__ import annotations

import os
import shutil
import tempfile
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import mujoco
import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.task import Context, Shape, Simulator
from understudy_mujoco.scene import MujocoScene

try:
    import mujoco_warp as mjw
    import warp as wp
except ImportError as error:
    raise ImportError(
        f"simulator 'mujoco_warp' needs MuJoCo Warp ({error}): pip install 'understudy[gpu]'"
    ) from error

#: Data fields that tasks may read, beside the state. Names and frames are MuJoCo's.
READABLE = ("xpos", "xquat", "xipos", "cvel", "subtree_com", "geom_xpos", "actuator_force")
#: What decides the future of a world.
STATE = ("qpos", "qvel", "act", "qacc_warmstart", "ctrl", "time")
#: Beyond this a position, or a velocity, is one of a simulation that diverged.
_LIMIT = 1e6


def start_warp() -> None:
    """Initialise Warp, with a kernel cache that can be written.

    Where the usual folder (``$WARP_CACHE_PATH``, or the user's cache) cannot be written, what it
    holds is copied to a temporary one, so that a read-only but warm cache keeps its use.
    """
    wp.config.quiet = True
    try:
        wp.init()
        folder = wp.config.kernel_cache_dir
        if folder is not None and os.access(folder, os.W_OK):
            return
        reason = f"{folder} cannot be written"
    except OSError as error:
        folder, reason = None, str(error)
    temporary = tempfile.mkdtemp(prefix="understudy-kernels-")
    if folder is not None and os.path.isdir(folder):
        shutil.copytree(folder, temporary, dirs_exist_ok=True)
    wp.config.kernel_cache_dir = temporary
    wp.init()
    warnings.warn(
        f"No kernel cache to write ({reason}); using {temporary}, so the next start compiles again. "
        "Set WARP_CACHE_PATH to a folder that can be written.",
        stacklevel=2,
    )


def contact_capacity(model: mujoco.MjModel) -> int:
    """The most contacts that geoms of `model` can make with planes, plus room for others.

    A plane touches a sphere in 1 point, a capsule in 2, anything else in at most 4. Pairs of other
    geoms that may collide get one contact each, up to 64: they cannot all touch at once.
    """
    points = {int(mujoco.mjtGeom.mjGEOM_SPHERE): 1, int(mujoco.mjtGeom.mjGEOM_CAPSULE): 2}
    plane = int(mujoco.mjtGeom.mjGEOM_PLANE)
    with_planes = others = 0
    for a in range(model.ngeom):
        for b in range(a + 1, model.ngeom):
            if model.body_weldid[model.geom_bodyid[a]] == model.body_weldid[model.geom_bodyid[b]]:
                continue
            if not (
                model.geom_contype[a] & model.geom_conaffinity[b]
                or model.geom_contype[b] & model.geom_conaffinity[a]
            ):
                continue
            types = (int(model.geom_type[a]), int(model.geom_type[b]))
            if plane in types:
                with_planes += points.get(max(types), 4)
            else:
                others += 1
    return max(1, with_planes + min(others, 64))


class MujocoWarpSimulator(Simulator):
    """Fields are torch views of Warp's arrays, float32; ``ctrl`` is the control.

    One control period is one CUDA graph: all sub-steps, then the kinematics of the new state, so
    that what is read belongs to the same moment. On the CPU, where there are no graphs, it computes
    the same slowly; tests use that.
    """

    state_fields = ("qpos", "qvel")

    @dataclass(frozen=True)
    class Options:
        #: Contacts and constraint rows to hold per world; null takes the most the scene can make.
        contacts: int | None = None
        constraints: int | None = None
        deterministic: bool = False  #: repeat bit for bit from run to run, at some cost

    def __init__(self, options: Options, context: Context) -> None:
        scene = context.need_scene(MujocoScene, "simulator 'mujoco_warp'")
        self.model = scene.compiled(context)
        self._device = context.device
        self._substeps = context.substeps
        contacts = options.contacts or contact_capacity(self.model)
        limits = int(self.model.jnt_limited.sum())
        constraints = options.constraints or 4 * contacts + limits  # pyramids have 4 edges
        self._refuse_too_large(context.num_worlds, constraints)
        start_warp()
        with self._on_device():
            try:
                self._m = mjw.put_model(self.model)
                self._d = mjw.make_data(
                    self.model, nworld=context.num_worlds, nconmax=contacts, njmax=constraints
                )
            except NotImplementedError as error:
                raise ConfigError(
                    f"simulator 'mujoco_warp' cannot run this scene: {error} Use simulator=mujoco."
                ) from error
            self._m.opt.warn_overflow = 0  # counted here, not printed by every world
            if options.deterministic:
                self._m.opt.deterministic = int(mjw.DeterminismType.ALL)
        self.control_size = self.model.nu
        self._views = {
            name: wp.to_torch(getattr(self._d, name)) for name in (*STATE, *READABLE, "overflow")
        }
        self.fields: Mapping[str, Shape] = {
            name: tuple(self._views[name].shape[1:]) for name in ("qpos", "qvel", "ctrl", *READABLE)
        }
        dropped = mjw.OverflowType
        self._dropping = int(
            dropped.NEFC
            | dropped.NJMAX_NNZ
            | dropped.BROADPHASE
            | dropped.NARROWPHASE
            | dropped.CCD
        )
        self._overflows = torch.zeros((), dtype=torch.int64, device=self._device)
        self._step_graph = self._capture(self._advance)
        self._ready_graph = self._capture(self._refresh)
        self._views["qpos"].copy_(
            torch.tensor(self.model.qpos0, dtype=torch.float32).to(self._device)
        )
        self._views["qvel"].zero_()
        self._views["qacc_warmstart"].zero_()
        self._views["time"].zero_()
        self._run(self._ready_graph, self._refresh)

    def _refuse_too_large(self, num_worlds: int, constraints: int) -> None:
        """Say before allocating that the worlds do not fit; an estimate of the largest arrays."""
        if self._device.type != "cuda":
            return
        nv = self.model.nv
        need = 4 * num_worlds * (constraints * (nv + 16) + 6 * nv * nv + 200 * self.model.nbody)
        free, _ = torch.cuda.mem_get_info(self._device)
        if need > 0.9 * free:
            fit = int(0.9 * free / need * num_worlds)
            raise ConfigError(
                f"num_worlds={num_worlds} needs about {need / 2**30:.0f} GiB of GPU memory and "
                f"{free / 2**30:.0f} GiB are free. About {fit} worlds fit."
            )

    # ------------------------------------------------------------------ Warp and torch together

    def _on_device(self) -> Any:
        return wp.ScopedDevice(wp.device_from_torch(self._device))

    def _capture(self, work: Callable[[], None]) -> Any:
        """The CUDA graph of `work`, or None on the CPU."""
        if self._device.type != "cuda":
            return None
        with self._on_device():
            work()  # compiles the kernels, which must not happen while capturing
            with wp.ScopedCapture() as capture:
                work()
            return capture.graph

    def _run(self, graph: Any, work: Callable[[], None]) -> None:
        """Run `work` on torch's stream, so that both libraries' kernels keep their order."""
        if graph is None:
            with self._on_device():
                work()
            return
        stream = wp.stream_from_torch(torch.cuda.current_stream(self._device))
        with wp.ScopedStream(stream):
            wp.capture_launch(graph)

    def _advance(self) -> None:
        for _ in range(self._substeps):
            mjw.step(self._m, self._d)
        self._refresh()

    def _refresh(self) -> None:
        mjw.kinematics(self._m, self._d)
        mjw.com_pos(self._m, self._d)
        mjw.com_vel(self._m, self._d)

    # ------------------------------------------------------------------ Simulator

    def read(self, name: str) -> Tensor:
        return self._views[name]

    def set_state(self, worlds: Tensor, state: Mapping[str, Tensor]) -> None:
        rows = worlds.unsqueeze(1)
        for name in self.state_fields:
            view = self._views[name]
            torch.where(rows, state[name], view, out=view)
        for name in ("act", "qacc_warmstart", "ctrl"):
            self._views[name].masked_fill_(rows, 0.0)
        self._views["time"].masked_fill_(worlds, 0.0)
        self._run(self._ready_graph, self._refresh)

    def step(self, control: Tensor) -> None:
        self._views["ctrl"].copy_(control)
        self._run(self._step_graph, self._advance)
        overflow = self._views["overflow"]
        self._overflows += ((overflow & self._dropping) != 0).sum()
        overflow.zero_()

    def failed(self) -> Tensor:
        sound = torch.ones(self._views["qpos"].shape[0], dtype=torch.bool, device=self._device)
        for name in self.state_fields:
            sound &= (self._views[name].abs() < _LIMIT).all(dim=1)  # false for NaN
        return ~sound

    def snapshot(self) -> dict[str, Tensor]:
        return {name: self._views[name].clone() for name in STATE}

    def restore(self, snapshot: Mapping[str, Tensor]) -> None:
        for name in STATE:
            self._views[name].copy_(snapshot[name])
        self._run(self._ready_graph, self._refresh)

    def report(self) -> dict[str, int]:
        count = int(self._overflows)
        return {"contact_or_constraint_overflows": count} if count else {}

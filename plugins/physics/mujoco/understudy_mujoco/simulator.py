"""The CPU simulator: N copies of one MuJoCo model in ``mujoco.batch.Batch``."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import mujoco
import numpy as np
import torch
from mujoco.batch import Batch, SimulationError
from torch import Tensor

from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.records.runs import cores
from understudy.task import Context, Shape, Simulator
from understudy_mujoco.fields import AT_ITERATIONS, AT_LIMIT, RECENT, Stage, limits, often, readable
from understudy_mujoco.lean import NEED_ALL, lean, read_no_clock
from understudy_mujoco.parameters import MOCAP, Parameter, chosen, parameters
from understudy_mujoco.scene import MujocoScene

#: MuJoCo's stage at which ours is reached; the velocity stage costs mj_step nothing to stop at.
_STAGE = {
    Stage.KINEMATICS: mujoco.mjtStage.mjSTAGE_VEL,
    Stage.VELOCITY: mujoco.mjtStage.mjSTAGE_VEL,
    Stage.ACCELERATION: mujoco.mjtStage.mjSTAGE_ACC,
}
#: Nothing that MuJoCo keeps in the model is computed from these.
_PLAIN = (*MOCAP, "geom_friction", "dof_damping", "actuator_gainprm", "actuator_biasprm")
_WARNINGS = [
    name.removeprefix("mjWARN_").lower()
    for name, value in sorted(mujoco.mjtWarning.__members__.items(), key=lambda item: int(item[1]))
    if name != "mjNWARNING"
]
_BAD = [i for i, name in enumerate(_WARNINGS) if name.startswith("bad")]


class MujocoSimulator(Simulator):
    """Fields are MuJoCo's ``MjData`` arrays in float32; ``ctrl`` is the control.

    The engine's automatic reset is switched off, so a diverged world stays visibly diverged. Such
    worlds, any that raised a bad-state warning, and any in which the engine raised an error (they
    stay where they were) are reported by :meth:`failed`.

    A field is bound when it is first read. Forces, accelerations and their sensors cost one forward
    computation a step from then on.

    *Limits:* CPUs alone; the worlds' number is fixed, and all have one model, which they
    vary in named parameters. What is read is float32; the engine computes in float64.
    """

    state_fields = ("qpos", "qvel")

    @dataclass(frozen=True)
    class Options:
        threads: int = 0  #: 0 uses every core this process may run on

        def __post_init__(self) -> None:
            check_range(self, "threads", least=0, most=1024)

    def __init__(self, options: Options, context: Context) -> None:
        if context.device.type != "cpu":
            raise ConfigError(
                f"simulator 'mujoco' computes on the CPU, and device={context.device}. Set device=cpu, "
                "or choose simulator=mujoco_warp."
            )
        scene = context.need_scene(MujocoScene, "simulator 'mujoco'")
        flags, threads = int(mujoco.mjtDisableBit.mjDSBL_AUTORESET), options.threads or cores()
        read_no_clock()
        self._whole = partial(scene.compiled, context, flags)
        self._start(scene.compiled(context, flags, lean), context.num_worlds, threads)
        self.control_size = self.model.nu
        self._substeps = context.substeps
        self._readable = readable(self.model)
        self._known = parameters(self.model)
        self.fields: Mapping[str, Shape] = {n: f.shape for n, f in self._readable.items()}
        self.parameters: Mapping[str, Shape] = {n: p.shape for n, p in self._known.items()}
        self._varied: dict[str, np.ndarray] = {}  # (N, …), the engine's own memory
        self._switches: list[Parameter] = []
        self._derives = False
        self._stage = Stage.VELOCITY
        #: (kinds,) since the start; the engine's own counters begin anew with their world.
        self._counts = np.zeros(len(_WARNINGS), dtype=np.int64)
        self._broken = np.zeros(context.num_worlds, dtype=bool)
        self._asked = False  #: whether anybody was told of those
        self._recent: dict[str, np.ndarray] = {}  #: (N, …), copies by array
        self._reached = {AT_ITERATIONS: 0, AT_LIMIT: 0}
        self._looked = 0  #: steps of all worlds of which those are

    def _start(self, model: mujoco.MjModel, worlds: int, threads: int) -> None:
        self.model = model
        self.batch = Batch(model, worlds, threads)
        self._limits = limits(model)
        self._limited = bool(np.isfinite(self._limits).any())
        names = ("qpos", "qvel", "ctrl", "solver_niter", *["actuator_force"] * self._limited)
        self._views = {name: self.batch.bind(name) for name in names}
        self._rows = self.batch.state

    def _warnings(self) -> np.ndarray:
        """(N, kinds), how often each of the engine's warnings was raised."""
        return self.batch.warning[:, :, 1].copy()

    def _run(self, call: Callable[..., None], *arguments: object, **options: int) -> None:
        """A call of the engine; worlds in which it raises an error have failed."""
        try:
            call(*arguments, **options)
        except SimulationError:
            self._broken |= self.batch.status != 0

    def _forward(self, ids: np.ndarray | None = None) -> None:
        self._run(self.batch.forward, ids, stage=int(_STAGE[self._stage]))

    # ------------------------------------------------------------------ parameters

    def vary(self, names: Sequence[str]) -> None:
        picked = chosen(self._known, names, "simulator 'mujoco'")
        if any(parameter.field in NEED_ALL for parameter in picked):
            self._start(self._whole(), self.batch.nsim, self.batch.nthread)
        for parameter in picked:
            if parameter.field == "active":
                self._varied[parameter.name] = np.ones(self.batch.nsim)
                self._switches.append(parameter)
            elif parameter.field in MOCAP:
                self._varied[parameter.name] = self.batch.bind(parameter.field)[:, parameter.rows]
            else:
                field = "opt.gravity" if parameter.field == "gravity" else parameter.field
                self._varied[parameter.name] = self.batch.expand(field)[:, parameter.rows]
        self.fields = {**self.fields, **{p.name: p.shape for p in picked}}
        self._derives = any(p.field not in _PLAIN for p in picked)
        self._derive(np.arange(self.batch.nsim))

    def _set_parameters(self, ids: np.ndarray, values: Mapping[str, Tensor]) -> None:
        given = [name for name in self._varied if name in values]
        for name in given:
            self._varied[name][ids] = values[name].numpy()[ids]
        if given:
            self._derive(ids)

    def _derive(self, ids: np.ndarray) -> None:
        """What the engine keeps in the model beside the parameters: bounds, inverse weights, …"""
        if self._switches:
            on = np.ones((len(ids), self.model.ngeom), dtype=bool)
            for switch in self._switches:
                on[:, switch.rows] &= self._varied[switch.name][ids, None] != 0
            for field in ("geom_contype", "geom_conaffinity"):
                self.batch.expand(field)[ids] = np.where(on, getattr(self.model, field), 0)
        if self._derives:
            self._run(self.batch.set_const, ids)

    # ------------------------------------------------------------------ Simulator

    def read(self, name: str) -> Tensor:
        if name in self._varied:
            return torch.from_numpy(self._varied[name].astype(np.float32))
        field = self._readable[name]
        if field.recent:
            if field.array not in self._recent:
                self._recent[field.array] = np.zeros_like(self._bound(field.array))
            return torch.from_numpy(self._recent[field.array][:, field.columns].astype(np.float32))
        if field.array not in self._views or field.stage > self._stage:
            # bound when first read: every bound field is copied each step
            self._bound(field.array)
            self._stage = max(field.stage, self._stage)
            self._forward()
        return torch.from_numpy(self._views[field.array][:, field.columns].astype(np.float32))

    def _bound(self, array: str) -> np.ndarray:
        """(N, …), the engine's own memory of MjData's `array`."""
        if array not in self._views:
            self._views[array] = self.batch.bind(array)
        return self._views[array]

    def set_state(self, worlds: Tensor, state: Mapping[str, Tensor]) -> None:
        ids = worlds.nonzero().squeeze(1).numpy()
        if not len(ids):
            return
        self._broken[ids] = False
        mocap = {n: v[ids].copy() for n, v in self._varied.items() if n.startswith(MOCAP)}
        self._run(self.batch.reset, ids, stage=int(mujoco.mjtStage.mjSTAGE_NONE))
        for name, value in mocap.items():  # in the engine they are state, here they are parameters
            self._varied[name][ids] = value
        self._set_parameters(ids, state)
        for copy in self._recent.values():
            copy[ids] = 0.0
        for name in (*self.state_fields, *{"ctrl"} & state.keys()):
            self._views[name][ids] = state[name].numpy()[ids]
        self._forward(ids)

    def step(self, control: Tensor, substeps: int | None = None) -> None:
        if self._asked:  # not before: several steps may come between
            self._broken[:] = self._asked = False
        self._views["ctrl"][:] = control.numpy()
        before = self._warnings()
        count = self._substeps if substeps is None else substeps
        # what the last sub-step computed is there until forces are computed anew
        self._run(self.batch.step, nstep=count, stage=int(_STAGE[Stage.VELOCITY]))
        for array, copy in self._recent.items():
            copy[:] = self._bound(array)
        self._count_limits()
        if self._stage == Stage.ACCELERATION:
            self._forward()
        raised = self._warnings() - before
        self._counts += raised.sum(axis=0)
        self._broken |= raised[:, _BAD].any(axis=1)

    def _count_limits(self) -> None:
        """Of the last sub-step: solvers that used all iterations, actuators as strong as they can be."""
        most = self._views["solver_niter"].max(axis=1)
        self._looked += len(most)
        self._reached[AT_ITERATIONS] += int((most >= self.model.opt.iterations).sum())
        if self._limited:
            force = np.abs(self._views["actuator_force"])
            self._reached[AT_LIMIT] += int((force >= self._limits).sum())

    def failed(self) -> Tensor:
        sound = np.isfinite(self._views["qpos"]).all(1) & np.isfinite(self._views["qvel"]).all(1)
        self._asked = True
        return torch.from_numpy(self._broken | ~sound)

    def snapshot(self) -> dict[str, Tensor]:
        copies = {name: torch.from_numpy(value.copy()) for name, value in self._varied.items()}
        recent = {f"{RECENT}{n}": torch.from_numpy(c.copy()) for n, c in self._recent.items()}
        return {"state": torch.from_numpy(self._rows.copy()), **copies, **recent}

    def restore(self, snapshot: Mapping[str, Tensor], worlds: Tensor | None = None) -> None:
        ids = np.arange(self.batch.nsim) if worlds is None else worlds.nonzero().squeeze(1).numpy()
        if not len(ids):
            return
        self._broken[ids] = False
        self._rows[ids] = snapshot["state"].numpy()[ids]
        for name, copy in self._recent.items():
            kept = snapshot.get(f"{RECENT}{name}")  # none of a time when nobody read it
            copy[ids] = 0.0 if kept is None else kept.numpy()[ids]
        self._set_parameters(ids, snapshot)
        self._forward(ids)

    def report(self) -> dict[str, int]:
        return {
            name: int(count) for name, count in zip(_WARNINGS, self._counts, strict=True) if count
        } | often(
            self._reached[AT_ITERATIONS], self._reached[AT_LIMIT], self._looked, self.model.nu
        )

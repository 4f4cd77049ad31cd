"""The CPU simulator: N copies of one MuJoCo model in ``mujoco.batch.Batch``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
import torch
from mujoco.batch import Batch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.records.runs import cores
from understudy.task import Context, Shape, Simulator
from understudy_mujoco.scene import MujocoScene

#: MjData fields that tasks may read, beside the state. Names and frames are MuJoCo's.
READABLE = (
    "xpos", "xquat", "xipos", "cvel", "subtree_com", "geom_xpos", "geom_xmat", "site_xpos",
    "sensordata", "actuator_force", "actuator_length", "actuator_velocity",
)  # fmt: skip

#: Positions, velocities and everything that derives from them are current after this stage.
_READY = mujoco.mjtStage.mjSTAGE_VEL
_WARNINGS = [
    name.removeprefix("mjWARN_").lower()
    for name, value in sorted(mujoco.mjtWarning.__members__.items(), key=lambda item: int(item[1]))
    if name != "mjNWARNING"
]
_BAD = [i for i, name in enumerate(_WARNINGS) if name.startswith("bad")]


class MujocoSimulator(Simulator):
    """Fields are MuJoCo's ``MjData`` arrays in float32; ``ctrl`` is the control.

    The engine's automatic reset is switched off, so a diverged world stays visibly diverged; such
    worlds, and any that raised a bad-state warning, are reported by :meth:`failed`.
    """

    state_fields = ("qpos", "qvel")

    @dataclass(frozen=True)
    class Options:
        threads: int = 0  #: 0 uses every core this process may run on

        def __post_init__(self) -> None:
            check_range(self, "threads", least=0)

    def __init__(self, options: Options, context: Context) -> None:
        if context.device.type != "cpu":
            raise ConfigError(
                f"simulator 'mujoco' computes on the CPU, and device={context.device}. Set device=cpu, "
                "or choose simulator=mujoco_warp."
            )
        scene = context.need_scene(MujocoScene, "simulator 'mujoco'")
        self.model = scene.compiled(context, int(mujoco.mjtDisableBit.mjDSBL_AUTORESET))
        threads = options.threads or cores()
        self.batch = Batch(self.model, context.num_worlds, threads)
        self._substeps = context.substeps
        self.control_size = self.model.nu
        self._views = {name: self.batch.bind(name) for name in ("qpos", "qvel", "ctrl")}
        data = mujoco.MjData(self.model)
        self.fields: Mapping[str, Shape] = {
            name: tuple(getattr(data, name).shape) for name in (*self._views, *READABLE)
        }
        self._seen = self._warnings().copy()
        #: (kinds,) since the start; the engine's own counters begin anew with their world.
        self._counts = np.zeros(self._seen.shape[1], dtype=np.int64)
        self._rows = self.batch.state

    def _warnings(self) -> np.ndarray:
        """(N, kinds) int32, how often each of the engine's warnings was raised."""
        return self.batch.warning[:, :, 1]

    def read(self, name: str) -> Tensor:
        if name not in self._views:  # bound when first read: every bound field is copied each step
            self._views[name] = self.batch.bind(name)
            self.batch.forward(stage=_READY)
        return torch.from_numpy(self._views[name].astype(np.float32))

    def set_state(self, worlds: Tensor, state: Mapping[str, Tensor]) -> None:
        ids = worlds.nonzero().squeeze(1).numpy()
        if not len(ids):
            return
        self.batch.reset(ids, stage=mujoco.mjtStage.mjSTAGE_NONE)
        self._views["qpos"][ids] = state["qpos"].numpy()[ids]
        self._views["qvel"][ids] = state["qvel"].numpy()[ids]
        self.batch.forward(ids, stage=_READY)
        self._seen[ids] = self._warnings()[ids]

    def step(self, control: Tensor, substeps: int | None = None) -> None:
        self._views["ctrl"][:] = control.numpy()
        self.batch.step(nstep=substeps or self._substeps, stage=_READY)

    def failed(self) -> Tensor:
        warnings = self._warnings()
        warned = (warnings != self._seen)[:, _BAD].any(axis=1)
        self._counts += np.maximum(warnings - self._seen, 0).sum(axis=0)
        self._seen[:] = warnings
        sound = np.isfinite(self._views["qpos"]).all(1) & np.isfinite(self._views["qvel"]).all(1)
        return torch.from_numpy(warned | ~sound | (self.batch.status != 0))

    def snapshot(self) -> dict[str, Tensor]:
        return {"state": torch.from_numpy(self._rows.copy())}

    def restore(self, snapshot: Mapping[str, Tensor], worlds: Tensor | None = None) -> None:
        rows = slice(None) if worlds is None else worlds.numpy()
        self._rows[rows] = snapshot["state"].numpy()[rows]
        self.batch.forward(stage=_READY)
        self._seen[:] = self._warnings()

    def report(self) -> dict[str, int]:
        return {
            name: int(count) for name, count in zip(_WARNINGS, self._counts, strict=True) if count
        }

"""The GPU simulator: N worlds of one MuJoCo model in MuJoCo Warp."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from typing import Any

import mujoco
import mujoco_warp as mjw
import numpy as np
import torch
import warp as wp
from torch import Tensor

from understudy.errors import ConfigError
from understudy.running.environment import Environment
from understudy.task import Context, Shape, Simulator
from understudy_mujoco.fields import RECENT, Stage, limits, often, readable
from understudy_mujoco.parameters import MOCAP, Parameter, chosen, parameters
from understudy_mujoco.scene import MujocoScene
from understudy_mujoco_warp.capacity import constraint_capacity, contact_capacity
from understudy_mujoco_warp.narrow import refuse_narrow_ranges
from understudy_mujoco_warp.part import MujocoWarp
from understudy_tensors.captured import Captured
from understudy_warp_torch.kernels import Kernels, put_rows

#: What decides the future of a world, beside its parameters; what a model has none of is left out.
STATE = ("qpos", "qvel", "act", "qacc_warmstart", "ctrl", "time", "history", "plastic")
#: Beyond this a position, or a velocity, is one of a simulation that diverged.
_LIMIT = 1e6

#: What MuJoCo keeps in the model beside a parameter, as groups of ``mjw.set_const``.
_BOUNDS = int(mjw.SetConstGroup.FIXED)
_POSES = int(mjw.SetConstGroup.KIN0)
_INERTIA = int(mjw.SetConstGroup.INERT0)
_GROUPS = {
    "geom_size": _BOUNDS,
    "body_mass": _BOUNDS | _INERTIA | _POSES,
    "body_inertia": _INERTIA,
    "body_ipos": _INERTIA | _POSES,
    "body_pos": _INERTIA | _POSES,
    "body_quat": _INERTIA | _POSES,
    "dof_armature": _INERTIA,
}
#: … and the fields that such a group computes, for each world where a parameter may differ.
_DERIVED = {
    _BOUNDS: ("geom_size", "geom_aabb", "geom_rbound", "body_subtreemass"),
    _POSES: (
        "tendon_length0", "eq_data", "cam_pos0", "cam_poscom0", "cam_mat0",
        "light_pos0", "light_poscom0", "light_dir0",
    ),
    _INERTIA: ("dof_invweight0", "body_invweight0", "tendon_invweight0", "actuator_acc0"),
}  # fmt: skip
#: Of a body that floats by itself, for which the weights need no solves (:meth:`MujocoWarpSimulator._weigh`).
_LONE = {"body_mass": _BOUNDS | _POSES, "body_inertia": 0}
#: Warp places the geoms of bodies that are fixed to the world once for all, unless told otherwise.
_PLACES = {"body_pos", "body_quat", "geom_pos", "geom_quat"}
#: Contacts begin where the distance of two geoms is less than the sum of their margins, so a geom
#: with this one, in metres, touches nothing. (Warp has no contype for each world.)
_SWITCHED, _FAR = "geom_margin", -1e8


class MujocoWarpSimulator(Simulator):
    """What :class:`~understudy_mujoco_warp.part.MujocoWarp` says."""

    state_fields = ("qpos", "qvel")
    Options = MujocoWarp.Options

    def __init__(self, options: Options, context: Context) -> None:
        scene = context.need_scene(MujocoScene, "simulator 'mujoco_warp'")
        self.model = scene.compiled(context)
        refuse_narrow_ranges(self.model)
        self._n = context.num_worlds
        self._substeps = context.substeps
        contacts = options.contacts or contact_capacity(self.model)
        constraints = options.constraints or constraint_capacity(self.model, contacts)
        self._kernels = Kernels(context.device)
        self._device = self._kernels.device
        self._refuse_too_large(context.num_worlds, constraints)
        with self._kernels.scope():
            try:
                self._m = self._put_model({})
                self._d = mjw.make_data(
                    self.model, nworld=self._n, nconmax=contacts, njmax=constraints
                )
            except NotImplementedError as error:
                raise ConfigError(
                    f"simulator 'mujoco_warp' cannot run this scene: {error} Use simulator=mujoco."
                ) from error
        self.control_size = self.model.nu
        self._readable = readable(self.model)
        self._known = parameters(self.model)
        self.fields: Mapping[str, Shape] = {n: f.shape for n, f in self._readable.items()}
        self.parameters: Mapping[str, Shape] = {n: p.shape for n, p in self._known.items()}
        self._views = {
            name: self._torch(field.array, self.fields[field.array])[:, field.columns]
            for name, field in self._readable.items()
            if not field.recent
        }
        self._state = {
            name: self._torch(name, tuple(getattr(self._d, name).shape[1:]))
            for name in STATE
            if getattr(self._d, name).size
        }
        self._initial = {name: view[:1].clone() for name, view in self._state.items()}
        self._varied: dict[str, Tensor] = {}  # (N, …), Warp's own memory
        self._switches: list[Parameter] = []
        self._lone = _lone_bodies(self.model)
        self._weighed: list[int] = []  #: of those, the ones whose mass or inertia differs by world
        self._unwelded: Any = None  # the model, were no body fixed to the world
        self._overflow = wp.to_torch(self._d.overflow)
        dropped = mjw.OverflowType
        self._dropping = int(
            dropped.NEFC
            | dropped.NJMAX_NNZ
            | dropped.BROADPHASE
            | dropped.NARROWPHASE
            | dropped.CCD
        )
        self._overflows = torch.zeros((), dtype=torch.int64, device=self._device)
        self._limits = torch.tensor(limits(self.model), dtype=torch.float32, device=self._device)
        self._limited = bool(self._limits.isfinite().any())
        self._iterations = wp.to_torch(self._d.solver_niter)
        #: (3,) of all steps: worlds at the iteration limit, actuators at theirs; and how many there were.
        self._reached = torch.zeros(3, dtype=torch.int64, device=self._device)
        self._recent: dict[str, Tensor] = {}  #: (N, …), copies by array
        #: (N,) worlds that began a step with numbers that the step may hide: it normalises quaternions.
        self._bad = torch.zeros(self._n, dtype=torch.bool, device=self._device)
        self._asked = False  #: whether anybody was told of those
        self._stage = Stage.KINEMATICS
        self._settle()

    def _put_model(self, batch: Mapping[str, int]) -> Any:
        """The model on the device, with room for `batch` values of the named fields."""
        m = mjw.put_model(self.model, dict(batch))
        m.opt.warn_overflow = 0  # counted here, not printed by every world
        return m

    def _torch(self, array: str, shape: Shape) -> Tensor:
        """The view (N, …) of one of Warp's data arrays; matrices are rows of numbers, as in MuJoCo."""
        return wp.to_torch(getattr(self._d, array)).view(self._n, *shape)

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

    def _run(
        self, key: Hashable, work: Callable[[], None], derive: Callable[[], None] = lambda: None
    ) -> None:
        self._kernels.run(key, work, (*self._state.values(), self._overflow), derive)

    def _advance(self, substeps: int) -> None:
        options = self._m.opt
        flags = options.disableflags
        if not self._m.nhistory:  # nobody sees sensors between sub-steps, unless they are delayed
            options.disableflags = flags | int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
        advance = self._first_step
        for left in reversed(range(substeps)):
            if left == 0 and "sensordata" in self._recent:
                options.disableflags = flags
            advance(self._m, self._d)
            advance = mjw.step
        options.disableflags = flags
        for array, copy in self._recent.items():
            wp.copy(wp.from_torch(copy), wp.from_torch(self._torch(array, self.fields[array])))
        self._refresh()

    @property
    def _first_step(self) -> Callable[[Any, Any], None]:
        """The first sub-step of a call: only its second half where :meth:`_refresh` has done the first."""
        options = self.model.opt
        # The second half knows neither Runge and Kutta's integration nor bodies that sleep.
        halves = options.integrator != mujoco.mjtIntegrator.mjINT_RK4
        halves &= not options.enableflags & mujoco.mjtEnableBit.mjENBL_SLEEP
        return mjw.step2 if halves and self._stage == Stage.VELOCITY else mjw.step

    def _refresh(self) -> None:
        """Compute what is read of the present state."""
        if self._stage == Stage.KINEMATICS:
            mjw.kinematics(self._m, self._d)
            mjw.com_pos(self._m, self._d)
            mjw.com_vel(self._m, self._d)
        elif self._stage == Stage.VELOCITY:
            mjw.step1(self._m, self._d)
        else:
            mjw.forward(self._m, self._d)

    def _settle(self, groups: int = 0) -> None:
        """Compute what derives from state and parameters; `groups` of constants of the model too."""

        def work() -> None:
            if groups:
                mjw.set_const(self._m, self._d, groups, restore=False)
            if self._unwelded is not None:
                mjw.kinematics(self._unwelded, self._d)
            self._refresh()

        self._run(("settle", groups), work)

    # ------------------------------------------------------------------ parameters

    def vary(self, names: Sequence[str]) -> None:
        picked = chosen(self._known, names, "simulator 'mujoco_warp'")
        if not picked:
            return
        fields = {_SWITCHED if p.field == "active" else p.field for p in picked}
        groups = self._groups((p.name for p in picked), all_bodies=True)
        derived = {name for group, names in _DERIVED.items() if groups & group for name in names}
        batched = (fields | derived) - {"gravity", *MOCAP}
        with self._kernels.scope():
            self._m = self._put_model(dict.fromkeys(batched, self._n))
            if "gravity" in fields:
                gravity = np.tile(self.model.opt.gravity, (self._n, 1))
                self._m.opt.gravity = wp.array(gravity, dtype=wp.vec3)
            if fields & _PLACES:
                nowhere = wp.full(self.model.nbody, -1, dtype=int)
                self._unwelded = dataclasses.replace(self._m, body_weldid=nowhere)
        self._kernels.forget()
        for parameter in picked:
            self._varied[parameter.name] = self._memory(parameter)
            if parameter.field == "active":
                self._switches.append(parameter)
        if self._switches:
            self._margins = wp.to_torch(self._m.geom_margin)
            self._model_margins = self._margins.clone()
        rows = (p.rows for p in picked if self._is_lone(p))
        self._weighed = sorted({row for row in rows if isinstance(row, int)})
        self.fields = {**self.fields, **{p.name: p.shape for p in picked}}
        self._views.update(self._varied)
        self._settle(groups)

    def _memory(self, parameter: Parameter) -> Tensor:
        """(N, …), where Warp keeps the parameter."""
        if parameter.field == "active":
            return torch.ones(self._n, device=self._device)
        owner = self._d if parameter.field in MOCAP else self._m
        array = (
            self._m.opt.gravity if parameter.field == "gravity" else getattr(owner, parameter.field)
        )
        return wp.to_torch(array)[:, parameter.rows].view(self._n, *parameter.shape)

    def _is_lone(self, parameter: Parameter) -> bool:
        """Whether what derives from it is of a body that floats by itself."""
        one = isinstance(parameter.rows, int)
        return one and parameter.field in _LONE and parameter.rows in self._lone

    def _groups(self, names: Iterable[str], all_bodies: bool = False) -> int:
        """The groups of the model's constants that derive from these parameters, but for what :meth:`_weigh` computes unless of
        `all_bodies`."""
        groups = 0
        for parameter in map(self._known.__getitem__, names):
            of = _LONE if self._is_lone(parameter) and not all_bodies else _GROUPS
            groups |= of.get(parameter.field, 0)
        model = self.model
        none = not (model.ncam or model.nlight or model.ntendon or model.neq)
        return groups & ~_POSES if none else groups

    def _weigh(self) -> None:
        """The inverse weights of bodies that float by themselves. Warp solves once for each coordinate and six times for each body."""
        for body in self._weighed:
            dof = self._lone[body]
            weight = wp.to_torch(self._m.body_invweight0)[:, body]
            more = wp.to_torch(self._m.dof_armature)[:, dof : dof + 6]
            # Means of three; the angular one does not depend on how the axes lie.
            weight[:, 0] = 1.0 / (wp.to_torch(self._m.body_mass)[:, body] + more[:, 0])
            inertia = wp.to_torch(self._m.body_inertia)[:, body] + more[:, 3:4]
            weight[:, 1] = (1.0 / inertia).mean(dim=1)
            of_dofs = wp.to_torch(self._m.dof_invweight0)[:, dof : dof + 6].view(-1, 2, 3)
            of_dofs.copy_(weight[:, :, None])

    def _set_parameters(self, worlds: Tensor, values: Mapping[str, Tensor]) -> int:
        """Write those that `values` has; returns the groups of constants to be computed anew."""
        given = [name for name in self._varied if name in values]
        for name in given:
            put_rows(self._varied[name], worlds, values[name])
        if self._switches:
            self._margins.copy_(self._model_margins)
            for switch in self._switches:
                off = (self._varied[switch.name] == 0).unsqueeze(1)
                self._margins[:, switch.rows].masked_fill_(off, _FAR)
        self._weigh()
        return self._groups(given)

    # ------------------------------------------------------------------ Simulator

    def read(self, name: str) -> Tensor:
        field = self._readable.get(name)
        if field is not None and field.recent:
            if field.array not in self._recent:
                copy = torch.zeros_like(self._torch(field.array, self.fields[field.array]))
                self._recent[field.array] = self._state[f"{RECENT}{field.array}"] = copy
                self._initial[f"{RECENT}{field.array}"] = copy[:1].clone()
                self._kernels.forget()
            return self._recent[field.array][:, field.columns]
        if field is not None and field.stage > self._stage:
            self._stage = field.stage
            self._kernels.forget()
            self._settle()
        return self._views[name]

    def set_state(self, worlds: Tensor, state: Mapping[str, Tensor]) -> None:
        self._bad &= ~worlds
        groups = self._set_parameters(worlds, state)
        for name, view in self._state.items():
            given = name in self.state_fields or (name == "ctrl" and name in state)
            put_rows(view, worlds, state[name] if given else self._initial[name])
        self._settle(groups)

    def step(self, control: Tensor, substeps: int | None = None) -> None:
        count = self._substeps if substeps is None else substeps
        if self._asked:
            self._bad.zero_()
            self._asked = False
        self._bad |= ~self._sound()
        self._views["ctrl"].copy_(control)
        self._run(("step", count), lambda: self._advance(count), self._refresh)
        self._overflows += ((self._overflow & self._dropping) != 0).sum()
        self._overflow.zero_()
        self._reached[0] += (self._iterations >= self.model.opt.iterations).sum()
        self._reached[2] += self._n
        if self._limited:
            force = self._views["actuator_force"].abs()
            self._reached[1] += (force >= self._limits).sum()

    def replayed(self, work: Callable[[Tensor], Any], environment: Environment) -> Captured[Any]:
        return Captured(work, environment)

    def failed(self) -> Tensor:
        self._asked = True
        return self._bad | ~self._sound()

    def _sound(self) -> Tensor:
        """(N,) bool: the state is finite and of sane size."""
        sound = torch.ones(self._n, dtype=torch.bool, device=self._device)
        for name in self.state_fields:
            sound &= (self._views[name].abs() < _LIMIT).all(dim=1)  # false for NaN
        return sound

    def snapshot(self) -> dict[str, Tensor]:
        return {name: view.clone() for name, view in {**self._state, **self._varied}.items()}

    def restore(self, snapshot: Mapping[str, Tensor], worlds: Tensor | None = None) -> None:
        if worlds is None:
            worlds = torch.ones(self._n, dtype=torch.bool, device=self._device)
        self._bad &= ~worlds
        groups = self._set_parameters(worlds, snapshot)
        for name, view in self._state.items():
            put_rows(view, worlds, snapshot.get(name, self._initial[name]))
        self._settle(groups)

    def report(self) -> dict[str, int]:
        overflows, iterations, limits, steps = torch.cat(
            [self._overflows[None], self._reached]
        ).tolist()
        found = {"contact_or_constraint_overflows": overflows} if overflows else {}
        return found | often(iterations, limits, steps, self.model.nu)


def _lone_bodies(model: mujoco.MjModel) -> dict[int, int]:
    """Bodies that float by themselves, with nothing attached and nothing that drives them, and the first of their coordinates."""
    joints, kinds = (
        np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE),
        model.actuator_trntype,
    )
    if model.ntendon or (kinds != mujoco.mjtTrn.mjTRN_JOINT).any():
        return {}
    driven, found = set(model.actuator_trnid[:, 0].tolist()), dict[int, int]()
    for joint in joints.tolist():
        body, dof = int(model.jnt_bodyid[joint]), int(model.jnt_dofadr[joint])
        armature = model.dof_armature[dof : dof + 6]
        if (
            joint not in driven
            and body not in model.body_parentid
            and not model.body_ipos[body].any()
            and (armature.reshape(2, 3) == armature[::3, None]).all()
        ):
            found[body] = dof
    return found

"""A scene for both engines' tests: sensors of all stages, contacts, a mocap body, a static body."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
import torch
from torch import Tensor

from understudy.task import Context, Simulator
from understudy_mujoco.scene import MujocoScene

SENSORS = ("touch", "place", "turning", "acceleration", "joint", "force", "distance")

ARENA = """<mujoco>
  <default><geom friction=".3"/></default>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 1"/>
    <body name="shelf" pos="2 0 .3"><geom name="shelf" type="box" size=".3 .3 .02"/></body>
    <body name="hand" mocap="true" pos="-2 0 .5"><geom name="hand" type="sphere" size=".2"/></body>
    <body name="box" pos="0 0 .1"><freejoint name="box"/>
      <geom name="box" type="box" size=".1 .1 .1" mass="2"/><site name="box" type="sphere" size=".3"/>
      <body name="arm" pos="0 0 .1"><joint name="hinge" axis="0 1 0" damping=".1" stiffness="2"/>
        <geom name="arm" type="capsule" fromto="0 0 .05 0 0 .3" size=".03" mass=".3"/></body>
    </body>
    <body name="ball" pos="2 0 .5"><freejoint name="ball"/>
      <geom name="ball" type="sphere" size=".1" mass="1"/></body>
  </worldbody>
  <actuator><position name="servo" joint="hinge" kp="3"/></actuator>
  <sensor>
    <touch name="touch" site="box"/><framepos name="place" objtype="site" objname="box"/>
    <gyro name="turning" site="box"/><accelerometer name="acceleration" site="box"/>
    <jointvel name="joint" joint="hinge"/><actuatorfrc name="force" actuator="servo"/>
    <distance name="distance" geom1="ball" geom2="shelf" cutoff="10"/>
  </sensor></mujoco>"""


class Arena(MujocoScene):
    """See :data:`ARENA`."""

    def spec(self) -> mujoco.MjSpec:
        return mujoco.MjSpec.from_string(ARENA)


def arena(worlds: int, device: str = "cpu", substeps: int = 5) -> Context:
    context = Context(
        0, torch.device(device), worlds, control_dt=0.002 * substeps, substeps=substeps
    )
    context.scene = Arena()
    return context


def states(worlds: int, device: str = "cpu") -> dict[str, Tensor]:
    """Different states: the box in and above the floor, turning; the ball near the shelf; the arm
    bent."""
    model = Arena().spec().compile()
    u = torch.rand(4, worlds, generator=torch.Generator().manual_seed(0))
    qpos = torch.tensor(model.qpos0, dtype=torch.float32).repeat(worlds, 1)
    qpos[:, 2] = 0.098 + 0.02 * u[0]
    qpos[:, 7] = u[1] - 0.5
    qpos[:, 10] = 0.41 + 0.05 * u[2]
    qvel = torch.zeros(worlds, model.nv)
    qvel[:, 5] = u[3]
    qvel[:, 6] = u[0] - u[3]
    return {"qpos": qpos.to(device), "qvel": qvel.to(device)}


def everywhere(simulator: Simulator) -> Tensor:
    value = simulator.read("qpos")
    return torch.ones(value.shape[0], dtype=torch.bool, device=value.device)


def forward(state: dict[str, Tensor], control: Tensor) -> list[mujoco.MjData]:
    """Plain ``mj_forward`` of each row."""
    model = Arena().spec().compile()
    found = []
    for qpos, qvel, u in zip(state["qpos"], state["qvel"], control, strict=True):
        data = mujoco.MjData(model)
        data.qpos, data.qvel, data.ctrl = qpos.cpu(), qvel.cpu(), u.cpu()
        mujoco.mj_forward(model, data)
        found.append(data)
    return found


def expected(found: list[mujoco.MjData], name: str) -> Tensor:
    """(N, …), a field of each."""
    if name.startswith("sensor_"):
        rows = [data.sensor(name.removeprefix("sensor_")).data.copy() for data in found]
    else:
        rows = [getattr(data, name).copy() for data in found]
    return torch.stack([torch.from_numpy(row).float() for row in rows])


#: Fields of every stage, other than sensors.
FIELDS = (
    "xpos", "geom_xmat", "cvel", "actuator_length", "actuator_velocity", "actuator_force", "qacc",
    "qfrc_constraint", "cfrc_int", "cacc",
)  # fmt: skip


def check_fields(simulator: Simulator, atol: float, rtol: float) -> None:
    """All fields are those of plain MuJoCo for the same state and control: after a state is set,
    after a step, and after some worlds only are restored."""
    n = simulator.read("qpos").shape[0]
    device = simulator.read("qpos").device
    names = (*FIELDS, *(f"sensor_{name}" for name in SENSORS))

    def check(when: str) -> None:
        state = {name: simulator.read(name).clone() for name in simulator.state_fields}
        found = forward(state, simulator.read("ctrl").clone())
        for name in names:
            value = simulator.read(name).cpu()
            exact = expected(found, name)
            scale = atol + rtol * exact.abs().max()
            assert (value - exact).abs().max() < scale, f"{name} {when}"

    simulator.set_state(everywhere(simulator), states(n, str(device)))
    check("after the state is set")
    early = simulator.snapshot()
    control = torch.linspace(-0.5, 0.5, n, device=device).unsqueeze(1)
    for _ in range(8):
        simulator.step(control)
    check("after steps")
    assert simulator.read("sensor_touch").max() > 1.0, "nothing touches: the test shows nothing"
    simulator.restore(early, torch.arange(n, device=device) % 2 == 0)
    check("after a restore of some")
    simulator.step(control, 1)
    check("after a sub-step")


#: Parameters, and two values of each that are not the model's.
PARAMETERS = {
    "mocap_pos/hand": ([2.15, 0, 0.6], [2, 0.2, 0.45]),
    "body_mass/box": (0.5, 20.0),
    "body_pos/shelf": ([2, 0, 0.1], [2.6, 0, 0.3]),
    "body_quat/shelf": ([0.98, 0, 0.199, 0], [0.98, 0.199, 0, 0]),
    "geom_size/box": ([0.15, 0.15, 0.15], [0.05, 0.05, 0.3]),
    "geom_pos/box": ([0.05, 0, 0.05], [0, 0.02, -0.05]),
    "geom_friction/floor": ([1, 0.005, 0.0001], [0.7, 0.005, 0.0001]),
    "dof_damping/hinge": ([1.0], [0.01]),
    "actuator_gainprm/servo": ([1] + 9 * [0], [9] + 9 * [0]),
    "gravity": ([0, 0, -1], [3, 0, -9]),
    "active/shelf": (0, 1),
}


def plain(name: str, value: Tensor) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """A model with that parameter, by hand."""
    model = Arena().spec().compile()
    data = mujoco.MjData(model)
    field, _, item = name.partition("/")
    number = value.double().numpy()
    if field == "gravity":
        model.opt.gravity = number
    elif field == "mocap_pos":
        data.mocap_pos[model.body(item).mocapid[0]] = number
    elif field == "active":
        if not number:
            model.geom(item).contype = model.geom(item).conaffinity = 0
    else:
        kind, _, attribute = field.partition("_")
        named = getattr(model, "joint" if kind == "dof" else kind)(item)
        getattr(named, attribute)[:] = number
    mocap = data.mocap_pos.copy()
    mujoco.mj_setConst(model, data)
    data.mocap_pos = mocap
    return model, data


def check_parameters(
    build: Callable[[Context], Simulator], device: str, steps: int, atol: float
) -> None:
    """Worlds that each differ in one parameter move as plain MuJoCo does; the first is the model's."""
    cases = [(name, value) for name, values in PARAMETERS.items() for value in values]
    n = 1 + len(cases)
    simulator = build(arena(n, device, substeps=10))
    simulator.vary(tuple(PARAMETERS))
    values = {name: simulator.read(name).clone() for name in PARAMETERS}
    for name, value in values.items():
        assert value.shape == (n, *simulator.parameters[name])
    for world, (name, value) in enumerate(cases, 1):
        values[name][world] = torch.tensor(value, dtype=torch.float32)
    begin = {k: v[:1].repeat(n, 1) for k, v in states(1, device).items()}
    begin["qpos"][:, 2] = 0.35  # the box falls, however high it is
    begin["qvel"][:, 0] = 1.0  # and slides
    control = torch.full((n, 1), 0.3, device=device)
    simulator.set_state(everywhere(simulator), {**begin, **values})
    for _ in range(steps):
        simulator.step(control)
    found = {"model": simulator.read("qpos")[0].cpu()}
    for world, (name, value) in enumerate(cases, 1):
        qpos = simulator.read("qpos")[world].cpu()
        model, data = plain(name, torch.tensor(value, dtype=torch.float32))
        data.qpos, data.qvel = begin["qpos"][world].cpu(), begin["qvel"][world].cpu()
        data.ctrl = control[world].cpu()
        mujoco.mj_step(model, data, 10 * steps)
        error = (qpos - torch.from_numpy(data.qpos).float()).abs().max()
        assert error < atol, f"{name} = {value}: {error}"
        if name != "active/shelf" or not value:
            assert (qpos - found["model"]).abs().max() > 10 * atol, f"{name} changes nothing"
        found[f"{name} = {value}"] = qpos
    # a box that grew touches the floor at its new size: its bounds grew with it
    grown = found[f"geom_size/box = {PARAMETERS['geom_size/box'][0]}"]
    assert abs(float(grown[2]) - 0.15) < 0.02
    assert found["active/shelf = 0"][10] < 0.3 < found["active/shelf = 1"][10], "the ball fell"


#: What MuJoCo keeps in the model beside the parameters.
DERIVED = ("geom_rbound", "geom_aabb", "body_subtreemass", "dof_invweight0", "body_invweight0")


def check_derived(
    build: Callable[[Context], Simulator], field: Callable[[Simulator, str, int], np.ndarray]
) -> None:
    """For each parameter by itself, `field` of a world is what ``mj_setConst`` computes for it."""
    more = {
        "dof_armature/hinge": ([0.1], [1.0]), "body_inertia/box": ([1, 2, 2], [3, 3, 3]),
        # … of one that floats by itself
        "body_mass/ball": (0.5, 3.0), "body_inertia/ball": ([0.1, 0.2, 0.3], [1e-4, 2e-4, 1e-3]),
    }  # fmt: skip
    for name, values in {**PARAMETERS, **more}.items():
        simulator = build(arena(3))
        simulator.vary([name])
        default = simulator.read(name).clone()
        value = torch.tensor([default[0].tolist(), *values], dtype=torch.float32)
        simulator.set_state(everywhere(simulator), {**states(3), name: value})
        for world in range(3):
            model, _ = plain(name, value[world])
            for derived in DERIVED:
                exact = getattr(model, derived).ravel()
                found = field(simulator, derived, world).ravel()
                np.testing.assert_allclose(
                    found, exact, rtol=1e-4, atol=1e-5, err_msg=f"{derived} for {name}"
                )

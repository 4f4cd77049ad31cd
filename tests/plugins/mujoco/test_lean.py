"""What the CPU simulator leaves out changes nothing that is left."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
import pytest
import torch
from arena import arena

from understudy.task import Context
from understudy_humanoid.character import build_spec
from understudy_humanoid.jumper import build_jumper
from understudy_mujoco.lean import lean, read_no_clock
from understudy_mujoco.scene import MujocoScene
from understudy_mujoco.simulator import MujocoSimulator

CHAIR = """<mujoco><worldbody>
  <geom name="floor" type="plane" size="5 5 1"/><geom name="seat" type="box" size=".3 .3 .2" pos="0 0 .2"/>
  <body pos="0 0 1"><freejoint/><geom name="box" type="box" size=".1 .2 .1" mass="2"/></body>
  </worldbody></mujoco>"""
DAMPED = """<mujoco><option density="1.2" viscosity="1e-3"/><worldbody>
  <geom name="floor" type="plane" size="5 5 1" friction=".3"/>
  <body pos="0 0 .3"><freejoint/><geom name="rod" type="capsule" size=".05 .2" friction=".1 .02 .001"/>
    <body pos=".1 0 0"><joint type="hinge" stiffness="3" damping=".2" axis="0 1 0"/>
      <geom name="arm" type="capsule" fromto="0 0 0 .2 0 0" size=".03"/></body></body>
  </worldbody></mujoco>"""
RELATED = DAMPED.replace(
    'viscosity="1e-3"/>', 'viscosity="1e-3"><flag filterparent="disable"/></option>'
)
UNNAMED = DAMPED.replace('name="rod" ', "")
MIXED = DAMPED.replace('name="rod"', 'name="rod" solref=".01 1"')
PARTLY = DAMPED.replace('name="rod"', 'name="rod" margin=".01"')
APART = DAMPED.replace('<freejoint/><geom name="rod"', '<freejoint/><geom name="rod" contype="0"')


def whole_and_lean(make: Callable[[], mujoco.MjSpec]) -> tuple[mujoco.MjModel, mujoco.MjModel]:
    return make().compile(), lean(make())


def trajectory(model: mujoco.MjModel, seconds: float = 1.0) -> tuple[np.ndarray, int]:
    """The states of `seconds` of falling and of struggling, and how many contacts were made."""
    data, states, contacts = mujoco.MjData(model), [], 0
    chance = np.random.default_rng(0)
    for step in range(round(seconds / model.opt.timestep)):
        if model.nu and step % 20 == 0:
            data.ctrl[:] = chance.uniform(-1.0, 1.0, model.nu)
        mujoco.mj_step(model, data)
        contacts += data.ncon
        states.append(np.concatenate([data.qpos, data.qvel]))
    return np.array(states), contacts


def spec_of(text: str) -> Callable[[], mujoco.MjSpec]:
    return lambda: mujoco.MjSpec.from_string(text)


def of_arena() -> mujoco.MjSpec:
    scene = arena(1).scene
    assert isinstance(scene, MujocoScene)
    return scene.spec()


def self_colliding() -> mujoco.MjSpec:
    return build_spec(self_collision=True)


@pytest.mark.parametrize(
    ("make", "pairs"),
    [
        (build_spec, 15),
        (build_jumper, 15),
        (self_colliding, 0),
        (spec_of(CHAIR), 0),
        (spec_of(DAMPED), 2),
        (spec_of(RELATED), 0),
        (spec_of(UNNAMED), 0),
        (spec_of(MIXED), 0),
        (spec_of(PARTLY), 0),
        (spec_of(APART), 2),
        (of_arena, 0),
    ],
)
def test_every_bit_of_the_motion_stays(make: Callable[[], mujoco.MjSpec], pairs: int) -> None:
    whole, without = whole_and_lean(make)
    assert without.npair == pairs
    (expected, touched), (found, touches) = trajectory(whole), trajectory(without)
    assert touched == touches > 0, "a motion without contacts would show nothing"
    np.testing.assert_array_equal(found, expected)


def test_passive_forces_and_islands_stay_where_there_are_any() -> None:
    spring, island = mujoco.mjtDisableBit.mjDSBL_SPRING, mujoco.mjtDisableBit.mjDSBL_ISLAND
    flags = {
        name: lean(make()).opt.disableflags
        for name, make in {"humanoid": build_spec, "damped": spec_of(DAMPED)}.items()
    }
    assert flags["humanoid"] & int(spring)
    assert not flags["damped"] & int(spring)
    two = CHAIR.replace("</worldbody>", '<body><freejoint/><geom size=".1"/></body></worldbody>')
    assert flags["humanoid"] & int(island)
    assert not lean(mujoco.MjSpec.from_string(two)).opt.disableflags & int(island)


class Scene(MujocoScene):
    def spec(self) -> mujoco.MjSpec:
        return mujoco.MjSpec.from_string(
            DAMPED.replace('<body pos="0 0 .3">', '<body name="rod" pos="0 0 .3">')
        )


@pytest.mark.parametrize(
    ("name", "value"), [("active/rod", 0.0), ("geom_friction/rod", 2.0), ("dof_damping", 0.0)]
)
def test_what_worlds_differ_in_is_not_left_out(name: str, value: float) -> None:
    context = Context(0, torch.device("cpu"), 2, control_dt=0.02, substeps=10)
    context.scene = Scene()
    simulator = MujocoSimulator(MujocoSimulator.Options(threads=1), context)
    assert simulator.model.npair == 2
    simulator.vary([name])
    assert simulator.model.npair == 0
    start = simulator.read(name).clone()
    start[1] = value
    state = {"qpos": simulator.read("qpos").clone(), "qvel": simulator.read("qvel").clone() + 0.5}
    simulator.set_state(torch.ones(2, dtype=torch.bool), {**state, name: start})
    for _ in range(50):
        simulator.step(torch.zeros(2, 0))
    ends = simulator.read("qpos")
    assert torch.isfinite(ends).all()
    assert (ends[0] - ends[1]).abs().max() > 1e-3, f"{name} does nothing"
    if name == "active/rod":
        assert ends[0, 2] > 0.0 > ends[1, 2], "one lies on the floor, the other has fallen through"


def test_the_clock_is_not_read() -> None:
    read_no_clock()
    model = mujoco.MjModel.from_xml_string(CHAIR)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 10)
    assert not data.timer.duration.any()

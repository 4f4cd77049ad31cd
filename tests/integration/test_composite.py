"""Several simulators as one: each is what it would be alone, and what leads it is where it should be."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
import yaml

from understudy.errors import ConfigError
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import installed
from understudy.task import Context, Scene
from understudy.testing import FakeScene, check_simulator
from understudy_amorphous.character import TOOL, build_cook
from understudy_characters.scene import CharacterScene
from understudy_cloth.scene import Capsule, ClothModel, ClothScene
from understudy_cloth.scene import Tool as ClothTool
from understudy_cloth.simulator import ClothSimulator
from understudy_composite.couplings import ToolsFollow
from understudy_composite.scene import CompositeScene
from understudy_composite.simulator import CompositeSimulator
from understudy_mujoco.scene import MujocoScene
from understudy_mujoco.simulator import MujocoSimulator
from understudy_pbd.scene import Box, ParticleModel, ParticleScene, Table, Tool
from understudy_pbd.simulator import ParticleSimulator

N, PERIOD = 3, 1 / 60
REGISTRY = installed().registry


class Cook(MujocoScene):
    """The figure that holds amorphous' scraper, its arm moved by motors."""

    def spec(self) -> mujoco.MjSpec:
        spec = build_cook()
        spec.option.gravity = [0, 0, 0]
        hand = next(s for s in spec.sites if s.name == "right_grip")
        tool = hand.parent.add_body(name=TOOL, pos=[0, 0, -0.1])
        tool.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.01, 0.05, 0.03], mass=0.2,
                      contype=0, conaffinity=0)  # fmt: skip
        for joint in ("right_shoulder_raise", "right_elbow_bend"):
            motor = spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            motor.gainprm[0] = 5.0
        return spec


class Grains(ParticleScene):
    def model(self) -> ParticleModel:
        x = np.stack(np.meshgrid(*[0.02 * np.arange(3)] * 3, indexing="ij"), -1).reshape(-1, 3)
        blade = Tool((Box((0.01, 0.05, 0.03)),), (0.2, 0.0, 0.9))
        return ParticleModel(
            x + np.array([0.3, -0.2, 0.8]), 0.01, 0.01, tools=(blade,), table=Table()
        )


class Towel(ClothScene):
    def model(self) -> ClothModel:
        x = np.array([[0.05 * i + 0.2, 0.05 * j - 0.3, 0.9] for j in range(5) for i in range(5)])
        faces = [
            f for j in range(4) for i in range(4) for p in (5 * j + i,)
            for f in ((p, p + 1, p + 6), (p, p + 6, p + 5))
        ]  # fmt: skip
        hand = ClothTool((Capsule(0.04, 0.05),), (0.2, 0.0, 0.9), friction=0.5)
        return ClothModel(x, np.array(faces), pinned=(0, 4), tools=(hand,))


def chosen(**parts: tuple[Any, Any]) -> tuple[Any, ...]:
    return tuple(
        SimpleNamespace(name=name, where=name, options=options,
                        build=lambda *a, make=make, options=options: make(options, *a))
        for name, (make, options) in parts.items()
    )  # fmt: skip


SIMULATORS: Mapping[type[Scene], tuple[Any, Any]] = {
    Cook: (MujocoSimulator, MujocoSimulator.Options(threads=1)),
    Grains: (ParticleSimulator, ParticleSimulator.Options()),
    Towel: (ClothSimulator, ClothSimulator.Options()),
}
FOLLOW = ToolsFollow.Options("cook", "other", (TOOL,))


def context(
    *, substeps: int = 2, steps: Any = None, follow: Any = FOLLOW, **members: Any
) -> Context:
    made = Context(
        seed=0, device=torch.device("cpu"), num_worlds=N, control_dt=PERIOD, substeps=substeps,
        registry=REGISTRY,
        chosen={
            "scenes": chosen(**{k: (lambda o, c, s=s: s(), None) for k, s in members.items()}),
            "simulators": chosen(**{k: SIMULATORS[s] for k, s in members.items()}),
            "couplings": chosen(**({"hand": (ToolsFollow, follow)} if follow else {})),
        },
    )  # fmt: skip
    made.scene = CompositeScene(CompositeScene.Options(steps or {}), made)
    return made


def composite(**given: Any) -> CompositeSimulator:
    return CompositeSimulator(None, context(**given))


def alone(scene: Scene, dt: float, substeps: int) -> Any:
    make, options = SIMULATORS[type(scene)]
    return make(options, Context(
        seed=0, device=torch.device("cpu"), num_worlds=N, control_dt=dt, substeps=substeps, scene=scene,
    ))  # fmt: skip


def test_it_says_what_each_of_its_members_is() -> None:
    found = context(cook=Cook, other=Towel).scene
    assert found is not None
    assert found.identity() == {**Cook().identity(), **Towel().identity()}
    assert found.identity().keys() == {"qpos", "cloth_position"}


@pytest.mark.parametrize("other", [Grains, Towel])
def test_conforms(other: type[Scene]) -> None:
    found = composite(cook=Cook, other=other, steps={"cook": 2, "other": 3})
    assert "gravity" not in found.parameters, "of which member would it be?"
    check_simulator(found, N, ["cook/gravity", "other/gravity"])


@pytest.mark.parametrize("other", [Grains, Towel])
def test_it_is_what_its_members_are_alone(other: type[Scene]) -> None:
    """The cook moves as without anything around, and the other as if its tool were told where the cook's
    hand is: bit for bit."""
    steps, rounds = {"cook": 2, "other": 3}, 2
    both = composite(cook=Cook, other=other, steps=steps)
    cook = alone(Cook(), PERIOD / rounds, steps["cook"])
    single = alone(other(), PERIOD / rounds, steps["other"])
    body = mujoco.mj_name2id(cook.model, mujoco.mjtObj.mjOBJ_BODY, TOOL)
    everywhere = torch.ones(N, dtype=torch.bool)
    qpos = cook.read("qpos").clone()
    qpos[:, -6:] += 0.1 * torch.arange(N)[:, None]
    begin = {"qpos": qpos, "qvel": 0 * cook.read("qvel")}
    cook.set_state(everywhere, begin)
    start = {name: single.read(name).clone() for name in single.state_fields}
    both.set_state(everywhere, {**start, **begin})
    at, turn = cook.read("xpos")[:, body], cook.read("xquat")[:, body]
    single.set_state(everywhere, {**start, "tool_position": at, "tool_orientation": turn})
    actions = torch.randn(20, N, 2, generator=torch.Generator().manual_seed(0))
    for action in actions:
        both.step(action)
        for _ in range(rounds):
            cook.step(action)
            pose = ToolsFollow.control(
                both._couplings["other"][0], cook.read("xpos"), cook.read("xquat")
            )
            single.step(pose)
        for name in cook.fields:
            assert torch.equal(both.read(name), cook.read(name)), name
        for name in single.fields:
            assert torch.equal(both.read(name), single.read(name)), name
    moved = (single.read("tool_position") - at).norm(dim=1)
    assert moved.min() > 0.02, "the hand has hardly moved"
    assert torch.allclose(both.read("tool_position"), both.read("xpos")[:, body], atol=1e-6)


def test_worlds_that_begin_again_take_their_tool_along() -> None:
    found = composite(cook=Cook, other=Towel)
    begin = {name: found.read(name).clone() for name in found.state_fields}
    assert "tool_position" not in begin, "it follows from the cook"
    begin["qpos"][:, :2] += 0.5  # to another place in the room
    found.step(torch.ones(N, 2))
    worlds = torch.tensor([True, False, True])
    before = found.read("tool_position").clone()
    found.set_state(worlds, begin)
    body = mujoco.mj_name2id(found._members["cook"].model, mujoco.mjtObj.mjOBJ_BODY, TOOL)  # type: ignore[attr-defined]
    after, hand = found.read("tool_position"), found.read("xpos")[:, body]
    assert torch.allclose(after[worlds], hand[worlds], atol=1e-7)
    assert torch.equal(after[1], before[1])
    assert found.read("tool_velocity")[0].abs().max() == 0, "it did not fly there"


@pytest.mark.parametrize("member", ["cook", "other"])
@pytest.mark.parametrize("value", [math.nan, math.inf, 1e12])
def test_a_member_that_went_wrong_is_the_whole(member: str, value: float) -> None:
    """In that world alone, and until its state is set."""
    found = composite(cook=Cook, other=Towel)
    begin = {name: found.read(name).clone() for name in found.state_fields}
    name = {"cook": "qvel", "other": "cloth_position"}[member]
    bad = {k: v.clone() for k, v in begin.items()}
    bad[name][1] = value
    found.set_state(torch.ones(N, dtype=torch.bool), bad)
    found.step(torch.zeros(N, 2))
    assert found.failed().tolist() == [False, True, False]
    again = torch.tensor([False, True, False])
    found.set_state(again, begin)
    found.step(torch.zeros(N, 2))
    assert not found.failed().any()
    assert all(
        torch.isfinite(found.read(f)).all() for f in ("qpos", "cloth_position", "tool_position")
    )


def test_worlds_may_differ_in_what_several_members_have() -> None:
    found = composite(cook=Cook, other=Towel)
    with pytest.raises(ConfigError, match=r"no parameter 'gravity'.*other/gravity"):
        found.vary(["gravity"])
    found.vary(["other/gravity"])
    begin = {name: found.read(name).clone() for name in found.state_fields}
    gravity = found.read("other/gravity").clone()
    assert gravity[0, 2] == pytest.approx(-9.81)
    gravity[1] = 0.0
    found.set_state(torch.ones(N, dtype=torch.bool), {**begin, "other/gravity": gravity})
    for _ in range(10):
        found.step(torch.zeros(N, 2))
    fallen = (found.read("cloth_position") - begin["cloth_position"])[..., 2].amin(dim=1)
    assert fallen[0] < -0.02
    assert fallen[1] > -1e-4


def test_a_part_finds_the_member_that_it_needs() -> None:
    here = context(cook=Cook, other=Towel)
    assert here.scene is not None
    assert here.need_scene(Towel, "it") is here.scene.members["other"]
    assert here.need_scene(MujocoScene, "it") is here.scene.members["cook"]
    with pytest.raises(ConfigError, match="needs a scene of type FakeScene"):
        here.need_scene(FakeScene, "it")
    twice = context(cook=Cook, other=Cook, follow=None)
    with pytest.raises(
        ConfigError, match=r"needs one scene of type MujocoScene, but .* Cook, Cook"
    ):
        twice.need_scene(MujocoScene, "it")


def test_a_characters_parts_work_on_a_member() -> None:
    """`characters` knows nothing of composites."""
    from understudy_characters.parts import JointTargets, Kinematics

    made = {"scenes": chosen(
        figure=(CharacterScene, CharacterScene.Options("humanoid")), other=(lambda o, c: Towel(), None)
    )}  # fmt: skip
    here = Context(
        seed=0, device=torch.device("cpu"), num_worlds=N, control_dt=1 / 30, substeps=10,
        registry=REGISTRY, chosen=made,
    )  # fmt: skip
    here.scene = CompositeScene(CompositeScene.Options({"figure": 2}), here)
    member = here.scene.members["figure"]
    assert isinstance(member, CharacterScene)
    assert member.spec().option.timestep == pytest.approx(1 / 600)
    assert "qpos" in Kinematics(None, here).reads
    assert JointTargets(None, here).action_space.size == member.model.nu


def refused(message: str, **given: Any) -> None:
    with pytest.raises(ConfigError, match=message):
        composite(**given)


def test_what_does_not_go_together_is_refused() -> None:
    refused("both have a field 'qpos'", cook=Cook, other=Cook, follow=None)
    refused(r"has no body 'tol'.*'tool'", cook=Cook, other=Towel,
            follow=ToolsFollow.Options("cook", "other", ("tol",)))  # fmt: skip
    refused("names 2 bodies, and member 'other' has 1", cook=Cook, other=Towel,
            follow=ToolsFollow.Options("cook", "other", (TOOL, "root")))  # fmt: skip
    refused("source: there is no member 'cock'", cook=Cook, other=Towel,
            follow=ToolsFollow.Options("cock", "other", (TOOL,)))  # fmt: skip
    refused("moves on after", other=Towel, cook=Cook)
    refused("takes bodies of a MuJoCo scene", towel=Towel, other=Grains,
            follow=ToolsFollow.Options("towel", "other", (TOOL,)))  # fmt: skip
    with pytest.raises(ConfigError, match="has no member 'cook2'"):
        context(cook=Cook, other=Towel, steps={"cook2": 2})
    with pytest.raises(ValueError, match=r"steps\.a=0 is not possible"):
        CompositeScene.Options({"a": 0})
    lacking = context(cook=Cook, other=Towel)
    lacking.chosen = {**lacking.chosen, "simulators": lacking.chosen["simulators"][:1]}
    with pytest.raises(ConfigError, match="name one for each"):
        CompositeSimulator(None, lacking)


def test_a_composite_within_itself_is_refused() -> None:
    words = ("scene={name: composite}", "simulator={name: composite}")
    inner = ("scenes={inner: {name: composite}}", "simulators={inner: {name: composite}}")
    experiment = load_experiment(["experiment=miniature/go", *words, *inner])
    with pytest.raises(ConfigError, match=r"scenes\.inner is a composite within the composite"):
        build_environment(experiment)


def test_the_example_of_the_page_is_built() -> None:
    pytest.importorskip("potpourri3d", reason="potpourri3d is not installed")
    page = Path(__file__).parents[2] / "plugins" / "physics" / "composite" / "README.md"
    (example,) = re.findall(r"```yaml\n(.*?)```", page.read_text(), re.DOTALL)
    words = [f"{slot}={json.dumps(what).replace(chr(34), '')}" for slot, what in yaml.safe_load(example).items()]  # fmt: skip
    task = ["experiment=dressing/sleeve_small", "num_worlds=1"]
    built = build_environment(load_experiment([*task, *words]))
    assert built.context.scene is not None
    assert set(built.context.scene.members) == set(yaml.safe_load(example)["scenes"])
    built.environment.close()

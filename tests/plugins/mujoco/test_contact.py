"""Contact settings: any MuJoCo scene takes them, both simulators obey them, what cannot be is refused."""

from __future__ import annotations

from pathlib import Path

import mujoco
import pytest
import torch

from understudy.errors import ConfigError
from understudy.options import make_options
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import Plugins
from understudy.task import Context
from understudy_mujoco.contact import Contact
from understudy_mujoco.scene import MjcfFile, MujocoScene
from understudy_mujoco.simulator import MujocoSimulator

#: A block on a plane that leans by 0.5 rad, less than the friction's angle of 0.785.
SLOPE = """<mujoco><option integrator="implicitfast" noslip_iterations="{noslip}"/><worldbody>
  <geom type="plane" size="5 5 1" euler="0 28.6479 0"/>
  <body pos="0.0479 0 0.0878" euler="0 28.6479 0"><freejoint/>
    <geom type="box" size=".1 .1 .1" mass="2"/></body>
  <body pos="9 0 9"><joint type="slide"/><geom size=".1" contype="0" conaffinity="0"/></body>
</worldbody></mujoco>"""
HARD = Contact("discrete", "elliptic", 100.0, 20, 20, 0, 1e-9, (0.01, 1.0), (0.99, 0.99, 0.01))


def scene(folder: Path, contact: Contact, noslip: int = 0) -> MjcfFile:
    file = folder / "slope.xml"
    file.write_text(SLOPE.format(noslip=noslip), encoding="utf-8")
    return MjcfFile(MjcfFile.Options(str(file), contact))


def context_of(scene: MujocoScene) -> Context:
    context = Context(0, torch.device("cpu"), 1, control_dt=0.01, substeps=2)
    context.scene = scene
    return context


def check_hard(model: mujoco.MjModel) -> None:
    option = model.opt
    assert option.integrator == mujoco.mjtIntegrator.mjINT_DISCRETE
    assert option.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    assert (option.impratio, option.iterations, option.ls_iterations) == (100.0, 20, 20)
    assert (option.noslip_iterations, option.tolerance) == (0, 1e-9)
    colliding = (model.geom_contype | model.geom_conaffinity) != 0
    assert colliding.any()
    assert (model.geom_solref[colliding] == [0.01, 1.0]).all()
    assert (model.geom_solimp[colliding, :3] == [0.99, 0.99, 0.01]).all()


def test_a_scene_from_a_file_has_them(tmp_path: Path) -> None:
    made = scene(tmp_path, HARD)
    model = made.compiled(context_of(made))
    check_hard(model)
    assert model.geom_solref[2].tolist() == [0.02, 1.0]  # touches nothing


def test_without_any_everything_stays(tmp_path: Path) -> None:
    made = scene(tmp_path, Contact(), noslip=3)
    model, plain = made.compiled(context_of(made)), made.spec().compile()
    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    assert model.opt.noslip_iterations == 3
    assert (model.geom_solimp == plain.geom_solimp).all()


def test_a_character_has_them_by_the_command_line(plugins: Plugins) -> None:
    words = [
        f"scene.contact.{word}"
        for word in (
            "integrator=discrete", "cone=elliptic", "impratio=100", "iterations=20", "ls_iterations=20",
            "noslip_iterations=0", "tolerance=1e-9", "solref=[0.01, 1]", "solimp=[0.99, 0.99, 0.01]",
        )
    ]  # fmt: skip
    experiment = load_experiment(["experiment=spacetime/walk", "num_worlds=1", *words], plugins)
    built = build_environment(experiment)
    try:
        simulator = built.context.simulator
        assert isinstance(simulator, MujocoSimulator)
        option = simulator.model.opt
        assert option.integrator == mujoco.mjtIntegrator.mjINT_DISCRETE
        assert (option.cone, option.impratio) == (mujoco.mjtCone.mjCONE_ELLIPTIC, 100.0)
    finally:
        built.environment.close()


def slid(model: mujoco.MjModel, seconds: float = 1.0) -> float:
    data = mujoco.MjData(model)
    while data.time < 0.1:
        mujoco.mj_step(model, data)
    before = data.xpos[1].copy()
    while data.time < 0.1 + seconds:
        mujoco.mj_step(model, data)
    return float(((data.xpos[1] - before) ** 2).sum() ** 0.5)


def test_the_engine_obeys(tmp_path: Path) -> None:
    """On a slope a block creeps less with a harder friction."""
    far, near = (
        slid((made := scene(tmp_path, Contact(cone="elliptic", impratio=ratio))).compiled(context_of(made)))
        for ratio in (1.0, 100.0)
    )  # fmt: skip
    assert near < 0.1 * far


def test_the_gpu_simulator_has_the_same(tmp_path: Path) -> None:
    pytest.importorskip("mujoco_warp._src", reason="MuJoCo Warp is not installed")
    from understudy_mujoco_warp.simulator import MujocoWarpSimulator

    simulator = MujocoWarpSimulator(
        MujocoWarpSimulator.Options(), context_of(scene(tmp_path, HARD))
    )
    check_hard(simulator.model)
    ours = simulator._m.opt
    assert int(ours.integrator) == int(mujoco.mjtIntegrator.mjINT_DISCRETE)
    assert int(ours.cone) == int(mujoco.mjtCone.mjCONE_ELLIPTIC)
    assert (int(ours.iterations), int(ours.ls_iterations)) == (20, 20)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"integrator": "discrete", "noslip_iterations": 5}, "noslip_iterations=5 is not possible"),
        ({"impratio": 0.0}, "impratio=0.0 is not possible"),
        ({"iterations": 0}, "iterations=0 is not possible"),
        ({"solimp": (0.99, 0.9, 0.01)}, "the lower first"),
        ({"solref": (20.0, 1.0)}, "sink in for 20 s; .* If these are ms, give 0.02"),
        ({"solimp": (0.9, 0.95, 1.0)}, "in metres, at most 0.5. If it is in mm, give 0.001"),
        ({"solref": (-1000.0, -10.0)}, "both must be positive"),
        ({"integrator": "verlet"}, "scene.contact.integrator='verlet' is not possible"),
    ],
)
def test_what_cannot_be_is_refused(given: dict[str, object], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        make_options(Contact, given, "scene.contact")


def test_a_scene_with_noslip_takes_no_discrete_integrator(tmp_path: Path) -> None:
    made = scene(tmp_path, Contact(integrator="discrete"), noslip=4)
    with pytest.raises(
        ConfigError, match=r"noslip_iterations=4 is not possible with the integrator"
    ):
        made.compiled(context_of(made))

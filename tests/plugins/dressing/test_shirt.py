"""The shirt on the person, and the subtasks of putting it on."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch
from torch import Tensor

from understudy.command.cli import main
from understudy.errors import ConfigError
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import installed
from understudy_cloth.mesh import face_areas
from understudy_dressing.body import TIP, Side, limb
from understudy_dressing.initial_states import WornShirt
from understudy_dressing.person import PersonScene, depth_in, neutral_pose
from understudy_dressing.shirt import ShirtScene
from understudy_dressing.shirt_state import under_hem
from understudy_dressing.state import (
    centre_and_normal,
    in_world,
    passes,
    pierces,
    places_on,
    progress,
)
from understudy_dressing.waypoints import IN_SLEEVE
from understudy_reproduce.tables import load_table
from understudy_sequencing.algorithm import Algorithm1, stages_of
from understudy_sweeps.chain import Chain
from understudy_tensors import rotations

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "benchmarks"))

import by_hand

pytest.importorskip("potpourri3d", reason="potpourri3d is not installed")
MODEL = PersonScene(PersonScene.Options()).spec().compile()
SHIRT = ShirtScene(ShirtScene.Options(edge=0.032, substeps=5))
#: As `_shirt` is, on a CPU, and no first episode is cut.
SMALL = ["device=cpu", "curriculum=null", "simulators.person.name=mujoco", "scenes.cloth.edge=0.032", "scenes.cloth.substeps=5",
         "num_worlds=2", "scene.steps.cloth=5", "simulators.cloth.self_contact=false"]  # fmt: skip
STAGES = ("grip", "tuck", "sleeve", "regrip", "tuck_second", "sleeve_second", "finish")


@pytest.fixture(scope="module")
def on_shoulders() -> tuple[np.ndarray, np.ndarray]:
    return SHIRT.settled("on_shoulders", "left")


@pytest.fixture(scope="module")
def held() -> tuple[np.ndarray, np.ndarray]:
    return SHIRT.settled("held", "left")


@pytest.fixture(scope="module")
def tucked() -> tuple[np.ndarray, np.ndarray]:
    return SHIRT.settled("tucked", "left")


@pytest.fixture(scope="module")
def bank(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("shirt") / "starts"
    given = [
        "experiment=dressing/shirt_grip",
        *SMALL,
        "job=settle",
        "job.count=2",
        "job.seconds=0.04",
    ]
    assert main(["train", *given, f"run.dir={folder}"]) == 0
    return folder


def test_sleeves_turn_outwards_and_the_collar_up() -> None:
    x = torch.tensor(SHIRT.begins)[None]
    for side, sign in (("left", 1.0), ("right", -1.0)):
        loops = SHIRT.sleeve(side)  # type: ignore[arg-type]
        places = [centre_and_normal(x[:, loop]) for loop in loops.values()]
        assert all(sign * float(normal[0, 1]) > 0.5 for _, normal in places)
        out = [sign * float(centre[0, 1]) for centre, _ in places]
        assert out == sorted(out), "entrance, middle, end"
    assert centre_and_normal(x[:, SHIRT.collar])[1][0, 2] > 0.5


def test_it_hangs_on_the_shoulders_around_the_neck(
    on_shoulders: tuple[np.ndarray, np.ndarray],
) -> None:
    pose, x = on_shoulders
    person = PersonScene(PersonScene.Options())
    assert pose == pytest.approx(neutral_pose(person).numpy())
    assert depth_in(person, pose)(x).max() < 0.0, "no cloth in the person"
    neck = torch.tensor([[[0, 0, 0.4], [0, 0, 0.0], [0, 0, -0.2]]], dtype=torch.float64)
    assert passes(neck, torch.tensor(x)[None, SHIRT.collar])[0].any()
    assert -0.75 < x[:, 2].min() < -0.5, "it reaches to the hips"
    area = face_areas(x[SHIRT.faces]) / face_areas(SHIRT.corners)
    assert area.max() < 1.5


def test_the_right_hand_holds_the_hem_in_front(
    on_shoulders: tuple[np.ndarray, np.ndarray], held: tuple[np.ndarray, np.ndarray]
) -> None:
    patch = SHIRT.garment.patches["right_hem"]
    before, after = (one[1][patch].mean(axis=0) for one in (on_shoulders, held))
    assert after[0] > before[0] + 0.1
    assert after[2] > before[2] + 0.1
    person = PersonScene(PersonScene.Options())
    moved = np.abs(held[0] - neutral_pose(person).numpy()) > 1e-6
    assert {
        hinge.name.partition("_")[0] for hinge, m in zip(person.hinges, moved, strict=True) if m
    } == {"right"}
    assert depth_in(person, held[0])(held[1]).max() < 0.0


def links_apart(pose: np.ndarray) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The person in `pose`, in which no link is in another."""
    model = PersonScene(PersonScene.Options(self_collision=True)).spec().compile()
    data = mujoco.MjData(model)
    data.qpos[: len(pose)] = pose
    mujoco.mj_forward(model, data)
    assert all(contact.dist > -1e-3 for contact in data.contact)
    return model, data


@pytest.mark.parametrize("worn", ["held", "tucked"])
def test_starts_of_ours_are_not_torn(worn: str, request: pytest.FixtureRequest) -> None:
    """The links keep apart, so that the first step throws none of them out, and the shirt stays as it is while no torque
    acts. They once began 6 cm in each other, and the area ratio came to 11."""
    pose, x = request.getfixturevalue(worn)
    assert (face_areas(x[SHIRT.faces]) / face_areas(SHIRT.corners)).max() < 1.6
    links_apart(pose)
    task = {"held": "shirt_tuck", "tucked": "shirt_sleeve"}[worn]
    environment = build_environment(
        load_experiment([f"experiment=dressing/{task}", *SMALL])
    ).environment
    environment.reset(seed=1)
    for _ in range(15):
        environment.step(torch.zeros(2, environment.action_size))
        assert (environment.table["area_ratio"] < 1.8).all()
    environment.close()


@pytest.mark.parametrize(("side", "bent"), [("left", 0), ("left", 2), ("right", 1)])
def test_a_hand_begins_in_the_mouth_of_its_sleeve(side: Side, bent: int) -> None:
    """A start of ours, easier than the ends of the second subtask; either arm's poses are the other's mirror image."""
    pose, x = SHIRT.settled("in_sleeve", side, IN_SLEEVE[bent])
    assert (face_areas(x[SHIRT.faces]) / face_areas(SHIRT.corners)).max() < 2.0
    _, data = links_apart(pose)
    at = torch.tensor(data.xpos[None]).float(), torch.tensor(data.xquat[None]).float()
    share = _in_sleeve(side, *at, torch.tensor(x)[None].float())
    assert 0.1 < float(share) < 0.35


def _in_sleeve(side: Side, xpos: Tensor, xquat: Tensor, cloth: Tensor) -> Tensor:
    """(N,) which share of that arm is in its sleeve, where it goes through no cloth."""
    bones = in_world(places_on(MODEL, limb(side), torch.device("cpu")), xpos, xquat)
    assert not pierces(bones, cloth[:, torch.tensor(SHIRT.faces)]).any()
    entrance = torch.tensor(SHIRT.sleeve(side)["entrance"].copy())
    contained, share = progress(bones, cloth[:, entrance])
    return torch.where(contained, share, 0.0)


@pytest.mark.parametrize(
    ("stage", "dressed", "bare"),
    [
        ("regrip", ["left"], ["right"]),
        ("tuck_second", ["left"], ["right"]),
        ("sleeve_second", ["left"], ["right"]),
        ("finish", ["left", "right"], []),
    ],
)
def test_later_subtasks_have_starts_of_their_own(
    stage: str, dressed: list[Side], bare: list[Side]
) -> None:
    """Narrow ones, as Algorithm 1's first pass needs: ours, since nobody published the paper's. Nothing is torn, nothing is
    done yet, and both stay so while no torque acts."""
    environment = build_environment(
        load_experiment([f"experiment=dressing/shirt_{stage}", *SMALL])
    ).environment
    environment.reset(seed=1)
    table = environment.table
    criterion = {"regrip": "gripped", "tuck_second": "tucked", "sleeve_second": "dressed", "finish": "rested"}[stage]  # fmt: skip
    for _ in range(15):
        at = table["xpos"], table["xquat"], table["cloth_position"]
        assert all((_in_sleeve(side, *at) > 0.6).all() for side in dressed)
        assert all((_in_sleeve(side, *at) == 0).all() for side in bare)
        assert (table["area_ratio"] < 1.8).all()
        assert not table["collar_lost"].any()
        assert not table[criterion].any()
        environment.step(torch.zeros(2, environment.action_size))
    environment.close()


def test_the_second_arm_begins_raised() -> None:
    """Under the hem, its hand before the chin, as led arms begin; through no cloth, the first arm in its sleeve."""
    words = ["experiment=dressing/shirt_sleeve_second", "initial_states.worn=raised", *SMALL]
    words += ["scenes.cloth.substeps=10"]  # with fewer the arm goes through the front
    environment = build_environment(load_experiment(words)).environment
    environment.reset(seed=1)
    table = environment.table
    at = table["xpos"], table["xquat"], table["cloth_position"]
    assert (_in_sleeve("left", *at) > 0.6).all()
    assert (_in_sleeve("right", *at) == 0).all()
    hand = in_world(places_on(MODEL, limb("right"), torch.device("cpu")), *at[:2])[:, 0]
    assert (hand[:, 0] > 0.2).all()
    assert (hand[:, 2] > 0.0).all(), "above the base of the neck"
    assert not table["pierced"].any()
    assert not table["collar_lost"].any()
    environment.close()


def test_no_bare_arm_begins_raised() -> None:
    with pytest.raises(ConfigError, match="worn=raised needs other_dressed=true"):
        load_experiment(["experiment=dressing/shirt_sleeve", "initial_states.worn=raised"])


def test_starts_are_drawn_among_hands_in_the_sleeve() -> None:
    environment = build_environment(
        load_experiment(
            ["experiment=dressing/shirt_sleeve", *SMALL, "num_worlds=24", "initial_states.worn=in_sleeve"]
        )
    ).environment  # fmt: skip
    environment.reset(seed=1)
    elbows = environment.table["qpos"][:, 11]
    assert elbows.max() - elbows.min() > 0.1  # of three arms, beside a noise of 0.01
    assert (environment.table["progress"] > 0.1).all()
    environment.close()


@pytest.mark.slow
def test_a_written_controller_gets_the_arm_into_the_sleeve_from_its_mouth() -> None:
    """The third subtask can be done from there with half of the torques, and no bone goes through the cloth."""
    met, _, _ = by_hand.sleeved([*SMALL, "scene.steps.cloth=10"], decisions=45)
    assert met.isfinite().all()


def test_a_share_of_the_torques_is_what_actions_ask_for() -> None:
    controls = []
    for most in (1.0, 0.5):
        built = build_environment(
            load_experiment(["experiment=dressing/shirt_grip", *SMALL, f"actuation.most={most}"])
        )
        controls.append(built.environment.parts.actuation.part.control(torch.full((2, 22), 2.0)))
        built.environment.close()
    assert controls[0][:, :22].tolist() == [[1.0] * 22] * 2
    assert controls[1][:, :22].tolist() == [[0.5] * 22] * 2
    assert torch.equal(controls[0][:, 22:], controls[1][:, 22:])


def test_a_written_controller_gets_the_arm_under_the_hem(
    held: tuple[np.ndarray, np.ndarray],
) -> None:
    """The second subtask can be done from our start, with half of the torques and nothing torn until it is."""
    met, torn, _ = by_hand.tucked(SHIRT, held[0], [*SMALL, "scene.steps.cloth=7"])
    assert met.isfinite().all()
    assert (torn < 2.0).all()


@pytest.mark.parametrize("stage", STAGES)
def test_a_stage_steps_from_a_bank(stage: str, bank: Path) -> None:
    given = ["initial_states=bank", f"initial_states.file={bank}"]
    built = build_environment(
        load_experiment([f"experiment=dressing/shirt_{stage}", *SMALL, *given])
    )
    environment = built.environment
    try:
        environment.reset(seed=1)
        for _ in range(2):
            step = environment.advance(torch.zeros(2, environment.action_size))
            assert torch.isfinite(step.rewards).all()
            assert not step.ended.any()
        table = environment.table
        assert (table["collar_lost"] == 0).all()
        grips = [stage in ("tuck", "sleeve", "regrip"), stage in ("tuck_second", "sleeve_second")]
        assert table["grip_closed"].tolist() == [[float(g) for g in grips]] * 2
        assert torch.isfinite(table["cloth_position"]).all()
    finally:
        environment.close()


def test_the_hand_that_is_at_the_hem_has_gripped(held: tuple[np.ndarray, np.ndarray]) -> None:
    built = build_environment(
        load_experiment(["experiment=dressing/shirt_tuck", *SMALL, "fields.shirt.near=0.09"])
    )
    built.environment.reset(seed=1)
    table = built.environment.table
    assert (table["gripped"] == 1).all()
    assert (table["grip_distance"] < 0.09).all()
    assert (table["tucked"] == 0).all()
    assert (table["tuck"] < 0).all(), "the left arm hangs"
    names = [mujoco.mj_id2name(MODEL, mujoco.mjtObj.mjOBJ_BODY, i) for i in range(MODEL.nbody)]
    hand, torso = names.index("left_hand"), names.index("torso")
    tip = rotations.rotate(table["xquat"][:, hand], torch.tensor(TIP).expand(2, -1))
    from_torso = table["xpos"][:, hand] + tip - table["xpos"][:, torso]
    before = rotations.inverse_rotate(table["xquat"][:, torso], from_torso)[:, 0]
    assert torch.allclose(table["behind"], (-before).clamp(min=0.0), atol=1e-5)
    built.environment.close()


@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize("touched", [True, False])
@pytest.mark.parametrize("needed", [True, False])
def test_an_arm_is_under_the_hem(way: float, touched: bool, needed: bool) -> None:
    """Equation 19 as the 2018 code has it: 1 from below, −1 from above; of its second arm −1 too while nothing touches
    the fingertip from inside; before that minus the fingertip's distance from the triangle's middle."""
    triangle = torch.tensor([[[0.3, 0.0, 0.0], [0.0, 0.3, 0.0], [-0.3, -0.3, 0.0]]])
    arm = torch.tensor(
        [[[0.0, 0.0, 0.1], [0.0, 0.0, -0.1], [0.0, 0.0, -0.4]]]
    )  # the fingertip is through
    arm = arm * torch.tensor([1.0, 1.0, way])
    tuck, below = under_hem(arm, triangle, torch.tensor([touched]), needed)
    assert bool(below) is (way > 0)
    assert float(tuck) == (1.0 if way > 0 and (touched or not needed) else -1.0)
    arm[..., 2] -= way * 0.5
    assert float(under_hem(arm, triangle, torch.tensor([touched]), needed)[0]) == pytest.approx(
        -0.4
    )


def test_what_pierces_cloth() -> None:
    """As solving for where each segment and each triangle meet says."""
    drawn = torch.Generator().manual_seed(0)
    corners = torch.rand(5000, 1, 3, 3, generator=drawn, dtype=torch.float64)
    bone = torch.rand(5000, 2, 3, generator=drawn, dtype=torch.float64)
    (a, b, c), (p, q) = corners[:, 0].unbind(1), bone.unbind(1)
    sides = torch.stack([b - a, c - a, p - q], dim=-1)
    u, v, t = torch.linalg.solve(sides, p - a).unbind(-1)
    meets = (u >= 0) & (v >= 0) & (u + v <= 1) & (t >= 0) & (t <= 1)
    assert meets.any()
    assert torch.equal(pierces(bone, corners), meets)
    chain = torch.cat([bone + 5.0, bone], dim=1)
    assert torch.equal(pierces(chain[:, 1:], corners) | meets, pierces(chain[:, 1:], corners))
    assert torch.equal(pierces(bone, corners.expand(-1, 3, -1, -1)), meets)


def test_an_arm_through_the_cloth_is_not_dressed() -> None:
    """It ends an episode of the sleeves, and is counted in the other subtasks."""
    for stage in STAGES:
        starts = ["initial_states=bank", "initial_states.file=anywhere"]
        experiment = load_experiment([f"experiment=dressing/shirt_{stage}", *starts])
        terms = {term.name: term for term in experiment.many("termination.terms")}
        ends = terms["pierced"].extras["outcome"] == "failure"
        assert ends is stage.startswith("sleeve")
    environment = build_environment(
        load_experiment(["experiment=dressing/shirt_sleeve", *SMALL, "initial_states.worn=held"])
    ).environment
    environment.reset(seed=1)
    assert not environment.table["pierced"].any(), "the arm hangs in the shirt"
    simulator = environment.parts.simulator
    state = {name: simulator.read(name).clone() for name in simulator.state_fields}
    names = [hinge.name for hinge in PersonScene(PersonScene.Options()).hinges]
    state["qpos"][:, names.index("left_shoulder_swing")] = -1.5  # forwards, through the front
    simulator.set_state(torch.ones(2, dtype=torch.bool), state)
    environment.refresh()
    assert environment.table["pierced"].all()
    assert not environment.table["dressed"].any()
    environment.close()


def test_both_passes_of_all_seven_compose(bank: Path) -> None:
    options = load_experiment(["search=dressing/algorithm_1"]).need("outer_loop").options
    assert isinstance(options, Algorithm1.Options)
    stages = stages_of(options)
    assert [name for name in stages if name in STAGES] == list(STAGES)
    for name, words in stages.items():
        if name.endswith("_ends"):  # a harvest, of the run before it
            continue
        given = [re.sub(r"\{\w+\}", str(bank), word) for word in words]
        experiment = load_experiment(
            [word for word in given if not word.startswith(("start.", "job"))]
        )
        own = isinstance(experiment.need("initial_states").options, WornShirt.Options)
        assert own is (name not in STAGES[1:])
        towards = [
            term.name for term in experiment.many("reward.terms") if term.name == "next_start"
        ]
        assert bool(towards) is (name.removesuffix("_first") in STAGES[:-1])


def test_grips_that_the_garment_has_not_are_refused() -> None:
    with pytest.raises(ConfigError, match="2 grips"):
        build_environment(
            load_experiment(["experiment=dressing/shirt_grip", *SMALL, "actuation.closed=[true]"])
        )


def test_the_search_trains_every_stage_in_order() -> None:
    options = load_experiment(["search=dressing/shirt"]).need("outer_loop").options
    assert isinstance(options, Chain.Options)
    trained = [name for name in options.stages if not name.endswith(("starts", "ends"))]
    trained.remove("mouth")  # ours
    assert trained == list(STAGES)


def test_the_sleeve_begins_at_the_mouth_too_and_is_judged_from_the_tuck(bank: Path) -> None:
    options = load_experiment(["search=dressing/shirt"]).need("outer_loop").options
    words = [re.sub(r"\{\w+\}", str(bank), word) for word in options.stages["sleeve"]]
    experiment = load_experiment([word for word in words if not word.startswith("start.")])
    assert experiment.need("initial_states").options.beside == (str(bank),)
    starts = experiment.many("evaluation.starts")
    assert [(one.name, one.options.beside) for one in starts] == [("tuck", ())]


def test_both_passes_of_the_first_sleeve_compose(bank: Path) -> None:
    """Every training of Algorithm 1 on the shirt, and the three that are compared, with a bank for every run before."""
    options = load_experiment(["search=dressing/first_sleeve"]).need("outer_loop").options
    assert isinstance(options, Algorithm1.Options)
    stages = stages_of(options)
    assert list(stages)[-3:] == ["tuck", "tuck_ends", "sleeve"]
    assert "sleeve_first" in stages
    for name in ("tuck_first", "tuck"):  # the others have the same parts
        words = [re.sub(r"\{\w+\}", str(bank), word) for word in stages[name]]
        begun = [word for word in words if not word.startswith("start.")]
        environment = build_environment(load_experiment([*begun, *SMALL])).environment
        try:
            environment.reset(seed=1)
            step = environment.advance(torch.zeros(2, environment.action_size))
            assert (environment.rewarded["next_start"] < 0).all()
            assert torch.isfinite(step.rewards).all()
        finally:
            environment.close()
    table = load_table("dressing/first_sleeve", installed())
    for column in table.columns.values():
        load_experiment([*table.overrides, *table.rows["sleeve"], *column])

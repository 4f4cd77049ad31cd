"""Equations 2 to 18 of the paper, each against numbers found by hand: the neutral person, and a sleeve laid where it is
asked for."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any, cast

import mujoco
import numpy as np
import pytest
import torch
from torch import Tensor

from understudy.setup.composition import load_experiment
from understudy.task import Context
from understudy_dressing.body import limb, sensors
from understudy_dressing.parts import SleeveObservation
from understudy_dressing.person import PersonScene, neutral_pose
from understudy_dressing.sleeve import SleeveScene
from understudy_dressing.state import SleeveState
from understudy_dressing.terms import TargetPose, along_task_vector, deformation, geodesic

pytest.importorskip("potpourri3d", reason="potpourri3d is not installed")
PERSON = PersonScene(PersonScene.Options())
SLEEVE = SleeveScene(SleeveScene.Options(around=0.56, length=0.44, edge=0.0257))
#: The right fingertip's sensor, and where it is: the forearm leans forwards by 0.21 from the elbow.
TIP = len(sensors()) - 1
SINE, COSINE = math.sin(0.21), math.cos(0.21)
SENSED = torch.tensor([0.45 * SINE, -0.21, -0.30 - 0.45 * COSINE])


def context() -> Context:
    scenes = (PERSON, SLEEVE)

    def need_scene(kind: type, who: str) -> Any:
        return next(scene for scene in scenes if isinstance(scene, kind))

    return cast(Context, SimpleNamespace(need_scene=need_scene, device=torch.device("cpu")))


@pytest.fixture(scope="module")
def state() -> SleeveState:
    return SleeveState(SleeveState.Options(side="right"), context())


def sleeve(x: float, y: float, z: float) -> Tensor:
    """(1, V, 3): as it is laid out, its axis going down from the middle of its entrance."""
    points = torch.tensor(SLEEVE.laid_out, dtype=torch.float32)
    radius = 0.56 / (2 * math.pi)
    turned = torch.stack([points[:, 2] + radius, points[:, 1], -points[:, 0]], dim=1)
    return (turned + torch.tensor([x, y, z]))[None]


def seen(state: SleeveState, cloth: Tensor, **touched: tuple[int, ...]) -> dict[str, Tensor]:
    """The fields of the neutral person; vertices that are touched from `inside` or `outside` push with 2 N along x."""
    model = PERSON.spec().compile()
    data = mujoco.MjData(model)
    data.qpos[: model.nu] = neutral_pose(PERSON).numpy()
    mujoco.mj_kinematics(model, data)
    force, side = torch.zeros_like(cloth), torch.zeros(1, cloth.shape[1])
    for where, sign in (("inside", 1.0), ("outside", -1.0)):
        for vertex in touched.get(where, ()):
            force[0, vertex, 0], side[0, vertex] = 2.0, sign
    xpos, xquat = (
        torch.tensor(np.array(a), dtype=torch.float32)[None] for a in (data.xpos, data.xquat)
    )
    found = state.compute(xpos, xquat, cloth, force, side)
    return {name: value[0] for name, value in found.items()}


def test_depth_in_the_entrance(state: SleeveState) -> None:
    """Equations 9 to 11: an entrance at z = −0.60 is 0.30 m below the elbow, so what is beyond it is the rest of the
    forearm's 0.35 m, and 0.04 m and 0.075 m of the hand; the limb has 0.975 m."""
    along = 0.30 / COSINE
    found = seen(state, sleeve(along * SINE, -0.21, -0.60))
    assert found["contained"] == 1
    beyond = (0.35 - along) + 0.04 + 0.075
    assert float(found["progress"]) == pytest.approx(beyond / 0.975, abs=1e-4)
    assert found["task_vector"].tolist() == pytest.approx([0, 0, -1], abs=1e-5), "equation 7"


def test_before_the_entrance(state: SleeveState) -> None:
    """Equation 11: minus the distance to the entrance's middle; equation 7: towards the middle loop's."""
    found = seen(state, sleeve(0.6, -0.21, -0.4))
    tip = torch.tensor([0.465 * SINE, -0.21, -0.30 - 0.465 * COSINE])
    assert torch.allclose(found["fingertip"], tip, atol=1e-5)
    assert torch.allclose(found["fingertip_offset"], tip - torch.tensor([0, -0.21, 0]), atol=1e-5)
    way = torch.tensor([0.6, -0.21, -0.4]) - tip
    assert float(found["progress"]) == pytest.approx(-float(way.norm()), abs=1e-5)
    row = SLEEVE.laid_out[SLEEVE.loops["middle"][0], 0]
    to = way - torch.tensor([0, 0, float(row)])
    assert torch.allclose(found["task_vector"], to / to.norm(), atol=1e-5)
    assert found["touching"] == 0
    assert geodesic(found["contained"][None], found["touched_geodesic"][None]).item() == 0


def test_the_touched_vertex_that_is_nearest_along_the_cloth(state: SleeveState) -> None:
    """Equations 7, 14 and 15: of two rows that the fingertip touches from outside, the one nearer to the entrance; from
    there the way is up to the entrance, since the feature is inside."""
    rows = SLEEVE.laid_out[:, 0].reshape(-1, len(SLEEVE.loops["entrance"]))
    count = rows.shape[1]
    near, far = (
        row * count + count // 2 for row in (2, 5)
    )  # of the line that is nearest to the person
    cloth = sleeve(0, 0, 0)
    cloth += SENSED - cloth[0, near]
    found = seen(state, cloth, outside=(near, far))
    assert found["touching"] == 1
    field = state._distance[0]
    assert field[near] < field[far]
    assert found["touched_geodesic"] == field[near]
    assert found["task_vector"].tolist() == pytest.approx([0, 0, 1], abs=1e-5)
    term = geodesic(found["contained"][None], found["touched_geodesic"][None])
    assert term.item() == pytest.approx(1 - float(field[near]))
    within = seen(state, cloth, inside=(near,))
    assert within["touched_geodesic"] < found["touched_geodesic"], "not around the edge"


def test_what_is_felt(state: SleeveState) -> None:
    """Equations 4 to 6: forces of two vertices add up at their nearest sensor, which the cloth pushes back; two from
    outside against one from inside give −1."""
    cloth = sleeve(0, 0, 0)
    cloth += SENSED - cloth[0, 0]
    found = seen(state, cloth, outside=(0, 1), inside=(2,))
    felt = torch.zeros(len(sensors()), 3)
    felt[TIP, 0] = -6.0
    assert torch.equal(found["sensor_force"], felt)
    assert found["sensor_sign"].nonzero().flatten().tolist() == [TIP]
    assert found["sensor_sign"][TIP] == -1


def test_areas(state: SleeveState) -> None:
    """Equation 12: as laid out 1; a fifth larger both ways 1.44; one vertex drawn out alone is what counts."""
    cloth = sleeve(0.6, 0, 0)
    assert float(seen(state, cloth)["area_ratio"]) == pytest.approx(1, abs=1e-4)
    assert float(seen(state, 1.2 * cloth)["area_ratio"]) == pytest.approx(1.44, abs=1e-3)
    cloth[0, 100] += 1.0
    assert float(seen(state, cloth)["area_ratio"]) > 30


def test_deformation_with_the_papers_numbers() -> None:
    """Equation 13: w_mid 25 and w_scale 0.14 take half at 25, and (1 ∓ tanh 1.4) / 2 at 15 and 35; the sleeves on a
    GPU take as much at 1.5 and at 2."""
    wanted = [-0.0573, -0.5, -0.9427]
    paper = deformation(torch.tensor([15.0, 25.0, 35.0]), middle=25.0, scale=0.14)
    assert paper.tolist() == pytest.approx(wanted, abs=1e-4)
    ours = deformation(torch.tensor([1.5, 1.75, 2.0]), middle=1.75, scale=5.6)
    assert ours.tolist() == pytest.approx(wanted, abs=1e-4)


def test_the_way_along_the_task_vector() -> None:
    """Equation 16: 3 cm along x and 4 cm along z, with the vector (0.6, 0, 0.8), are 5 cm; across it, nothing."""
    before = torch.tensor([[0.5, 0.1, 0.0], [0.5, 0.1, 0.0]])
    after = before + torch.tensor([[0.03, 0.0, 0.04], [0.04, 0.2, -0.03]])
    vector = torch.tensor([[0.6, 0.0, 0.8]]).expand(2, -1)
    assert along_task_vector(after, before, vector).tolist() == pytest.approx([0.05, 0.0], abs=1e-6)


def test_distance_from_the_goal_pose() -> None:
    """Equation 17: hinges off by 0.3 and 0.4 rad are 0.5 away; the gripper's place does not count."""
    pose = neutral_pose(PERSON)
    qpos = torch.cat([pose, torch.ones(3)])[None].repeat(2, 1)
    qpos[1, 2] += 0.3
    qpos[1, 8] -= 0.4
    assert TargetPose(None, context())(qpos).tolist() == pytest.approx([0, -0.5], abs=1e-6)


def test_what_the_policy_sees() -> None:
    """Equations 1 to 3, 6 and 7: 163 numbers in the 2018 code's order."""
    encoder = SleeveObservation(SleeveObservation.Options(), context())
    q, rate = torch.rand(1, 25), torch.rand(1, 25)
    force, sign = torch.rand(1, 22, 3), torch.ones(1, 22)
    tip, feature = torch.tensor([[0.1, 0.2, 0.3]]), torch.tensor([[0.4, 0.4, 0.1]])
    vector = torch.tensor([[0.0, 0.6, 0.8]])
    found = encoder.encode(q, rate, force, sign, tip, feature, vector)[0]
    assert found.shape == encoder.shape == (163,)
    assert torch.equal(found[:66], torch.cat([q[0, :22].cos(), q[0, :22].sin(), rate[0, :22]]))
    assert torch.equal(found[66:132], force.flatten())
    assert found[132:141].tolist() == pytest.approx([0.4, 0.4, 0.1, -0.3, -0.2, 0.2, 0, 0.6, 0.8])
    assert (found[141:] == 1).all()


def test_the_limb_is_the_papers() -> None:
    """Section 7.1, figure 4: from the fingertip inwards, so that bones 0 to 4 have 0.075, 0.04, 0.35, 0.30 and 0.21 m."""
    model = PERSON.spec().compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    points = [
        data.body(name).xpos + data.body(name).xmat.reshape(3, 3) @ np.array(place)
        for name, place in limb("right")
    ]
    bones = [float(np.linalg.norm(a - b)) for a, b in zip(points[1:], points[:-1], strict=True)]
    assert bones == pytest.approx([0.075, 0.04, 0.35, 0.30, 0.21])


#: Table 1: w1 progress, w2 deformation, w3 geodesic, w4 task vector, w5 target, α1 grip, α2 tuck; 0 where it has a dash.
TABLE = {
    "shirt_grip": (0, 400, 0, 0, 1, 100, 0),
    "shirt_tuck": (0, 20, 2, 0, 1, 0, 1),
    "shirt_sleeve": (15, 5, 4, 50, 1, 0, 0),
    "shirt_regrip": (0, 15, 0, 0, 5, 20, 0),
    "shirt_tuck_second": (0, 10, 2, 0, 0.5, 0, 20),
    "shirt_sleeve_second": (10, 5, 4, 50, 1, 0, 0),
    "shirt_finish": (0, 10, 0, 0, 1, 0, 0),
    "sleeve": (10, 5, 2, 50, 1, 0, 0),
}
#: Where the 2018 code is followed: no goal pose in a shirt's sleeve, and ten times as much for the first tuck.
CODE = {
    ("shirt_sleeve", "target"): 0,
    ("shirt_sleeve_second", "target"): 0,
    ("shirt_tuck", "tuck"): 10,
}
#: The 2018 code's beside: upright, head, and the end where the collar is lost; the last one's end is ours.
BESIDE = {
    "shirt_grip": (10, 3, -20_000),
    "shirt_tuck": (2, 3, -20_000),
    "shirt_sleeve": (0, 0, -2_000),
    "shirt_regrip": (2, 2, -2_500),
    "shirt_tuck_second": (0, 2, -5_000),
    "shirt_sleeve_second": (0, 0, -500),
    "shirt_finish": (0, 2, -500),
    "sleeve": (5, 1, 0),
}
#: The 2018 code's beside: a hand behind the torso, and what the fingertip is touched from.
FELT = {"shirt_grip": (-10, 0), "shirt_tuck": (-15, 3), "shirt_tuck_second": (0, 6)}
#: As the collar, where the arm goes in by the sleeve's end.
BACKWARDS = {"shirt_sleeve": -2_000, "shirt_sleeve_second": -500}


@pytest.mark.parametrize("task", TABLE)
def test_weights(task: str) -> None:
    """Equations 8 and 17: α1 and α2 are multiplied by w5. Ours are all times 0.02."""
    *plain, grip, tuck = TABLE[task]
    names = ("progress", "deformation", "geodesic", "task_vector", "target")
    wanted = dict(zip(names, plain, strict=True))
    wanted |= {"grip": -grip * wanted["target"], "tuck": tuck * wanted["target"]}
    wanted |= {term: weight for (of, term), weight in CODE.items() if of == task}
    wanted |= dict(zip(("upright", "head", "collar"), BESIDE[task], strict=True))
    wanted["backwards"] = BACKWARDS.get(task, 0)
    wanted |= dict(zip(("behind", "sign"), FELT.get(task, (0, 0)), strict=True))
    terms = load_experiment([f"experiment=dressing/{task}"]).root.reward.terms
    found = {name: terms.get(name, {"weight": 0.0})["weight"] / 0.02 for name in wanted}
    assert found == pytest.approx(wanted)

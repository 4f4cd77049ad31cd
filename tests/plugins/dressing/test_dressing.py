"""A sleeve on a track: what an arm does in it, and what that is worth."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest
import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.running.environment import Environment
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.testing.capture import check_capturable
from understudy.testing.conformance import check_environment
from understudy_dressing.person import PersonScene
from understudy_dressing.state import SleeveState
from understudy_dressing.terms import deformation, geodesic

pytest.importorskip("potpourri3d", reason="potpourri3d is not installed")
N = 4
HINGES = ("right_shoulder_spread", "right_shoulder_swing", "right_shoulder_twist", "right_elbow")


@pytest.fixture(scope="module")
def environment() -> Iterator[Environment]:
    built = build_environment(
        load_experiment(["experiment=dressing/sleeve_small", f"num_worlds={N}"])
    )
    person = built.context.need_scene(PersonScene, "the test")
    assert tuple(hinge.name for hinge in person.hinges) == HINGES
    yield built.environment
    built.environment.close()


Policy = Callable[[Environment], Tensor]


def idle(environment: Environment) -> Tensor:
    return torch.zeros(N, 4)


def point_at_the_entrance(environment: Environment) -> Tensor:
    """PD torques that hold the arm out straight, towards the middle of the sleeve's entrance."""
    fields = environment.parts.fields[0].part
    assert isinstance(fields, SleeveState)
    entrance = environment.table["cloth_position"][:, fields._loops["entrance"]].mean(1)
    way = entrance - torch.tensor([0.0, -0.21, 0.0])
    target = torch.zeros(N, 4)
    target[:, 1] = -(torch.pi / 2 + torch.atan2(way[:, 2], way[:, 0]))
    target[:, 3] = 0.2
    q, rate = environment.table["qpos"][:, :4], environment.table["qvel"][:, :4]
    return (8 * (target - q) - 0.5 * rate) / 4


def episode(environment: Environment, policy: Policy, decisions: int = 70) -> dict[str, Tensor]:
    """By field, (T, N, …)."""
    names = ("progress", "contained", "touching", "touched_geodesic", "area_ratio", "sensor_sign",
             "sensor_force", "task_vector", "cloth_position", "qpos")  # fmt: skip
    seen: dict[str, list[Tensor]] = {name: [] for name in (*names, "reward")}
    environment.reset(seed=1)
    for _ in range(decisions):
        step = environment.advance(policy(environment))
        assert not step.unsound.any()
        for name in names:
            seen[name].append(environment.table[name].clone())
        # each control period's, by itself, and each decision's
        assert torch.equal(environment.table["limb_progress"], environment.table["progress"])
        assert (environment.table["most_progress"] >= environment.table["progress"]).all()
        seen["reward"].append(step.rewards.clone())
        assert not step.ended.any()
    return {name: torch.stack(values) for name, values in seen.items()}


def test_an_arm_that_hangs_stays_out(environment: Environment) -> None:
    seen = episode(environment, idle, 60)
    assert (seen["progress"] < 0).all()
    assert (seen["sensor_force"] == 0).all(), "nothing is touched"
    assert seen["area_ratio"].max() < 1.3, "the sleeve only travels"
    gripper, cloth = seen["qpos"][:, :, -3:], seen["cloth_position"]
    travelled = gripper[-1] - gripper[0]
    assert torch.allclose((cloth[-1] - cloth[0]).mean(1), travelled, atol=0.02), "as it is told"
    assert travelled.norm(dim=1).min() > 0.25


def test_an_arm_that_points_at_the_entrance_goes_in(environment: Environment) -> None:
    """The task can be done; untrained it is not (above)."""
    seen = episode(environment, point_at_the_entrance)
    assert (seen["progress"].amax(0) > 0.15).sum() >= 3, "of four hands"
    inside = seen["contained"] > 0
    assert (seen["progress"][inside] > 0).all()
    assert torch.equal(inside, seen["progress"] > 0)
    assert (seen["sensor_sign"][inside] > 0).any(), "felt from inside"
    touching = seen["touching"] > 0
    assert touching.any()
    assert (seen["touched_geodesic"][~touching] == 1).all()
    assert torch.allclose(seen["task_vector"].norm(dim=-1), torch.tensor(1.0), atol=1e-4)
    assert all(torch.isfinite(value).all() for value in seen.values())
    lazy = episode(environment, idle)
    assert seen["reward"].sum(0).mean() > lazy["reward"].sum(0).mean() + 5


def test_it_repeats_and_can_be_recorded(environment: Environment) -> None:
    check_environment(environment, steps=6)
    check_capturable(environment)


def test_forces_are_shared_out_to_the_nearest_sensors(environment: Environment) -> None:
    """Equation 4: none is lost; equation 6: the sign is the sum's."""
    part = environment.parts.fields[0].part
    environment.reset(seed=1)
    taken = environment.table.pick({name: name for name in part.reads})
    force, side = torch.zeros_like(taken["contact_force"]), torch.zeros_like(taken["contact_side"])
    force[:, 5], side[:, 5] = torch.tensor([0.0, 0.0, 2.0]), 1.0
    force[:, 6], side[:, 6] = torch.tensor([0.0, 1.0, 0.0]), -1.0
    force[0, 7], side[0, 7] = torch.tensor([1.0, 0.0, 0.0]), -1.0
    given = {**taken, "contact_force": force, "contact_side": side}
    x = taken["cloth_position"].clone()
    given["cloth_position"] = x
    tip = part.compute(**taken)["fingertip"]
    x[:, 5:8] = tip.unsqueeze(1) + 0.001
    found = part.compute(**given)
    assert torch.allclose(found["sensor_force"].sum(1), -force.sum(1))
    assert (found["sensor_force"].abs().sum(-1) > 0).sum() == N, "one sensor each"
    assert found["sensor_sign"].abs().sum(1).tolist() == [1, 0, 0, 0]
    assert found["touching"].tolist() == [1] * N


def test_deformation_is_punished_between_its_limits() -> None:
    found = deformation(torch.tensor([1.0, 1.09, 1.5, 1.95, 9.0]))
    assert found.tolist() == pytest.approx([0, 0, -0.5, -1, -1], abs=0.005)
    paper = deformation(torch.tensor([15.0, 25.0, 35.0]), middle=25.0, scale=0.14)
    assert paper.tolist() == pytest.approx([-0.06, -0.5, -0.94], abs=0.01)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["~couplings.touch"], "4 torques and 1 grips, and the simulator takes 77 controls.*couplings.touch"),
        (["scenes.person.driven=true"], "4 torques and 1 grips, and the simulator takes 11 controls.*driven=false"),
        (["scenes.person.still=[torso,spine,neck,head,left,right]"], "no hinge that could move"),
        (["+reward.terms.upright={name: dressing/upright, least: 1, weight: 1}"], "least=1.* at most 0"),
    ],
)  # fmt: skip
def test_what_leaves_nothing_to_act_is_refused(words: list[str], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        build_environment(
            load_experiment(["experiment=dressing/sleeve_small", "num_worlds=1", *words])
        )


def test_torn_cloth_is_counted_and_ends_nothing(environment: Environment) -> None:
    """Section 7.2: to end there made policies too cautious."""
    (torn,) = (term for term in environment.parts.terminations if term.name == "torn")
    ratio = torch.tensor([1.0, 1.9, 2.0, 30.0])
    assert torn.function(value=ratio, **torn.options).tolist() == [False, False, True, True]
    assert torn.reads == {"value": "area_ratio"}
    assert torn.outcome == "report"


def test_the_geodesic_term() -> None:
    contained, distance = torch.tensor([0.0, 0.0, 1.0]), torch.tensor([1.0, 0.25, 0.7])
    assert geodesic(contained, distance).tolist() == pytest.approx([0.0, 0.75, 1.0])

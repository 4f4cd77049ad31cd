"""How one sits down: falls, slides and squats, with numbers and in the simulator."""

from __future__ import annotations

import math

import pytest
import torch
from sitting_tasks import build, follow_clip
from torch import Tensor

from understudy.setup.building import Built
from understudy.task import Context
from understudy_sitting.manner import Descent, planted, spent, unhurried

DT = 1 / 60


def descent() -> Descent:
    context = Context(
        seed=0, device=torch.device("cpu"), num_worlds=1, control_dt=DT, substeps=4, decision=1
    )
    return Descent(Descent.Options(), context)


def frame(**given: float | list[float]) -> dict[str, Tensor]:
    """One world's fields, standing still where nothing else is said."""
    still: dict[str, float | list[float]] = {
        "weight_height": 0.9, "pelvis_height": 0.88, "pelvis_fall": 0.0, "seat_depth": -0.2,
        "seat_contact": 0.0, "feet_speed": [0.0, 0.0], "feet_down": [1.0, 1.0],
    }  # fmt: skip
    return {name: torch.tensor([value]) for name, value in {**still, **given}.items()}


def told(*frames: dict[str, Tensor]) -> dict[str, float]:
    memory = descent()
    kept = memory.begin(**frames[0])
    for now in frames[1:]:
        kept = memory.advance(kept, **now)
    return {name: float(value) for name, value in kept.items()}


def test_the_first_contact_counts_with_the_speed_of_before() -> None:
    found = told(
        frame(),
        frame(pelvis_fall=1.5, seat_depth=0.05),
        frame(pelvis_fall=0.1, seat_depth=0.07, seat_contact=1.0),
        frame(pelvis_fall=0.4, seat_depth=0.2),
        frame(pelvis_fall=0.0, seat_depth=0.21, seat_contact=1.0),
    )
    assert found["landing_fall"] == pytest.approx(1.5)
    assert found["landing_depth"] == pytest.approx(0.07)
    assert found["fastest_fall"] == pytest.approx(1.5)
    assert found["landed"] == 1.0
    assert told(frame(), frame(pelvis_fall=0.3))["landed"] == 0.0


def test_feet_slide_where_they_touch() -> None:
    found = told(
        frame(),
        frame(feet_speed=[0.6, 0.0]),
        frame(feet_speed=[0.6, 2.0], feet_down=[1.0, 0.0]),
        frame(feet_speed=[3.0, 3.0], feet_down=[0.0, 0.0]),
    )
    assert found["slid"] == pytest.approx(2 * 0.3 * DT)


def test_a_squat_is_low_and_not_on_the_seat() -> None:
    low = frame(pelvis_height=0.6)
    found = told(frame(), low, low, frame(pelvis_height=0.55, seat_contact=1.0))
    assert found["squatted"] == pytest.approx(2 * DT)


@pytest.mark.parametrize(
    ("share", "drops"), [(1.0, True), (0.6, True), (0.4, False), (-1.0, False)]
)
def test_who_falls_is_not_borne(share: float, drops: bool) -> None:
    """Its centre of mass accelerates downwards with a share of g, from rest."""
    falling = [frame(weight_height=2.0 - 0.5 * share * 9.81 * (k * DT) ** 2) for k in range(6)]
    assert told(*falling)["dropped"] == pytest.approx(4 * DT if drops else 0.0)


def test_who_moves_evenly_from_the_start_on_drops_not() -> None:
    assert told(*(frame(weight_height=2.0 - k * DT) for k in range(4)))["dropped"] == 0.0


def test_terms_against_dropping_and_sliding() -> None:
    speed, down = torch.tensor([[0.0, 0.1], [0.0, 0.0]]), torch.tensor([[1.0, 1.0], [0.0, 1.0]])
    assert planted(speed, down, scale=30.0).tolist() == pytest.approx(
        [0.5 + 0.5 * math.exp(-0.3), 0.5]
    )
    fall = torch.tensor([-2.0, 0.6, 0.9])
    assert unhurried(fall).tolist() == pytest.approx([1.0, 1.0, math.exp(-0.9)])
    assert spent(torch.tensor([1.5]), torch.tensor([1.2])).tolist() == pytest.approx([-0.3])


def test_what_is_seen_in_the_simulator(sit: Built) -> None:
    """Standing: both feet down and still, the pelvis before the seat; the clip's end: 8 cm behind its front edge."""
    environment = sit.environment
    environment.reset()
    follow_clip(environment, 5)  # contacts exist once the simulator has stepped
    table = environment.table
    assert table["feet_down"].tolist() == [[1.0, 1.0]] * 4
    assert float(table["feet_speed"].max()) < 0.05
    assert float(table["seat_depth"].max()) < 0.0
    assert float(table["pelvis_height"].min()) == pytest.approx(0.88, abs=0.02)
    ends = build("experiment=sitting/sit", "num_worlds=2", "initial_states.span=[1,1]").environment
    ends.reset()
    assert ends.table["seat_depth"].tolist() == pytest.approx([0.08, 0.08], abs=0.01)


def test_speeds_are_those_of_places(sit: Built) -> None:
    """While the servos pull it down, heights and speeds agree."""
    environment = sit.environment
    environment.reset()
    follow_clip(environment, 30)
    before = environment.table["pelvis_height"].clone()
    falls = environment.table["pelvis_fall"].clone()
    follow_clip(environment, 1)
    fell = (before - environment.table["pelvis_height"]) / DT
    mean = 0.5 * (falls + environment.table["pelvis_fall"])
    assert fell.tolist() == pytest.approx(mean.tolist(), abs=0.1)


def test_it_learns_gently_by_a_word() -> None:
    gentle = build("experiment=sitting/sit_gently", "num_worlds=2").environment
    gentle.reset()
    gentle.step(gentle.action * 0.0)
    assert {"pose", "velocity", "nearing", "planted", "unhurried", "servos"} == set(gentle.rewarded)


def test_feet_without_a_chair_are_those_with_one() -> None:
    """The figure of a sit, told of twice: by the fields with a chair and by those without."""
    words = ["experiment=sitting/sit", "num_worlds=2"]
    feet = "+fields.feet={name: sitting/feet, provides: {feet_speed: speeds, feet_down: downs}}"
    environment = build(
        *words,
        feet,
        "reward.terms.planted={name: sitting/planted, reads: {feet_speed: speeds, feet_down: downs}}",
    ).environment
    environment.reset(seed=1)
    follow_clip(environment, 5)
    table = environment.table
    assert table["feet_speed"].max() > 0
    torch.testing.assert_close(table["speeds"], table["feet_speed"])
    torch.testing.assert_close(table["downs"], table["feet_down"])
    environment.close()


def test_a_turn_may_be_rewarded_for_feet_that_stand() -> None:
    feet, planted_too = (
        "+fields.feet={name: sitting/feet}",
        "reward.terms.planted={name: sitting/planted}",
    )
    environment = build(
        "experiment=sitting/turn_right", "num_worlds=2", feet, planted_too
    ).environment
    environment.reset(seed=1)
    follow_clip(environment, 2)
    assert (environment.rewarded["planted"] > 0).all()
    environment.close()

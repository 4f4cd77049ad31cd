"""Targets, initial states, baselines and the chain of trainings."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import pytest
import torch
from sitting_tasks import build

from understudy.errors import ConfigError
from understudy.random import WorldStreams
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.task import Context
from understudy_sitting.initial_states import PLACE, TURN
from understudy_sitting.targets import TargetAhead, TargetByChair
from understudy_skills import bank
from understudy_tensors import rotations


def test_targets_are_drawn_in_front_and_drawn_again() -> None:
    context = Context(0, torch.device("cpu"), 512, 1 / 60, 4)
    memory = TargetAhead(TargetAhead.Options(), context)
    position, yaw = torch.rand(512, 3), torch.full((512,), 2.0)
    streams = WorldStreams(0, "targets", 512, "cpu")
    kept = memory.begin(streams.uniform(2), torso_position=position, torso_yaw=yaw)
    away = kept["target"] - position[:, :2]
    off = torch.atan2(away[:, 1], away[:, 0]) - 2.0
    off = torch.remainder(off + math.pi, 2 * math.pi) - math.pi
    assert 55 < math.degrees(float(off.abs().max())) <= 60.001
    distance = away.norm(dim=1)
    assert 1.5 <= float(distance.min()) < float(distance.max()) <= 4.0
    first = kept["target"].clone()
    for _ in range(149):
        kept = memory.advance(kept, streams.uniform(2), position, yaw)
    torch.testing.assert_close(kept["target"], first)
    kept = memory.advance(kept, streams.uniform(2), position, yaw)  # 2.5 s
    assert (kept["target"] != first).any(dim=1).all()
    position[:, :2] = kept["target"] - 0.2  # 0.28 m away
    reached = memory.advance(kept, streams.uniform(2), position, yaw)
    assert (reached["target"] != kept["target"]).any(dim=1).all()


def test_a_target_by_the_chair_is_in_its_frame() -> None:
    context = Context(0, torch.device("cpu"), 1, 1 / 60, 4)
    field = TargetByChair(TargetByChair.Options(ahead=0.25), context)
    found = field.compute(
        goal=torch.tensor([[0.75, 0.5]]),
        chair_position=torch.tensor([[3.0, 2.0, 0.0]]),
        chair_rotation=rotations.from_heading(torch.tensor([math.pi / 2])),
    )
    assert found["target"][0].tolist() == pytest.approx([2.5, 3.0])


def test_servo_targets_that_lag_come_nearer_and_nearer() -> None:
    at_once, lagging = (
        build("experiment=sitting/turn_left", "num_worlds=1", *more)
        for more in ([], ["actuation.lag=0.02"])
    )
    actuation = lagging.environment.parts.actuation.part
    action = torch.ones_like(at_once.environment.action[:1])
    asked = at_once.environment.parts.actuation.part.control(action)
    followed = torch.zeros_like(asked)
    for periods in (1, 2, 3):
        followed = actuation.control(action, ctrl=followed)
        torch.testing.assert_close(followed, asked * (1 - math.exp(-periods / 60 / 0.02)))
    for built in (at_once, lagging):
        built.environment.close()


def test_targets_that_lag_begin_at_what_the_servos_were_told() -> None:
    built = build("experiment=sitting/turn_left", "num_worlds=2", "actuation.lag=0.02")
    try:
        environment = built.environment
        environment.reset(0, "a")
        action = torch.ones_like(environment.action)
        told = [environment.table["ctrl"].clone()]
        for _ in range(3):
            environment.step(action)
            told.append(environment.table["ctrl"].clone())
        steps = [(b - a).norm() for a, b in itertools.pairwise(told)]
        for first, second in itertools.pairwise(steps):
            assert second / first == pytest.approx(math.exp(-1 / 60 / 0.02), rel=1e-4)
    finally:
        built.environment.close()


@pytest.fixture(scope="module")
def states(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bank of standing poses here and there."""
    built = build("experiment=sitting/turn_left", "num_worlds=6", "initial_states.span=[0,0]")
    built.environment.reset()
    table = built.environment.table
    qpos, qvel = table["qpos"].clone(), table["qvel"].clone()
    angle = torch.linspace(-3, 3, 6)
    qpos[:, :2] = torch.stack([angle, 2 * angle], dim=1)
    qpos[:, 3:7] = rotations.multiply(rotations.from_heading(angle), qpos[:, 3:7])
    qvel[:, 0], qvel[:, 1] = angle.cos(), angle.sin()  # ahead, 1 m/s
    path = tmp_path_factory.mktemp("banks") / "bank"
    bank.save(path, {"qpos": qpos, "qvel": qvel}, {"run": "standing"})
    return path


def test_the_second_stage_begins_where_others_ended(states: Path) -> None:
    """Whatever their place and heading were, they are moved to where the clip begins, and the chair
    stands where the clip sits down."""
    overrides = [f"initial_states.banks=['{states}']", "initial_states.share=1.0", "start.run=x"]
    built = build("experiment=sitting/sit_tuned", "num_worlds=32", *overrides)
    environment = built.environment
    environment.reset()
    table = environment.table
    assert float(rotations.heading(table["qpos"][:, 3:7]).abs().max()) < 1e-3
    assert float((table["qpos"][:, :2] - table["reference_qpos"][:, :2]).abs().max()) < 1e-4
    torch.testing.assert_close(table["qvel"][:, :2], torch.tensor([[1.0, 0.0]]).expand(32, 2))
    chair = table["chair_position"]
    assert float(chair[:, 0].max()) < -0.15  # behind: 0.45 m, 0.25 m more or less
    assert 0.05 < float(chair[:, :2].std(dim=0).max()) < 0.25  # more or less
    assert math.radians(60) >= float(rotations.heading(table["chair_rotation"]).abs().max()) > 0.05


def test_a_run_keeps_the_bank_that_it_began_with(states: Path, tmp_path: Path) -> None:
    own = tmp_path / "bank"
    bank.save(own, bank.load(states), {})
    words = ["experiment=sitting/sit_tuned", "num_worlds=2", "start.run=x"]
    experiment = load_experiment([*words, f"initial_states.banks=['{own}']"])
    build_environment(experiment)
    kept = experiment.inputs.copy(tmp_path / "inputs")
    assert len(kept[f"bank {own}"]) == 2
    for path in bank.files(own):
        path.unlink()
    build_environment(experiment)


def test_the_second_stage_may_begin_slower(states: Path) -> None:
    """Whole velocities are scaled, uniformly; they were 1 m/s."""
    given = [f"initial_states.banks=['{states}']", "initial_states.share=1.0", "start.run=x"]
    built = build(
        "experiment=sitting/sit_tuned", "num_worlds=2", *given, "initial_states.speed=[0.2,0.6]"
    )
    part, streams = built.environment.parts.initial_states, WorldStreams(1, "speed", 2, "cpu")
    speeds = torch.cat([part.sample(streams)["qvel"][:, :2].norm(dim=1) for _ in range(500)])
    assert 0.2 <= float(speeds.min()) < 0.21
    assert 0.59 < float(speeds.max()) <= 0.6
    assert float(speeds.mean()) == pytest.approx(0.4, abs=0.015)


def test_a_chair_may_stand_where_it_was(states: Path, tmp_path: Path) -> None:
    """Seen from the figure, where the bank has it; a metre ahead of each, turned by half a radian."""
    known = bank.load(states)
    heading = rotations.heading(known["qpos"][:, 3:7])
    ahead = torch.stack([heading.cos(), heading.sin()], dim=1)
    place = torch.nn.functional.pad(known["qpos"][:, :2] + ahead, (0, 1))
    turn = rotations.from_heading(heading + 0.5)
    bank.save(tmp_path / "bank", {**known, "mocap_pos/chair": place, "mocap_quat/chair": turn}, {})
    given = ["initial_states.share=1.0", "start.run=x", "num_worlds=32"]
    exactly = ["initial_states.metres=0", "initial_states.degrees=0"]
    there = [f"initial_states.banks=['{tmp_path / 'bank'}']"]
    built = build("experiment=sitting/sit_switched", *given, *exactly, *there)
    built.environment.reset()
    table = built.environment.table
    own = rotations.heading(table["qpos"][:, 3:7])
    away = (table["chair_position"] - table["qpos"][:, :3])[:, :2]
    torch.testing.assert_close(away, torch.stack([own.cos(), own.sin()], dim=1), atol=1e-3, rtol=0)
    chair = rotations.heading(table["chair_rotation"])
    torch.testing.assert_close(chair, own + 0.5, atol=1e-3, rtol=0)
    with pytest.raises(ConfigError, match="mocap_pos/chair' is missing there"):
        build("experiment=sitting/sit_switched", *given, f"initial_states.banks=['{states}']")


@pytest.mark.parametrize("speed", ["[0.5,0.2]", "[-1,1]"])
def test_speeds_that_are_none_are_refused(states: Path, speed: str) -> None:
    given = [f"initial_states.banks=['{states}']", f"initial_states.speed={speed}", "start.run=x"]
    with pytest.raises(ConfigError, match=r"initial_states.*speed=.* is not possible"):
        build("experiment=sitting/sit_tuned", *given)


@pytest.mark.parametrize(
    ("experiment", "word"),
    [
        ("sit", "metres=100"), ("sit", "degrees=1e6"), ("meta", "spread=11"), ("meta", "distance=101"),
        ("meta", "degrees=181"), ("meta", "at_chair.aside=11"), ("meta", "at_chair.degrees=181"),
    ],
)  # fmt: skip
def test_starts_out_of_reach_are_refused(experiment: str, word: str) -> None:
    """A chair a hundred metres away was trained with."""
    key = word.partition("=")[0]
    with pytest.raises(ConfigError, match=rf"initial_states.{key}=.* it must be at most"):
        load_experiment([f"experiment=sitting/{experiment}", f"initial_states.{word}"])


def test_a_share_of_the_episodes_begins_in_the_first_frame() -> None:
    span = ["initial_states.span=[0.2,1.0]", "initial_states.first=0.25"]
    built = build("experiment=sitting/turn_left", "num_worlds=2", *span)
    states, streams = built.environment.parts.initial_states, WorldStreams(1, "first", 2, "cpu")
    starts = torch.cat([states.sample(streams)["motion_start"] for _ in range(1000)])
    first = torch.isclose(starts, torch.tensor(0.2 * 9.0))
    assert float(first.float().mean()) == pytest.approx(0.25, abs=0.04)
    assert float(starts.min()) == pytest.approx(0.2 * 9.0)
    assert float(starts.max()) == pytest.approx(9.0, abs=0.1)


def test_a_bank_of_another_figure_is_refused(tmp_path: Path) -> None:
    bank.save(tmp_path / "bank", {"qpos": torch.zeros(3, 43), "qvel": torch.zeros(3, 34)}, {})
    with pytest.raises(ConfigError, match=r"'qpos' is \(43,\) there and \(28,\) here"):
        build(
            "experiment=sitting/turn_left_tuned", "num_worlds=2", "start.run=x",
            f"initial_states.banks=['{tmp_path / 'bank'}']",
        )  # fmt: skip


@pytest.mark.parametrize("words", ["initial_states.distance=0.3", "initial_states.spread=1.9"])
def test_figures_do_not_begin_within_the_chair(words: str) -> None:
    with pytest.raises(
        ConfigError, match=r"from the seat's middle, and the chair reaches 0\.311 m"
    ):
        build("experiment=sitting/sit", "initial_states=sitting/around_chair", words)


def test_zones_of_figure_4() -> None:
    built = build(
        "experiment=sitting/sit", "num_worlds=512", "initial_states=sitting/around_chair",
        "++motion={name: walk, parameters: {}}", "~fields.reference", "~fields.reference_body",
        "~reward.terms.pose", "~reward.terms.velocity", "~measure.pose",
        "actuation=joint_targets",
    )  # fmt: skip
    states = built.environment.parts.initial_states
    streams = WorldStreams(3, "zones", 512, "cpu")
    for difficulty, zones in ((0.0, {1.0}), (0.5, {1.0, 2.0}), (1.0, {1.0, 2.0, 3.0})):
        drawn = states.sample(streams, difficulty=torch.full((512,), difficulty))
        assert set(drawn["zone"].tolist()) == zones
        share = float(drawn["newest"].mean())
        assert ((drawn["zone"] == max(zones)) == (drawn["newest"] == 1)).all()
        assert share == pytest.approx(0.5 + 0.5 / len(zones), abs=0.08)
        place = drawn["qpos"][:, :2]
        assert 1.8 <= float(place.norm(dim=1).min()) < float(place.norm(dim=1).max()) <= 2.2
        angle = torch.atan2(place[:, 1], place[:, 0]).rad2deg()
        for zone, low, high in ((1.0, 0, 90), (2.0, 90, 135), (3.0, 135, 180)):
            here = angle[drawn["zone"] == zone].abs()
            assert not len(here) or low <= float(here.min()) < float(here.max()) <= high
        assert ((angle > 0) == (drawn["side"] > 0)).all()
        facing = rotations.heading(drawn["qpos"][:, 3:7])
        off = torch.remainder(
            facing - torch.atan2(-place[:, 1], -place[:, 0]) + math.pi, 2 * math.pi
        )
        assert float((off - math.pi).abs().max().rad2deg()) < 32
        assert not drawn[PLACE].any()
        assert float(rotations.heading(drawn[TURN]).abs().max()) == 0.0


def test_with_a_sector_the_angle_rises_evenly() -> None:
    given = [
        "experiment=sitting/sit", "num_worlds=2000", "initial_states=sitting/around_chair",
        "++motion={name: walk, parameters: {}}", "~fields.reference", "~fields.reference_body",
        "~reward.terms.pose", "~reward.terms.velocity", "~measure.pose",
        "actuation=joint_targets", "initial_states.sector=20",
    ]  # fmt: skip
    states = build(*given).environment.parts.initial_states
    streams = WorldStreams(3, "sector", 2000, "cpu")
    for difficulty, end in ((0.0, 90.0), (0.5, 135.0), (0.7, 153.0), (1.0, 180.0)):
        drawn = states.sample(streams, difficulty=torch.full((2000,), difficulty))
        place = drawn["qpos"][:, :2]
        angle = torch.atan2(place[:, 1], place[:, 0]).rad2deg().abs()
        assert end - 1 < float(angle.max()) <= end + 1e-3
        newest = drawn["newest"] == 1
        assert (newest == (angle >= end - 20)).all()
        assert float(newest.float().mean()) == pytest.approx(0.5 + 0.5 * 20 / end, abs=0.04)
        assert torch.equal(drawn["zone"], 1.0 + (angle > 90) + (angle > 135))
    judged = build_environment(load_experiment(given), evaluating=True)
    zones = judged.environment.parts.initial_states.sample(streams, difficulty=torch.ones(2000))[
        "zone"
    ]
    assert float((zones == 3.0).float().mean()) == pytest.approx(1 / 3, abs=0.04)
    with pytest.raises(ConfigError, match="sector"):
        build(*given[:-1], "initial_states.sector=0")


def test_some_training_episodes_begin_before_the_chair(states: Path) -> None:
    given = [
        "experiment=sitting/sit", "num_worlds=2000", "initial_states=sitting/around_chair",
        "++motion={name: walk, parameters: {}}", "~fields.reference", "~fields.reference_body",
        "~reward.terms.pose", "~reward.terms.velocity", "~measure.pose",
        "actuation=joint_targets", f"initial_states.at_chair.banks=['{states}']",
    ]  # fmt: skip
    built, easy = build(*given), torch.zeros(2000)
    drawn = built.environment.parts.initial_states.sample(
        WorldStreams(3, "near", 2000, "cpu"), difficulty=easy
    )
    near = drawn["zone"] == 0
    assert float(near.float().mean()) == pytest.approx(0.25, abs=0.04)
    assert set(drawn["zone"][~near].tolist()) == {1.0}
    assert (drawn["newest"] != near.float()).all()
    place, height = drawn["qpos"][near, :2], drawn["qpos"][near, 2]
    assert 0.4 <= float(place[:, 0].min()) < 0.45 < 0.85 < float(place[:, 0].max()) <= 0.9
    assert float(place[:, 1].abs().max()) <= 0.2
    assert set(height.tolist()) <= set(bank.load(str(states))["qpos"][:, 2].tolist())
    quarter = torch.histc(rotations.heading(drawn["qpos"][near, 3:7]), 4, -math.pi, math.pi)
    assert float(quarter.min()) > 0.15 * len(place)
    evaluated = build_environment(load_experiment(given), evaluating=True)
    judged = evaluated.environment.parts.initial_states.sample(
        WorldStreams(3, "near", 2000, "cpu"), difficulty=easy
    )
    assert set(judged["zone"].tolist()) == {1.0}


def test_evaluations_draw_all_zones_alike() -> None:
    """Whatever share of the training repeats earlier ones."""
    for keep in (0.0, 0.9):
        given = [
            "experiment=sitting/sit", "num_worlds=3000", "initial_states=sitting/around_chair",
            "++motion={name: walk, parameters: {}}", "~fields.reference", "~fields.reference_body",
            "~reward.terms.pose", "~reward.terms.velocity", "~measure.pose",
            "actuation=joint_targets", f"initial_states.keep={keep}",
        ]  # fmt: skip
        built = build_environment(load_experiment(given), evaluating=True)
        zones = built.environment.parts.initial_states.sample(
            WorldStreams(3, "zones", 3000, "cpu"), difficulty=torch.ones(3000)
        )["zone"]
        for zone in (1.0, 2.0, 3.0):
            assert float((zones == zone).float().mean()) == pytest.approx(1 / 3, abs=0.04)


@pytest.mark.parametrize("search", ["all", "small"])
def test_the_whole_chain_composes(search: str) -> None:
    """Each stage is an experiment, whatever folders take the names' places."""
    chain = f"search=sitting/{search}"
    (chosen,) = load_experiment([chain]).choices["outer_loop"]
    stages = dict(chosen.options.stages)
    assert list(stages)[-1] == "meta_switched"
    assert len(stages) == 22
    for given in stages.values():
        overrides = [o.replace("{", "").replace("}", "") for o in given]
        load_experiment([chain, *overrides, "outer_loop=null", "executor=null"])


def test_bounds_and_imitation_are_judged_alike() -> None:
    found = []
    grid = load_experiment(["ablation=sitting/bounds"]).need("outer_loop").options
    for overrides in grid.variants.values():
        found.append(load_experiment(["ablation=sitting/bounds", *overrides]).failures)
    assert found == [("low", "off_course")] * 2

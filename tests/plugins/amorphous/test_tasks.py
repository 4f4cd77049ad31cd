"""The tasks as they are composed: where episodes begin, what is measured, and that all of it trains."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from on_gpu import rollouts_without_waiting
from torch.nn.functional import pad

from understudy.command.cli import main
from understudy.errors import ConfigError
from understudy.records.runs import differences, open_run
from understudy.running.environment import Environment
from understudy.running.training import Training
from understudy.setup.building import build_environment
from understudy.setup.composition import compose_raw, load_experiment
from understudy.setup.plugins import installed
from understudy.testing import check_plugin
from understudy_amorphous import flipping
from understudy_amorphous.maps import in_tool_frame
from understudy_amorphous.report import MapsSection, png
from understudy_amorphous.tool import euler_angles, orientation
from understudy_reproduce.tables import load_table

TASKS = ("gather", "spread", "flip")
TINY = (
    "num_worlds=2", "learner.rollout_steps=16", "learner.minibatches=2", "budget.samples=32",
    "evaluation.episodes=2", "evaluation.final_episodes=2", "evaluation.seconds=0.5",
    "run.video_seconds=0.2",
)  # fmt: skip


def environment(*overrides: str, evaluating: bool = False) -> Environment:
    experiment = load_experiment(["num_worlds=6", *overrides])
    built = build_environment(experiment, evaluating=evaluating).environment
    built.reset(seed=1)
    return built


def blocks_of(env: Environment) -> tuple[torch.Tensor, torch.Tensor]:
    """Centres (N, K, 2) of the gathering task's blocks, and whether they are there (N, K)."""
    place = env.table["particle_position"].unflatten(1, (4, -1))
    return place[..., :2].mean(dim=2), env.table["active_particles"].unflatten(1, (4, -1))[
        ..., 0
    ] > 0


@pytest.mark.parametrize(("evaluating", "clusters"), [(False, 1), (True, 4)])
def test_gathering_begins_with_as_many_clusters_as_the_curriculum_says(
    evaluating: bool, clusters: int
) -> None:
    env = environment("experiment=amorphous/gather", evaluating=evaluating)
    centres, there = blocks_of(env)
    assert there.sum(dim=1).tolist() == [clusters] * 6
    away = centres.norm(dim=2)[there]
    assert float(away.min()) >= 1.8 - 1e-4
    assert float(away.max()) <= 2.8 + 1e-4
    far = env.table["farthest_distance"]
    assert bool(((far > 1.8) & (far < 2.8 + 0.5 * math.sqrt(2))).all())
    assert len({round(float(x), 4) for x in away}) == 6 * clusters, "drawn anew for each"


def test_blocks_and_tool_go_with_a_goal_that_is_drawn() -> None:
    env = environment(
        "experiment=amorphous/gather", "num_worlds=64", "initial_states.goal=[0.5,0]",
        "initial_states.goal_spread=0.4", evaluating=True,
    )  # fmt: skip
    goal = env.table["goal"]
    off = goal - torch.tensor([0.5, 0.0])
    assert 0.3 < float(off.abs().max()) <= 0.4
    assert float(off.std(dim=0).min()) > 0.15, "uniform along both axes: 0.23"
    centres, there = blocks_of(env)
    away = (centres - goal.unsqueeze(1)).norm(dim=2)[there]
    assert 1.8 - 1e-4 <= float(away.min()) < 2.0
    assert 2.6 < float(away.max()) <= 2.8 + 1e-4
    tool = (env.table["tool_position"][:, :2] - goal).norm(dim=1)
    assert float(tool.min()) >= 3.9 - 1e-4
    assert float(tool.max()) <= 4.2 + 1e-4


def test_no_block_begins_within_another() -> None:
    env = environment("experiment=amorphous/gather", "num_worlds=200", evaluating=True)
    place = env.table["particle_position"]
    apart = torch.cdist(place, place) + 9.0 * torch.eye(200)
    assert float(apart.min()) > 0.19


def test_the_maps_hold_the_table_and_most_of_the_material() -> None:
    env = environment("experiment=amorphous/gather", "num_worlds=500", evaluating=True)
    tool, turn = env.table["tool_position"], env.table["tool_orientation"]
    effective: Any = load_experiment(["experiment=amorphous/gather"]).effective()
    grid, limits = effective["encoder"]["image"]["grid"], effective["actuation"]["limits"]
    reach = 0.5 * grid["cells"] * grid["width"]
    assert limits["x"][1] < reach, "absolute maps, figure 11"
    away = in_tool_frame(env.table["particle_position"], tool, turn)[..., :2].abs().amax(dim=2)
    seen = away[env.table["active_particles"] > 0] < reach
    assert 0.5 < float(seen.float().mean()) < 1.0


def test_the_same_seed_begins_the_same_and_another_draw_does_not() -> None:
    env = environment("experiment=amorphous/spread")
    first = env.table["particle_position"].clone()
    env.reset(seed=1)
    assert torch.equal(env.table["particle_position"], first)
    env.reset(seed=1, draw="final")
    assert not torch.equal(env.table["particle_position"], first)


def drive_from(env: Environment, distance: float) -> None:
    """Put the tool so far from the goal, behind the one cluster, facing the goal."""
    centre = env.table["particle_position"].mean(dim=1)
    angle = torch.atan2(centre[:, 1], centre[:, 0])
    state = {name: env.table[name].clone() for name in env.parts.simulator.state_fields}
    state["tool_position"] = distance * torch.stack([angle.cos(), angle.sin(), 0 * angle], dim=1)
    state["tool_orientation"] = orientation(pad(angle.unsqueeze(1) + math.pi, (2, 0)))
    env.parts.simulator.set_state(torch.ones(env.num_worlds, dtype=torch.bool), state)
    env.refresh()
    env._keep(env.parts.actuation, env.parts.actuation.part.begin(
        **env.table.pick(env.parts.actuation.reads)
    ))  # fmt: skip


def test_a_scraper_pushes_its_cluster_towards_the_goal() -> None:
    """The tool behind a cluster, driven at the goal: the farthest particle comes nearer, and the
    reward says so."""
    env = environment(
        "experiment=amorphous/gather_small", "num_worlds=1", "scene.blocks=1", "curriculum.most=1",
        "initial_states.distance=[1.2,1.2]",
    )  # fmt: skip
    drive_from(env, 2.0)
    before = float(env.table["farthest_distance"])
    rewards = [float(env.advance(torch.tensor([[9.0, 0.0, 0.0]])).rewards) for _ in range(12)]
    assert float(env.table["farthest_distance"]) < before - 0.3
    assert max(rewards) > 0.5


@pytest.mark.parametrize("material", ["granular", "viscous", "viscoplastic"])
def test_a_straight_push_brings_most_of_a_cluster_along(material: str) -> None:
    """From behind a cluster past the goal, at 1 m/s. Of honey without cohesion, which flowed around both
    ends of the blade, two thirds came along."""
    env = environment(
        "experiment=amorphous/gather", "scene.blocks=1", "curriculum.most=1",
        f"scene.material={material}", "initial_states.distance=[2.3,2.3]",
    )  # fmt: skip
    drive_from(env, 3.3)
    for _ in range(48):
        env.advance(torch.tensor([[0.442, 0.0, 0.0]]).expand(6, -1))
    assert float(env.table["tool_position"][:, :2].norm(dim=1).max()) < 0.6
    measured = env.measure()
    assert float(measured["gathered_share"].mean()) >= 0.9
    assert bool((measured["farthest_distance"] >= measured["distance_95"]).all())


def around_and_in(env: Environment, seconds: float) -> dict[str, float]:
    """Drive the tool of each world around the material, behind its farthest particle, and straight to
    the goal, again and again; returns what is then measured, in the mean."""
    worlds = env.num_worlds
    phase, chosen = torch.zeros(worlds, dtype=torch.long), torch.zeros(worlds)
    for _ in range(round(seconds * 15)):
        place, yaw = env.table["tool_pose"][:, :2], env.table["tool_pose"][:, 5]
        far = env.table["farthest_position"]
        away, around = place.norm(dim=1), torch.atan2(place[:, 1], place[:, 0])
        outside = (phase == 0) & ((away - 3.7).abs() < 0.25)
        chosen = torch.where(outside, torch.atan2(far[:, 1], far[:, 0]), chosen)
        phase = torch.where(outside, 1, phase)
        left = chosen - around
        left = torch.atan2(left.sin(), left.cos())
        phase = torch.where((phase == 1) & (left.abs() < 0.12), 2, phase)
        phase = torch.where((phase == 2) & (away < 0.6), 0, phase)
        inwards = phase == 2
        angle = torch.where(
            inwards, chosen, torch.where(phase == 1, around + left.clamp(-0.35, 0.35), around)
        )
        radius = torch.where(inwards, (away - 0.45).clamp(min=0.45), 3.7)
        x, y = (radius * angle.cos() - place[:, 0]), (radius * angle.sin() - place[:, 1])
        turn = torch.where(inwards, chosen, around) + math.pi - yaw
        action = torch.stack(
            [
                (yaw.cos() * x + yaw.sin() * y) / 0.6,
                (yaw.cos() * y - yaw.sin() * x) / 0.6,
                torch.atan2(turn.sin(), turn.cos()) / 0.7,
            ],
            dim=1,
        )
        env.advance(action.clamp(-0.98, 0.98).atanh())
    return {name: float(value.mean()) for name, value in env.measure().items()}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("material", "share", "most"),
    [("viscoplastic", 0.98, 1.2), ("granular", 0.75, 2.3), ("viscous", 0.8, 2.0)],
)
def test_four_clusters_of_any_material_can_be_gathered_in_an_episode(
    material: str, share: float, most: float
) -> None:
    """What a policy is asked for is possible with this tool, within its speed, in 30 s."""
    env = environment(
        "experiment=amorphous/gather", f"scene.material={material}", "num_worlds=2", evaluating=True
    )
    assert float(env.measure()["gathered_share"].max()) < 0.1
    found = around_and_in(env, 29.5)
    assert found["gathered_share"] >= share
    assert found["distance_95"] <= most


def test_the_tool_begins_facing_the_material() -> None:
    for task, most in (("gather", 1.0), ("spread", 0.0)):
        env = environment(f"experiment=amorphous/{task}", "num_worlds=100")
        place, yaw = env.table["tool_position"], euler_angles(env.table["tool_orientation"])[:, 2]
        towards = torch.atan2(-place[:, 1], -place[:, 0])
        off = torch.atan2((yaw - towards).sin(), (yaw - towards).cos()).abs()
        assert most - 0.1 <= float(off.max()) <= most + 1e-3, task


#: Table 2, by the task's term and option; those of `gathering` have names of their own there.
TABLE_2 = {
    "gather": {
        "gathering": {"weight": 1.0, "c_1": 10.0, "c_2": 0.03, "c_3": 1.0, "c_4": 4.0, "c_5": 1.0}
        | {"w_1": 1.0, "w_2": 5.0, "w_3": 0.01, "w_4": 1.0},
    },
    "spread": {
        "movement": {"weight": 0.1, "c_min": 0.2}, "occupied": {"weight": 0.1},
        "lowered": {"weight": 50.0}, "outliers": {"weight": 0.001, "c_rad": 3.2},
    },
    "flip": {
        "height": {"weight": 0.1, "c_1": 0.1, "w_1": 10.0, "w_2": 0.1},
        "spin": {"weight": 1.0, "w_3": 4.0, "c_2": 0.5, "least": -1.0, "most": 1.0},
    },
}  # fmt: skip


@pytest.mark.parametrize("task", TASKS)
def test_the_rewards_have_the_constants_of_table_2(task: str) -> None:
    chosen: Any = load_experiment([f"experiment=amorphous/{task}"]).effective()
    terms = chosen["reward"]["terms"]
    assert list(terms) == list(TABLE_2[task])
    for name, constants in TABLE_2[task].items():
        found = {key: terms[name][key] for key in constants}
        assert found == constants, name


def test_a_scraper_through_a_pile_occupies_more_cells_and_is_rewarded() -> None:
    env = environment("experiment=amorphous/spread", "scene.material=granular", "num_worlds=2")
    before = env.table["occupied_cells"].clone()
    assert 100 <= float(before.min()) <= float(before.max()) <= 140
    ahead = torch.tensor([[9.0, 0.0, 0.0, 0.0]]).expand(2, -1)  # it begins facing the pile
    total = sum((env.advance(ahead).rewards for _ in range(25)), torch.zeros(2))
    assert bool((env.table["occupied_cells"] > before + 20).all())
    assert bool((total > 3.0).all())


@pytest.mark.parametrize("frame", ["tool", "world"])
def test_cells_are_rewarded_in_the_frame_that_is_chosen(frame: str) -> None:
    """The scraper leaves the pile: the observed map loses it, the table's does not."""
    env = environment(
        "experiment=amorphous/spread", f"fields.observed_map.frame={frame}", "num_worlds=1",
        "scene.material=granular",
        *(f"~reward.terms.{name}" for name in ("movement", "lowered", "outliers")),
    )  # fmt: skip
    start = env.table["observed_cells"].clone(), env.table["occupied_cells"].clone()
    total = 0.0
    for _ in range(45):
        total += float(env.advance(torch.tensor([[-9.0, 0.0, 0.0, 0.0]])).rewards)
    gained = float(env.table["observed_cells"] - start[0])
    assert total == pytest.approx(0.1 * gained, abs=1e-4)
    assert float(env.measure()["occupied_cells"]) >= 100.0
    if frame == "world":
        assert gained == float(env.table["occupied_cells"] - start[1])
    else:
        assert gained < -20.0


def test_figure_11_changes_what_is_seen_and_not_what_is_rewarded() -> None:
    """Section 4.5 compares observations."""
    table = load_table("amorphous/figure_11", installed())
    for row in ("gather", "spread"):
        relative, absolute = (
            compose_raw([*table.overrides, *table.variants()[f"{row}/{column}"]])
            for column in ("relative", "absolute")
        )
        assert absolute["encoder"]["image"].pop("frame") == "world"
        assert relative["encoder"]["image"].pop("frame", "tool") == "tool"
        assert absolute == relative


def test_a_toss_turns_the_disk_over() -> None:
    """The pan is thrown up and tilted: the disk leaves it, turns, and the reward counts its turning."""
    env = environment("experiment=amorphous/flip", "num_worlds=1")
    height, spin, turned = 0.0, 0.0, 0.0
    for i in range(36):
        up, tilt = (9.0, -9.0) if i < 7 else (-9.0, 9.0)
        env.advance(torch.tensor([[0.0, 0.0, up, tilt]]))
        height = max(height, float(env.table["clearance"]))
        spin = min(spin, float(env.table["material_angular_velocity"][0, 1]))
        turned = float(env.table["turned"])
    assert height > 1.0
    assert spin < -1.5
    assert turned < -math.pi, "counted over half a turn"
    assert float(env.table["caught_turn"]) > -1.0, "and not caught yet"
    caught = torch.tensor([turned])
    rewarded = flipping.spin(torch.tensor([1.0]), torch.tensor([[0.0, spin, 0.0]]))
    assert float(rewarded) < 0, "so eq. 12 asks for the direction that counts as flipped"
    assert (float(flipping.flipped(caught)), float(flipping.flipped(caught, direction=-1))) == (
        0.0,
        1.0,
    )


@pytest.mark.parametrize("material", ["granular", "viscous", "viscoplastic"])
def test_all_materials_rest_and_can_be_swapped_into_a_task(material: str) -> None:
    env = environment("experiment=amorphous/gather", f"scene.material={material}", "num_worlds=1")
    for _ in range(15):
        step = env.advance(torch.zeros(1, 3))
    active = env.table["active_particles"][0] > 0
    place = env.table["particle_position"][0][active]
    assert float(place[:, 2].min()) > 0.0
    assert float(env.table["particle_velocity"][0][active].norm(dim=1).mean()) < 0.5
    assert not bool(step.unsound.any())


@pytest.mark.parametrize(("resolution", "particles"), [(2, 1600), (3, 5400)])
def test_the_same_material_of_smaller_particles_makes_the_same_map(
    resolution: int, particles: int
) -> None:
    """Table 5's resolutions; the mass stays."""
    maps = []
    for scale in (1, resolution):
        env = environment(
            "experiment=amorphous/gather",
            f"scene.resolution={scale}",
            "num_worlds=1",
            evaluating=True,
        )
        maps.append(env.observations["image"][0, 0])
    assert env.table["particle_position"].shape[1] == particles
    assert float(maps[1].sum()) == pytest.approx(float(maps[0].sum()), rel=0.05)
    assert float((maps[1] - maps[0]).abs().max()) < 0.35 * float(maps[0].max())


@pytest.mark.parametrize("task", [*TASKS, *(f"{name}_small" for name in TASKS)])
def test_experiments_train_and_leave_pictures(task: str, tmp_path: Path) -> None:
    run = tmp_path / "run"
    assert main(["train", f"experiment=amorphous/{task}", *TINY, f"run.dir={run}"]) == 0
    section = MapsSection().html(open_run(run))
    assert section is not None
    assert section.count("data:image/png") >= 2
    assert "What the policy sees" in (run / "report.html").read_text()


def test_runs_without_maps_have_no_such_section(tmp_path: Path) -> None:
    run = tmp_path / "run"
    blind = ("experiment=amorphous/gather_small", "policy=mlp", "encoder.image=null")
    assert main(["train", *blind, *TINY, f"run.dir={run}"]) == 0
    assert MapsSection().html(open_run(run)) is None


#: By variant: the one option that it changes.
CHANGES = {
    "no_tool_reward": "reward.terms.gathering.w_3",
    "no_vicinity": "reward.terms.gathering.w_4",
    "no_farthest": "reward.terms.gathering.w_1",
    "no_gate": "reward.terms.gathering.c_5",
    "no_occupied": "reward.terms.occupied",
    "no_outliers": "reward.terms.outliers",
    "no_lowered": "reward.terms.lowered",
    "no_height": "reward.terms.height",
    "no_spin": "reward.terms.spin",
    "absolute": "encoder.image.frame",
    "medium": "scene.resolution",
    "high": "scene.resolution",
    "granular": "scene.material",
    "viscous": "scene.material",
}
NO_MOVEMENT = {"gathering": "reward.terms.gathering.w_2", "spreading": "reward.terms.movement"}
#: Variants that the paper has not.
OURS = ("no_gate",)


@pytest.mark.parametrize(
    ("ablation", "variants"),
    [
        ("gathering", 6), ("spreading", 5), ("flipping", 3), ("frames_gather", 2), ("frames_spread", 2),
        ("resolutions_gather", 3), ("resolutions_spread", 3), ("materials_gather", 3),
    ],
)  # fmt: skip
def test_every_variant_of_the_ablations_differs_in_one_thing(ablation: str, variants: int) -> None:
    raw = compose_raw([f"ablation=amorphous/{ablation}"])
    chosen: dict[str, list[str]] = raw["outer_loop"]["variants"]
    assert len(chosen) == variants
    base = f"experiment={raw['task']}"
    full = load_experiment([base]).effective()
    for name, overrides in chosen.items():
        changed = load_experiment([base, *overrides]).effective()
        found = [line.partition(":")[0] for line in differences(full, changed)]
        change = NO_MOVEMENT[ablation] if name == "no_movement" else CHANGES.get(name)
        assert found == [change] * len(overrides), name
    paper = raw["outer_loop"].get("paper")
    assert paper is None or list(paper["values"]) == [n for n in chosen if n not in OURS]
    assert raw["evaluation"].get("objective", "success_rate") in (*raw["measure"], "success_rate")


@pytest.mark.parametrize(
    ("variant", "policy", "seen"),
    [
        ("maps", "cnn", {"image": (1, 16, 16), "state": (13,)}),
        ("maps_and_touch", "cnn", {"image": (1, 16, 16), "state": (13,), "touch": (20,)}),
        ("touch", "mlp", {"state": (13,), "touch": (20,)}),
        ("neither", "mlp", {"state": (13,)}),
    ],
)
def test_a_pan_feels_in_place_of_seeing(
    variant: str, policy: str, seen: dict[str, tuple[int, ...]]
) -> None:
    raw = compose_raw(["ablation=amorphous/touch"])
    chosen = [f"experiment={raw['task']}_small", *raw["outer_loop"]["variants"][variant]]
    experiment: Any = load_experiment(chosen).effective()["policy"]
    assert experiment["name"] == policy
    assert (experiment["hidden"], experiment["learn_noise"]) == ([64, 64], True)
    assert experiment["noise"]["start"] == 0.8
    read = experiment["observation" if policy == "mlp" else "flat"]
    assert {"image", *([read] if isinstance(read, str) else read)} == {"image", *seen}
    assert environment(*chosen).observation_shapes == seen


def test_the_papers_learner_has_its_figures() -> None:
    options: Any = (
        load_experiment(["experiment=amorphous/gather", "learner=amorphous/ppo", "num_worlds=49"])
        .need("learner")
        .options
    )
    assert options.rollout_steps * 49 == 49_000
    assert (options.batch_size, options.epochs, options.gamma) == (64, 10, 0.99)
    assert options.kl_penalty is not None


def test_piles_of_several_blocks_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"places one block, and scene\.blocks=4"):
        environment("experiment=amorphous/spread", "scene.blocks=4")


@pytest.mark.parametrize(
    ("task", "words", "sentence"),
    [
        ("gather", "initial_states.distance=[5,6]", r"along x .* from -6 to 6 m, and the tool goes from -4.5 to 4.5 m"),
        ("gather", "initial_states.goal=[0,100]", r"initial_states.goal=.0.0, 100.0. is not possible: along y"),
        ("gather", "initial_states.goal_spread=5", "initial_states.goal="),
        ("gather", "initial_states.tool=[50,60]", "initial_states.tool="),
        ("gather", "initial_states.tool=[0,0]", "blocks lie up to .* m from the goal, and the tool begins outside of them"),
        ("gather", "initial_states.distance=[0.5,2.8]", "the middles of two of 4 blocks may be .* m apart, and one is .* across"),
        ("gather", "scene.spacing=1", "Put them farther away, or take fewer or smaller ones|the tool begins outside"),
        ("gather", "scene.blocks=1000", "scene.blocks=1000 is not possible: side by side they would reach 4e[+]03 m"),
        ("spread", "initial_states.spread=100", "initial_states.spread=100.0 is not possible: along x"),
        ("spread", "initial_states.tool=0", "the block reaches .* m from the middle, and the tool begins outside of it"),
        ("spread", "initial_states.tool=1000", "initial_states.tool=1000.0 is not possible"),
        ("flip", "initial_states.spread=5", "from the pan's middle, and the pan 0.9 m"),
        ("flip", "scene.block=[30,30,2]", "a smaller block"),
        ("flip", "scene.tool=scraper", "Set scene.tool=pan"),
        ("flip", "initial_states.height=1000", r"along z .* and the tool goes from 0.5 to 2 m \(actuation.limits.z\)"),
    ],
)  # fmt: skip
def test_what_is_out_of_reach_is_refused(task: str, words: str, sentence: str) -> None:
    with pytest.raises(ConfigError, match=sentence):
        environment(f"experiment=amorphous/{task}", "num_worlds=2", words)


def test_pictures_are_png_files() -> None:
    import io

    imageio = pytest.importorskip("imageio.v3")

    image = np.arange(2 * 3 * 3, dtype=np.uint8).reshape(2, 3, 3)
    assert np.array_equal(imageio.imread(io.BytesIO(png(image))), image)


def test_the_plugin_keeps_what_plugins_promise() -> None:
    check_plugin("amorphous", num_worlds=2)


@pytest.mark.gpu
@pytest.mark.parametrize("task", TASKS)
def test_steps_are_recorded_on_a_gpu_and_wait_for_nothing(task: str) -> None:
    many = ("device=cuda", "num_worlds=256", "learner.minibatches=4", "learner.rollout_steps=8")
    training = Training(load_experiment([f"experiment=amorphous/{task}", *many])).prepare()
    rollouts_without_waiting(training)


@pytest.mark.gpu
def test_a_gpu_moves_the_material_as_a_cpu_does() -> None:
    """Ten decisions of a scraper in visco-plastic clusters: the same, but for float32's order of sums."""
    found = {}
    for device in ("cpu", "cuda"):
        env = environment("experiment=amorphous/gather_small", f"device={device}", "num_worlds=4")
        for _ in range(10):
            env.advance(torch.tensor([[1.0, 0.0, 0.3]], device=device).expand(4, -1))
        found[device] = env.table["particle_position"].cpu(), env.observations["image"].cpu()
    for first, second in zip(found["cpu"], found["cuda"], strict=True):
        torch.testing.assert_close(first, second, atol=0.02, rtol=0.02)

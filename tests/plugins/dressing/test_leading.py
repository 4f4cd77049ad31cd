"""Arms that are led into the sleeve without forces, and a reward for staying near their way."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from understudy.command.cli import main
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.task import Context
from understudy_dressing.lead import Lead
from understudy_dressing.lead_grip import LeadGrip
from understudy_dressing.led import Led
from understudy_dressing.moves import TRUNK
from understudy_dressing.person import PersonScene, neutral_pose
from understudy_dressing.shirt import ShirtScene
from understudy_dressing.terms import AlongWay
from understudy_dressing.waypoints import DRESSED, HELD_AT
from understudy_skills import bank
from understudy_sweeps.film import scene_of

pytest.importorskip("potpourri3d", reason="potpourri3d is not installed")
SHIRT = ShirtScene(ShirtScene.Options(edge=0.032, substeps=5))
SMALL = ["device=cpu", "simulators.person.name=mujoco", "scenes.cloth.edge=0.032", "scenes.cloth.substeps=5",
         "num_worlds=2", "scene.steps.cloth=5", "simulators.cloth.self_contact=false", "run.video_seconds=0"]  # fmt: skip
LEAD = [
    "train",
    "experiment=dressing/shirt_sleeve",
    "job=dressing/lead",
    "job.lowers=0.1",
    "job.out=0.9",
    *SMALL,
]


def _states(pose: np.ndarray, cloth: np.ndarray, count: int = 1) -> dict[str, Tensor]:
    """Of a bank: so many of this one, at rest."""
    qpos = torch.cat([torch.tensor(pose), torch.zeros(3)]).float().expand(count, -1).clone()
    position = torch.tensor(cloth).float().expand(count, -1, -1).clone()
    return {"qpos": qpos, "qvel": torch.zeros_like(qpos), "cloth_position": position, "cloth_velocity": torch.zeros_like(position)}  # fmt: skip


@pytest.fixture(scope="module")
def starts(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bank of hands in the sleeve's mouth, from which the way is short; the first is held out."""
    states = _states(*SHIRT.settled("in_sleeve", "left"), count=3)
    # the head turned, by which they are told apart
    states["qpos"][:, 5] = torch.tensor([0.0, 0.01, 0.02])
    path = tmp_path_factory.mktemp("starts") / "bank"
    bank.save(path, states, {}, SHIRT)
    return path


@pytest.fixture(scope="module")
def run(starts: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("led") / "run"
    assert main([*LEAD, f"job.bank={starts}", "job.count=2", f"run.dir={folder}"]) == 0
    return folder


def test_it_leaves_states_of_the_way_and_what_follows(run: Path) -> None:
    found = {name: bank.load(run / name) for name in Lead.portions if (run / name).is_dir()}
    assert {"ends", "out"} <= found.keys()
    ends = found["ends"]
    assert ends["qpos"][:, 5].tolist() == pytest.approx([0.01, 0.02]), "not the one held out"
    arm = ends["way"][:, -1, 6:14]
    assert torch.allclose(arm, torch.tensor(DRESSED).expand_as(arm), atol=1e-5)
    for states in found.values():
        assert states["way"].shape[1:] == ends["way"].shape[1:]
    for pose, way in zip(found["out"]["qpos"], found["out"]["way"], strict=True):
        nearest = (ends["way"] - pose[:22]).norm(dim=2).min(dim=1)
        which = int(nearest.values.argmin())
        at = int(nearest.indices[which])
        assert nearest.values[which] < 1e-5
        assert torch.allclose(way[0], ends["way"][which, at + 1], atol=1e-5), "the next decision's"


def test_a_film_shows_the_members_of_a_run_that_has_several(run: Path) -> None:
    """As `understudy compare` draws one."""
    assert {type(one) for one in scene_of(run).members.values()} == {PersonScene, ShirtScene}  # type: ignore[attr-defined]


def test_the_second_arm_is_led_while_the_first_is_dressed(tmp_path: Path) -> None:
    """From its sleeve's mouth out to the other side, by the mirror image of the first one's way."""
    pose, cloth = SHIRT.settled("in_sleeve", "right", other_dressed=True)
    bank.save(tmp_path / "bank", _states(pose, cloth), {}, SHIRT)
    words = ["experiment=dressing/shirt_sleeve_second", "job.side=right", "job.count=1"]
    given = [word for word in LEAD if not word.startswith("experiment=")]
    assert main([*given, *words, f"job.bank={tmp_path}/bank", f"run.dir={tmp_path}/run"]) == 0
    way = bank.load(tmp_path / "run/ends")["way"][0]
    out = Led(SHIRT, "right", pose, cloth).bent({"right": DRESSED})
    assert np.allclose(way[-1, 14:], out[14:], atol=1e-5)
    assert np.allclose(way[:, 6:14], way[:1, 6:14], atol=1e-5), "the arm that holds is still"


def test_the_dressed_arms_hand_is_led_to_the_hem(tmp_path: Path) -> None:
    bank.save(tmp_path / "bank", _states(*SHIRT.settled("dressed", "left")), {}, SHIRT)
    words = ["train", "experiment=dressing/shirt_regrip", "job=dressing/lead_grip", "job.count=1", "job.speed=2.0", *SMALL]  # fmt: skip
    assert main([*words, f"job.bank={tmp_path}/bank", f"run.dir={tmp_path}/run"]) == 0
    found = {name: bank.load(tmp_path / "run" / name) for name in LeadGrip.portions}
    (taken,), (cloth,) = found["taken"]["qpos"], found["taken"]["cloth_position"]
    assert torch.allclose(found["ends"]["way"][0, -1], taken[:22])
    arm = Led(SHIRT, "left", taken[:22].double().numpy(), cloth.double().numpy())
    assert arm.grip(0.0) < 0.05, "the grip's own distance"
    assert arm.place(0).progress > 0.6, "and the arm is still in its sleeve"
    far, near = (found[name]["way"][:, 0] - taken[:22] for name in ("far", "near"))
    assert far.norm(dim=1).min() > near.norm(dim=1).max()


def test_a_dressed_person_is_led_to_the_neutral_pose(tmp_path: Path) -> None:
    pose, cloth = SHIRT.settled("dressed", "right", other_dressed=True)
    bank.save(tmp_path / "bank", _states(pose, cloth), {}, SHIRT)
    words = ["train", "experiment=dressing/shirt_finish", "job=dressing/lead_rest", "job.count=1", "job.seconds=0.8", *SMALL]  # fmt: skip
    assert main([*words, f"job.bank={tmp_path}/bank", f"run.dir={tmp_path}/run"]) == 0
    neutral = neutral_pose(PersonScene(PersonScene.Options()))
    assert torch.allclose(bank.load(tmp_path / "run/rested")["qpos"][0, :22], neutral, atol=1e-6)
    ends = bank.load(tmp_path / "run/ends")
    assert torch.equal(ends["qpos"][0, :22], torch.tensor(pose).float())
    assert torch.allclose(ends["way"][0, -1], neutral, atol=1e-6)


def test_a_place_is_reached_with_the_trunk_as_it_is_or_upright() -> None:
    pose, cloth = SHIRT.settled("dressed", "left")
    pose = pose.copy()
    pose[:TRUNK] += 0.1
    arm = Led(SHIRT, "left", pose, cloth)
    place = np.array(HELD_AT)
    for upright, trunk in ((False, pose[:TRUNK]), (True, neutral_pose(PersonScene(PersonScene.Options()))[:TRUNK])):  # fmt: skip
        found = arm.reached("right", place, upright=upright)
        assert np.allclose(found[:TRUNK], trunk, atol=1e-6)
        arm.go(found, 1.0, pose)
        assert np.linalg.norm(arm.bones("right")[0] - place) < 0.03


@pytest.mark.slow
def test_a_larger_shirt_in_more_substeps_hardly_tears(tmp_path: Path) -> None:
    """From the held hem under it and into the sleeve: an area ratio of 2.01, where the shirt of 10 sub-steps came to 4 and more."""
    words = [
        "experiment=dressing/shirt_sleeve",
        "+garment=larger_shirt",
        "job=dressing/lead_gently",
    ]
    members = load_experiment([*words, "job.bank=any"]).many("scenes")
    scene = ShirtScene(next(one.options for one in members if one.name == "cloth"))
    bank.save(tmp_path / "bank", _states(*scene.settled("held", "left"), count=2), {}, scene)
    words += ["device=cpu", "simulators.person.name=mujoco", "num_worlds=1", "run.video_seconds=0", "job.count=1"]  # fmt: skip
    held = ["job.held=true", f"job.bank={tmp_path}/bank", f"run.dir={tmp_path}/run"]
    assert main(["train", *words, *held]) == 0
    rows = [json.loads(line) for line in (tmp_path / "run/metrics.jsonl").open()]
    ratios = [row["area_ratio"] for row in rows if "area_ratio" in row]
    assert len(ratios) == 1
    assert ratios[0] < 2.1
    tucks, ends = (bank.load(tmp_path / "run" / name) for name in ("tucks", "ends"))
    assert torch.equal(tucks["way"][0, -1], ends["qpos"][0, :22]), "it ends under the hem"
    back = ["job.back=true", f"job.bank={tmp_path}/run/ends", f"run.dir={tmp_path}/again"]
    assert main(["train", *words, *back]) == 0
    again = bank.load(tmp_path / "again/ends")
    assert torch.equal(again["qpos"], ends["qpos"]), "from under the hem, and into the sleeve"
    assert not (tmp_path / "again/tucks").exists()


def test_episodes_begin_in_them_and_are_paid_for_what_follows(run: Path) -> None:
    words = [
        "experiment=dressing/shirt_sleeve_led",
        *SMALL,
        "curriculum=null",
        f"initial_states.file={run}/out",
    ]
    environment = build_environment(load_experiment(words)).environment
    environment.reset(seed=1)
    table = environment.table
    way = table["way"].clone()
    environment.step(torch.zeros(2, environment.action_size))
    term = next(t for t in environment.parts.rewards if t.name == "way")
    wanted = torch.exp(-(table["qpos"][:, :22] - way[:, 0]).square().sum(dim=1))
    assert torch.allclose(environment.evaluate(term), wanted)
    environment.close()


def test_the_reward_by_hand() -> None:
    context = Context(
        seed=0, device=torch.device("cpu"), num_worlds=2, control_dt=0.01, substeps=1, decision=4
    )
    term = AlongWay(AlongWay.Options(width=0.5), context)
    way = torch.tensor([[[0.0, 0.0], [1.0, 0.0]]]).expand(2, -1, -1)
    pose = torch.tensor([[0.3, 0.4, 9.0], [1.0, 0.5, 9.0]])
    assert term(pose, way, torch.tensor([4, 8])).tolist() == pytest.approx([np.exp(-1), np.exp(-1)])
    assert term(pose, way, torch.tensor([4, 400])).tolist() == pytest.approx(
        [np.exp(-1), np.exp(-1)]
    )


@pytest.mark.parametrize(
    "search",
    [
        "shirt_sleeve_led",
        "shirt_sleeve_second_led",
        "shirt_larger_led",
        "shirt_sleeve_larger_led",
        "shirt_larger_second_led",
    ],
)
def test_the_whole_search_composes(search: str, tmp_path: Path) -> None:
    load_experiment([f"search=dressing/{search}", f"run.dir={tmp_path}/led"])
    others = {
        "shirt_larger_led": "shirt_tuck_led",
        "shirt_larger_second_led": "shirt_tuck_second_led",
    }
    experiment = others.get(search, search)
    load_experiment([f"experiment=dressing/{experiment}", f"initial_states.file={tmp_path}/bank"])


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["job.bank=nowhere"], "The bank nowhere.json cannot be used"),
        (["job.bank=BANK", "scenes.cloth.edge=0.03"], "does not fit this task"),
        (["job.bank=BANK", "job.count=0"], "count=0"),
        (["job.bank=BANK", "job.taken=true"], "taken=true is not possible"),
        (
            ["job.bank=BANK", "experiment=dressing/sleeve_small", "scenes.cloth.substeps="],
            "ShirtScene",
        ),
        (["job.bank=POSES"], "has no 'cloth_velocity'"),
        (
            ["job.bank=BANK", "job.side=right"],
            "job 'dressing/lead' is of the right arm, and fields.sleeve.side=left",
        ),
        (
            ["job.bank=BANK", "job=dressing/lead_grip", "job.lowers=", "job.out="],
            "job 'dressing/lead_grip' is of the left arm, and fields.shirt.hand=right",
        ),
    ],
)
def test_bad_input(
    words: list[str], says: str, starts: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    states = bank.load(starts)
    del states["cloth_velocity"]
    bank.save(tmp_path / "poses", states, {}, SHIRT)
    words = [
        word.replace("BANK", str(starts)).replace("POSES", str(tmp_path / "poses"))
        for word in words
    ]
    given = [
        one for one in LEAD if not any(one.split("=")[0] == word.split("=")[0] for word in words)
    ]
    words = [word for word in words if not word.endswith("=")]  # which that garment has not
    assert main([*given, *words, f"run.dir={tmp_path}/run"]) == 2
    lines = [one for one in capsys.readouterr().err.splitlines() if one.startswith("understudy:")]
    assert len(lines) == 1
    assert says in lines[0]
    assert not (tmp_path / "run").exists()

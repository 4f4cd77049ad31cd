"""A gown from a file: its loops, where it is held, and what is answered to files that cannot be used."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from garment_files import write_gown

from understudy.command.cli import main
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy_cloth.patterns import Shirt, t_shirt
from understudy_dressing.gown import GownScene
from understudy_dressing.state import centre_and_normal

pytest.importorskip("potpourri3d", reason="potpourri3d is not installed")
MESH = Path(os.environ.get("UNDERSTUDY_DATA", "nowhere")) / "garments" / "hospitalgown_reduced.obj"
SMALL = ["device=cpu", "curriculum=null", "simulators.person.name=mujoco", "num_worlds=2", "scene.steps.cloth=5",
         "simulators.cloth.self_contact=false"]  # fmt: skip


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return write_gown(tmp_path)


@pytest.fixture
def hospital(tmp_path: Path) -> GownScene:
    if not MESH.is_file():
        pytest.skip("no gown: UNDERSTUDY_DATA is not set, or has no garments")
    (tmp_path / "gown.obj").write_bytes(MESH.read_bytes())
    loops = {"outline": {"hole": 0}, "left_sleeve": {"hole": 293}, "right_sleeve": {"hole": 258}}
    path = tmp_path / "gown.yaml"
    path.write_text(yaml.safe_dump({"mesh": "gown.obj", "unit": 1.3, "loops": loops}))
    return GownScene(GownScene.Options(file=str(path), turn=180.0))


def around(x: np.ndarray) -> float:
    return float(np.linalg.norm(np.roll(x, -1, axis=0) - x, axis=1).sum())


def test_the_gown_is_as_wide_as_the_codes_where_the_hand_goes_in(hospital: GownScene) -> None:
    """0.46 m; and the right arm's sleeve is the one that is on the right once it is turned."""
    x, loop = hospital.laid_out, hospital.sleeve("right")["entrance"]
    assert around(x[loop]) == pytest.approx(0.46, abs=0.03)
    assert x[loop, 1].mean() < x[hospital.sleeve("left")["entrance"], 1].mean()
    assert 10 <= len(hospital.patch_of(x)) <= 20


def test_it_hangs_open_towards_the_person(hospital: GownScene) -> None:
    hung = torch.from_numpy(hospital.settled())
    loop = hung[hospital.sleeve("right")["entrance"].copy()]
    centre, normal = (one[0] for one in centre_and_normal(loop[None]))
    assert normal[0] > 0.9, "the hand goes forwards"
    assert centre[2] < 0, "below what holds it"
    assert (loop.amax(0) - loop.amin(0))[1:].min() > 0.07, "room for a hand of 9 cm"


def test_steps_of_a_gown_stay_finite(file: Path) -> None:
    words = ["experiment=dressing/gown", *SMALL, f"scenes.cloth.file={file}"]
    environment = build_environment(load_experiment(words)).environment
    environment.reset(seed=1)
    for _ in range(3):
        step = environment.step(torch.zeros(2, environment.action_size))
        assert not step.unsound.any()
    assert torch.isfinite(environment.table["area_ratio"]).all()
    environment.close()


def test_what_is_not_turned_has_its_sleeves_named_by_sides(file: Path) -> None:
    for turn in (0.0, 180.0):
        scene = GownScene(GownScene.Options(file=str(file), turn=turn))
        sides = [
            scene.laid_out[scene.sleeve(side)["entrance"], 1].mean() for side in ("left", "right")
        ]  # type: ignore[arg-type]
        assert sides[0] > sides[1] + 0.3


@pytest.mark.parametrize(
    ("change", "words", "says"),
    [
        ({}, ["scenes.cloth.file=nowhere.yaml"], "nowhere.yaml cannot be read"),
        ({"unit": 0.01}, [], "m across"),
        ({"unit": 100}, [], "m across"),
        ({"loops": {"hem": {"hole": 0}}}, [], "hole"),
        ({"loops": "LOOPS_OF_OTHER_NAMES"}, [], "names no loop 'left_sleeve'"),
        ({"loops": "ONE_SLEEVE_TWICE"}, [], "are one loop"),
        ({"loops": "A_TRIANGLE"}, [], "'right_sleeve' is not the border of a hole"),
        ({}, ["scenes.cloth.loop=0.9"], "scenes.cloth.loop=0.9"),
        ({}, ["scenes.cloth.loop=0"], "loop=0"),
        ({}, ["scenes.cloth.grip=0.9"], "scenes.cloth.grip=0.9"),
        ({}, ["initial_states.low=[0,-0.2,0]", "initial_states.high=[0.1,0,0.1]"], "inside the person"),
    ],
)  # fmt: skip
def test_bad_input(
    change: dict[str, object], words: list[str], says: str, file: Path, tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    named = yaml.safe_load(file.read_text())
    loops = named["loops"]
    others = {
        "LOOPS_OF_OTHER_NAMES": {name.replace("left_sleeve", "other"): at for name, at in loops.items()},
        "ONE_SLEEVE_TWICE": {**loops, "other": loops["right_sleeve"], "right_sleeve": {**loops["left_sleeve"]}},
        "A_TRIANGLE": {**loops, "other": loops["right_sleeve"], "right_sleeve": t_shirt(Shirt(edge=0.032)).faces[700].tolist()},
    }  # fmt: skip
    if isinstance(change.get("loops"), str):
        change = {"loops": {name: {**at} if isinstance(at, dict) else at for name, at in others[str(change["loops"])].items()}}  # fmt: skip
    file.write_text(yaml.safe_dump({**named, **change}))
    given = ["experiment=dressing/gown", *SMALL, f"scenes.cloth.file={file}", *words]
    assert main(["train", *given, f"run.dir={tmp_path}/run"]) == 2
    lines = [one for one in capsys.readouterr().err.splitlines() if one.startswith("understudy:")]
    assert len(lines) == 1
    assert says in lines[0]
    assert not (tmp_path / "run").exists()

"""A bank of another garment or body, of as many numbers, is refused in one sentence; one of the same fits."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest
import torch

from understudy.command.cli import main
from understudy.errors import ConfigError, FileError
from understudy.records import checkpoint
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.task import Scene
from understudy_cloth.scene import ClothModel, ClothScene
from understudy_mujoco.scene import MujocoScene
from understudy_pbd.scene import ParticleModel, ParticleScene, Springs
from understudy_skills import bank
from understudy_training.workflow import train

#: A task whose sleeve is small enough to settle within a second or two.
SLEEVE = [
    "experiment=dressing/sleeve_small", "num_worlds=2", "scenes.cloth.edge=0.07", "run.video_seconds=0",
]  # fmt: skip
#: The same number of vertices, of other lengths.
LONGER = "scenes.cloth.length=0.45"
#: As many hinges, but others.
OTHER_HINGES = (
    "scenes.person.still=[torso,spine,neck,head,right,left_clavicle,left_wrist]",
    "fields.sleeve.side=left",
)


@pytest.fixture(scope="module")
def settled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("potpourri3d", reason="potpourri3d is not installed")
    run = tmp_path_factory.mktemp("bank") / "run"
    train([*SLEEVE, "job=settle", "job.count=2", "job.seconds=0.05", f"run.dir={run}"])
    return run


def starts(run: Path) -> list[str]:
    return [f"++initial_states={{name: bank, file: {run}}}", "episode.seconds=1"]


def test_a_bank_of_the_same_garment_and_body_fits(settled: Path) -> None:
    environment = build_environment(load_experiment([*SLEEVE, *starts(settled)])).environment
    environment.reset(seed=0)
    found = environment.table["cloth_position"][0]
    kept = bank.load(settled)["cloth_position"]
    assert any(torch.equal(found, one) for one in kept)
    environment.close()


@pytest.mark.parametrize(
    ("other", "field", "what"),
    [((LONGER,), "cloth_position", "a garment of"), (OTHER_HINGES, "qpos", "bodies of 7 joints")],
    ids=["garment", "body"],
)
def test_a_bank_of_another_is_refused(
    settled: Path,
    other: tuple[str, ...],
    field: str,
    what: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    run = tmp_path / "run"
    assert main(["train", *SLEEVE, *other, *starts(settled), f"run.dir={run}"]) == 2
    error = capsys.readouterr().err.strip().splitlines()
    assert len(error) == 1
    assert f"its '{field}' is of {what}" in error[0]
    assert "Harvest it in a task of this scene." in error[0]
    assert not run.exists(), "before anything is written"


def test_what_is_left_out_need_not_fit(settled: Path) -> None:
    built = build_environment(load_experiment([*SLEEVE, LONGER]))
    context = built.context
    with pytest.raises(ConfigError, match="here it is of a garment"):
        bank.fitting(settled, context, "it")
    assert "qpos" in bank.fitting(settled, context, "it", ["cloth_position"])
    built.environment.close()


def scene(**identity: str) -> Any:
    return SimpleNamespace(identity=lambda: identity)


def read(path: Path, own: Any) -> dict[str, torch.Tensor]:
    inputs = SimpleNamespace(file=lambda asked, find: find()[0])
    context: Any = SimpleNamespace(scene=own, simulator=None, inputs=inputs)
    return bank.fitting(path, context, "it")


def test_a_bank_that_does_not_say_whose_it_is_is_taken(tmp_path: Path) -> None:
    states = {"qpos": torch.zeros(2, 1)}
    bank.save(tmp_path / "old", states, {})
    assert read(tmp_path / "old", scene(qpos="a")).keys() == {"qpos"}
    bank.save(tmp_path / "new", states, {}, scene(qpos="a", other="b"))
    assert read(tmp_path / "new", scene(qpos="a", third="c")).keys() == {"qpos"}
    with pytest.raises(ConfigError, match="its 'qpos' is of a, and here it is of b"):
        read(tmp_path / "new", scene(qpos="b"))


@pytest.mark.parametrize("of", [3, ["qpos"], {"qpos": 3}])
def test_a_bank_whose_things_are_no_words_is_none(tmp_path: Path, of: object) -> None:
    checkpoint.save(tmp_path / "odd", {"states": {"qpos": torch.zeros(2, 1)}}, {"bank": {"of": of}})
    with pytest.raises(FileError, match="is no bank of states"):
        bank.load(tmp_path / "odd")


SQUARE = ClothModel(
    np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]), np.array([[0, 1, 2], [2, 1, 3]])
)


class Cloth(ClothScene):
    def __init__(self, **other: Any) -> None:
        self._model = replace(SQUARE, **other)

    def model(self) -> ClothModel:
        return self._model


class Particles(ParticleScene):
    def __init__(self, **other: Any) -> None:
        given = {"radius": 0.01, "mass": 0.1, **other}
        self._model = ParticleModel(np.zeros((2, 3)), **given)

    def model(self) -> ParticleModel:
        return self._model


class Arm(MujocoScene):
    def __init__(self, length: float = 0.3, name: str = "elbow", mass: float = 1.0) -> None:
        self._of = length, name, mass

    def spec(self) -> mujoco.MjSpec:
        length, name, mass = self._of
        spec = mujoco.MjSpec()
        parent = spec.worldbody
        for joint in ("shoulder", name):
            parent = parent.add_body(pos=[0, 0, -length])
            parent.add_geom(size=[0.05, 0, 0], mass=mass)
            parent.add_joint(name=joint)
        return spec


def spring(length: float) -> Springs:
    return Springs(pairs=np.array([[0, 1]]), lengths=np.array([length]))


@pytest.mark.parametrize(
    ("one", "same"),
    [
        (Cloth(), Cloth(positions=SQUARE.positions + 0.5)),
        (Cloth(), Cloth(gravity=(0.0, 0.0, 0.0), rest=SQUARE.positions[SQUARE.faces][..., :2])),
        (Arm(), Arm(mass=2.0)),
        (Particles(springs=spring(0.1)), Particles(springs=spring(0.1), mass=0.2)),
    ],
)
def test_the_same_thing_has_the_same_identity(one: Scene, same: Scene) -> None:
    assert one.identity() == same.identity() != {}


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (Cloth(), Cloth(rest=1.001 * SQUARE.positions)),
        (Cloth(), Cloth(faces=np.array([[0, 1, 3], [2, 0, 3]]))),
        (Arm(), Arm(length=0.301)),
        (Arm(), Arm(name="wrist")),
        (Particles(springs=spring(0.1)), Particles(springs=spring(0.11))),
        (Particles(), Particles(radius=0.011)),
    ],
)
def test_another_thing_has_another(one: Scene, other: Scene) -> None:
    assert one.identity().keys() == other.identity().keys()
    assert one.identity() != other.identity()

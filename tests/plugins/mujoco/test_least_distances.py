"""Least distances between groups of geoms, against MuJoCo's own."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch

from understudy.errors import ConfigError
from understudy.task import Context
from understudy_hand.scene import HandScene
from understudy_hand.tools import Thing
from understudy_mujoco.distances import Distances, Pair
from understudy_mujoco.scene import MjcfFile

FINGERS = tuple(f"{n}_distal" for n in ("thumb", "index", "middle", "ring", "little"))
STICKS = ("upper_stick", "lower_stick")


def made(**between: Pair) -> tuple[Distances, HandScene]:
    scene = HandScene(HandScene.Options(object=Thing("sphere", (0.01,))))
    context = Context(0, torch.device("cpu"), 3, control_dt=0.01, substeps=2)
    context.scene = scene
    return Distances(Distances.Options(between), context), scene


def test_they_are_mujocos_nearest_of_the_group() -> None:
    fields, scene = made(grip=Pair(FINGERS, STICKS), object=Pair(STICKS, ("object",)))
    model, generator = scene.model, np.random.default_rng(0)
    low, high = model.jnt_range[:36].T
    data, read, expected = mujoco.MjData(model), [], []
    for _ in range(3):
        data.qpos[:36] = low + (high - low) * generator.random(36)
        mujoco.mj_forward(model, data)
        read.append([data.geom_xpos.copy(), data.geom_xmat.copy()])
        expected.append([
            min(
                mujoco.mj_geomDistance(model, data, model.geom(a).id, model.geom(b).id, 1.0, None)
                for a in one for b in other
            )
            for one, other in ((FINGERS, STICKS), (STICKS, ("object",)))
        ])  # fmt: skip
    places, turns = (
        torch.tensor(np.array(v), dtype=torch.float32) for v in zip(*read, strict=True)
    )
    found = fields.compute(geom_xpos=places, geom_xmat=turns)
    assert set(found) == {"distance_grip", "distance_object"} == set(fields.provides)
    np.testing.assert_allclose(found["distance_grip"], np.array(expected)[:, 0], atol=2e-5)
    np.testing.assert_allclose(found["distance_object"], np.array(expected)[:, 1], atol=2e-5)


def test_a_model_from_a_file_has_distances_too(tmp_path: Path) -> None:
    file = tmp_path / "two.xml"
    file.write_text(
        "<mujoco><worldbody><geom name='low' size='.1'/>"
        "<geom name='high' size='.1' pos='0 0 1'/></worldbody></mujoco>"
    )
    context = Context(0, torch.device("cpu"), 1, control_dt=0.01, substeps=2)
    context.scene = scene = MjcfFile(MjcfFile.Options(str(file)))
    fields = Distances(Distances.Options({"gap": Pair(("low",), ("high",))}), context)
    data = mujoco.MjData(scene.model)
    mujoco.mj_forward(scene.model, data)
    found = fields.compute(
        geom_xpos=torch.tensor(data.geom_xpos[None], dtype=torch.float32),
        geom_xmat=torch.tensor(data.geom_xmat[None], dtype=torch.float32),
    )
    assert found["distance_gap"].item() == pytest.approx(0.8, abs=1e-6)


@pytest.mark.parametrize(
    ("pair", "said"),
    [
        (Pair(("thumb_distl",), STICKS), "which the scene has not got. Did you mean"),
        (Pair(("table",), STICKS), "'table' is neither"),
    ],
)
def test_geoms_that_cannot_be_measured(pair: Pair, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        made(one=pair)


@pytest.mark.parametrize("pair", [Pair((), STICKS), Pair(STICKS, ("upper_stick",))])
def test_groups_that_are_none(pair: Pair) -> None:
    with pytest.raises(ValueError, match="neither empty, that share no geom"):
        Distances.Options({"one": pair})

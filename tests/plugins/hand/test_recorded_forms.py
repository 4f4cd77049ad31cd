"""An object that is another one in each world, in files of what was recorded."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from understudy.records import runs
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import Plugins
from understudy_characters.recording import recorded_surroundings
from understudy_hand.scene import HandScene
from understudy_hand.tools import Thing, mujoco_sizes


@pytest.mark.parametrize(
    ("kind", "sizes", "extent"),
    [
        ("sphere", (0.007,), (0.014, 0.014, 0.014)),
        ("capsule", (0.006, 0.03), (0.042, 0.012, 0.012)),
        ("box", (0.012, 0.016, 0.02), (0.012, 0.016, 0.02)),
    ],
)
def test_a_file_has_the_object_that_the_world_had(
    kind: str, sizes: tuple[float, ...], extent: tuple[float, ...], plugins: Plugins, tmp_path: Path
) -> None:
    overrides = ["experiment=chopsticks/objects", "device=cpu", "simulator=mujoco", f"run.dir={tmp_path / 'run'}"]  # fmt: skip
    runs.create(load_experiment(overrides, plugins), overrides, {}).unlock()
    scene = HandScene(HandScene.Options(object=Thing("any", ())))
    assert scene.forms is not None
    number = scene.forms.kinds.index(kind)
    was = scene.forms.values(torch.tensor([number]), torch.tensor([mujoco_sizes(kind, sizes)]))
    tracks: dict[str, Any] = {name: value.repeat_interleave(3, 0) for name, value in was.items()}
    np.savez(
        tmp_path / "run" / "recording.npz", control_dt=0.01, first_episode=3,
        qpos=np.tile(scene.model.qpos0, (3, 1)), **tracks,
    )  # fmt: skip
    found = {shown.clip.name: shown.shapes for shown in recorded_surroundings(tmp_path / "run")}
    (shape,) = found["object"]
    np.testing.assert_allclose(np.ptp(shape.vertices, axis=0), extent, rtol=0.02)

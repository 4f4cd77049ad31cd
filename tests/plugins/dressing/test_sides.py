"""Left and right: what is of one arm in several places, and arms that are mirror images of each other."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from garment_files import write_gown

from understudy.errors import ConfigError
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy_dressing.gown import GownScene

pytest.importorskip("potpourri3d", reason="potpourri3d is not installed")
SMALL = ["device=cpu", "curriculum=null", "simulators.person.name=mujoco", "num_worlds=1", "scene.steps.cloth=5",
         "simulators.cloth.self_contact=false"]  # fmt: skip
BOTH = ["fields.sleeve.side=left", "fields.limb.side=left"]
LEFT = ["initial_states.low=[0.7,-0.2,-0.3]", "initial_states.high=[0.8,0.4,0.2]", "initial_states.end=[0,0.21,0.1]"]  # fmt: skip


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["scenes.cloth.side=left", *LEFT], "of the right arm, and the garment is held by its left sleeve"),
        (["scenes.cloth.side=left", *BOTH], r"end=\[0\.0, -0\.21, 0\.1\] is on the other side than the left arm"),
        (["fields.sleeve.side=left"], "of the left arm, and the garment is held by its right sleeve"),
        (["fields.limb.side=left"], "'dressing/limb_progress' is of the left arm, and fields.sleeve.side=right"),
        (["scenes.cloth.turn=90"], r"not to the left and right of the wearer, but 0\.\d+ m forward, 0\.0\d to the side"),
        (["scenes.cloth.loop=0.001"], "there is no ring of edges yet; give more"),
        (["scenes.cloth.loop=0.9"], "the garment is no tube; give less"),
    ],
)  # fmt: skip
def test_a_gown_held_for_another_arm_is_refused(
    words: list[str], said: str, tmp_path: Path
) -> None:
    file = f"scenes.cloth.file={write_gown(tmp_path)}"
    with pytest.raises(ConfigError, match=said):
        build_environment(load_experiment(["experiment=dressing/gown", *SMALL, file, *words]))


def test_a_gown_of_another_axis_is_refused(tmp_path: Path) -> None:
    """It lies on its side: one sleeve is above the other, and both arms had the same one."""
    file = write_gown(tmp_path)
    named = yaml.safe_load(file.read_text())
    file.write_text(yaml.safe_dump({**named, "up": "y"}))
    with pytest.raises(ConfigError, match=r"and 0\.\d+ up from each other.*correct `up`"):
        GownScene(GownScene.Options(file=str(file)))


def test_a_gown_can_be_held_for_the_left_arm(tmp_path: Path) -> None:
    file = f"scenes.cloth.file={write_gown(tmp_path)}"
    words = ["experiment=dressing/gown", *SMALL, file, "scenes.cloth.side=left", *BOTH, *LEFT]
    environment = build_environment(load_experiment(words)).environment
    environment.reset(seed=1)
    assert not environment.step(torch.zeros(1, environment.action_size)).unsound.any()
    environment.close()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["fields.shirt.side=right", "initial_states.side=right"], "'dressing/shirt_state' is of the right arm, and fields.sleeve.side=left"),
        (["initial_states.side=right"], "'dressing/worn_shirt' is of the right arm, and fields.shirt.side=left"),
    ],
)  # fmt: skip
def test_a_shirt_for_another_arm_is_refused(words: list[str], said: str) -> None:
    coarse = ["scenes.cloth.edge=0.032", "scenes.cloth.substeps=5"]
    with pytest.raises(ConfigError, match=said):
        build_environment(
            load_experiment(["experiment=dressing/shirt_grip", *SMALL, *coarse, *words])
        )


def test_a_sleeve_for_the_left_arm_is_the_mirror_image() -> None:
    found = []
    for side, other, sign in (("right", "left", -1.0), ("left", "right", 1.0)):
        words = [
            "experiment=dressing/sleeve_small", "num_worlds=1", "initial_states.noise=0.0", f"fields.sleeve.side={side}",
            f"fields.limb.side={side}", *(f"initial_states.{name}=[{x},{0.21 * sign},{z}]" for name, x, z in (
                ("low", 0.7, 0.0), ("high", 0.7, 0.0), ("end", 0.1, 0.1))),
            f"scenes.person.still=[torso,spine,neck,head,{other},{side}_clavicle,{side}_wrist]",
        ]  # fmt: skip
        environment = build_environment(load_experiment(words)).environment
        environment.reset(seed=0)
        rows = []
        for number in range(60):  # spread, swing, twist, elbow
            environment.step(torch.tensor([[0.0, -0.15 if number < 40 else 0.0, 0.0, 0.0]]))
            table = environment.table
            tip = table["fingertip"][0] * torch.tensor([1.0, sign, 1.0])
            names = ("progress", "limb_progress", "area_ratio", "touching")
            rows.append([*tip.tolist(), *(float(table[name][0]) for name in names)])
        environment.close()
        found.append(np.array(rows))
    assert found[0][:, 6].any(), "nothing was touched"
    # cloth is solved in an order that is no mirror image
    np.testing.assert_allclose(found[0], found[1], atol=0.02)
    np.testing.assert_allclose(found[0][:, :3], found[1][:, :3], atol=1e-5)

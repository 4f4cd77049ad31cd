"""Features of poses and back, and poses as targets of any character's servos."""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch
from random_characters import random_poses
from scipy.spatial.transform import Rotation

from understudy.errors import ConfigError
from understudy.setup.plugins import installed
from understudy_characters.character import Character, load_character
from understudy_characters.scene import CharacterScene
from understudy_humanoid.clips import generated_walk
from understudy_pose_vae.features import PoseFeatures, joint_rotations
from understudy_pose_vae.targets import ServoTargets
from understudy_tensors import rotations

CPU = torch.device("cpu")


@pytest.fixture(scope="module")
def humanoid() -> Character:
    return load_character("humanoid", installed().registry)


def test_rotations_come_back_from_their_features() -> None:
    """Half turns about every axis and about none too, where a naive formula divides by nothing."""
    q = torch.randn(500, 3, 4, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    half = torch.eye(4, dtype=torch.float64).roll(1, 0)[:, None].expand(4, 3, 4)
    q = rotations.normalize(torch.cat([q, half, half + 1e-9]))
    found = joint_rotations(rotations.tangent_normal(q).flatten(1), 3)
    assert rotations.angle_between(q, found).max() < 1e-7


def test_any_numbers_make_rotations() -> None:
    made = joint_rotations(torch.randn(200, 30, generator=torch.Generator().manual_seed(1)), 5)
    assert torch.allclose(made.norm(dim=-1), torch.ones(200, 5), atol=1e-5)


def test_positions_are_those_of_the_simulator(humanoid: Character) -> None:
    """Joints and links' centres of mass, whatever the root does."""
    features, clip = PoseFeatures(humanoid), generated_walk()
    local = clip.rotations[:6, [clip.joint_names.index(n) for n in features.joints]]
    found = features.of(local)
    assert found.shape == (6, features.size)
    joints = len(features.joints)
    data, qpos = mujoco.MjData(humanoid.model), humanoid.qpos(clip)[:6]
    for row in range(6):
        data.qpos[:] = qpos[row]
        mujoco.mj_kinematics(humanoid.model, data)
        root = torch.from_numpy(data.xmat[humanoid.root].reshape(3, 3).copy())
        bodies = [joint.body for joint in humanoid.joints[1:]]
        links = sorted(humanoid.carrier)
        places = torch.from_numpy(data.xpos[bodies] - data.xpos[humanoid.root]) @ root
        centres = torch.from_numpy(data.xipos[links] - data.xpos[humanoid.root]) @ root
        expected = torch.cat([places.flatten(), centres.flatten()]).float()
        assert torch.allclose(found[row, 6 * joints :], expected, atol=1e-5)


def reached(character: Character, targets: torch.Tensor) -> torch.Tensor:
    """The rotations (F, J, 4) of the joints when all servos are where `targets` (F, U) say."""
    model = character.model
    qpos = torch.from_numpy(model.qpos0.copy()).repeat(len(targets), 1)
    balls: dict[int, torch.Tensor] = {}
    for servo in range(model.nu):
        joint = int(model.actuator_trnid[servo, 0])
        at = int(model.jnt_qposadr[joint])
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_BALL:
            axis = int(abs(model.actuator_gear[servo, :3]).argmax())
            balls.setdefault(at, torch.zeros(len(targets), 3))[:, axis] = targets[:, servo]
        else:
            qpos[:, at] = targets[:, servo].double()
    for at, vector in balls.items():
        qpos[:, at : at + 4] = rotations.from_exponential_map(vector.double())
    times = torch.arange(len(targets), dtype=torch.float64)
    return character.clip(qpos, times, name="reached").rotations[:, 1:]


def random_figure(seed: int) -> str:
    """MJCF of a trunk on which hang a ball and one, two and three hinges, one on the other, on bodies
    that stand anyhow in the zero pose."""
    rng = np.random.default_rng(seed)

    def text(values: np.ndarray) -> str:
        return " ".join(map(str, values))

    inner = ""
    for count in rng.permutation([0, 1, 2, 3]):
        frame = Rotation.random(random_state=rng.integers(1 << 30))
        axes = frame.as_matrix()[:count]
        hinges = "".join(f'<joint axis="{text(a)}" pos="0.1 0 0"/>' for a in axes)
        joints = hinges or '<joint type="ball" pos="0 0.1 0"/>'
        quat = text(Rotation.random(random_state=rng.integers(1 << 30)).as_quat())
        inner = f'<body name="b{count}" pos="0.2 0.1 0.3" quat="{quat}">{joints}<geom size="0.1"/>{inner}</body>'
    root = '<freejoint/><geom size="0.2"/>'
    quat = text(Rotation.random(random_state=rng.integers(1 << 30)).as_quat())
    return (
        '<mujoco><worldbody><body name="trunk" pos="0 0 2" quat="'
        f'{quat}">{root}{inner}</body></worldbody></mujoco>'
    )


@pytest.mark.parametrize("seed", range(8))
def test_servos_turn_any_characters_joints_as_told(seed: int, tmp_path: Path) -> None:
    """Balls, and one to three hinges on bodies that stand anyhow in the zero pose."""
    path = tmp_path / "figure.xml"
    path.write_text(random_figure(seed))
    character = CharacterScene(CharacterScene.Options(str(path))).character
    qpos = random_poses(character.model, seed, 20)
    clip = character.clip(qpos, torch.arange(20, dtype=torch.float64), name="poses")
    local = clip.rotations[:, 1:].float()
    names = character.joint_names[1:]
    back = torch.randperm(len(names), generator=torch.Generator().manual_seed(seed)).tolist()
    targets = ServoTargets(character, [names[i] for i in back], "RUN", CPU)
    assert targets(local[:, back]).shape == (20, character.model.nu)
    found = targets(local[:, back])
    assert rotations.angle_between(reached(character, found), local.double()).max() < 2e-3
    assert found.abs().max() < 2 * math.pi


def test_on_the_humanoid_targets_are_those_of_the_clip(humanoid: Character) -> None:
    clip = generated_walk()
    names = humanoid.joint_names[1:]
    local = clip.rotations[:, [clip.joint_names.index(n) for n in names]].float()
    targets = ServoTargets(humanoid, names, "RUN", CPU)(local)
    assert targets.shape == (len(local), 28)
    assert rotations.angle_between(reached(humanoid, targets), local.double()).max() < 2e-3


def test_a_joint_without_a_pose_is_one_sentence(humanoid: Character) -> None:
    names = [n for n in humanoid.joint_names[1:] if n != "neck"]
    with pytest.raises(ConfigError, match="RUN makes poses without a joint 'neck'") as error:
        ServoTargets(humanoid, names, "RUN", CPU)
    assert "\n" not in str(error.value)

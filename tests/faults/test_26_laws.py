"""Fault 26: laws that hold for every part. Rotations and GAE have property tests of their own
(``tests/plugins/networks``)."""

from __future__ import annotations

import pytest
import torch

from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.testing import check_environment
from understudy_characters.scene import reference_motion
from understudy_humanoid.character import BODIES

WALK = ("experiment=spacetime/walk", "num_worlds=6")


def test_phase_wraps() -> None:
    built = build_environment(load_experiment(WALK))
    reference = reference_motion(built.context)
    times = torch.linspace(0.0, 5 * reference.duration, 101)
    first, later = reference.sample(times), reference.sample(times + reference.duration)
    assert ((first["phase"] >= 0) & (first["phase"] < 1)).all()
    apart = (first["phase"] - later["phase"]).abs()
    assert torch.minimum(apart, 1 - apart).max() < 1e-4
    joints = first["reference_joint_rotations"] - later["reference_joint_rotations"]
    assert joints.abs().max() < 1e-3


def test_rewards_stay_in_range_and_torques_within_limits() -> None:
    built = build_environment(load_experiment([*WALK, "episode.seconds=1"]))
    environment = built.environment
    limits = torch.tensor(
        [
            joint.torque
            for row in BODIES
            for joint in row.joints
            for _ in range(3 if joint.kind == "ball" else 1)
        ]
    )
    generator = torch.Generator().manual_seed(0)
    environment.reset()
    for _ in range(20):
        step = environment.step(4 * torch.randn(6, 28, generator=generator))
        assert ((step.rewards == 0) | (step.rewards == 1)).all()
        force = environment.parts.simulator.read("actuator_force").abs()
        assert (force <= limits + 1e-3).all()


@pytest.mark.parametrize(
    "overrides",
    [
        (),
        ("policy=mlp",),
        ("initial_states=spacetime/uniform",),
        ("initial_states=spacetime/evolution",),
        ("~termination.terms.com", "~termination.terms.end_effectors"),
        ("scene.self_collision=true",),
        ("control.frequency=60", "control.substeps=10"),
        ("motion.name=walk", "termination.terms.root.size=[[0, 0.4], [0.5, 1.0]]"),
        ("reward.combine=sum", "reward.terms.survival.weight=2"),
    ],
    ids=" ".join,
)
def test_any_configuration_resets_and_steps_finite(overrides: tuple[str, ...]) -> None:
    environment = build_environment(load_experiment([*WALK, *overrides])).environment
    check_environment(environment, steps=12)

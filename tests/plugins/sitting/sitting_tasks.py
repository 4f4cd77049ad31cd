"""Tasks of sitting, and how they are acted in without a policy."""

from __future__ import annotations

from understudy.running.environment import Environment
from understudy.setup.building import Built, build_environment
from understudy.setup.composition import load_experiment


def build(*overrides: str) -> Built:
    return build_environment(load_experiment(list(overrides)))


def follow_clip(environment: Environment, steps: int) -> None:
    """Let the servos follow the clip's own targets, for `steps` decisions."""
    actuation = environment.parts.actuation.part
    nothing = environment.action * 0.0
    middle = actuation.control(nothing)
    unit = actuation.control(nothing + 1.0) - middle
    for _ in range(steps):
        environment.step((environment.table["reference_joint_targets"] - middle) / unit)

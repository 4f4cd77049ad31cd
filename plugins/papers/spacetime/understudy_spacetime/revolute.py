# pyright: reportAttributeAccessIssue=false
"""The robot onto which motions of people are transferred by bounds alone (thesis, section 3.5.2)."""

from __future__ import annotations

from pathlib import Path

import mujoco


def build_revolute() -> mujoco.MjSpec:
    """A robot whose ball joints are three hinges each, and whose proportions are no person's.

    The paper's is PyBullet's Atlas, whose model is not ours to ship; this one differs from the
    humanoid in the same ways.
    """
    return mujoco.MjSpec.from_file(str(Path(__file__).parent / "revolute.xml"))

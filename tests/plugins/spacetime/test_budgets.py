"""A clip of one's own has the budget of its kind of skill."""

from __future__ import annotations

from understudy.setup.composition import compose_raw


def test_a_fast_skill_has_not_the_budget_of_the_walk() -> None:
    """At 4.1 M samples a flip has not been learned (table 3.1: up to 41.6 M)."""
    walk = compose_raw(["experiment=spacetime/walk", "motion.file=mine.npz"])
    fast = compose_raw(["experiment=spacetime/dynamic", "motion.file=mine.npz"])
    assert walk["budget"]["samples"] == 4_080_000
    assert fast["budget"]["samples"] == 41_630_000

"""A harvest of its own simulator, of tasks that come with plugins."""

from __future__ import annotations

from understudy.setup.composition import load_experiment
from understudy_skills.harvest import _with_simulators, _without_simulators


def test_a_member_of_a_composite_may_have_another_simulator() -> None:
    """As where a packed skill, which plays on a CPU, is harvested on a GPU."""
    found = load_experiment(["experiment=dressing/sleeve_small"])
    own = load_experiment(["job=harvest", "job.run=x", "simulators.person.name=mujoco_warp"])
    config = {
        "simulator": {"name": "composite"},
        "simulators": {"person": {"threads": 1}, "cloth": {}},
    }
    assert _without_simulators(config, own) == {**config, "simulators": {"cloth": {}}}
    members = {c.name: c.component.name for c in _with_simulators(found, own)["simulators"]}
    assert members == {"person": "mujoco_warp", "cloth": "cloth"}
    before = {c.name: c.component.name for c in found.choices["simulators"]}
    assert before == {"person": "mujoco", "cloth": "cloth"}


def test_a_simulator_of_the_harvest_takes_the_runs_place() -> None:
    found = load_experiment(["experiment=spacetime/walk"])
    own = load_experiment(["job=harvest", "job.run=x", "simulator=mujoco_warp", "device=cpu"])
    assert "simulator" not in _without_simulators({"simulator": {"name": "mujoco"}}, own)
    assert [c.component.name for c in _with_simulators(found, own)["simulator"]] == ["mujoco_warp"]
    nothing = load_experiment(["job=harvest", "job.run=x"])
    assert _with_simulators(found, nothing)["simulator"] == found.choices["simulator"]

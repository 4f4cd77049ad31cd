from __future__ import annotations

import pytest
from worlds import SMALL

from understudy.errors import ConfigError
from understudy.setup.config import compose_raw, load_experiment, provenance, refuse_code, validate
from understudy.setup.plugins import Plugins
from understudy.testing.fake import FAKE_TASK


def test_experiment(plugins: Plugins) -> None:
    experiment = load_experiment([*FAKE_TASK, *SMALL, "+reward.terms.near.weight=2"], plugins)
    assert experiment.root.num_worlds == 16
    assert experiment.scene.component.plugin == "fake"
    assert [(t.name, t.weight, dict(t.options)) for t in experiment.rewards] == [("near", 2.0, {})]
    assert [(t.name, t.outcome) for t in experiment.terminations] == [("far", "failure")]
    assert experiment.learner is not None
    assert experiment.learner.options.rollout_steps == 8
    used = {c.name for c in experiment.components()}
    assert {"fake", "fake.point", "fake.near_origin", "fake.far_away", "ppo", "mlp"} <= used
    again = validate(experiment.raw, plugins.registry)
    assert again.root == experiment.root


def test_null_removes_a_term(plugins: Plugins) -> None:
    more = ["+reward.terms.more={name: fake.near_origin, scale: 3}", "reward.terms.near=null"]
    assert [t.name for t in load_experiment([*FAKE_TASK, *more], plugins).rewards] == ["more"]


def test_provenance(plugins: Plugins) -> None:
    """Each value with the file that set it, or the command line."""
    overrides = [
        "learner=ppo",
        "seed=3",
        "control.frequency=60",
        "+learner.clip=0.3",
        "evaluation.failures=[far]",
        "+scene={name: fake}",
        "+policy.noise={start: 1, end: 2}",
    ]
    origin = provenance(overrides, plugins)
    assert origin["num_worlds"] == "conf/config.yaml"
    assert origin["control.substeps"] == "conf/config.yaml"
    assert origin["learner.name"] == "plugins/ppo/understudy_ppo/conf/learner/ppo.yaml"
    assert origin["seed"] == "command line: seed=3"
    assert origin["control.frequency"] == "command line: control.frequency=60"
    assert origin["learner.clip"] == "command line: +learner.clip=0.3"
    assert origin["evaluation.failures"] == "command line: evaluation.failures=[far]"
    assert origin["scene.name"] == "command line: +scene={name: fake}"
    assert origin["policy.noise.end"] == "command line: +policy.noise={start: 1, end: 2}"


def test_every_value_has_an_origin(plugins: Plugins) -> None:
    def leaves(value: object, prefix: str = "") -> list[str]:
        if isinstance(value, dict) and value:
            return [
                x for k, v in value.items() for x in leaves(v, f"{prefix}.{k}" if prefix else k)
            ]
        return [prefix]

    overrides = ["experiment=spacetime/walk", "seed=3"]
    origin = provenance(overrides, plugins)
    assert not [key for key in leaves(compose_raw(overrides, plugins)) if key not in origin]


def test_refuse_code() -> None:
    refuse_code({"a": [{"name": "x", "target": 1}]})
    with pytest.raises(
        ConfigError, match=r"^a\[0\]\.b\._target_: configurations name registered components"
    ):
        refuse_code({"a": [{"b": {"_target_": "os.system"}}]})


def test_composing_leaves_hydra_clean(plugins: Plugins) -> None:
    first = compose_raw([*FAKE_TASK], plugins)
    with pytest.raises(ConfigError):
        compose_raw(["learner=nothing"], plugins)
    assert compose_raw([*FAKE_TASK], plugins) == first

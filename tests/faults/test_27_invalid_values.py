"""Fault 27: each invalid value fails at composition with its key path; none at iteration 10 000."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from worlds import PADDLE_TASK, SMALL

from understudy.command.cli import main
from understudy.errors import ConfigError
from understudy.running.training import Training
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import Plugins
from understudy.testing.fake import FAKE_TASK

#: Key path and values that cannot work.
INVALID: dict[str, tuple[str, ...]] = {
    "num_worlds": ("0", "-1", "1.5", "abc", "null", "true", "[1]"),
    "seed": ("-1", "9223372036854775808", "x", "0.5", f"1{400 * '0'}"),
    "control.frequency": ("-1", "0", "inf", "nan", "null", "fast"),
    "control.substeps": ("0", "-3", "0.5", "1e9"),
    "episode.seconds": ("0", "-2", "nan", "inf"),
    "budget.samples": ("-5", "0", "1.5", "lots", f"1{400 * '0'}"),
    "budget.minutes": ("-1", "0", "nan", "inf"),
    "evaluation.episodes": ("0", "-1", "2.5"),
    "evaluation.seconds": ("0", "-1", "nan"),
    "evaluation.criterion": ("2", "0", "-0.1", "nan"),
    "evaluation.gate": ("-0.1", "1.1", "nan"),
    "evaluation.every_samples": ("-1", "0.5"),
    "evaluation.failures": ("[fa]", "far", "[3]"),
    "checkpoint.keep": ("0", "-1"),
    "checkpoint.minutes": ("-1", "nan", "inf"),
    "run.video_seconds": ("-1", "inf"),
    "reward.combine": ("average",),
    "+reward.terms.near.scale": ("abc", "nan", "inf", "[1]", "null"),
    "+reward.terms.near.weight": ("nan", "heavy"),
    "+termination.terms.far.outcome": ("fail", "3"),
    "+termination.terms.far.limit": ("abc",),
    "+initial_states.spread": ("nan", "wide"),
    "policy.hidden": ("[0]", "[16, -1]", "[1.5]", "16", "[a]"),
    "+policy.noise.start": ("0", "-1", "nan", "inf"),
    "+policy.activation": ("sin",),
    "+policy.final_scale": ("-1",),
    "+policy.noise": ("{start: 0.1, end: 0}", "{start: 0, end: 0.1}", "0.1", "{start: 0.1, end: 0.1, samples: 0}"),
    "learner.rollout_steps": ("0", "-1", "2.5"),
    "learner.epochs": ("0",),
    "learner.minibatches": ("0", "-32"),
    "+learner.gamma": ("1.5", "-0.1", "nan", f"1{400 * '0'}", f"-1{400 * '0'}"),
    "+learner.gae_lambda": ("1.5",),
    "+learner.td_lambda": ("-1",),
    "+learner.clip": ("0", "-0.2", "nan", "inf"),
    "+learner.actor_learning_rate": ("0", "-1e-3", "inf"),
    "+learner.critic_learning_rate": ("0", "nan"),
    "+learner.entropy_weight": ("-1", "nan"),
    "+learner.max_gradient_norm": ("0", "inf"),
    "+learner.patience": ("0",),
    "+learner.precision": ("float16",),
    "simulator.name": ("fak", "3"),
    "learner.name": ("pop",),
    "reward.terms.near.name": ("fake/near",),
}  # fmt: skip

CASES = [(key, value) for key, values in INVALID.items() for value in values]


@pytest.mark.parametrize(("key", "value"), CASES, ids=[f"{k}={v}" for k, v in CASES])
def test_refused_with_its_key_path(plugins: Plugins, key: str, value: str) -> None:
    path = key.lstrip("+")
    override = f"{key}={value}"
    if path == "policy.noise.start":
        override = f"+policy.noise={{start: {value}, end: 0.1}}"
    with pytest.raises(ConfigError) as caught:
        load_experiment([*FAKE_TASK, *SMALL, override], plugins)
    message = str(caught.value)
    if path.endswith(".name"):
        path = path.removesuffix(".name")
    assert path in message, message
    assert "config." not in message, message
    assert "\n" not in message


@pytest.mark.parametrize("value", ["-1", "x", "1.5"])
def test_simulator_threads(plugins: Plugins, value: str) -> None:
    with pytest.raises(ConfigError, match=r"^simulator\.threads="):
        load_experiment([*PADDLE_TASK, *SMALL, f"simulator.threads={value}"], plugins)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        (
            "+num_world=3",
            r"There is no configuration key 'num_world'\. Did you mean 'num_worlds'\?",
        ),
        ("num_world=3", r"num_world"),
        (
            "+control.frequenzy=3",
            r"^control has no option 'frequenzy'\. Did you mean 'frequency'\?",
        ),
        ("+learner.gama=0.9", r"^learner has no option 'gama'\. Did you mean 'gamma'\?"),
        (
            "+policy.noise={strt: 1}",
            r"^policy\.noise has no option 'strt'\. Did you mean 'start'\?",
        ),
        ("+policy.noise={start: 1}", r"^policy\.noise\.end is not set"),
        (
            "+reward.terms.near.scal=1",
            r"^reward\.terms\.near has no option 'scal'\. Did you mean 'scale'\?",
        ),
        ("+simulator.threads=1", r"^simulator has no option 'threads'"),
        ("+reward.terms.more={weight: 2}", r"^reward\.terms\.more must be \{name: COMPONENT"),
        ("+encoder.more=3", r"^encoder\.more must be"),
        ("learner=pop", r"learner=pop"),
        ("seed=[", r"."),
        ("=3", r"."),
        ("seed=${nowhere}", r"nowhere"),
        ("seed=???", r"seed"),
        ("experiment=walk", r"experiment=walk"),
    ],
)
def test_keys_and_slots(plugins: Plugins, override: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        load_experiment([*FAKE_TASK, *SMALL, override], plugins)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("reward.terms.near=null", r"^reward\.terms is empty"),
        ("encoder.state=null", r"^encoder is empty"),
        ("device=quantum", r"^device=quantum is no device"),
        (
            "learner.minibatches=100000",
            r"^learner\.minibatches=100000 are more than the samples of an iteration",
        ),
        ("+policy.observation=stat", r"needs the observation 'stat'.*Did you mean 'state'\?"),
    ],
)
def test_refused_before_the_first_step(plugins: Plugins, override: str, message: str) -> None:
    """What depends on several values together fails when the parts are built."""
    with pytest.raises(ConfigError, match=message):
        Training(load_experiment([*FAKE_TASK, *SMALL, override], plugins)).prepare()


@pytest.mark.parametrize(
    "slot", ["scene", "simulator", "actuation", "initial_states", "policy", "learner"]
)
def test_missing_part(plugins: Plugins, slot: str) -> None:
    overrides = [o for o in (*FAKE_TASK, *SMALL) if slot not in o.partition("=")[0]]
    with pytest.raises(ConfigError, match=rf"^{slot} is not set"):
        Training(load_experiment(overrides, plugins)).prepare()


def test_one_sample_is_too_few(plugins: Plugins) -> None:
    overrides = [
        *FAKE_TASK,
        *SMALL,
        "num_worlds=1",
        "learner.rollout_steps=1",
        "learner.minibatches=1",
    ]
    with pytest.raises(ConfigError, match=r"raise num_worlds or learner\.rollout_steps"):
        Training(load_experiment(overrides, plugins)).prepare()


@pytest.mark.parametrize(
    "override",
    ["num_worlds=2e1", "budget.samples=1e6", "control.frequency=60", "policy.hidden=[]", "evaluation.criterion=1",
     "checkpoint.minutes=0", "+reward.terms.near.scale=2", "evaluation.every_samples=0", "budget.minutes=null"],
)  # fmt: skip
def test_unusual_but_possible(plugins: Plugins, override: str) -> None:
    training = Training(load_experiment([*FAKE_TASK, *SMALL, override], plugins)).prepare()
    row = training.iterate()
    assert row["skipped_steps"] == 0


@pytest.mark.parametrize("value", ["{0}", "-{0}", "[{0}]", "{{a: {0}}}"])
def test_a_number_of_more_digits_than_are_read(plugins: Plugins, value: str) -> None:
    """Python reads 4300; it ended in a traceback."""
    override = f"learner.gamma={value.format(9 * '1234567890' * 60)}"
    with pytest.raises(ConfigError, match=r"cannot be read|takes a number"):
        load_experiment([*FAKE_TASK, *SMALL, override], plugins)


def test_what_a_message_quotes_of_a_file_is_cut(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A terminal was filled with a hundred thousand letters."""
    file = tmp_path / "room.json"
    objects = [{"label": "chair", "centre": 100_000 * "x", "size": [1, 1, 1]}]
    file.write_text(json.dumps({"camera": {}, "objects": objects}))
    assert main(["config", "experiment=sitting/sit", f"+room.file={100_000 * 'x'}"]) == 2
    capsys.readouterr()
    assert main(["train", "experiment=sitting/sit", f"+room.file={file}"]) == 2
    assert 0 < len(capsys.readouterr().err) < 11_000

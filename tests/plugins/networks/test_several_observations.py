"""Networks of several observations, for the actor and for the critic apart."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from understudy.command.cli import main
from understudy.errors import ConfigError
from understudy.options import make_options
from understudy.running.training import Training
from understudy.setup.composition import load_experiment
from understudy.task import Context, box
from understudy_networks.policies import CNNPolicy, MLPPolicy
from understudy_reinforcement.policy import Policy

SHAPES = {"state": (5,), "extra": (2,), "secret": (3,), "image": (2, 8, 8)}
SMALL = ["num_worlds=4", "run.dir=run", "budget.samples=64", "learner.rollout_steps=8"]
GO = ["experiment=miniature/go", "encoder.extra={name: miniature/reach}"]


def make(kind: str, **options: Any) -> Policy:
    torch.manual_seed(0)
    context = Context(
        seed=0, device=torch.device("cpu"), num_worlds=6, control_dt=1.0, substeps=1,
        action_space=box(3), observation_shapes=SHAPES,
    )  # fmt: skip
    if kind == "mlp":
        return MLPPolicy(
            make_options(MLPPolicy.Options, {"hidden": [8], **options}, "policy"), context
        )
    flat = {"flat" if key == "observation" else key: value for key, value in options.items()}
    return CNNPolicy(make_options(CNNPolicy.Options, flat, "policy"), context)


def seen() -> dict[str, Tensor]:
    chance = torch.Generator().manual_seed(0)
    return {name: torch.randn(6, *shape, generator=chance) for name, shape in SHAPES.items()}


def moved(policy: Policy, name: str) -> tuple[bool, bool]:
    """Whether what the actor, and what the critic, gives changes with the observation `name`."""
    other = {**seen(), name: seen()[name] + 1}
    actor = policy.distribution(seen()).mode(), policy.distribution(other).mode()
    critic = policy.value(seen()), policy.value(other)
    return not torch.equal(*actor), not torch.equal(*critic)


@pytest.mark.parametrize("kind", ["mlp", "cnn"])
def test_who_reads_what(kind: str) -> None:
    both = make(kind, observation=["state", "extra"])
    assert [moved(both, name) for name in ("state", "extra", "secret")] == [
        (True, True),
        (True, True),
        (False, False),
    ]
    apart = make(kind, observation="state", critic=["state", "secret"])
    assert [moved(apart, name) for name in ("state", "extra", "secret")] == [
        (True, True),
        (False, False),
        (False, True),
    ]


@pytest.mark.parametrize("kind", ["mlp", "cnn"])
def test_each_is_normalised_by_its_own(kind: str) -> None:
    """After samples of spread 10 about 3 the network sees what it saw of a standard normal."""
    policy = make(kind, observation=["state", "extra"], critic=["secret", "extra"])
    before = policy.distribution(seen()).mode(), policy.value(seen())
    flat = ("state", "extra", "secret")
    chance = torch.Generator().manual_seed(1)
    many = {n: 10 * torch.randn(20_000, *SHAPES[n], generator=chance) + 3 for n in flat}
    policy.observe(many)
    far = {**seen(), **{name: 10 * seen()[name] + 3 for name in flat}}
    torch.testing.assert_close(policy.distribution(far).mode(), before[0], atol=2e-2, rtol=0.05)
    torch.testing.assert_close(policy.value(far), before[1], atol=2e-2, rtol=0.05)


@pytest.mark.parametrize("kind", ["mlp", "cnn"])
def test_one_name_is_what_it_was(kind: str) -> None:
    """Checkpoints of before have the same tensors under the same names, and the same numbers at the start."""
    one, listed = make(kind), make(kind, observation=["state"])
    assert list(one.state_dict()) == list(listed.state_dict())
    assert not any("critic_normaliser" in name for name in one.state_dict())
    assert all(map(torch.equal, one.state_dict().values(), listed.state_dict().values()))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"observation": []}, "name each observation once, one at least"),
        ({"observation": ["state", "state"]}, "name each observation once"),
        ({"critic": []}, "name each observation once"),
        ({"observation": ["state", "extr"]}, "Did you mean 'extra'"),
        ({"critic": ["secrets"]}, "Did you mean 'secret'"),
        ({"observation": ["state", "image"]}, "needs a flat observation 'image'"),
        ({"observation": {"a": 3}}, "it takes"),
    ],
)
def test_refused(options: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        make("mlp", **options)


def test_what_nobody_reads_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    first = Training(load_experiment([*GO, *SMALL])).prepare()
    read, note = first.job.notes()
    assert read == "The policy reads state [4] (actor and critic)."
    assert "No network reads the observation 'extra'" in note
    advice = next(word for word in note.split() if word.startswith("policy.")).rstrip(";")
    first.close()
    second = Training(load_experiment([*GO, *SMALL, advice])).prepare()
    (read,) = second.job.notes()
    assert read == "The policy reads state [4] (actor and critic), extra [4] (actor and critic)."
    second.close()
    third = Training(load_experiment([*GO, *SMALL, "policy.critic=[state,extra]"])).prepare()
    (read,) = third.job.notes()
    assert read == "The policy reads state [4] (actor and critic), extra [4] (critic)."
    third.close()


def test_an_added_observation_trains_plays_and_exports(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    onnx = pytest.importorskip("onnx")
    pytest.importorskip("onnxscript")
    monkeypatch.chdir(tmp_path)
    words = [
        "policy.observation=[state,extra]",
        "policy.critic=[state,extra,more]",
        "encoder.more={name: miniature/reach}",
    ]
    assert main(["train", *GO, *SMALL, *words]) == 0
    assert "No network reads" not in capsys.readouterr().err
    assert main(["evaluate", "run", "episodes=2", "seconds=1"]) == 0
    assert main(["export", "run", "go.onnx"]) == 0
    model = onnx.load("go.onnx")
    assert [entry.name for entry in model.graph.input] == ["state", "extra"]
    told = {entry.key: entry.value for entry in model.metadata_props}
    assert "code understudy" in told["licence"]

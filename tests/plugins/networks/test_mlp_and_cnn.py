"""The policies: what they refuse, what they see, and that learning moves actor and critic alone."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.options import make_options
from understudy.random import WorldStreams
from understudy.setup.plugins import Plugins
from understudy.task import ActionSpace, Box, Choice, Context, box
from understudy.testing import check_plugin
from understudy_networks.nn import DiagonalGaussian, Joint, Schedule, set_precision
from understudy_networks.policies import CNNPolicy, MLPPolicy
from understudy_reinforcement.policy import Policy

HYBRID = ActionSpace({"skill": Choice(4), "target": Box(2)})


def context(space: ActionSpace | None = None, **shapes: tuple[int, ...]) -> Context:
    return Context(
        seed=0,
        device=torch.device("cpu"),
        num_worlds=6,
        control_dt=1.0,
        substeps=1,
        action_space=space or box(3),
        observation_shapes=shapes or {"state": (5,), "image": (2, 32, 32)},
    )


def seen(*batch: int) -> dict[str, Tensor]:
    chance = torch.Generator().manual_seed(0)
    return {
        "state": torch.randn(*batch, 5, generator=chance),
        "image": torch.rand(*batch, 2, 32, 32, generator=chance),
    }


def make(kind: str, space: ActionSpace | None = None, **options: Any) -> Policy:
    torch.manual_seed(0)
    if kind == "mlp":
        return MLPPolicy(MLPPolicy.Options(hidden=(16,), **options), context(space))
    return CNNPolicy(CNNPolicy.Options(**options), context(space))


def test_plugin_conforms(plugins: Plugins) -> None:
    check_plugin("networks", plugins)


@pytest.mark.parametrize("kind", ["mlp", "cnn"])
def test_shapes_for_any_batch_and_any_space(kind: str) -> None:
    policy = make(kind)
    distribution = policy.distribution(seen(4, 6))
    assert isinstance(distribution, DiagonalGaussian)
    assert distribution.mean.shape == (4, 6, 3)
    assert policy.value(seen(4, 6)).shape == (4, 6)
    hybrid = make(kind, HYBRID).distribution(seen(6))
    assert isinstance(hybrid, Joint)
    action = hybrid.sample(WorldStreams(0, "a", 6, "cpu"))
    assert action.shape == (6, 3)
    assert hybrid.log_prob(action).shape == (6,)
    assert set(HYBRID.split(action)["skill"].tolist()) <= {0, 1, 2, 3}
    only_choice = make(kind, ActionSpace({"skill": Choice(4)})).distribution(seen(6))
    assert only_choice.mode().shape == (6, 1)


@pytest.mark.parametrize("kind", ["mlp", "cnn"])
def test_rows_do_not_depend_on_one_another(kind: str) -> None:
    policy, whole = make(kind), seen(4, 6)
    part = {name: value[2] for name, value in whole.items()}
    torch.testing.assert_close(policy.value(whole)[2], policy.value(part))
    torch.testing.assert_close(
        policy.distribution(whole).mode()[2], policy.distribution(part).mode()
    )


@pytest.mark.parametrize("learn_noise", [False, True])
@pytest.mark.parametrize("kind", ["mlp", "cnn"])
def test_every_learned_weight_is_the_actors_or_the_critics(kind: str, learn_noise: bool) -> None:
    policy = make(kind, learn_noise=learn_noise)
    actor, critic = (
        {id(p) for p in f()} for f in (policy.actor_parameters, policy.critic_parameters)
    )
    assert not actor & critic
    assert actor | critic == {id(p) for p in policy.parameters() if p.requires_grad}
    distribution, value = policy.distribution(seen(6)), policy.value(seen(6))
    (distribution.mode().sum() + distribution.entropy().sum()).backward()
    assert all(p.grad is None for p in policy.critic_parameters())
    assert all(p.grad is not None and p.grad.any() for p in policy.actor_parameters())
    value.sum().backward()
    assert all(p.grad is not None for p in policy.critic_parameters())


def test_only_the_flat_observation_is_normalised() -> None:
    policy = make("cnn")
    before = policy.value(seen(6))
    policy.observe({k: 10 * v + 3 for k, v in seen(50, 6).items()})
    moved = {**seen(6), "state": 10 * seen(6)["state"] + 3}
    assert not torch.allclose(policy.value(seen(6)), before)
    torch.testing.assert_close(policy.value(moved), before, atol=0.1, rtol=0.1)
    brighter = {**seen(6), "image": 2 * seen(6)["image"]}
    assert not torch.allclose(policy.value(brighter), policy.value(seen(6)))


def test_an_image_alone() -> None:
    policy = make("cnn", flat=None)
    image = {"image": seen(6)["image"]}
    policy.observe(image)
    assert policy.value(image).shape == (6,)


def test_the_published_network() -> None:
    """Figure 3: conv(5, 2, 1), pool 2, conv(3, 2, 1), pool 2, FC 32, beside O_tool, FC 64, FC 64."""
    policy = make("cnn")
    assert isinstance(policy, CNNPolicy)
    shapes = [tuple(p.shape) for p in policy.actor_parameters() if p.ndim > 1]
    assert shapes == [
        (2, 2 + 2, 5, 5), (2, 2, 3, 3), (32, 2 * 8 * 8), (64, 32 + 5), (64, 64), (3, 64),
    ]  # fmt: skip


@pytest.mark.parametrize("coordinates", [True, False])
def test_only_with_coordinates_it_matters_where_a_shape_is(coordinates: bool) -> None:
    policy = make("cnn", coordinates=coordinates, pool=1)
    assert isinstance(policy, CNNPolicy)
    convolutions = policy.actor_eye[:-3]
    image = torch.zeros(1, 2, 32, 32)
    image[:, :, 8:12, 9:13] = torch.rand(2, 4, 4, generator=torch.Generator().manual_seed(0))
    there = convolutions(image.roll((7, 9), (2, 3)))
    moved = convolutions(image).roll((7, 9), (2, 3))
    assert there.abs().max() > 0.1
    assert torch.allclose(there, moved, atol=1e-6) is not coordinates


@pytest.mark.parametrize("kind", ["mlp", "cnn"])
def test_bfloat16_is_near_and_keeps_weights_in_float32(kind: str) -> None:
    policy = make(kind, final_scale=1.0)
    exact = policy.distribution(seen(6)).mode(), policy.value(seen(6))
    set_precision(policy, "bfloat16")
    found = policy.distribution(seen(6)).mode(), policy.value(seen(6))
    for a, b in zip(exact, found, strict=True):
        assert b.dtype == torch.float32
        assert not torch.equal(a, b)
        torch.testing.assert_close(a, b, atol=0.05, rtol=0.05)
    found[1].sum().backward()
    assert all(
        p.grad is not None and p.grad.dtype == torch.float32 for p in policy.critic_parameters()
    )
    set_precision(policy, "float32")
    assert torch.equal(policy.value(seen(6)), exact[1])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"filters": (2,)}, r"kernels=\(5, 3\) .* one for each of filters=\(2,\)"),
        ({"kernels": (4, 3)}, "must be odd"),
        ({"hidden": (0,)}, r"hidden=\(0,\) is not possible"),
        ({"noise": {"start": 0.1, "end": 0}}, r"noise\.end=0.* greater than 0"),
    ],
)
def test_refuses_options(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        make_options(CNNPolicy.Options, options, "policy")


@pytest.mark.parametrize(
    ("shapes", "message"),
    [
        ({"state": (5,)}, "policy 'cnn' needs the observation 'image'"),
        ({"state": (5,), "image": (32, 32)}, r"of shape \(channels, height, width\)"),
        ({"state": (5, 2), "image": (1, 32, 32)}, "needs a flat observation 'state'"),
        ({"state": (5,), "image": (1, 3, 3)}, "leave nothing of an image of 3 × 3 pixels"),
    ],
)
def test_refuses_observations(shapes: dict[str, tuple[int, ...]], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        CNNPolicy(CNNPolicy.Options(), context(**shapes))


def test_noise_follows_its_schedule() -> None:
    for kind in ("mlp", "cnn"):
        policy = make(kind, noise=Schedule(0.4, 0.1, 100))
        policy.schedule(50)
        distribution = policy.distribution(seen(6))
        assert isinstance(distribution, DiagonalGaussian)
        torch.testing.assert_close(distribution.std, torch.full((3,), 0.25))

from __future__ import annotations

import copy
import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import nn

from understudy.random import WorldStreams
from understudy.task import ActionSpace, Box, Choice
from understudy_networks import nn as networks
from understudy_networks.nn import (
    DiagonalGaussian,
    RunningNormaliser,
    Schedule,
    action_distribution,
    box_columns,
    head_size,
    mlp,
    set_precision,
)


def test_mlp() -> None:
    net = mlp([4, 8, 3], final_scale=0.01)
    assert [type(m).__name__ for m in net] == ["Linear", "ReLU", "Linear"]
    assert float(
        net[0].weight.detach().T.matmul(net[0].weight.detach()).diagonal().mean()
    ) == pytest.approx(2.0)  # type: ignore[operator]
    assert float(net[2].weight.abs().max()) <= 0.01  # type: ignore[union-attr]
    assert not net[0].bias.any()  # type: ignore[union-attr]


def test_normaliser_equals_numpy_statistics() -> None:
    x = (
        torch.randn(1000, 3, generator=torch.Generator().manual_seed(0))
        * torch.tensor([1.0, 20, 0.3])
        + 5
    )
    normaliser = RunningNormaliser(3)
    for part in x.split([1, 99, 400, 500]):
        normaliser.observe(part.view(1, -1, 3))
    assert torch.allclose(normaliser.mean, x.double().mean(0))
    assert torch.allclose(normaliser.variance, x.double().var(0, correction=0))
    assert float(normaliser.count) == 1000
    out = normaliser(x)
    assert out.abs().max() <= 5
    assert out.dtype == torch.float32


def test_normaliser_goes_on_from_its_state() -> None:
    x = 3 + torch.randn(100, 3, generator=torch.Generator().manual_seed(0))
    normaliser, other = RunningNormaliser(3), RunningNormaliser(3)
    normaliser.observe(x)
    assert set(normaliser.state_dict()) == {"mean", "variance", "count"}
    other.load_state_dict(normaliser.state_dict())
    assert torch.equal(other(x), normaliser(x))
    assert float(other(x).mean(0).abs().max()) < 1e-5
    assert torch.equal(copy.deepcopy(other)(x), normaliser(x))


@pytest.mark.parametrize("name", ["variance", "count"])
def test_statistics_that_no_samples_have_are_refused(name: str) -> None:
    """Of a variance below 0 everything observed became NaN, and the figure was judged without a word."""
    state = dict(RunningNormaliser(3).state_dict())
    RunningNormaliser(3).load_state_dict(state)
    with pytest.raises(ValueError, match="variance or count is below 0"):
        RunningNormaliser(3).load_state_dict({**state, name: state[name] - 2.0})


def test_normaliser_horizon_lets_old_samples_fade() -> None:
    normaliser = RunningNormaliser(1, horizon=100)
    normaliser.observe(torch.zeros(100_000, 1))
    for _ in range(100):
        normaliser.observe(torch.ones(10, 1))
    assert float(normaliser.mean) > 0.99


def test_gaussian() -> None:
    mean, std = torch.tensor([[0.5, -1.0]]).repeat(4, 1), torch.tensor([0.5, 2.0])
    distribution = DiagonalGaussian(mean, std)
    reference = torch.distributions.Independent(torch.distributions.Normal(mean, std), 1)
    action = torch.randn(4, 2, generator=torch.Generator().manual_seed(0))
    assert torch.allclose(distribution.log_prob(action), reference.log_prob(action))
    assert torch.allclose(distribution.entropy(), reference.entropy())
    assert torch.equal(distribution.mode(), mean)
    many = DiagonalGaussian(mean[:1].repeat(100_000, 1), std).sample(
        WorldStreams(0, "a", 100_000, "cpu")
    )
    assert torch.allclose(many.mean(0), mean[0], atol=0.03)
    assert torch.allclose(many.std(0), std, rtol=0.01)


def test_schedule() -> None:
    schedule = Schedule(1.0, 0.0, 100)
    assert [schedule.at(n) for n in (0, 50, 100, 10**9)] == [1.0, 0.5, 0.0, 0.0]
    with pytest.raises(ValueError, match="samples=0"):
        Schedule(1.0, 0.0, 0)
    assert math.isclose(Schedule(0.1, 0.1).at(7), 0.1)


SPACE = ActionSpace({"skill": Choice(3), "target": Box(2), "turn": Choice(2), "reach": Box(1)})
STD = torch.tensor([0.3, 1.2, 0.7])


def outputs(seed: int, *batch: int, scale: float = 1.0) -> torch.Tensor:
    chance = torch.Generator().manual_seed(seed)
    return scale * torch.randn(*batch, head_size(SPACE), generator=chance)


def reference(out: torch.Tensor, std: torch.Tensor) -> list[torch.distributions.Distribution]:
    """torch's own, part by part."""
    a, b, c, d = out.split([3, 2, 2, 1], dim=-1)
    normal, independent = torch.distributions.Normal, torch.distributions.Independent
    return [
        torch.distributions.Categorical(logits=a),
        independent(normal(b, std[:2]), 1),
        torch.distributions.Categorical(logits=c),
        independent(normal(d, std[2:]), 1),
    ]


def columns(action: torch.Tensor) -> list[torch.Tensor]:
    return [action[..., 0], action[..., 1:3], action[..., 3], action[..., 4:]]


def test_a_hybrid_equals_torchs_distributions() -> None:
    assert (SPACE.size, head_size(SPACE), box_columns(SPACE)) == (5, 8, 3)
    out, other = outputs(0, 4, 6), outputs(1, 4, 6)
    hybrid, second = (
        action_distribution(SPACE, out, STD),
        action_distribution(SPACE, other, 2 * STD),
    )
    theirs, seconds = reference(out, STD), reference(other, 2 * STD)
    action = torch.cat(
        [
            torch.randint(3, (4, 6, 1)).float(), torch.randn(4, 6, 2),
            torch.randint(2, (4, 6, 1)).float(), torch.randn(4, 6, 1),
        ],
        dim=-1,
    )  # fmt: skip
    log_prob = sum(d.log_prob(x) for d, x in zip(theirs, columns(action), strict=True))
    torch.testing.assert_close(hybrid.log_prob(action), log_prob)
    torch.testing.assert_close(hybrid.entropy(), sum(d.entropy() for d in theirs))
    kl = sum(torch.distributions.kl_divergence(p, q) for p, q in zip(theirs, seconds, strict=True))
    torch.testing.assert_close(hybrid.divergence(second), kl)
    mode = hybrid.mode()
    assert mode.shape == (4, 6, 5)
    assert torch.equal(mode[..., 0], out[..., :3].argmax(-1).float())
    assert torch.equal(mode[..., 1:3], out[..., 3:5])


def test_a_hybrid_samples_as_often_as_it_says() -> None:
    n = 100_000
    out = outputs(3, 1).expand(n, -1)
    hybrid = action_distribution(SPACE, out, STD)
    action = hybrid.sample(WorldStreams(0, "a", n, "cpu"))
    assert action.shape == (n, 5)
    for column, logits in ((0, out[0, :3]), (3, out[0, 5:7])):
        shares = torch.bincount(action[:, column].long(), minlength=len(logits)) / n
        torch.testing.assert_close(shares, logits.softmax(-1), atol=0.01, rtol=0)
    torch.testing.assert_close(action[:, 1:3].mean(0), out[0, 3:5], atol=0.02, rtol=0)
    torch.testing.assert_close(action[:, 4].std(), STD[2], atol=0.01, rtol=0)
    correlation = torch.corrcoef(action.T) - torch.eye(5)
    assert correlation.abs().max() < 0.02, "parts are drawn independently"
    assert torch.isfinite(hybrid.log_prob(action)).all()


@settings(max_examples=60, deadline=None)
@given(
    one=st.integers(0, 10**6), two=st.integers(0, 10**6),
    scale=st.floats(0.01, 8), spread=st.floats(0.2, 5),
)  # fmt: skip
def test_divergence_is_nonnegative_and_zero_of_itself(
    one: int, two: int, scale: float, spread: float
) -> None:
    p = action_distribution(SPACE, outputs(one, 16, scale=scale).double(), STD.double())
    q = action_distribution(SPACE, outputs(two, 16, scale=scale).double(), spread * STD.double())
    assert float(p.divergence(q).min()) >= -1e-9
    assert float(p.divergence(p).abs().max()) < 1e-9
    torch.testing.assert_close(
        p.divergence(p.map(torch.Tensor.detach)), torch.zeros(16).double(), atol=1e-9, rtol=0
    )


@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_divergence_agrees_with_sampling(seed: int) -> None:
    n = 40_000
    p = action_distribution(SPACE, outputs(seed, 1).expand(n, -1), STD)
    q = action_distribution(SPACE, outputs(seed + 1, 1).expand(n, -1), 1.3 * STD)
    action = p.sample(WorldStreams(seed, "a", n, "cpu"))
    differences = p.log_prob(action) - q.log_prob(action)
    error = float(differences.std()) / math.sqrt(n)
    assert float(differences.mean()) == pytest.approx(float(p.divergence(q)[0]), abs=5 * error)


def test_detached_distributions_pass_no_gradient() -> None:
    out = outputs(0, 4).requires_grad_()
    std = STD.clone().requires_grad_()
    hybrid = action_distribution(SPACE, out, std)
    fixed = hybrid.map(torch.Tensor.detach)
    fixed.divergence(hybrid).sum().backward()
    assert out.grad is not None
    assert float(out.grad.abs().max()) < 1e-6, "the divergence from itself is at its least"
    assert not fixed.entropy().requires_grad


def test_a_distribution_is_made_again_of_its_parameters() -> None:
    out = outputs(0, 4, 6)
    hybrid, other = action_distribution(SPACE, out, STD), action_distribution(SPACE, 0 * out, STD)
    found: list[torch.Tensor] = []
    hybrid.map(lambda p: found.append(p) or p)
    given = iter([p.expand(4, 6, -1) for p in found])
    again = other.map(lambda _: next(given))
    action = hybrid.mode()
    torch.testing.assert_close(again.log_prob(action), hybrid.log_prob(action))
    torch.testing.assert_close(again.divergence(other), hybrid.divergence(other))
    assert float(again.divergence(other).min()) > 0


def test_a_network_in_float32_stays_so_where_others_are_halved() -> None:
    """As within another library's ``torch.autocast``: its hidden layers compute as anywhere else."""
    net, x = mlp([5, 16, 16, 2]), torch.randn(7, 5)
    hidden: list[torch.Tensor] = []
    net[2].register_forward_hook(lambda *given: hidden.append(given[2].clone()))
    net(x)
    with torch.autocast("cpu", torch.bfloat16):
        net(x)
    assert hidden[0].dtype == torch.float32
    assert torch.equal(*hidden)


def test_a_network_in_bfloat16_keeps_its_last_layer() -> None:
    net = mlp([6, 32, 2])
    x = torch.randn(64, 6, generator=torch.Generator().manual_seed(0))
    exact = net(x)
    net.precision = "bfloat16"
    hidden = torch.relu(
        nn.functional.linear(x.bfloat16(), net[0].weight.bfloat16(), net[0].bias.bfloat16())
    )  # type: ignore[arg-type, union-attr]
    torch.testing.assert_close(net(x), net[2](hidden.float()))
    assert not torch.equal(net(x), exact)
    assert net(x.double().float()).dtype == torch.float32


@pytest.mark.skipif(not torch.backends.mkldnn.is_available(), reason="this torch has no oneDNN")
@pytest.mark.parametrize("shape", [(7, 20), (2, 3, 20)])
def test_a_wide_network_is_the_same_through_onednn(
    shape: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    net = mlp([20, 1024, 256, 3])
    x = torch.randn(shape, generator=torch.Generator().manual_seed(0))

    def found(faster: bool) -> tuple[torch.Tensor, ...]:
        monkeypatch.setattr(networks, "_onednn_is_faster", lambda: faster)
        assert net._through_onednn(x) == faster
        value = net(x)
        slopes = torch.autograd.grad(value.square().mean(), list(net.parameters()))
        with torch.no_grad():
            assert torch.equal(net(x), value)
        return (value, *slopes)

    for ours, plain in zip(found(True), found(False), strict=True):
        torch.testing.assert_close(ours, plain, rtol=1e-4, atol=1e-5)


def test_what_onednn_cannot_do_goes_without(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(networks, "_onednn_is_faster", lambda: True)
    x = torch.randn(3, 20)
    assert not mlp([20, 64, 32, 3])._through_onednn(x)  # gains nothing
    assert not mlp([20, 1024, 256, 3], activation=nn.Tanh)._through_onednn(x)
    net = mlp([20, 1024, 256, 3])
    assert not net._through_onednn(x.double())
    set_precision(net, "bfloat16")
    assert not net._through_onednn(x)
    set_precision(net, "float32", twice=True)
    first = next(net.parameters())
    (slope,) = torch.autograd.grad(net(x).square().mean(), first, create_graph=True)
    (curvature,) = torch.autograd.grad(slope.square().sum(), first)
    assert curvature.abs().max() > 0

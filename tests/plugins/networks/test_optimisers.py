"""Steps of the optimisers that learners share, against torch's plain ones."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import pytest
import torch
from torch import Tensor, nn

from understudy_networks import optimisers

Make = Callable[..., torch.optim.Optimizer]
RATE, DECAY, LARGEST = 0.003, 0.02, 0.5


def network() -> nn.Sequential:
    torch.manual_seed(0)
    return nn.Sequential(nn.Linear(5, 7), nn.Tanh(), nn.Linear(7, 3))


def loss_of(net: nn.Module, seed: int) -> Tensor:
    x = torch.randn(16, 5, generator=torch.Generator().manual_seed(seed))
    return 10 * net(x).square().mean()


def flat_of(parameters: Sequence[nn.Parameter]) -> Tensor:
    flat = torch.zeros(sum(p.numel() for p in parameters))
    optimisers.gradient_views(parameters, flat)
    return flat


@pytest.mark.parametrize(
    ("make", "peer"),
    [
        pytest.param(
            lambda p: optimisers.adam(p, torch.tensor(RATE), weight_decay=DECAY),
            lambda p: torch.optim.Adam(p, RATE, weight_decay=DECAY, foreach=False),
            id="adam",
        ),
        pytest.param(
            lambda p: optimisers.sgd(p, torch.tensor(RATE), momentum=0.9, weight_decay=DECAY),
            lambda p: torch.optim.SGD(p, RATE, momentum=0.9, weight_decay=DECAY, foreach=False),
            id="sgd",
        ),
    ],
)
def test_steps_with_clipped_gradients_equal_torchs(make: Make, peer: Make) -> None:
    ours, theirs = network(), network()
    parameters = list(ours.parameters())
    flat = flat_of(parameters)
    optimiser, other = make(parameters), peer(list(theirs.parameters()))
    for seed in range(20):
        optimisers.differentiate(loss_of(ours, seed), parameters, flat)
        largest = LARGEST if seed % 2 else 1e9
        over = (torch.linalg.vector_norm(flat) / largest).clamp(min=1.0)
        optimisers.step(optimiser, torch.zeros(()), over)
        other.zero_grad()
        loss_of(theirs, seed).backward()
        assert float(nn.utils.clip_grad_norm_(theirs.parameters(), largest)) > LARGEST
        other.step()
    for a, b in zip(parameters, theirs.parameters(), strict=True):
        torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-5)


def test_an_unsound_step_changes_nothing() -> None:
    net = network()
    parameters = list(net.parameters())
    flat = flat_of(parameters)
    optimiser = optimisers.adam(parameters, torch.tensor(RATE))
    before = [p.detach().clone() for p in parameters]
    flat.fill_(torch.nan)
    optimisers.step(optimiser, torch.ones(()), torch.tensor(torch.nan))
    assert all(torch.equal(a, b) for a, b in zip(parameters, before, strict=True))
    assert all(float(s["step"]) == 0 for s in optimisers.state_of(optimiser).values())


@pytest.mark.parametrize("sizes", [(40, 300, 9), (5, 7, 3), (1000, 1024, 40)])
def test_adam_in_pieces_is_adam(sizes: tuple[int, int, int]) -> None:
    """As on a GPU, and on the CPU what can be compared to the last bits."""
    a, b, c = sizes
    moved = []
    for in_pieces in (False, True):
        torch.manual_seed(0)
        net = nn.Sequential(nn.Linear(a, b), nn.Linear(b, c))
        parameters = list(net.parameters())
        flat = flat_of(parameters)
        optimiser = optimisers.adam(parameters, torch.tensor(RATE), weight_decay=DECAY)
        optimiser.param_groups[0]["capturable"] = in_pieces
        for unsound in (0.0, 0.0, 1.0, 0.0):
            flat.copy_(torch.randn_like(flat))
            optimisers.step(optimiser, torch.tensor(unsound), torch.tensor(2.0))
        state = optimisers.state_of(optimiser)
        assert [float(one["step"]) for one in state.values()] == [3.0] * 4
        moved.append([*parameters, *(one["exp_avg_sq"] for one in state.values())])
    for one, other in zip(*moved, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-6, atol=1e-7)


def test_a_parameter_that_the_loss_does_not_use_has_no_gradient() -> None:
    used, unused = nn.Parameter(torch.ones(2)), nn.Parameter(torch.ones(3))
    flat = flat_of([used, unused])
    flat.fill_(7.0)
    optimisers.differentiate((3 * used).sum(), [used, unused], flat)
    assert flat.tolist() == [3, 3, 0, 0, 0]
    assert unused.grad is not None
    assert unused.grad.data_ptr() == flat[2:].data_ptr()


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("step", torch.zeros(1)),
        ("exp_avg", torch.zeros(7, 5, dtype=torch.float64)),
        ("exp_avg", torch.zeros(5, 7)),
        ("exp_avg_sq", torch.full((7, 5), torch.nan)),
        ("exp_avg_sq", torch.full((7, 5), -1.0)),
        ("step", torch.tensor(-1.0)),
    ],
)
def test_moments_that_are_not_of_these_parameters_are_refused(name: str, wrong: Tensor) -> None:
    parameters = list(network().parameters())
    optimiser, flat = optimisers.adam(parameters, torch.tensor(RATE)), flat_of(parameters)
    flat.fill_(1.0)
    optimisers.step(optimiser, torch.zeros(()))
    state = optimisers.state_of(optimiser)
    optimisers.load_state(optimiser, state)
    with pytest.raises(ValueError, match=f"'{name}' of parameter 0"):
        optimisers.load_state(optimiser, {**state, "0": {**state["0"], name: wrong}})
    with pytest.raises(ValueError, match="moments of 3 parameters, and there are 4"):
        optimisers.load_state(optimiser, {k: v for k, v in state.items() if k != "0"})
    with pytest.raises(ValueError, match="moments of 0 parameters, and there are 4"):
        optimisers.load_state(optimiser, {})


def test_moments_before_the_first_step_are_those_that_it_begins_with() -> None:
    """As torch makes them; a checkpoint that lacked them was taken for one of a fresh optimiser."""
    parameters = list(network().parameters())
    twins = [nn.Parameter(p.detach().clone()) for p in parameters]
    ours = optimisers.adam(parameters, torch.tensor(RATE))
    torchs = torch.optim.Adam(twins, torch.tensor(RATE), fused=True)
    assert len(optimisers.state_of(ours)) == 4
    for _ in range(3):
        for p, twin in zip(parameters, twins, strict=True):
            p.grad = torch.sin(torch.arange(p.numel()) + 1.0).view_as(p) * (p.detach() + 1)
            twin.grad = p.grad.clone()
        optimisers.step(ours, torch.zeros(()))
        torchs.step()
    for p, twin in zip(parameters, twins, strict=True):
        assert torch.equal(p, twin)
        assert ours.state[p].keys() == torchs.state[twin].keys()
        assert all(
            torch.equal(ours.state[p][name], torchs.state[twin][name]) for name in ours.state[p]
        )

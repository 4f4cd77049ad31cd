"""The Gaussian process: eq. 6.2, what it predicts, and data that would break a careless one."""

from __future__ import annotations

import math

import pytest
import torch
from botorch.fit import fit_gpytorch_mll
from botorch.models import SingleTaskGP
from gpytorch.mlls import ExactMarginalLogLikelihood
from torch import Tensor

from understudy_bayes import draws
from understudy_bayes.acquisition import beta, climb, upper_bound
from understudy_bayes.book import Data
from understudy_bayes.surrogate import Surrogate, SurrogateOptions

OPTIONS = SurrogateOptions()


def data(x: Tensor, y: Tensor, z: Tensor | float = 1.0) -> Data:
    z = z if isinstance(z, Tensor) else torch.full((len(x),), z, dtype=torch.float64)
    return Data(x.double(), z, y.double(), torch.ones(len(x), dtype=torch.float64))


def smooth(n: int = 20) -> Data:
    x = draws.many(0, 0, 2, n)
    return data(x, torch.sin(5 * x[:, 0]))


def at(model: Surrogate, x: Tensor, z: float = 1.0) -> tuple[Tensor, Tensor]:
    with torch.no_grad():
        return model.posterior(x.double(), torch.full((len(x),), z, dtype=torch.float64))


def test_it_predicts_what_it_did_not_see() -> None:
    d = smooth()
    model, x = Surrogate(OPTIONS, d), draws.many(1, 1, 2, 30)
    mean, deviation = at(model, x)
    truth = (torch.sin(5 * x[:, 0]) - d.y.mean()) / model.scale
    assert (mean - truth).abs().max() < 0.1
    assert ((mean - truth).abs() < 4 * deviation + 0.02).all()
    assert mean.dtype == torch.float64


def test_a_sensitive_parameter_has_a_short_length_scale() -> None:
    short, long = Surrogate(OPTIONS, smooth()).length_scales
    assert short < 0.5 * long


def test_without_fidelities_it_is_botorchs() -> None:
    d = smooth(12)
    theirs = SingleTaskGP(d.x, d.y.unsqueeze(1))
    fit_gpytorch_mll(ExactMarginalLogLikelihood(theirs.likelihood, theirs))
    ours, x = Surrogate(OPTIONS, d), draws.many(2, 2, 2, 10)
    found = theirs.posterior(x)
    mean, deviation = at(ours, x)
    assert mean * ours.scale + d.y.mean() == pytest.approx(found.mean[:, 0].detach(), abs=5e-3)
    assert deviation * ours.scale == pytest.approx(found.variance[:, 0].sqrt().detach(), abs=5e-3)


@pytest.mark.parametrize("kernel", ["se", "matern"])
def test_few_points_have_the_posterior_and_the_slopes_that_botorch_finds(kernel: str) -> None:
    """To the bit; the first are BoTorch's own, which remembers from then on what the trials gave."""
    options = SurrogateOptions(kernel=kernel, slope=1.0)  # type: ignore[arg-type]
    model, found = Surrogate(options, smooth()), []
    for _ in range(2):
        x = draws.many(2, 2, 2, 8).double().requires_grad_()
        mean, deviation = model.posterior(x, torch.full((8,), 0.7, dtype=torch.float64))
        (slopes,) = torch.autograd.grad((mean + deviation).sum(), x)
        found.append(torch.cat([mean, deviation, slopes.flatten()]))
    assert torch.equal(*found)


@pytest.mark.parametrize("kernel", ["se", "matern"])
def test_the_kernel_is_a_product(kernel: str) -> None:
    """k((x, z), (x', z')) = k(x, x') k_SE(z, z'), eq. 6.2."""
    model = Surrogate(SurrogateOptions(kernel=kernel), smooth())  # type: ignore[arg-type]
    x, xs = torch.tensor([0.3, 0.6]).double(), draws.many(3, 3, 2, 5)
    z, zs = torch.tensor(0.2).double(), torch.rand(5, dtype=torch.float64)
    scales = torch.tensor(model.length_scales, dtype=torch.float64)
    r = ((xs - x) / scales).norm(dim=1)
    se, s = torch.exp(-(r**2) / 2), math.sqrt(5) * r
    space = se if kernel == "se" else (1 + s + s**2 / 3) * torch.exp(-s)
    fidelity = torch.exp(-(((zs - z) / model.fidelity_scale) ** 2) / 2)
    assert model.correlation(x, z, xs, zs) == pytest.approx(space * fidelity, abs=1e-6)


def test_fidelities_that_agree_share_what_they_know() -> None:
    """A function that does not depend on z is known at z = 1 from z = 0; one that does is not."""
    x = draws.many(0, 0, 1, 24)
    z = (torch.arange(24) % 3).double() / 2
    same = Surrogate(OPTIONS, data(x, torch.sin(6 * x[:, 0]), z))
    other = Surrogate(OPTIONS, data(x, torch.sin(6 * x[:, 0] + 9 * z), z))
    assert same.fidelity_scale > 2 * other.fidelity_scale


def test_a_shift_that_all_points_share_does_not_shorten_the_fidelitys_scale() -> None:
    """The mean's line in z takes it; without one, l_z does."""
    x = draws.many(0, 0, 1, 24)
    z = (torch.arange(24) % 3).double() / 2
    shifted = data(x, torch.sin(6 * x[:, 0]) + 3 * z, z)
    flat, line = Surrogate(OPTIONS, shifted), Surrogate(SurrogateOptions(slope=1.0), shifted)
    assert line.fidelity_scale > 3 * flat.fidelity_scale
    x = draws.many(1, 1, 1, 8)
    mean, _ = at(line, x, 0.75)  # a fidelity that it has not seen
    truth = torch.sin(6 * x[:, 0]) + 3 * 0.75
    assert mean == pytest.approx((truth - shifted.y.mean()) / line.scale, abs=0.05)


def test_a_slope_that_nothing_shows_is_none() -> None:
    """With one fidelity seen, others are expected to be as high."""
    line, flat = Surrogate(SurrogateOptions(slope=1.0), smooth()), Surrogate(OPTIONS, smooth())
    x = draws.many(1, 1, 2, 8)
    assert at(line, x)[0] == pytest.approx(at(flat, x)[0], abs=5e-3)


def test_what_still_runs_is_taken_as_expected() -> None:
    model, x = Surrogate(OPTIONS, smooth(6)), torch.tensor([[0.11, 0.93]]).double()
    (before,), (doubt,) = at(model, x)
    model.believe(x, torch.ones(1).double())
    (after,), (less,) = at(model, x)
    assert float(after) == pytest.approx(float(before), abs=0.02)
    assert less < 0.8 * doubt


def test_the_same_data_give_the_same_bits() -> None:
    x = draws.many(5, 5, 2, 7)
    torch.manual_seed(1)
    first = at(Surrogate(OPTIONS, smooth(), seed=3), x)
    torch.manual_seed(2)
    second = at(Surrogate(OPTIONS, smooth(), seed=3), x)
    assert torch.equal(first[0], second[0])
    assert torch.equal(first[1], second[1])


def test_fitting_leaves_the_global_generator_alone() -> None:
    torch.manual_seed(7)
    expected = torch.rand(3)
    torch.manual_seed(7)
    Surrogate(OPTIONS, smooth())
    assert torch.equal(torch.rand(3), expected)


X = draws.many(9, 9, 3, 16)
NOISE = torch.randn(16, generator=torch.Generator().manual_seed(0)).double()


@pytest.mark.parametrize(
    ("x", "y"),
    [
        (X[:1], torch.tensor([0.4])),
        (X[:2], torch.tensor([0.4, 0.4])),
        (X, torch.zeros(16)),
        (X, torch.full((16,), 1e9)),
        (X[:1].expand(16, 3), torch.zeros(16)),
        (X[:1].expand(16, 3), NOISE),
        (torch.cat([X[:8], X[:8]]), torch.cat([X[:8, 0], X[:8, 0]])),
        (torch.cat([X[:8], X[:8]]), NOISE),
        (torch.cat([X[:8], X[:8] + 1e-9]), NOISE),
        (X, NOISE),
        (X, 1e6 * NOISE),
        (X, 1e-9 * NOISE),
        (X, torch.cat([torch.zeros(15), torch.tensor([1e12])])),
    ],
    ids=[
        "one", "two the same", "constant", "a large constant", "one place", "one place, noise",
        "duplicates", "duplicates that disagree", "nearly duplicates", "noise only", "huge noise",
        "tiny values", "an outlier",
    ],
)  # fmt: skip
def test_data_that_would_break_a_careless_model(x: Tensor, y: Tensor) -> None:
    model = Surrogate(OPTIONS, data(x, y, torch.linspace(0, 1, len(x)).double()))
    mean, deviation = at(model, torch.cat([x.double(), X]))
    assert mean.isfinite().all()
    assert deviation.isfinite().all()
    assert (deviation > 0).all()
    found = climb(upper_bound(model, beta(3, 5)), X[:4])
    assert ((found >= 0) & (found <= 1)).all()


def test_noise_is_told_from_signal() -> None:
    noisy, clean = Surrogate(OPTIONS, data(X, NOISE)), Surrogate(OPTIONS, smooth())
    assert noisy.noise > 5 * clean.noise


def test_a_climb_ends_at_the_top() -> None:
    top = torch.tensor([0.3, 0.8]).double()
    found = climb(lambda x: -((x - top) ** 2).sum(dim=1), draws.many(0, 0, 2, 3))
    assert found == pytest.approx(top, abs=1e-4)
    edge = climb(lambda x: x[:, 0] - x[:, 1], draws.many(0, 0, 2, 3))
    assert edge.tolist() == [1.0, 0.0]


def test_a_climb_stays_close_to_its_start_when_asked_to() -> None:
    starts = torch.tensor([[0.2, 0.9], [0.7, 0.4]]).double()
    found = climb(lambda x: x[:, 0] - x[:, 1], starts, within=0.15)
    assert found.tolist() == pytest.approx([0.85, 0.25])  # of the better start
    cube = climb(lambda x: x[:, 0] - x[:, 1], starts, within=0.5)
    assert cube.tolist() == pytest.approx([1.0, 0.0])
    found = climb(lambda x: x[:, 0] - x[:, 1], starts, within=0.15, of=starts - 0.1)
    assert found.tolist() == pytest.approx([0.75, 0.15])


def test_the_bound_of_equation_6_3() -> None:
    """a(x, z) = μ(x, z) + β^½ σ(x, z_max)."""
    x = draws.many(0, 0, 2, 12)
    z = (torch.arange(12) % 2).double()
    model = Surrogate(OPTIONS, data(x, torch.sin(5 * x[:, 0]) + z, z))
    where = draws.many(1, 1, 2, 4)
    mean, deviation = at(model, where, 0.25)[0], at(model, where, 1.0)[1]
    with torch.no_grad():
        found = upper_bound(model, 4.0, 0.25, of=1.0)(where)
    assert found == pytest.approx(mean + 2 * deviation)
    assert beta(7, 3) == pytest.approx(0.2 * 7 * math.log(6))

from __future__ import annotations

import pytest
import torch

from understudy.random import WorldStreams, derive_seed, generator, private_rng


def test_uniform() -> None:
    x = WorldStreams(0, "x", 1000, "cpu").uniform(1000)
    assert x.dtype == torch.float32
    assert float(x.min()) >= 0
    assert float(x.max()) < 1
    counts = torch.histc(x, 100, 0, 1)  # chi-square with 99 degrees of freedom: 99 ± 14
    assert 50 < float(((counts - 1e4) ** 2 / 1e4).sum()) < 150


def test_bits_are_fair() -> None:
    bits = WorldStreams(1, "x", 500, "cpu").bits(400)
    ones = torch.stack([(bits >> b) & 1 for b in range(64)]).float().mean((1, 2))
    assert (ones - 0.5).abs().max() < 5 * 0.5 / (200_000**0.5)


def test_normal() -> None:
    x = WorldStreams(0, "x", 1000, "cpu").normal(501)
    assert x.shape == (1000, 501)
    assert abs(float(x.mean())) < 0.005
    assert abs(float(x.var()) - 1) < 0.01
    assert abs(float((x**4).mean()) - 3) < 0.05
    assert torch.isfinite(x).all()


def test_independence() -> None:
    """Between neighbouring worlds, successive draws, the halves of a normal draw, names and seeds."""
    x = WorldStreams(0, "x", 1000, "cpu").normal(1000)
    limit = 5e-3  # five standard errors of a million pairs
    pairs = [
        (x[1:], x[:-1]), (x[:, 1:], x[:, :-1]), (x[:, :500], x[:, 500:]), (x[1:, 1:], x[:-1, :-1]),
        (x, WorldStreams(0, "y", 1000, "cpu").normal(1000)), (x, WorldStreams(1, "x", 1000, "cpu").normal(1000)),
    ]  # fmt: skip
    for a, b in pairs:
        assert abs(float((a * b).mean())) < limit * (x.numel() / a.numel()) ** 0.5
        assert abs(float((a.abs() * b.abs()).mean()) - 2 / torch.pi) < 2 * limit
    assert len(torch.unique(WorldStreams(0, "x", 1000, "cpu").bits(1000))) == 1_000_000


def test_draws_do_not_depend_on_their_grouping() -> None:
    one, two = WorldStreams(0, "x", 5, "cpu"), WorldStreams(0, "x", 5, "cpu")
    assert torch.equal(one.uniform(6), torch.cat([two.uniform(2), two.uniform(4)], dim=1))


def test_state() -> None:
    streams = WorldStreams(0, "x", 5, "cpu")
    streams.uniform(3)
    state = streams.state_dict()
    expected = streams.normal(4)
    streams.load_state_dict(state)
    assert torch.equal(streams.normal(4), expected)


def test_give_back() -> None:
    """Worlds that give back draw the same again; the others go on."""
    streams, other = WorldStreams(0, "x", 4, "cpu"), WorldStreams(0, "x", 4, "cpu")
    before = streams.state_dict()
    first = streams.uniform(2)
    streams.give_back(torch.tensor([True, False, True, False]), before)
    second, following = streams.uniform(2), (other.uniform(2), other.uniform(2))[1]
    assert torch.equal(second[::2], first[::2])
    assert torch.equal(second[1::2], following[1::2])


def test_names_and_seeds() -> None:
    seeds = {derive_seed(s, n) for s in range(100) for n in ("a", "b", "ppo")}
    assert len(seeds) == 300
    assert all(0 <= s < 2**63 for s in seeds)
    assert torch.equal(
        torch.rand(3, generator=generator(1, "a")), torch.rand(3, generator=generator(1, "a"))
    )


def test_private_rng() -> None:
    before = torch.get_rng_state()
    with private_rng(0, "x"):
        first = torch.rand(3)
    with pytest.raises(KeyError), private_rng(0, "x"):  # noqa: PT012
        assert torch.equal(torch.rand(3), first)
        raise KeyError
    assert torch.equal(torch.get_rng_state(), before)

"""Worlds out of step."""

from __future__ import annotations

import torch

from understudy.random import WorldStreams
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.task import Context, Rollout
from understudy_curricula.staggered import Staggered

N = 512
STREAMS = WorldStreams(0, "test", N, "cpu")


def built() -> Staggered:
    context = Context(0, torch.device("cpu"), N, control_dt=0.1, substeps=1)
    return Staggered(Staggered.Options(seconds=8.0), context)


def rollout(ended: torch.Tensor) -> Rollout:
    none, zero = torch.zeros_like(ended), torch.zeros(ended.shape)
    return Rollout({}, {}, zero, zero, zero, ended, none, none, zero, zero, {})


def limits(curriculum: Staggered) -> torch.Tensor:
    return curriculum.begin(STREAMS)["episode_limit"]


def test_first_episodes_are_of_all_lengths_and_later_ones_whole() -> None:
    curriculum = built()
    first = limits(curriculum).clone()
    counts = torch.histc(first, bins=8, min=0.0, max=8.0)
    assert counts.sum() == N
    assert counts.min() > N / 16, "evenly"
    ended = torch.zeros(3, N, dtype=torch.bool)
    ended[1, : N // 2] = True
    curriculum.update(rollout(ended))
    assert torch.equal(limits(curriculum)[: N // 2], torch.full((N // 2,), 8.0))
    assert torch.equal(limits(curriculum)[N // 2 :], first[N // 2 :])
    curriculum.update(rollout(~ended))
    assert limits(curriculum).eq(8.0).all()


def test_it_continues_exactly_and_in_place() -> None:
    one, two = built(), built()
    ended = torch.zeros(1, N, dtype=torch.bool)
    ended[0, ::3] = True
    one.update(rollout(ended))
    where = limits(two).data_ptr()
    two.load_state_dict(one.state_dict())
    assert torch.equal(limits(one), limits(two))
    assert limits(two).data_ptr() == where, "a captured step has this memory"


def test_worlds_that_were_in_step_are_in_all_phases() -> None:
    """Of a task whose episodes all last equally long."""
    phases = {}
    for words in ([], ["curriculum=staggered", "curriculum.seconds=${episode.seconds}"]):
        experiment = load_experiment(
            ["experiment=miniature/sleeve", "device=cpu", "num_worlds=16", *words]
        )
        environment = build_environment(experiment).environment
        environment.reset(seed=0)
        curriculum = environment.parts.curriculum
        limit = float(experiment.root.episode.seconds)
        decisions = round(limit / environment.control_dt / environment.decision)
        action = torch.zeros(16, environment.action_size)
        for _ in range(decisions):
            step = environment.step(action)
            if curriculum is not None:
                ended = step.ended.unsqueeze(0)
                curriculum.update(rollout(ended))
        phases[bool(words)] = environment.episode_step.unique().numel()
        environment.close()
    assert phases[False] == 1
    assert phases[True] > 8

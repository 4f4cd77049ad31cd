"""The derivative by every action, beside autograd through the whole of an imagined trajectory."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from imagined_walk import IMITATION, WALK
from torch import Tensor

from understudy.task import Rollout
from understudy_imagination.adjoint import Adjoint, Weights, Window, clean, limited
from understudy_imagination.errors import model_errors
from understudy_imagination.learner import Imagination
from understudy_reinforcement.job import Reinforcement

STEPS = 5
WEIGHTS = Weights(margins=1.0, actions=0.01, rewards=1.0, norm=8.0, power=2.0)


def window_of(job: Reinforcement, learner: Imagination) -> Window:
    return window_in(job.collector.collect(STEPS), learner)


def window_in(rollout: Rollout, learner: Imagination) -> Window:
    return Window(
        {name: rollout.fields[name] for name in learner.rollout_fields},
        rollout.next_fields,
        rollout.actions,
        rollout.terminated | rollout.truncated,
    )


def parts(job: Reinforcement) -> tuple[Imagination, Adjoint]:
    learner = job.learner
    assert isinstance(learner, Imagination)
    imagined, rigid = learner.adjoint._imagined, learner.adjoint._rigid
    with torch.no_grad():
        learner.model.out.deviation.fill_(3.0)
        for p in job.policy.actor_parameters():
            p.mul_(3.0)  # so that feedback counts
    return learner, Adjoint(
        rigid, imagined, learner.model, job.policy, WEIGHTS, decay=1.0, clip=1e9
    )


def imagine(
    job: Reinforcement, learner: Imagination, moved: Tensor, noise: Tensor, ended: Tensor
) -> tuple[Tensor, Window]:
    """What a trajectory costs whose decisions the model makes, the actions `moved` (L, N, A) from what
    policy and noise would do; where `ended` (L, N) what follows begins at the first states again."""
    table = job.environment.table
    imagined, rigid = learner.adjoint._imagined, learner.adjoint._rigid
    first = {name: table[name].clone() for name in learner.rollout_fields}
    state, rows = dict(first), []
    dt, total = job.environment.control_dt, torch.zeros(())
    for t in range(len(moved)):
        posed = rigid.posed(state["qpos"], state["qvel"])
        fields = imagined.fields(posed, imagined.constants(state), noise[t])
        mean = job.policy.distribution(imagined.observations(fields)).mode() + moved[t]
        action = mean + noise[t]
        total = total + WEIGHTS.actions * imagined.offset(mean, fields).square().mean(1).sum()
        qpos, qvel = learner.model(posed, imagined.control(action, fields))
        reached = {**state, "qpos": qpos, "qvel": qvel, "episode_time": state["episode_time"] + dt}
        there = imagined.fields(rigid.posed(qpos, qvel), imagined.constants(reached), action)
        total = total + WEIGHTS.margins * imagined.used(there, WEIGHTS.norm, WEIGHTS.power).sum()
        rows.append((state, reached, action))
        again = ended[t].unsqueeze(1)
        state = {
            name: torch.where(again if value.dim() > 1 else ended[t], first[name], value)
            for name, value in reached.items()
        }
    before, reached, actions = zip(*rows, strict=True)

    def stacked(many: tuple[dict[str, Tensor], ...]) -> dict[str, Tensor]:
        return {name: torch.stack([one[name].detach() for one in many]) for name in many[0]}

    window = Window(stacked(before), stacked(reached), torch.stack(actions).detach(), ended)
    return total, window


@pytest.mark.parametrize("cut", [False, True], ids=["whole", "cut"])
def test_it_is_the_derivative_of_what_the_model_imagines(
    job: Callable[..., Reinforcement], cut: bool
) -> None:
    made = job()
    learner, adjoint = parts(made)
    n, a = made.environment.num_worlds, made.environment.action_size
    noise = 0.1 * torch.randn(STEPS, n, a, generator=torch.Generator().manual_seed(1))
    ended = torch.zeros(STEPS, n, dtype=torch.bool)
    ended[2, 1] = cut
    moved = torch.zeros(STEPS, n, a, requires_grad=True)
    total, window = imagine(made, learner, moved, noise, ended)
    (expected,) = torch.autograd.grad(total, moved)
    found = adjoint(window)
    scale = float(expected.abs().max())
    torch.testing.assert_close(found.actions / scale, expected / scale, rtol=0, atol=2e-4)
    # The first actions matter by what follows from them, not by themselves alone.
    alone = adjoint(Window(
        {k: v[:1] for k, v in window.before.items()}, {k: v[:1] for k, v in window.reached.items()},
        window.actions[:1], window.ended[:1],
    )).actions[0]  # fmt: skip
    assert (found.actions[0] - alone).abs().max() > 0.05 * scale
    if cut:  # what comes after an end is another episode's
        torch.testing.assert_close(found.actions[2, 1], adjoint(Window(
            {k: v[2:3] for k, v in window.before.items()},
            {k: v[2:3] for k, v in window.reached.items()},
            window.actions[2:3], window.ended[2:3],
        )).actions[0, 1])  # fmt: skip


@pytest.mark.parametrize("task", [WALK, IMITATION], ids=["margins", "margins_and_rewards"])
def test_the_costs_derivative_is_its_difference(
    job: Callable[..., Reinforcement], task: tuple[str, ...]
) -> None:
    """Of the task's own terms at the simulator's states, by every state and by the action."""
    made = job(task=task)
    learner, adjoint = parts(made)
    rigid = adjoint._rigid
    window = window_of(made, learner)
    cost, by_state, by_action = adjoint._costs(window)
    draw = torch.Generator().manual_seed(3)
    way = torch.randn(by_state.shape, generator=draw)
    way /= torch.linalg.vector_norm(way, dim=-1, keepdim=True)
    size, costs = 2e-3, []
    place, speed = (part.flatten(0, 1) for part in way.chunk(2, dim=-1))
    for side in (size, -size):
        qpos, qvel = (window.reached[name].flatten(0, 1) for name in ("qpos", "qvel"))
        moved = {"qpos": rigid.moved(qpos, side * place), "qvel": qvel + side * speed}
        moved = {k: v.unflatten(0, window.ended.shape) for k, v in moved.items()}
        costs.append(adjoint._costs(replace(window, reached={**window.reached, **moved}))[0])
    expected = ((costs[0] - costs[1]) / (2 * size)).view_as(window.ended)
    found = (by_state * way).sum(-1)
    scale = float(expected.abs().max())
    assert scale > 0.01
    torch.testing.assert_close(found / scale, expected / scale, rtol=0, atol=0.02)
    assert cost.isfinite().all()
    assert not by_action.any()  # no term of these tasks reads the action


def test_where_it_stands_on_the_reference_itself_a_margin_has_a_derivative(
    job: Callable[..., Reinforcement],
) -> None:
    """Distances that are 0 make no number that is not finite, which would cost the whole row."""
    made = job()
    learner, adjoint = parts(made)
    imagined, rigid = adjoint._imagined, adjoint._rigid
    table = made.environment.table  # the first states are the clip's
    state = {name: table[name].clone() for name in learner.rollout_fields}
    step = torch.zeros(len(state["qpos"]), 2 * rigid.nv, requires_grad=True)
    fields = imagined.fields(
        adjoint._posed(state, step), imagined.constants(state), made.environment.action
    )
    (found,) = torch.autograd.grad(imagined.used(fields, WEIGHTS.norm, WEIGHTS.power).sum(), step)
    assert found.isfinite().all()


def test_what_it_says_of_the_policy_is_what_the_policy_does(
    job: Callable[..., Reinforcement],
) -> None:
    made = job()
    learner, adjoint = parts(made)
    rollout = made.collector.collect(STEPS)
    found = adjoint(window_in(rollout, learner))
    assert found.observations.keys() == rollout.observations.keys()
    for name, value in rollout.observations.items():
        torch.testing.assert_close(found.observations[name], value, rtol=1e-4, atol=1e-4)
    with torch.no_grad():
        means = made.policy.distribution(rollout.observations).mode()
    torch.testing.assert_close(found.means, means, rtol=1e-4, atol=1e-4)


def test_rows_that_are_not_finite_are_zero() -> None:
    rows = torch.tensor([[1.0, 2.0], [torch.nan, 3.0], [4.0, torch.inf]])
    assert clean(rows).tolist() == [[1.0, 2.0], [0.0, 0.0], [0.0, 0.0]]


def test_long_rows_are_cut_to_medians_of_those_that_are_not_zero() -> None:
    rows = torch.tensor([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [30.0, 40.0]])
    found = limited(rows, 3.0)
    assert found[:3].tolist() == rows[:3].tolist()
    assert found[3].tolist() == pytest.approx([1.8, 2.4])
    assert limited(torch.zeros(2, 3), 3.0).tolist() == torch.zeros(2, 3).tolist()


def test_a_models_error_is_how_far_bodies_are_off(job: Callable[..., Reinforcement]) -> None:
    """None of what the model itself imagined; as much as the trajectory is moved, before it ends."""
    made = job()
    learner, _ = parts(made)
    rigid, imagined = learner.adjoint._rigid, learner.adjoint._imagined
    n, a = made.environment.num_worlds, made.environment.action_size
    ended = torch.zeros(STEPS, n, dtype=torch.bool)
    with torch.no_grad():
        _, window = imagine(
            made, learner, torch.zeros(STEPS, n, a), torch.zeros(STEPS, n, a), ended
        )
    found = model_errors(rigid, imagined, learner.model, window)
    assert list(found) == [1, 4]
    for off in found.values():
        assert off[1:].max() < 1e-3
    moved = window.reached["qpos"].clone()
    moved[3, 0, 0] += 0.5  # of one world, 4 decisions ahead
    shifted = replace(window, reached={**window.reached, "qpos": moved})
    found = model_errors(rigid, imagined, learner.model, shifted)
    assert found[4][1:].tolist() == pytest.approx(
        [0.5 / n] * (rigid.fields["xpos"][0] - 1), abs=1e-3
    )
    ended[1, 0] = True  # and its episode does not last so long
    found = model_errors(rigid, imagined, learner.model, replace(shifted, ended=ended))
    assert found[4][1:].max() < 1e-3


def test_the_cost_is_that_of_the_worst_of_a_margins_things(
    job: Callable[..., Reinforcement],
) -> None:
    """One joint that is about to end the episode counts as much as a centre of mass that is."""
    _, adjoint = parts(job())
    imagined = adjoint._imagined
    one, many = torch.full((4, 1), 0.9), torch.zeros(4, 30)
    many[:, 7] = 0.9

    class Only:
        def __init__(self, share: Tensor) -> None:
            self.share = share

        def used(self) -> Tensor:
            return self.share

    def cost(share: Tensor) -> Tensor:
        term = replace(imagined.margins[0], function=Only(share), reads={}, options={})
        imagined.margins[:] = [term]
        fields = {"action": torch.zeros(4, 1)}
        return imagined.used(fields, norm=8.0, power=2.0)

    first = imagined.margins[0]
    torch.testing.assert_close(cost(one), torch.full((4,), 0.81))
    torch.testing.assert_close(cost(many), torch.full((4,), 0.81))
    imagined.margins[:] = [first]

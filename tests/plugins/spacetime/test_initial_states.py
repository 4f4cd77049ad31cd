"""Where episodes begin: equations 3.9 and 3.10 of the thesis, and that states stay states."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st
from torch import Tensor

from understudy.errors import ConfigError, RunError
from understudy.random import WorldStreams
from understudy.task import Context, Rollout
from understudy_characters.initial_states import ReferenceStates
from understudy_characters.scene import reference_motion
from understudy_spacetime import evolution
from understudy_spacetime.clip_starts import ClipStart
from understudy_spacetime.evolution import Evolution, Evolved, boltzmann_draws
from understudy_spacetime.importance import Importance
from understudy_spacetime.segments import segment_probabilities

MakeRollout = Callable[[dict[str, Tensor], Tensor], Rollout]
WORLDS = 40_000
SEGMENTS = 4
RETURNS = torch.tensor([1.0, 4.0, 7.0, 10.0])  # by segment


def streams(worlds: int = WORLDS, seed: int = 0) -> WorldStreams:
    return WorldStreams(seed, "test", worlds, "cpu")


def segment_of(start: Tensor, duration: float, segments: int = SEGMENTS) -> Tensor:
    return (start / duration * segments).long().clamp(0, segments - 1)


def frequencies(start: Tensor, duration: float) -> Tensor:
    return segment_of(start, duration).bincount(minlength=SEGMENTS) / len(start)


def walked(
    context: Context, make_rollout: MakeRollout, steps: int = 50, worlds: int = 40
) -> Rollout:
    """A rollout along the reference, of the returns `RETURNS` by segment, in any cycle."""
    reference = reference_motion(context)
    time = (
        5.0
        * reference.duration
        * torch.rand(steps * worlds, generator=torch.Generator().manual_seed(1))
    )
    state = reference.sample(time)
    fields = {
        "phase": state["phase"],
        "episode_step": torch.zeros(len(time), dtype=torch.int64),
        "motion_time": time,
        "qpos": state["reference_qpos"],
        "qvel": state["reference_qvel"],
    }
    segment = (state["phase"] * SEGMENTS).long()
    return make_rollout(
        {name: value.unflatten(0, (steps, worlds)) for name, value in fields.items()},
        RETURNS[segment].view(steps, worlds),
    )


@given(
    st.lists(st.floats(-1e3, 1e3, width=32), min_size=1, max_size=30),
    st.floats(0.0, 1.0, width=32),
)
@example([0.0, 1e-45], 0.0)
@settings(max_examples=60, deadline=None)
def test_probabilities_are_probabilities_with_a_uniform_share(
    returns: list[float], uniform: float
) -> None:
    p = segment_probabilities(torch.tensor(returns), uniform=uniform)
    assert p.sum().item() == pytest.approx(1.0, abs=1e-5)
    assert (p >= uniform / len(returns) - 1e-6).all()
    order = torch.tensor(returns).argsort()
    assert (p[order].diff() <= 1e-6).all()  # the lower the return, the likelier


def test_equation_3_9() -> None:
    scale = (10.0 - 1.0) / 3.0
    weights = torch.exp(-RETURNS / scale)
    expected = 0.8 * weights / weights.sum() + 0.2 / 4
    torch.testing.assert_close(segment_probabilities(RETURNS, uniform=0.2), expected)
    shifted = segment_probabilities(5.0 * RETURNS - 300.0, uniform=0.2)
    torch.testing.assert_close(shifted, expected)  # neither scale nor origin of returns matters


def test_equal_returns_are_drawn_equally() -> None:
    p = segment_probabilities(torch.full((8,), 3.0), uniform=0.2)
    torch.testing.assert_close(p, torch.full((8,), 1 / 8))


def test_uniform_begins_anywhere_in_the_reference(context: Context) -> None:
    reference = reference_motion(context)
    found = ReferenceStates(None, context).sample(streams())
    share = frequencies(found["motion_start"], reference.duration)
    torch.testing.assert_close(share, torch.full((4,), 0.25), atol=0.01, rtol=0.0)
    expected = reference.sample(found["motion_start"])
    assert torch.equal(found["qpos"], expected["reference_qpos"])
    assert torch.equal(found["qvel"], expected["reference_qvel"])


def test_importance_draws_as_equation_3_9_says(context: Context, make_rollout: MakeRollout) -> None:
    states = Importance(Importance.Options(segments=SEGMENTS), context)
    duration = reference_motion(context).duration
    before = frequencies(states.sample(streams())["motion_start"], duration)
    torch.testing.assert_close(before, torch.full((4,), 0.25), atol=0.01, rtol=0.0)
    measures = states.update(walked(context, make_rollout))
    assert measures["hardest_segment"] == 0.0
    after = states.sample(streams())
    expected = segment_probabilities(RETURNS, uniform=0.2)
    found = frequencies(after["motion_start"], duration)
    torch.testing.assert_close(found, expected, atol=0.01, rtol=0.0)
    within = after["motion_start"] / duration * SEGMENTS % 1.0
    assert within.mean().item() == pytest.approx(0.5, abs=0.01)


def test_averages_run_and_unseen_segments_count_as_average(
    context: Context, make_rollout: MakeRollout
) -> None:
    states = Importance(Importance.Options(segments=SEGMENTS, decay=0.75), context)
    phase = torch.tensor([[0.1, 0.3, 0.3]])
    states.update(make_rollout({"phase": phase}, torch.tensor([[2.0, 5.0, 7.0]])))
    assert states.state_dict()["average"].tolist() == [2.0, 6.0, 0.0, 0.0]
    p = segment_probabilities(torch.tensor([2.0, 6.0, 4.0, 4.0]), uniform=0.2)
    torch.testing.assert_close(states.state_dict()["cumulative"], p.cumsum(0))
    states.update(make_rollout({"phase": phase[:, :1]}, torch.tensor([[10.0]])))
    torch.testing.assert_close(states.state_dict()["average"], torch.tensor([4.0, 6.0, 0.0, 0.0]))


def test_evolution_begins_with_the_reference(context: Context) -> None:
    reference = reference_motion(context)
    found = Evolution(Evolution.Options(segments=SEGMENTS, size=8), context).sample(streams())
    expected = reference.sample(found["motion_start"])
    torch.testing.assert_close(found["qpos"], expected["reference_qpos"])
    share = frequencies(found["motion_start"], reference.duration)
    torch.testing.assert_close(share, torch.full((4,), 0.25), atol=0.01, rtol=0.0)


def test_evolution_takes_over_states_of_any_cycle_moved_into_the_first(
    context: Context, make_rollout: MakeRollout
) -> None:
    reference = reference_motion(context)
    states = Evolution(Evolution.Options(segments=SEGMENTS, reference_share=0.0), context)
    states.update(walked(context, make_rollout))
    found = states.sample(streams(2000))
    assert ((found["motion_start"] >= 0) & (found["motion_start"] <= reference.duration)).all()
    for value in found.values():
        assert value.isfinite().all()
    expected = reference.sample(found["motion_start"])
    assert (found["qpos"][:, :3] - expected["reference_qpos"][:, :3]).abs().max() < 1e-3
    share = segment_probabilities(RETURNS, uniform=0.2)
    more = frequencies(states.sample(streams())["motion_start"], reference.duration)
    torch.testing.assert_close(more, share, atol=0.01, rtol=0.0)


@pytest.mark.parametrize("prefer", ["low", "high"])
def test_equation_3_10(context: Context, make_rollout: MakeRollout, prefer: str) -> None:
    """In one segment, two kinds of states of returns 0 and 2, so v = 2 and odds exp(1)."""
    size = 4000
    options = Evolution.Options(segments=1, size=size, reference_share=0.0, prefer=prefer)
    states = Evolution(options, context)
    rollout = walked(context, make_rollout, steps=100, worlds=50)
    good = torch.arange(50) % 2 == 1
    rollout.returns = torch.where(good, 2.0, 0.0).expand(100, 50)
    rollout.fields["qvel"] = torch.where(good[:, None], 1.0, -1.0).expand(100, 50, 34)
    states.update(rollout)
    assert rollout.returns is not None
    share = (states.state_dict()["buffer"]["qvel"][0, :, 6] > 0).float().mean()
    odds = torch.tensor(1.0 if prefer == "high" else -1.0).exp()
    assert share.item() == pytest.approx((odds / (1 + odds)).item(), abs=0.03)


def test_a_segment_with_too_few_states_keeps_its_buffer(
    context: Context, make_rollout: MakeRollout
) -> None:
    states = Evolution(Evolution.Options(segments=SEGMENTS, size=1000), context)
    before = states.state_dict()["buffer"]
    states.update(walked(context, make_rollout, steps=10, worlds=10))
    after = states.state_dict()["buffer"]
    assert all(torch.equal(after[name], before[name]) for name in before)


def test_some_episodes_still_begin_in_the_reference(
    context: Context, make_rollout: MakeRollout
) -> None:
    options = Evolution.Options(segments=SEGMENTS, size=8, reference_share=0.3)
    states = Evolution(options, context)
    rollout = walked(context, make_rollout)
    rollout.fields["qvel"] = torch.full((50, 40, 34), 99.0)
    states.update(rollout)
    evolved = (states.sample(streams())["qvel"][:, 10] == 99.0).float().mean()
    assert evolved.item() == pytest.approx(0.7, abs=0.01)


def test_draws_go_by_their_weights_and_repeat_exactly() -> None:
    returns = torch.tensor([0.0, 2.0, 5.0, 5.0, 9.0])
    of_segment = torch.tensor([[1, 1, 0, 0, 0], [0, 0, 1, 1, 0], [0, 0, 0, 0, 0]]).bool()
    bits = streams(3).bits(50_000)
    rows, counts = boltzmann_draws(of_segment, returns, bits, sign=-1.0)
    assert counts.tolist() == [2, 2, 0]
    assert set(rows[0].tolist()) == {0, 1}
    assert set(rows[1].tolist()) == {2, 3}
    odds = (rows[0] == 0).float().mean() / (rows[0] == 1).float().mean()
    assert odds.item() == pytest.approx(torch.tensor(1.0).exp().item(), rel=0.03)
    assert (rows[1] == 2).float().mean().item() == pytest.approx(0.5, abs=0.01)
    again, _ = boltzmann_draws(of_segment, returns, bits, sign=-1.0)
    assert torch.equal(rows, again)


@pytest.mark.parametrize("kind", [Importance, Evolution])
def test_what_a_captured_step_reads_stays_where_it_is(
    kind: type[Importance] | type[Evolution], context: Context, make_rollout: MakeRollout
) -> None:
    """Learning and loading change the tensors that draws are made from in place."""
    states = kind(kind.Options(segments=SEGMENTS), context)  # type: ignore[arg-type]

    def tensors() -> list[Tensor]:
        found = list(vars(states._segments).values())
        found += getattr(states, "_buffer", {}).values()
        return [value for value in found if isinstance(value, Tensor)]

    before, values = tensors(), [value.clone() for value in tensors()]
    states.update(walked(context, make_rollout))
    states.load_state_dict(states.state_dict())
    after = tensors()
    assert [value.data_ptr() for value in after] == [value.data_ptr() for value in before]
    assert any(not torch.equal(a, b) for a, b in zip(after, values, strict=True))


@pytest.mark.parametrize("kind", [Importance, Evolution])
def test_state_goes_round(
    kind: type[Importance] | type[Evolution],
    make_context: Callable[[], Context],
    make_rollout: MakeRollout,
) -> None:
    """A restored distribution draws and evolves exactly as the saved one."""
    first, second = (kind(kind.Options(segments=SEGMENTS), make_context()) for _ in range(2))
    rollout = walked(make_context(), make_rollout)
    first.update(rollout)
    saved = first.state_dict()
    first.update(rollout)
    second.load_state_dict(saved)
    second.update(rollout)
    a, b = first.sample(streams(500)), second.sample(streams(500))
    assert a.keys() == b.keys()
    assert all(torch.equal(a[name], b[name]) for name in a)


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        (Importance, {"segments": 0}),
        (Importance, {"uniform": 1.1}),
        (Importance, {"decay": 1.1}),
        (Evolution, {"segments": 0}),
        (Evolution, {"size": 0}),
        (Evolution, {"uniform": -0.1}),
        (Evolution, {"decay": 1.1}),
        (Evolution, {"reference_share": 1.5}),
        (Evolution, {"prefer": "best"}),
    ],
)
def test_impossible_options_are_refused(kind: type, options: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=next(iter(options))):
        kind.Options(**options)


def test_by_starts_only_the_states_in_which_episodes_begin_count(
    context: Context, make_rollout: MakeRollout
) -> None:
    """Eq. 3.9's w is the return from where an episode began: in segment 1 those are bad and all that
    pass through it are good."""
    phase = torch.tensor([[0.1, 0.3, 0.3, 0.3]])
    step = torch.tensor([[0, 0, 5, 9]])
    returns = torch.tensor([[4.0, 1.0, 9.0, 9.0]])
    found = {}
    for by in ("visits", "starts"):
        states = Importance(Importance.Options(segments=SEGMENTS, by=by), context)  # type: ignore[arg-type]
        states.update(make_rollout({"phase": phase, "episode_step": step}, returns))
        found[by] = states.state_dict()["average"].tolist()
    assert found["visits"] == pytest.approx([4.0, 19 / 3, 0.0, 0.0])
    assert found["starts"] == [4.0, 1.0, 0.0, 0.0]


def test_evolution_weighs_segments_by_starts_and_evolves_by_all_states(
    context: Context, make_rollout: MakeRollout
) -> None:
    options = Evolution.Options(segments=SEGMENTS, size=8, by="starts", reference_share=0.0)
    states = Evolution(options, context)
    rollout = walked(context, make_rollout)
    rollout.fields["episode_step"] += 1  # no episode began in this rollout
    before = states.state_dict()
    states.update(rollout)
    after = states.state_dict()
    assert torch.equal(after["average"], before["average"])
    assert not torch.equal(after["buffer"]["qpos"], before["buffer"]["qpos"])


def test_the_clips_start(context: Context) -> None:
    reference = reference_motion(context)
    found = ClipStart(ClipStart.Options(window=0.1), context).sample(streams())
    start = found["motion_start"]
    assert start.min() >= 0.0
    assert start.max() <= 0.1
    assert start.mean().item() == pytest.approx(0.05, abs=1e-3)
    assert torch.equal(found["qpos"], reference.sample(start)["reference_qpos"])
    first = ClipStart(ClipStart.Options(window=0.0), context).sample(streams(4))
    assert first["motion_start"].tolist() == [0.0] * 4
    with pytest.raises(ConfigError, match=r"initial_states\.window=99 .* the clip lasts [\d.]+ s"):
        ClipStart(ClipStart.Options(window=99.0), context)


def test_evolved_states_of_another_run(
    context: Context, make_rollout: MakeRollout, monkeypatch: pytest.MonkeyPatch
) -> None:
    trained = Evolution(Evolution.Options(segments=SEGMENTS, size=8), context)
    trained.update(walked(context, make_rollout))
    state = {"environment": {"initial_states": trained.state_dict()}}
    monkeypatch.setattr(evolution, "newest_state", lambda run: state)
    found = Evolved(Evolved.Options(run="runs/it"), context).sample(streams())
    buffer = trained.state_dict()["buffer"]
    known = buffer["motion_start"].flatten()
    counts = (found["motion_start"].unsqueeze(1) == known).sum(0)
    assert counts.sum() >= WORLDS  # each is one of these …
    assert counts.min() > 0.7 * WORLDS / len(known)  # … and all are drawn alike
    row = int((known == found["motion_start"][7]).nonzero()[0, 0])
    assert torch.equal(found["qpos"][7], buffer["qpos"].flatten(0, 1)[row])


@pytest.mark.parametrize(
    "spoil",
    [
        lambda b: {**b, "qpos": b["qpos"][:, :-1]},
        lambda b: {**b, "qpos": b["qpos"].bool()},
        lambda b: {**b, "qvel": b["qvel"] * torch.nan},
        lambda b: {**b, "motion_start": b["motion_start"].flatten()},
    ],
)  # fmt: skip
def test_evolved_states_that_are_damaged_are_refused(
    spoil: Callable[[dict[str, Tensor]], Any], context: Context, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = Evolution(Evolution.Options(segments=SEGMENTS, size=8), context).state_dict()
    state = {"environment": {"initial_states": {**own, "buffer": spoil(own["buffer"])}}}
    monkeypatch.setattr(evolution, "newest_state", lambda run: state)
    with pytest.raises(RunError, match="The initial states of runs/it are damaged"):
        Evolved(Evolved.Options(run="runs/it"), context)


@pytest.mark.parametrize(
    "state",
    [{"environment": 3}, {"environment": {"initial_states": {"buffer": {"qpos": 3}}}}],
    ids=str,
)
def test_a_checkpoint_without_environment_is_refused(
    state: Any, context: Context, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(evolution, "newest_state", lambda run: state)
    with pytest.raises(RunError, match="initial_states=spacetime/evolution"):
        Evolved(Evolved.Options(run="runs/it"), context)


def test_a_run_that_does_not_evolve_is_refused(
    context: Context, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(evolution, "newest_state", lambda run: {"policy": {}})
    with pytest.raises(RunError, match="initial_states=spacetime/evolution"):
        Evolved(Evolved.Options(run="runs/it"), context)

"""MuJoCo Warp against MuJoCo, and the fault tests that concern the GPU (1, 3, 10, 19, 30).

On a machine without a GPU the simulator runs on Warp's CPU device, slowly; those tests are marked
slow. The tests marked gpu run the same checks where they matter.
"""

from __future__ import annotations

import gc
import itertools
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
import torch
from arena import arena, states
from on_gpu import captured
from repeatable import repeatable  # noqa: F401 - a fixture

pytest.importorskip(
    "mujoco_warp", reason="MuJoCo Warp is not installed (pip install 'understudy[gpu]')"
)

from faults_on_gpu import TASK, apart_after_a_second, build, cold_start, dropped

from understudy.command.cli import main
from understudy.errors import ConfigError
from understudy.running.training import Training
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.task import Rollout
from understudy.testing import check_environment
from understudy_mujoco_warp.simulator import MujocoWarpSimulator
from understudy_reinforcement.job import Reinforcement
from understudy_tensors.captured import Captured

DEVICES = [
    pytest.param("cpu", marks=pytest.mark.slow),
    pytest.param("cuda", marks=pytest.mark.gpu),
]


def on_gpu(*overrides: str, task: Sequence[str] = TASK) -> Training:
    """A training of 64 worlds on the GPU, none of whose steps goes uncaptured silently."""
    fixed = ["simulator=mujoco_warp", "num_worlds=64", "evaluation.episodes=16"]
    with warnings.catch_warnings():
        warnings.filterwarnings("error", message="Steps cannot be captured")
        training = Training(load_experiment([*task, *fixed, *overrides])).prepare()
        learning(training).collector.collect(6)
    return training


def learning(training: Training) -> Reinforcement:
    assert isinstance(training.job, Reinforcement)
    return training.job


@pytest.mark.parametrize("device", DEVICES)
def test_agrees_with_mujoco_over_a_second(device: str) -> None:
    """Fault 19: the same states under the same targets for 30 control steps (600 physics steps).

    The moment of a contact magnifies rounding, so worlds may differ as far as plain MuJoCo does from
    itself, begun 1e-6 beside in several ways.
    """
    apart, own = apart_after_a_second(device, 8)
    assert (apart < 1e-4 + 3 * own).all()
    assert (own < 1e-4).sum() >= 5, "too many contacts: the test shows little"


@pytest.mark.parametrize("device", DEVICES)
def test_environment_conforms(device: str) -> None:
    environment = build(device).environment
    environment.reset(seed=0)
    if device == "cpu":
        check_environment(environment, steps=5)
    for _ in range(5):
        step = environment.step(environment.observations["feedforward"])
        assert torch.isfinite(step.rewards).all()


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("value", [float("nan"), float("inf"), 1e12])
@pytest.mark.parametrize(
    ("field", "place"), [("qvel", 3), ("qpos", 4)]
)  # the latter of a quaternion
@pytest.mark.parametrize("decision", [1, 2])
def test_a_bad_world_ends_alone(
    device: str, decision: int, field: str, place: int, value: float
) -> None:
    """Fault 1: that world fails and begins anew; the others go on; nothing non-finite gets out."""
    environment = build(device, f"control.decision={decision}").environment
    environment.reset(seed=1)
    environment.parts.simulator.read(field)[2, place] = value
    step = environment.step(environment.observations["feedforward"])
    expected = torch.zeros(8, dtype=torch.bool)
    expected[2] = True
    assert bool(step.terminated.cpu()[2])
    assert not step.terminated.cpu()[~expected].any()
    assert int(environment.quarantined) == 1
    for tensor in (step.rewards, *step.observations.values()):
        assert torch.isfinite(tensor).all()


@pytest.mark.parametrize("device", DEVICES)
def test_overflow_is_counted(device: str) -> None:
    """Fault 3: too small a capacity is reported with a count; the default one never overflows."""
    small = build(device, "simulator.constraints=4", "simulator.contacts=1").environment
    assert dropped(small, steps=4) > 0
    assert dropped(build(device).environment, steps=4) == 0


@pytest.mark.usefixtures("repeatable")
@pytest.mark.parametrize("device", DEVICES)
def test_resume_continues(device: str) -> None:
    """Fault 10: where the engine repeats itself, save and load in between changes no bit."""
    fixed = ["simulator=mujoco_warp", f"device={device}", "num_worlds=8"]
    overrides = [*TASK, *fixed, "learner.rollout_steps=4"]

    def train(iterations: int, training: Training) -> Training:
        for _ in range(iterations):
            training.iterate()
        return training

    straight = train(4, Training(load_experiment(overrides)).prepare())
    first = train(2, Training(load_experiment(overrides)).prepare())
    second = Training(load_experiment(overrides)).prepare()
    second.load_state_dict(first.state_dict())
    train(2, second)
    weights = learning(second).policy.state_dict()
    for name, value in learning(straight).policy.state_dict().items():
        assert torch.equal(value, weights[name]), name


@pytest.mark.gpu
def test_too_many_worlds_are_refused_before_allocating(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "mem_get_info", lambda device: (2**20, 2**34))
    with pytest.raises(ConfigError, match=r"About \d+ worlds fit"):
        build("cuda", worlds=1024)


@pytest.mark.parametrize("device", DEVICES)
def test_what_sharpens_goes_on_from_its_state_and_is_captured_anew(device: str) -> None:
    """A graph of the coarse step would go on making five sub-steps; on a CPU the physics alone is compared."""
    words = ["simulator=mujoco_warp", f"device={device}", "num_worlds=8", "resolution.substeps=5"]
    training = Training(load_experiment([*TASK, *words])).prepare()
    job = learning(training)
    coarse = job.environment
    coarse.reset(seed=0)
    for _ in range(6):
        coarse.step(coarse.observations["feedforward"])
    assert coarse.captured_step.on == (device == "cuda")
    state, targets = coarse.state_dict(), coarse.observations["feedforward"].clone()
    assert job.sharpen() == {"mark/physics at 600 Hz": 1.0}
    fine = job.environment
    assert fine is not coarse
    assert not fine.captured_step.on
    plain = build_environment(load_experiment([*TASK, *words]), substeps=20).environment
    plain.reset()
    plain.load_state_dict(state)
    for k in range(6):
        found = fine.step(targets)
        expected = plain._step(targets)  # never captured
        exact = {"rtol": 0, "atol": 0} if device == "cpu" else {"rtol": 1e-3, "atol": 1e-3}
        torch.testing.assert_close(fine.table["qpos"], plain.table["qpos"], **exact)
        if device == "cpu":
            torch.testing.assert_close(found.rewards, expected.rewards, **exact)
        assert fine.captured_step.on == (device == "cuda" and k >= 3)
    training.close()
    plain.close()


def test_without_a_gpu_one_line_says_what_is_missing(capsys: pytest.CaptureFixture[str]) -> None:
    if torch.cuda.is_available():
        pytest.skip("this machine has a GPU")
    assert main(["train", *TASK, "simulator=mujoco_warp"]) == 2
    assert capsys.readouterr().err.strip().splitlines()[-1] == (
        "understudy: device=cuda, but torch sees no CUDA GPU here. Use device=cpu."
    )


@pytest.mark.gpu
@pytest.mark.parametrize("captured", [True, False])
def test_nothing_goes_to_the_host_inside_a_rollout(captured: bool) -> None:
    """torch raises at any operation that waits for the device."""
    job = learning(on_gpu())
    assert job.environment.captured_step.on
    if not captured:
        job.environment.captured_step = Captured(job.environment._step, job.environment)
    torch.cuda.synchronize()
    torch.cuda.set_sync_debug_mode("error")
    try:
        job.collector.collect(3)  # without a capture: so many steps come before one
    finally:
        torch.cuda.set_sync_debug_mode("default")
    assert job.environment.captured_step.on == captured


@pytest.mark.gpu
@pytest.mark.usefixtures("repeatable")
@pytest.mark.parametrize("initial_states", ["importance", "evolution"])
def test_captured_steps_are_the_same_steps(initial_states: str) -> None:
    """Where the engine repeats itself, to the last bit, over episodes that end and begin; also after other
    worlds were begun by hand and after the state was restored."""
    chosen = f"initial_states=spacetime/{initial_states}"
    captured, plain = (learning(on_gpu(chosen)) for _ in range(2))
    plain.environment.captured_step._on = False
    state = plain.environment.state_dict()

    def run(job: Reinforcement) -> list[Rollout]:
        job.environment.load_state_dict(state)
        job.collector.streams.restart(5, "actions")
        rollouts = []
        for _ in range(3):
            rollouts.append(job.collector.collect(16))
            job.environment.parts.initial_states.update(_digested(rollouts[-1]))
        job.environment.begin(torch.arange(64, device=job.environment.device) % 3 == 0)
        return [*rollouts, job.collector.collect(8)]

    expected = run(plain)
    assert sum(int((r.terminated | r.truncated).sum()) for r in expected) > 64
    assert _first_difference(run(plain), expected) is None, "plain steps do not repeat themselves"
    for _ in range(2):
        assert _first_difference(run(captured), expected) is None


def _first_difference(found: list[Rollout], expected: list[Rollout]) -> str | None:
    """Where two series of rollouts part: rollout, step, what, in how many worlds and how far."""
    for number, (one, other) in enumerate(zip(found, expected, strict=True)):
        pairs = {
            **{k: (v, other.observations[k]) for k, v in one.observations.items()},
            **{k: (getattr(one, k), getattr(other, k)) for k in ("actions", "rewards")},
            **{k: (getattr(one, k), getattr(other, k)) for k in ("terminated", "truncated")},
            "final_values": (one.final_values, other.final_values),
        }
        for step in range(len(one.rewards)):
            for name, (a, b) in pairs.items():
                unlike = (a[step] != b[step]).reshape(len(a[step]), -1)
                if unlike.any():
                    most = (a[step].double() - b[step].double()).abs().max().item()
                    worlds = int(unlike.any(1).sum())
                    return f"rollout {number}, step {step}: {name}, {worlds} worlds, {most:.3g}"
    return None


def _digested(rollout: Rollout) -> Rollout:
    rollout.values, rollout.returns = torch.zeros_like(rollout.rewards), rollout.rewards.clone()
    return rollout


@pytest.mark.gpu
@pytest.mark.usefixtures("repeatable")
def test_captured_evaluations_are_the_same_evaluations() -> None:
    job = learning(on_gpu("evaluation.seconds=1"))
    evaluator = job.evaluator
    first = evaluator.run(job.policy, "test", 40)
    assert evaluator._step.on
    assert evaluator.run(job.policy, "test", 40) == first
    evaluator._step._on = False
    assert evaluator.run(job.policy, "test", 40) == first
    assert evaluator.run(job.policy, "other", 40) != first


@pytest.mark.gpu
def test_garbage_ends_no_capture() -> None:
    """Another environment's capture that is freed while a step is captured would end it."""
    threshold = gc.get_threshold()
    for _ in range(2):
        garbage: list[object] = [torch.cuda.CUDAGraph()]
        with torch.cuda.graph(garbage[0]):  # type: ignore[arg-type]
            torch.zeros(1, device="cuda").add_(1)
        garbage.append(garbage)
        del garbage
    gc.set_threshold(1)
    try:
        assert learning(on_gpu()).environment.captured_step.on
    finally:
        gc.set_threshold(*threshold)


@pytest.mark.gpu
def test_an_update_waits_for_the_device_once() -> None:
    job = learning(on_gpu())
    rollout = job.collector.collect(job.learner.rollout_steps)
    job.learner.update(rollout)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        torch.cuda.set_sync_debug_mode("warn")
        try:
            job.learner.update(rollout)
        finally:
            torch.cuda.set_sync_debug_mode("default")
    waits = [str(w.message) for w in caught if "called a synchronizing" in str(w.message)]
    # the sums of the metrics, the count of bad steps, and the explained variance, at the end
    assert len(waits) <= 3, waits


@pytest.mark.gpu
@pytest.mark.parametrize("learner", ["ppo", "trpo"])
def test_trains_and_evaluates_on_a_gpu(learner: str) -> None:
    parts = (f"learner={learner}", "policy=mlp", "learner.rollout_steps=16")
    training = on_gpu(*parts, task=["experiment=spacetime/walk"])
    for _ in range(2):
        row = training.iterate()
    assert all(value == value for value in row.values()), row
    assert training.job.evaluate("test", 32).episodes == 32


@pytest.mark.gpu
@pytest.mark.parametrize("exactly", [True, False])
def test_captured_in_the_callers_graph(exactly: bool, request: pytest.FixtureRequest) -> None:
    """50 steps through one torch graph, in which some worlds begin anew and some are restored, are
    those of plain calls: to the last bit where the engine repeats itself."""
    if exactly:
        request.getfixturevalue("repeatable")
    n, steps = 16, 50
    simulator = MujocoWarpSimulator(MujocoWarpSimulator.Options(), arena(n, "cuda"))
    simulator.vary(["gravity", "geom_size/box", "active/shelf"])
    everywhere = torch.ones(n, dtype=torch.bool, device="cuda")
    simulator.set_state(everywhere, states(n, "cuda"))
    start = simulator.snapshot()

    generator = torch.Generator().manual_seed(1)
    controls = torch.randn(steps, n, 1, generator=generator).cuda()
    begins, restores = (torch.rand(2, steps, n, generator=generator) < 0.05).cuda()
    sizes = torch.rand(steps, n, 3, generator=generator).cuda() * 0.1 + 0.05
    begin = {**states(n, "cuda"), "geom_size/box": sizes[0].clone()}
    control, begun, restored = controls[0].clone(), begins[0].clone(), restores[0].clone()
    names = ("qpos", "qvel", "xpos", "sensor_touch", "sensor_acceleration", "geom_size/box")
    seen = {name: torch.zeros_like(simulator.read(name)) for name in names}

    def advance() -> None:
        simulator.step(control)
        simulator.step(control, substeps=2)
        simulator.set_state(begun, begin)
        simulator.restore(start, restored)
        for name in names:
            seen[name].copy_(simulator.read(name) + 0.0)  # an allocation between, as tasks make

    def run(step: Callable[[], None]) -> list[dict[str, torch.Tensor]]:
        simulator.restore(start)
        trace = []
        for i in range(steps):
            control.copy_(controls[i])
            begun.copy_(begins[i])
            restored.copy_(restores[i])
            begin["geom_size/box"].copy_(sizes[i])
            step()
            trace.append({name: value.clone() for name, value in seen.items()})
        return trace

    expected = run(advance)
    found = run(captured(advance, torch.cuda.MemPool()).replay)  # see the plugin's README
    for i, (one, other) in enumerate(zip(expected, found, strict=True)):
        for name in names:
            if exactly:
                assert torch.equal(one[name], other[name]), f"{name} in step {i}"
            elif i < 5 and name in ("qpos", "qvel"):  # later, contacts part what rounding parted
                torch.testing.assert_close(one[name], other[name], atol=1e-3, rtol=1e-3)
    assert any((a["qpos"] != b["qpos"]).any() for a, b in itertools.pairwise(found))


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("cache", ["empty", "not writable"])
def test_cold_start(device: str, cache: str, tmp_path: Path) -> None:
    """Fault 30: with an empty kernel cache, and with one that cannot be written, the first step
    comes within a bound; the second says that the next start will be as slow."""
    folder = tmp_path / "kernels" if cache == "empty" else Path("/proc/no-such-cache")
    _, done = cold_start(device, str(folder))
    assert done.stdout.splitlines()[-1:] == ["stepped"], done.stderr
    assert ("No kernel cache to write" in done.stderr) == (cache != "empty")

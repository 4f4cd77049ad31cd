"""Speed on the CPU, as ratios measured in one run (``make bench``).

1. Environment: control steps of ``experiment=spacetime/walk`` while collecting, against bare
   ``mujoco.batch.Batch`` stepping the same model with the same controls.
2. End to end (collect and learn), against Stable-Baselines3's PPO on Gymnasium's Humanoid-v5 with
   networks of the same size. Each side does its own number of epochs and minibatches, which are in
   the record.
3. The update alone, both sides with the same samples, networks, epochs and batch size
   (``--parts update``).

Prints a table and appends it, with the hardware, to ``docs/benchmarks/cpu.jsonl``. Each ratio is the
median over rounds in which both sides run in turn, so drift of the machine's speed cancels.
"""

from __future__ import annotations

import argparse
import json
import platform
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import understudy_mujoco  # isort: skip  # noqa: F401 - before torch, to tell its threads how to wait
import numpy as np
import torch
from mujoco.batch import Batch
from sb3_speed import Peer

from understudy.records.runs import versions
from understudy.running.training import Training
from understudy.setup.composition import load_experiment
from understudy.task import Context, Rollout, box
from understudy_networks.policies import MLPPolicy
from understudy_ppo.learner import PPO
from understudy_reinforcement.collector import Collector
from understudy_reinforcement.job import Reinforcement

RESULTS = Path(__file__).resolve().parents[1] / "docs" / "benchmarks" / "cpu.jsonl"


#: Every bound is looked at and none ends an episode, which is cut after this many seconds.
EPISODE_SECONDS = 3.0
TERMS = ("com", "root", "joints", "end_effectors", "fall")


def environment_against_batch(rounds: int, steps: int, overrides: list[str]) -> dict[str, Any]:
    """Ratio of environment stepping (policy acting included and excluded) to bare stepping.

    Each step of the environment is paired with a bare one from the same states under the same
    controls.
    """
    lasting = [f"termination.terms.{name}.outcome=report" for name in TERMS]
    lasting.append(f"episode.seconds={EPISODE_SECONDS}")
    experiment = load_experiment(["experiment=spacetime/walk", *lasting, *overrides])
    training = Training(experiment).prepare()
    job = training.job
    assert isinstance(job, Reinforcement)
    environment = job.environment
    simulator: Any = environment.parts.simulator
    substeps = experiment.root.control.substeps
    n = environment.num_worlds
    bare = Batch(simulator.model, n, simulator.batch.nthread)
    ratios, env_rates, bare_rates, collect_ratios = [], [], [], []
    collector = Collector(environment, job.policy, 0)
    environment.reset(seed=0)
    for _ in range(rounds):
        env_time = bare_time = 0.0
        for _ in range(steps):
            targets = environment.observations["feedforward"].clone()
            bare.state[:] = simulator.snapshot()["state"].numpy()
            bare.bind("ctrl")[:] = targets.numpy()
            began = time.perf_counter()
            bare.step(nstep=substeps)
            between = time.perf_counter()
            environment.step(targets)
            env_time += time.perf_counter() - between
            bare_time += between - began
        if int(environment.quarantined):
            raise SystemExit(
                "The benchmark's worlds left the finite; its figures would mean nothing."
            )
        began = time.perf_counter()
        collector.collect(steps)
        collect_time = time.perf_counter() - began
        ratios.append(bare_time / env_time)
        collect_ratios.append(bare_time / collect_time)
        env_rates.append(n * steps / env_time)
        bare_rates.append(n * steps / bare_time)
    if not np.isfinite(bare.bind("qpos")).all():
        raise SystemExit("The bare simulation left the finite; its figures would mean nothing.")
    training.close()
    return {
        "worlds": n,
        "episode_seconds": EPISODE_SECONDS,
        "bare_physics_steps_per_second": statistics.median(bare_rates) * substeps,
        "environment_steps_per_second": statistics.median(env_rates),
        "environment_to_bare": statistics.median(ratios),
        "collecting_to_bare": statistics.median(collect_ratios),
    }


def end_to_end_against_sb3(rounds: int, seconds: float, overrides: list[str]) -> dict[str, Any]:
    """Ratio of samples/s, collecting and learning, to Stable-Baselines3's PPO on Humanoid-v5."""
    training = Training(load_experiment(["experiment=spacetime/walk", *overrides])).prepare()
    training.iterate()
    hidden = list(training.experiment.need("policy").options.feedback.hidden)  # pyright: ignore
    peer = Peer(hidden, 2048, 256)
    peer.samples_per_second(0.0)
    ours, theirs = [], []
    for _ in range(rounds):
        began, samples = time.perf_counter(), training.progress.samples
        while time.perf_counter() - began < seconds:
            training.iterate()
        ours.append((training.progress.samples - samples) / (time.perf_counter() - began))
        theirs.append(peer.samples_per_second(seconds))
    training.close()
    peer.close()
    ratio = statistics.median(a / b for a, b in zip(ours, theirs, strict=True))
    work = training.experiment.need("learner").options
    return {
        "hidden": hidden,
        "epochs": work.epochs,
        "minibatches": work.minibatches,
        "precision": work.precision,
        "samples_per_second": statistics.median(ours),
        "peer": "stable-baselines3 PPO, Humanoid-v5, 2 environments, 5 epochs of 256",
        "peer_samples_per_second": statistics.median(theirs),
        "samples_ratio": ratio,
        # Humanoid-v5 makes 5 physics steps a sample, the walk 20.
        "physics_steps_ratio": ratio * training.experiment.root.control.substeps / 5,
    }


#: Humanoid-v5's observation and action.
OBSERVATION, ACTION = 348, 17
HIDDEN, UPDATE_EPOCHS = (1024, 512), 5


def update_alone(rounds: int) -> dict[str, Any]:
    """Samples times epochs that an update digests a second, for batches of 256 and of 4096, and the
    ratio to Stable-Baselines3's PPO doing the same work in float32."""
    result: dict[str, Any] = {"hidden": HIDDEN, "epochs": UPDATE_EPOCHS}
    for batch in (256, 4096):
        samples = max(2048, batch)
        ours = {p: _our_update(samples, batch, p) for p in ("float32", "bfloat16")}
        peer = Peer(HIDDEN, samples, batch)
        sides = {**ours, "peer": peer.update_seconds}
        times: dict[str, list[float]] = {name: [] for name in sides}
        for update in sides.values():
            update()
        for _ in range(rounds):
            for name, update in sides.items():
                times[name].append(update())
        peer.close()
        for name, taken in times.items():
            rate = samples * UPDATE_EPOCHS / statistics.median(taken)
            result[f"batch_{batch}_{name}_per_second"] = rate
        for name in ("float32", "bfloat16"):
            pairs = zip(times["peer"], times[name], strict=True)
            result[f"batch_{batch}_{name}_ratio"] = statistics.median(a / b for a, b in pairs)
    return result


def _our_update(samples: int, batch: int, precision: Any) -> Callable[[], float]:
    """What makes an update and returns its seconds."""
    worlds = 256
    steps = samples // worlds
    context = Context(
        seed=0,
        device=torch.device("cpu"),
        num_worlds=worlds,
        control_dt=1 / 30,
        substeps=1,
        action_space=box(ACTION),
        observation_shapes={"state": (OBSERVATION,)},
    )
    policy = MLPPolicy(MLPPolicy.Options(hidden=HIDDEN), context)
    options = PPO.Options(
        rollout_steps=steps,
        epochs=UPDATE_EPOCHS,
        minibatches=None,
        batch_size=batch,
        precision=precision,
    )
    learner = PPO(options, context, policy)
    chance = torch.Generator().manual_seed(0)
    seen = torch.randn(steps, worlds, OBSERVATION, generator=chance)
    with torch.no_grad():
        distribution = policy.distribution({"state": seen})
        noise = 0.1 * torch.randn(steps, worlds, ACTION, generator=chance)
        actions = distribution.mode() + noise
    never, zero = torch.zeros(steps, worlds, dtype=torch.bool), torch.zeros(steps, worlds)
    rollout = Rollout(
        observations={"state": seen},
        last_observations={"state": seen[0]},
        actions=actions,
        log_probs=distribution.log_prob(actions),
        rewards=torch.rand(steps, worlds, generator=chance),
        terminated=never,
        truncated=never,
        failed=never,
        final_values=zero,
        episode_returns=zero,
        fields={},
    )

    def update() -> float:
        began = time.perf_counter()
        learner.update(rollout)
        return time.perf_counter() - began

    return update


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--steps", type=int, default=32)
    parser.add_argument("--seconds", type=float, default=12.0)
    parser.add_argument(
        "--parts",
        nargs="+",
        choices=("environment", "end_to_end", "update"),
        default=["environment", "end_to_end", "update"],
    )
    parser.add_argument("overrides", nargs="*", help="Hydra overrides of experiment=spacetime/walk")
    options = parser.parse_args()
    result: dict[str, Any] = {
        "when": time.strftime("%Y-%m-%d"),
        "processor": _processor(),
        "threads": torch.get_num_threads(),
        "versions": versions(),
    }
    measure: dict[str, Callable[[], dict[str, Any]]] = {
        "environment": lambda: environment_against_batch(
            options.rounds, options.steps, options.overrides
        ),
        "end_to_end": lambda: end_to_end_against_sb3(
            options.rounds, options.seconds, options.overrides
        ),
        "update": lambda: update_alone(options.rounds),
    }
    for part in options.parts:
        result[part] = measure[part]()
        for key, value in result[part].items():
            shown = f"{value:,.2f}" if isinstance(value, float) else str(value)
            print(f"{part:12} {key:32} {shown}")
    print("mjlab, whose physics is for GPUs, is measured beside ours by `make bench-gpu`.")
    with open(RESULTS, "a", encoding="utf-8") as file:
        file.write(json.dumps(result) + "\n")


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return f"{len(names)} × {names[0]}" if names else platform.processor()


if __name__ == "__main__":
    main()

"""Speed of PPO's update alone: many small optimiser steps (``python benchmarks/updates.py``).

Each case is an update of random samples with two networks. It is compared with the plainest loop in
torch of the same losses, clipping and optimiser (no statistics, no skipping of steps that are not
finite), run as it is and, on a GPU, with its step captured as a CUDA graph. All sides take turns;
figures are medians over rounds.

With ``--operations`` it counts instead: torch operations of an optimiser step that compute or copy
something, each about a kernel on a GPU.

Prints a JSON line for each case and appends it, with the hardware, to ``docs/benchmarks/updates.jsonl``.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import platform
import statistics
import time
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import torch
from rows import append
from torch import Tensor, nn
from torch.utils._python_dispatch import TorchDispatchMode

from understudy.records.runs import versions
from understudy.task import Context, Rollout, box
from understudy_networks.graphs import Captured
from understudy_networks.policies import MLPPolicy
from understudy_ppo.learner import PPO
from understudy_ppo.losses import KLPenalty

RESULTS = Path(__file__).resolve().parents[1] / "docs" / "benchmarks" / "updates.jsonl"
SAMPLES, ROWS = 16_384, 4
ADAM = {"actor_learning_rate": 1e-4, "critic_learning_rate": 3e-4}
#: Table 6.3 of Yang's thesis, with what the released DeepMimic does (learner=deepmimic/optimised_walk_gpu).
SGD = {
    "optimiser": "sgd",
    "momentum": 0.9,
    "weight_decay": 5e-4,
    "actor_learning_rate": 1.68e-5,
    "critic_learning_rate": 2e-3,
    "clip": 0.18,
    "max_gradient_norm": 47.36,
    "value_weight": 0.5,
    "advantage_clip": 4.0,
}
CASES: dict[str, dict[str, Any]] = {
    "adam": ADAM,
    "adaptive_rate": ADAM | {"target_kl": 0.02},
    "sgd": SGD,
    "penalty": ADAM | {"kl_penalty": KLPenalty()},
    "bfloat16": ADAM | {"precision": "bfloat16"},
}


def learner_of(options: argparse.Namespace, case: dict[str, Any]) -> tuple[PPO, Rollout]:
    worlds, device = SAMPLES // ROWS, torch.device(options.device)
    context = Context(
        seed=0,
        device=device,
        num_worlds=worlds,
        control_dt=1 / 30,
        substeps=1,
        action_space=box(options.action),
        observation_shapes={"state": (options.observation,)},
    )
    torch.manual_seed(0)
    policy = MLPPolicy(MLPPolicy.Options(hidden=tuple(options.hidden)), context).to(device)
    # The same rollout again and again leaves the policy far from it, which is no fault here.
    given = {"precision": "tf32", "epochs": options.epochs, "patience": 10**9} | case
    learner = PPO(
        PPO.Options(rollout_steps=ROWS, minibatches=None, batch_size=options.batch, **given),
        context,
        policy,
    )
    chance = torch.Generator().manual_seed(0)

    def drawn(*columns: int) -> Tensor:
        return torch.randn(ROWS, worlds, *columns, generator=chance).to(device)

    seen = drawn(options.observation)
    policy.observe({"state": seen})
    with torch.no_grad():
        distribution = policy.distribution({"state": seen})
        actions = distribution.mode() + 0.1 * drawn(options.action)
    never, zero = torch.zeros(2, ROWS, worlds, device=device)
    rollout = Rollout(
        observations={"state": seen},
        last_observations={"state": seen[0]},
        actions=actions,
        log_probs=distribution.log_prob(actions),
        rewards=drawn(),
        terminated=never.bool(),
        truncated=never.bool(),
        failed=never.bool(),
        final_values=zero,
        episode_returns=zero,
        fields={},
    )
    return learner, rollout


def peer_of(
    options: argparse.Namespace, case: dict[str, Any], captured: bool
) -> Callable[[], None]:
    """An update as the plainest loop in torch; of a KL penalty it has none."""
    device, chosen = torch.device(options.device), PPO.Options(**case)
    torch.manual_seed(0)

    def network(outputs: int) -> nn.Sequential:
        sizes = [options.observation, *options.hidden]
        layers: list[nn.Module] = []
        for inputs, units in itertools.pairwise(sizes):
            layers += [nn.Linear(inputs, units), nn.ReLU()]
        return nn.Sequential(*layers, nn.Linear(sizes[-1], outputs)).to(device)

    actor, critic = network(options.action), network(1)
    rates = (chosen.actor_learning_rate, chosen.critic_learning_rate)
    if chosen.optimiser == "sgd":
        kind: Any = torch.optim.SGD
        extra: dict[str, Any] = {"momentum": chosen.momentum}
    else:
        kind, extra = torch.optim.Adam, {"capturable": captured}
    extra["weight_decay"] = chosen.weight_decay
    optimisers = [
        kind(net.parameters(), lr=r, **extra) for net, r in zip((actor, critic), rates, strict=True)
    ]
    mean = torch.zeros(options.observation, device=device)
    scale = torch.ones(options.observation, device=device)
    deviation = torch.full((options.action,), 0.1, device=device)
    clip = chosen.clip or math.inf
    data = [
        torch.randn(SAMPLES, *columns, device=device)
        for columns in ((options.observation,), (options.action,), (), (), ())
    ]

    def step(seen: Tensor, actions: Tensor, old: Tensor, returns: Tensor, gains: Tensor) -> None:
        with torch.autocast(
            device.type, torch.bfloat16, enabled=case.get("precision") == "bfloat16"
        ):
            x = ((seen - mean) * scale).clamp(-5, 5)
            outputs, values = actor(x).float(), critic(x).float().squeeze(-1)
        log_prob = -0.5 * ((actions - outputs) / deviation).square().sum(-1) - deviation.log().sum()
        ratio = torch.exp((log_prob - old).clamp(-1, 1))
        surrogate = torch.minimum(ratio * gains, ratio.clamp(1 - clip, 1 + clip) * gains)
        value_loss = chosen.value_weight * (values - returns).square().mean()
        for optimiser in optimisers:
            optimiser.zero_grad(set_to_none=True)
        (value_loss - surrogate.mean()).backward()
        for net, optimiser in zip((actor, critic), optimisers, strict=True):
            nn.utils.clip_grad_norm_(net.parameters(), chosen.max_gradient_norm)
            optimiser.step()

    names = ("seen", "actions", "old", "returns", "gains")

    def run(minibatch: Mapping[str, Tensor]) -> None:
        step(*(minibatch[name] for name in names))

    chosen_run = Captured(run, device) if captured else run

    def update() -> None:
        for _ in range(options.epochs):
            order = torch.randperm(SAMPLES, device=device)
            for rows in order.split(options.batch):
                if len(rows) == options.batch:
                    chosen_run({n: part[rows] for n, part in zip(names, data, strict=True)})

    return update


def speed(options: argparse.Namespace, case: dict[str, Any]) -> dict[str, Any]:
    """Optimiser steps a second of each side."""
    learner, rollout = learner_of(options, case)
    on_gpu = options.device.startswith("cuda")
    sides: dict[str, Callable[[], Any]] = {"understudy": lambda: learner.update(rollout)}
    sides["peer"] = peer_of(options, case, False)
    if on_gpu:
        sides["captured_peer"] = peer_of(options, case, True)
    wait = torch.cuda.synchronize if on_gpu else lambda: None
    times: dict[str, list[float]] = {name: [] for name in sides}
    work: dict[str, list[float]] = {name: [] for name in sides}
    for update in sides.values():
        for _ in range(options.warm_up):
            update()
    for _ in range(options.rounds):
        for name, update in sides.items():
            wait()
            began, worked = time.perf_counter(), time.process_time()
            update()
            wait()
            times[name].append(time.perf_counter() - began)
            work[name].append(time.process_time() - worked)
    steps = options.epochs * (SAMPLES // options.batch)
    found: dict[str, Any] = {"steps": steps}
    for name, taken in times.items():
        found[f"{name}_steps_per_second"] = steps / statistics.median(taken)
        found[f"{name}_cpu_ms_per_step"] = 1e3 * statistics.median(work[name]) / steps
    for name in sides:
        if name != "understudy":
            pairs = zip(times[name], times["understudy"], strict=True)
            found[f"{name}_ratio"] = statistics.median(a / b for a, b in pairs)
    return found


#: Operations without a kernel, beside views.
NO_WORK = ("empty", "new_empty", "detach", "_unsafe_view", "_record_function")


class Operations(TorchDispatchMode):
    """Counts operations that are neither views nor allocations."""

    def __init__(self) -> None:
        super().__init__()
        self.counts: Counter[str] = Counter()

    def __torch_dispatch__(
        self, func: Any, types: Any, args: tuple[Any, ...] = (), kwargs: Any = None
    ) -> Any:
        name = func.__name__.partition(".")[0]
        if not func.is_view and not name.startswith(NO_WORK):
            self.counts[name] += 1
        return func(*args, **(kwargs or {}))


def operations(options: argparse.Namespace, case: dict[str, Any]) -> dict[str, Any]:
    """Operations per optimiser step: the difference between an update's first two epochs, by step,
    so that what an update does once does not count."""
    torch.set_num_threads(1)
    totals: list[Counter[str]] = []
    epochs = options.epochs
    for options.epochs in (1, 2):
        learner, rollout = learner_of(options, case)
        learner.update(rollout)
        with Operations() as mode:
            learner.update(rollout)
        totals.append(mode.counts)
    options.epochs = epochs
    steps = SAMPLES // options.batch
    each = {name: (totals[1][name] - totals[0][name]) / steps for name in totals[1]}
    shown = {name: round(n, 2) for name, n in sorted(each.items(), key=lambda x: -x[1]) if n > 0}
    return {"operations_per_step": round(sum(each.values()), 1), "operations": shown}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES))
    parser.add_argument("--hidden", nargs="+", type=int, default=[1024, 512])
    parser.add_argument("--observation", type=int, default=227)
    parser.add_argument("--action", type=int, default=28)
    parser.add_argument("--batch", type=int, default=688)
    parser.add_argument("--epochs", type=int, default=8)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--warm-up", type=int, default=3, help="updates before the first round")
    parser.add_argument("--operations", action="store_true", help="count operations instead")
    parser.add_argument("--output", type=Path, default=RESULTS)
    options = parser.parse_args()
    on_gpu = options.device.startswith("cuda")
    hardware = torch.cuda.get_device_name() if on_gpu else platform.processor()
    measure = operations if options.operations else speed
    for name in options.cases:
        row = {
            "when": time.strftime("%Y-%m-%d"),
            "device": hardware or options.device,
            "threads": torch.get_num_threads(),
            "versions": versions(),
            "case": name,
            "batch": options.batch,
            "hidden": options.hidden,
            **measure(options, CASES[name]),
        }
        print(json.dumps({k: v for k, v in row.items() if k != "versions"}), flush=True)
        append(options.output, row)


if __name__ == "__main__":
    main()

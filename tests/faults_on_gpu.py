"""The faults that need a GPU (3, 10, 19, 30), with figures: some minutes on one.

Prints a line of JSON for each and appends all, with the hardware, to ``docs/benchmarks/faults.jsonl``.
Ends with 1 if one does not end as it must::

    python tests/faults_on_gpu.py

3.  Contacts or constraints that found no room, in the scenes under test and where there is too little.
10. Six iterations against three, a checkpoint, a new process and three more: the differences of all of
    the states where the engine repeats itself; where it does not, the rewards of eight repetitions on
    either side, and how likely means as far apart are between halves of all sixteen.
19. A second under the same targets as MuJoCo on the CPU: how far joints and root end apart (m, rad,
    quaternion), beside how far MuJoCo ends from itself when it begins 1e-6 beside.
30. Seconds from the command to the first step: compiled kernels nowhere, not writable, and there.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from repeatable import repeat_exactly
from torch import Tensor
from worlds import all_plugins, flat, make_training, resumed

from understudy.records import checkpoint, runs
from understudy.running.environment import Environment
from understudy.setup.building import Built, build_environment
from understudy.setup.composition import load_experiment

RESULTS = Path(__file__).resolve().parents[1] / "docs" / "benchmarks" / "faults.jsonl"
TASK = ("experiment=spacetime/walk", "learner.minibatches=2", "policy.feedback.hidden=[32]")
#: Seconds within which the first step comes while kernels are compiled.
COLD = 240
STARTS = ("empty", "not writable", "filled")
#: Iterations before and after a checkpoint.
N = 3


def build(device: str, *overrides: str, worlds: int = 8) -> Built:
    fixed = ["simulator=mujoco_warp", f"device={device}", f"num_worlds={worlds}"]
    return build_environment(load_experiment([*TASK, *fixed, *overrides]))


def dropped(environment: Environment, steps: int) -> int:
    """World steps in which contacts or constraints found no room."""
    environment.reset(seed=0)
    for _ in range(steps):
        environment.step(environment.observations["feedforward"])
    return int(environment.parts.simulator.report().get("contact_or_constraint_overflows", 0))


def apart_after_a_second(device: str, worlds: int) -> tuple[Tensor, Tensor]:
    """By world, how far MuJoCo Warp's qpos are from MuJoCo's after 30 control steps (600 physics steps)
    under the same targets, and how far MuJoCo's are from its own, begun 1e-6 beside in six ways."""
    reference = build_environment(load_experiment([*TASK, f"num_worlds={worlds}"])).environment
    environment = build(device, worlds=worlds).environment
    everywhere = torch.ones(worlds, dtype=torch.bool)

    def second(beside: float = 0.0, way: int = 0) -> tuple[list[Tensor], Tensor]:
        reference.reset(seed=3)
        simulator, noise = reference.parts.simulator, torch.Generator().manual_seed(way)
        begun = {name: simulator.read(name).clone() for name in simulator.state_fields}
        for value in begun.values():
            value += beside * torch.randn(value.shape, generator=noise)
        simulator.set_state(everywhere, begun)
        reference.refresh()
        targets = []
        for _ in range(30):
            targets.append(reference.table["reference_joint_targets"].clone())
            simulator.step(targets[-1])
        return targets, simulator.read("qpos").clone()

    targets, exact = second()
    beside = torch.stack([second(1e-6, way)[1] for way in range(6)])
    environment.reset(seed=3)
    for target in targets:
        environment.parts.simulator.step(target.to(environment.device))
    found = environment.parts.simulator.read("qpos").cpu()
    return (found - exact).abs().amax(dim=1), (beside - exact).abs().amax(dim=(0, 2))


def cold_start(device: str, cache: str) -> tuple[float, subprocess.CompletedProcess[str]]:
    """Seconds from the command to the first step of a fresh process whose compiled kernels are in `cache`."""
    overrides = [*TASK, "simulator=mujoco_warp", f"device={device}", "num_worlds=8"]
    code = f"""
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
environment = build_environment(load_experiment({overrides!r})).environment
environment.reset(seed=0)
environment.step(environment.observations["feedforward"])
print("stepped")
"""
    began = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=COLD,
        env={**os.environ, "WARP_CACHE_PATH": cache},
    )  # fmt: skip
    return time.monotonic() - began, done


def fault_3(device: str) -> dict[str, Any]:
    worlds, steps = (4096, 60) if device == "cuda" else (8, 4)
    scenes = {"walk": (), "self_collision": ("scene.self_collision=true",)}
    found = {
        name: dropped(build(device, *overrides, worlds=worlds).environment, steps)
        for name, overrides in scenes.items()
    }
    small = build(device, "simulator.constraints=4", "simulator.contacts=1", worlds=worlds)
    little = dropped(small.environment, steps)
    return {
        "worlds": worlds, "steps": steps, "dropped": found, "dropped_with_too_little_room": little,
        "ok": not any(found.values()) and little > 0,
    }  # fmt: skip


def _resumable(device: str, worlds: int) -> list[str]:
    fixed = ["simulator=mujoco_warp", f"device={device}", f"num_worlds={worlds}"]
    return [*TASK, *fixed, "learner.rollout_steps=8"]


def fault_10_exactly(device: str) -> dict[str, Any]:
    """Where the engine repeats itself."""
    with tempfile.TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        repeat_exactly(patch)
        straight = make_training(all_plugins(), _resumable(device, 64), Path(folder) / "straight")
        cut = make_training(all_plugins(), _resumable(device, 64), Path(folder) / "cut")
        for training in (straight, cut):
            for _ in range(N):
                training.iterate()
        cut.save()
        assert cut.run is not None
        cut.run.unlock()
        for _ in range(N):
            straight.iterate()
        straight.save()
        _child(device, "go_on_exactly", f"{folder}/cut")
        both = [
            flat(checkpoint.load(Path(folder) / f"{name}/checkpoints/{2 * N:08d}")[0])
            for name in ("straight", "cut")
        ]
    differ = [
        name
        for name, value in both[0].items()
        if isinstance(value, Tensor) and not torch.equal(value, both[1][name])
    ]
    tensors = sum(isinstance(value, Tensor) for value in both[0].values())
    return {"tensors": tensors, "differ": len(differ), "ok": tensors > 50 and not differ}


def go_on_exactly(device: str, run: str) -> dict[str, Any]:
    with pytest.MonkeyPatch.context() as patch:
        repeat_exactly(patch)
        training = resumed(all_plugins(), Path(run))
        for _ in range(N):
            training.iterate()
        training.save()
    return {}


def fault_10_statistically(device: str) -> dict[str, Any]:
    """Where it does not: contacts come in no fixed order."""
    worlds, times = (512, 8) if device == "cuda" else (8, 2)
    with tempfile.TemporaryDirectory() as folder:
        training = make_training(all_plugins(), _resumable(device, worlds), Path(folder) / "run")
        for _ in range(N):
            training.iterate()
        training.save()
        assert training.run is not None
        training.run.unlock()
        straight = [training.iterate()["reward"] for _ in range(N)][-1:]
        run = Path(folder) / "run"
        state, _ = checkpoint.load(run / f"checkpoints/{N:08d}")
        for _ in range(times - 1):
            training.load_state_dict(state)
            straight.append([training.iterate()["reward"] for _ in range(N)][-1])
        again = _child(device, "go_on", str(run), str(times))["rewards"]
    everything = np.array([*straight, *again])
    apart = abs(np.mean(straight) - np.mean(again))
    halves = [
        abs(everything[list(half)].mean() - np.delete(everything, half).mean())
        for half in itertools.combinations(range(2 * times), times)
    ]
    likely = float(np.mean(np.array(halves) >= apart - 1e-12))
    return {
        "worlds": worlds, "repetitions": times, "reward": [float(np.mean(straight)), float(np.mean(again))],
        "deviation": [float(np.std(straight, ddof=1)), float(np.std(again, ddof=1))],
        "probability": likely, "ok": likely > 0.001,
    }  # fmt: skip


def go_on(device: str, run: str, times: str) -> dict[str, Any]:
    training = resumed(all_plugins(), Path(run))
    state, rewards = checkpoint.load(Path(run) / f"checkpoints/{N:08d}")[0], []
    for _ in range(int(times)):
        training.load_state_dict(state)
        rewards.append([training.iterate()["reward"] for _ in range(N)][-1])
    return {"rewards": rewards}


def fault_19(device: str) -> dict[str, Any]:
    worlds = 256 if device == "cuda" else 8
    apart, own = apart_after_a_second(device, worlds)
    within = apart < 1e-4 + 3 * own
    calm = own < 1e-4
    return {
        "worlds": worlds, "within": float(within.float().mean()),
        "apart": {"median": float(apart.median()), "most": float(apart.max())},
        "own": {"median": float(own.median()), "most": float(own.max())},
        "without_such_contacts": {"worlds": int(calm.sum()), "most": float(apart[calm].max())},
        "ok": float(within.float().mean()) >= 0.99 and bool(calm.any()),
    }  # fmt: skip


def fault_30(device: str, folder: str) -> dict[str, Any]:
    """The first two at the same time; the third where the first left its kernels."""
    places = dict(zip(STARTS, (folder, "/proc/no-such-cache", folder), strict=True))
    with ThreadPoolExecutor() as pool:
        cold = pool.map(lambda name: cold_start(device, places[name]), STARTS[:2])
    took = dict(zip(STARTS, [*cold, cold_start(device, folder)], strict=True))
    stepped = all(done.stdout.splitlines()[-1:] == ["stepped"] for _, done in took.values())
    said = {name: "No kernel cache to write" in done.stderr for name, (_, done) in took.items()}
    return {
        "seconds": {name: round(seconds, 1) for name, (seconds, _) in took.items()},
        "ok": stepped and said == {name: name == "not writable" for name in STARTS},
    }  # fmt: skip


def _child(device: str, what: str, *arguments: str) -> dict[str, Any]:
    """What a function of this file returns in a new process."""
    done = subprocess.run(
        [sys.executable, __file__, "--device", device, "--call", what, *arguments],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    if done.returncode:
        raise SystemExit(f"{what} ended with {done.returncode}:\n{done.stderr[-3000:]}")
    return json.loads(done.stdout.splitlines()[-1])


def main() -> int:
    parser = argparse.ArgumentParser(description="The faults that need a GPU, with figures.")
    parser.add_argument("--device", default="cuda", choices=["cuda", "cpu"])
    parser.add_argument("--out", type=Path, default=RESULTS)
    parser.add_argument("--call", nargs="+", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.call:
        print(json.dumps(globals()[options.call[0]](options.device, *options.call[1:])))
        return 0
    record = {
        "when": time.strftime("%Y-%m-%d"),
        "device": torch.cuda.get_device_name() if options.device == "cuda" else "cpu",
        "cores": os.cpu_count(), "versions": runs.versions(),
    }  # fmt: skip

    def found(name: str, figures: dict[str, Any]) -> bool:
        record[name] = figures
        print(json.dumps({"fault": name, **figures}), flush=True)
        return bool(figures["ok"])

    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor() as pool:
        ok = [found("30", fault_30(options.device, folder))]
        os.environ["WARP_CACHE_PATH"] = folder
        others = {
            "3": "fault_3", "19": "fault_19", "10, engine repeats itself": "fault_10_exactly",
            "10, engine does not": "fault_10_statistically",
        }  # fmt: skip
        calls = {name: pool.submit(_child, options.device, call) for name, call in others.items()}
        ok += [found(name, call.result()) for name, call in calls.items()]
    with options.out.open("a", encoding="utf-8") as file:
        file.write(json.dumps(record) + "\n")
    return int(not all(ok))


if __name__ == "__main__":
    sys.exit(main())

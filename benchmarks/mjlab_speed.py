"""What mjlab's environment costs beside the physics below it, in a process of its own.

mjlab pins versions of MuJoCo that are not ours, so it has an environment of its own: ``python -m venv VENV && VENV/bin/pip install
mjlab``, then ``UNDERSTUDY_MJLAB=VENV/bin/python make bench-gpu``. As a script, with that Python, it prints a line of JSON: each step
of its environment, under random actions, is paired with as many bare steps of the same simulation as it makes. Nothing of
understudy is imported here when it runs so.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from typing import Any

TASK = "Mjlab-Velocity-Flat-Unitree-G1"


def asked(worlds: list[int]) -> list[dict[str, Any]] | str:
    """What the Python of ``$UNDERSTUDY_MJLAB`` measures, or why nothing."""
    python = os.environ.get("UNDERSTUDY_MJLAB")
    if not python:
        return "UNDERSTUDY_MJLAB is not set: give it the Python of an environment into which mjlab is installed."
    command = [python, __file__, "--worlds", *map(str, worlds)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=1800)
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"{python} gave nothing: {error}."
    if done.returncode:
        return f"{python}: {(done.stderr.strip() or 'no reason given').splitlines()[-1]}"
    return [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]


def measure(task: str, worlds: int, steps: int, device: str) -> dict[str, Any]:
    """Environment steps and bare steps a second, and their ratio."""
    import mjlab.tasks  # pyright: ignore # noqa: F401
    import torch
    from mjlab.envs import ManagerBasedRlEnv  # pyright: ignore
    from mjlab.tasks.registry import load_env_cfg  # pyright: ignore

    config = load_env_cfg(task)
    config.scene.num_envs = worlds
    environment = ManagerBasedRlEnv(cfg=config, device=device)
    environment.reset()
    size = environment.action_manager.total_action_dim
    chance = torch.Generator(device=device).manual_seed(0)

    def bare(_: Any) -> None:
        for _ in range(config.decimation):
            environment.sim.step()

    def seconds(step: Any) -> float:
        action = 2 * torch.rand(worlds, size, device=device, generator=chance) - 1
        if device != "cpu":
            torch.cuda.synchronize()
        began = time.perf_counter()
        step(action)
        if device != "cpu":
            torch.cuda.synchronize()
        return time.perf_counter() - began

    for _ in range(4):
        seconds(environment.step)
    taken = [(seconds(bare), seconds(environment.step)) for _ in range(steps)]
    physics, whole = (sum(pair[k] for pair in taken) for k in (0, 1))
    environment.close()
    return {
        "peer": f"mjlab, {task}",
        "worlds": worlds,
        "physics_steps": config.decimation,
        "bare_physics_steps_per_second": worlds * steps * config.decimation / physics,
        "environment_steps_per_second": worlds * steps / whole,
        "environment_to_bare": physics / whole,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--task", default=TASK)
    parser.add_argument("--worlds", type=int, nargs="+", default=[4096])
    parser.add_argument("--steps", type=int, default=48)
    parser.add_argument("--device", default="cuda:0")
    given = parser.parse_args()
    for worlds in given.worlds:
        found = measure(given.task, worlds, given.steps, given.device)
        print(json.dumps(found), flush=True)


if __name__ == "__main__":
    sys.exit(main())

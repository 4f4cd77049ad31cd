"""The speed of Stable-Baselines3's PPO on Humanoid-v5, in a process of its own (:class:`Peer`).

Ours has torch's threads sleep and MuJoCo read no clock, for its whole process; the peer runs as anybody
would run it. As a script it answers lines: ``learn SECONDS`` with samples a second, ``update`` with
the seconds of one update.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence


class Peer:
    """PPO with `hidden` layers, 5 epochs of batches of `batch`, `samples` an iteration."""

    def __init__(self, hidden: Sequence[int], samples: int, batch: int) -> None:
        plain = {name: value for name, value in os.environ.items() if name != "OMP_WAIT_POLICY"}
        sizes = [str(size) for size in (samples, batch, *hidden)]
        self._process = subprocess.Popen(
            [sys.executable, __file__, *sizes],
            env=plain,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def samples_per_second(self, seconds: float) -> float:
        """Collecting and learning, for at least `seconds`."""
        return self._ask(f"learn {seconds}")

    def update_seconds(self) -> float:
        """Of one iteration's update."""
        return self._ask("update")

    def close(self) -> None:
        self._process.communicate()

    def _ask(self, question: str) -> float:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(question + "\n")
        self._process.stdin.flush()
        answer = self._process.stdout.readline()
        if not answer:
            raise SystemExit("Stable-Baselines3's process has ended; its error is above.")
        return float(answer)


def _answer(samples: int, batch: int, hidden: list[int]) -> None:
    import gymnasium
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import DummyVecEnv

    peer = PPO(
        "MlpPolicy",
        DummyVecEnv([lambda: gymnasium.make("Humanoid-v5")] * 2),
        n_steps=samples // 2,
        batch_size=batch,
        n_epochs=5,
        policy_kwargs={"net_arch": hidden, "activation_fn": torch.nn.ReLU},
        device="cpu",
    )
    peer.learn(samples)

    def learn(seconds: str) -> float:
        began, before = time.perf_counter(), peer.num_timesteps
        while time.perf_counter() - began < float(seconds):
            peer.learn(samples, reset_num_timesteps=False)
        return (peer.num_timesteps - before) / (time.perf_counter() - began)

    def update() -> float:
        began = time.perf_counter()
        peer.train()
        return time.perf_counter() - began

    questions: dict[str, Callable[..., float]] = {"learn": learn, "update": update}
    for line in sys.stdin:
        name, *arguments = line.split()
        print(questions[name](*arguments), flush=True)


if __name__ == "__main__":
    samples, batch, *hidden = (int(size) for size in sys.argv[1:])
    _answer(samples, batch, hidden)

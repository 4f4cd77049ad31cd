"""``understudy jumping heights``: the highest bar, or the widest box, that a run clears."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

from understudy.command.command import Command
from understudy.errors import RunError
from understudy.records import runs
from understudy.running.evaluation import Evaluation, wilson_interval
from understudy.running.warm_start import newest_state
from understudy_inspect.judging import load
from understudy_jumping.arena import Arena, ArenaOptions

#: In the run folder: what was found.
FILE = "heights.json"


class Heights(Command):
    """Judges a run at the obstacle that its training came to, and at ever easier ones until enough
    attempts succeed; an evaluation judges at the target alone, which a training may not have reached.

    Prints what it tries, and leaves the evaluation of the highest in ``heights.json`` of the run folder.
    """

    takes_overrides = True

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.usage = (
            "understudy jumping heights RUN [--success SHARE] [--step METRES] [KEY=VALUE …]"
        )
        parser.add_argument("run", help="run folder")
        parser.add_argument(
            "--success", type=float, default=0.5, help="share of attempts (default: 0.5)"
        )
        parser.add_argument(
            "--step", type=float, default=0.05, help="m, lower or narrower (default: 0.05)"
        )

    def run(self, options: argparse.Namespace) -> int:
        tried: list[tuple[float, float]] = []
        for difficulty, arena in _ladder(options.run, options.step, options.overrides):
            found, samples = _judged(
                options.run, difficulty, options.success, list(options.overrides)
            )
            size = f"{arena.height(difficulty):.2f} m high"
            if arena.options.width[0] != arena.options.width[1]:
                size += f", {arena.width(difficulty):.2f} m wide"
            print(f"{size}: {found.sentence()}", flush=True)
            rate = found.success_rate or 0.0
            tried.append((difficulty, rate))
            if found.complete and rate >= options.success:
                low, high = wilson_interval(rate, found.episodes)
                highest: dict[str, Any] = {
                    "difficulty": difficulty,
                    "height": arena.height(difficulty),
                    "width": arena.width(difficulty),
                    "evaluation": found.as_json(samples),
                }
                result = {"wanted": options.success, "highest": highest, "tried": tried}
                runs.open_run(options.run).write_json(FILE, result)
                print(f"It clears {size} in {rate:.0%} [{low:.0%}, {high:.0%}] of its attempts.")
                return 0
        raise RunError(
            f"{options.run} clears nothing in {options.success:.0%} of its attempts. Train it longer, "
            "or ask for fewer (--success)."
        )


def _ladder(path: str, step: float, overrides: list[str]) -> Iterator[tuple[float, Arena]]:
    """Difficulties from the one that the training of the run came to down to 0, and the arena."""
    curriculum = newest_state(path).get("environment", {}).get("curriculum", {})
    reached = curriculum.get("difficulty")
    experiment = runs.open_run(path).config
    if not reached or "arena" not in experiment:
        raise RunError(f"{path} is no run of a jump whose bar rises (task=jumping/high).")
    arena = Arena(ArenaOptions(**{k: _pair(v) for k, v in experiment["arena"].items()}))
    spans = (arena.options.height, arena.options.width)
    span = max(high - low for low, high in spans)
    difficulty, down = max(reached), step / span if span > 0 else 1.0
    while difficulty > 0:
        yield difficulty, arena
        difficulty -= down
    yield 0.0, arena


def _pair(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


def _judged(
    path: str, difficulty: float, wanted: float, words: list[str]
) -> tuple[Evaluation, int]:
    """The final evaluation at `difficulty`, given up where `wanted` is out of reach; and the samples
    of the training."""
    training, _, _, _ = load(path, [*words, f"difficulty={difficulty!r}"], {})
    try:
        episodes = training.experiment.root.evaluation.final_episodes
        found = training.job.evaluate("heights", episodes, give_up_below=wanted)
    finally:
        training.close()
    return found, training.progress.samples

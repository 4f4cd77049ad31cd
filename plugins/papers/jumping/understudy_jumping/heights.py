"""``understudy jumping heights``: the highest bar, or the widest box, that a run clears."""

from __future__ import annotations

import argparse
from collections.abc import Iterator

from understudy.command.command import Command
from understudy.errors import ConfigError, RunError
from understudy.options import at
from understudy.records import runs
from understudy.records.runs import newest_state
from understudy.running.jobs import Judgement
from understudy_characters.recording import unsimulated
from understudy_judging.commands import load
from understudy_jumping.arena import ArenaOptions
from understudy_motion.arguments import positive, share
from understudy_reinforcement.evaluation import wilson_interval
from understudy_skills.folder import run_folder

#: In the run folder: what was found.
FILE = "heights.json"
#: Obstacles that are tried at most; each is an evaluation.
_MOST = 1000


class Heights(Command):
    """Judges a run at the obstacle that its training came to, and at ever easier ones until enough
    attempts succeed; an evaluation judges only at the target, which a training may not have reached.
    ``--from`` sets another first obstacle, which may be above the target.

    Prints what it tries, and writes the evaluation of the highest into ``heights.json`` in the run folder.
    """

    example = "understudy jumping heights runs/high"

    takes_overrides = True

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("run", metavar="RUN", help="run folder, or a skill")
        parser.add_argument(
            "--success",
            type=share,
            default=0.5,
            metavar="SHARE",
            help="share of attempts that must clear the obstacle (default: %(default)s)",
        )
        parser.add_argument(
            "--step",
            type=positive,
            default=0.05,
            metavar="METRES",
            help="by how much lower the next bar, or narrower the next box, is (default: %(default)s)",
        )
        parser.add_argument(
            "--from",
            type=positive,
            dest="first",
            metavar="METRES",
            help="height of the bar, or width of the box, that is tried first",
        )

    def run(self, options: argparse.Namespace) -> int:
        options.run = run_folder(options.run)
        reached, arena = _trained(options.run)
        first = reached if options.first is None else options.first
        tried: list[tuple[float, float]] = []
        for size in _ladder(first, options.step, arena):
            words = [*options.overrides, *_words(size, arena)]
            found, samples = _judged(options.run, options.success, words)
            name = f"{size:.2f} m {_ADJECTIVES[_grows(arena)]}"
            print(f"{name}: {found.sentence()}", flush=True)
            rate = found.success_rate or 0.0
            tried.append((size, rate))
            if found.complete and rate >= options.success:
                low, high = wilson_interval(rate, found.trials)
                highest = {_grows(arena): size, "evaluation": found.as_json(samples)}
                result = {"wanted": options.success, "highest": highest, "tried": tried}
                runs.open_run(options.run).write_json(FILE, result)
                print(f"It clears {name} in {rate:.0%} [{low:.0%}, {high:.0%}] of its attempts.")
                if len(tried) == 1:
                    print(f"Nothing higher was tried; to try more: --from {size + 0.5:.2f}.")
                return 0
        raise RunError(
            f"{options.run} clears nothing in {options.success:.0%} of its attempts. Train it longer, "
            "or ask for fewer (--success)."
        )


#: How the obstacle grows, and the word for it.
_ADJECTIVES = {"height": "high", "width": "wide"}


def _trained(path: str) -> tuple[float, ArenaOptions]:
    """m: the obstacle that the training of the run came to; and its arena."""
    # it may be judged in another simulator than it learned in
    arena = unsimulated(runs.open_run(path)).sections.get("arena")
    state = newest_state(path)
    # a skill has no worlds: it is tried from the target on
    reached = at(state, "environment.curriculum.difficulty") if "environment" in state else 1.0
    # curricula of several groups have a difficulty for each
    levels = reached if isinstance(reached, list) else [reached]
    if (
        not isinstance(arena, ArenaOptions)
        or not levels
        or not all(isinstance(level, (int, float)) and 0 <= level <= 1 for level in levels)
    ):
        raise RunError(f"{path} is no run of a jump whose bar rises (task=jumping/high).")
    low, high = getattr(arena, _grows(arena))
    if low == high:
        raise RunError(
            f"{path}: its obstacle has one size, {low} m. Judge it by understudy evaluate."
        )
    return low + max(levels) * (high - low), arena


def _grows(arena: ArenaOptions) -> str:
    """What of the obstacle follows the difficulty."""
    return "width" if arena.width[0] < arena.width[1] else "height"


def _ladder(first: float, step: float, arena: ArenaOptions) -> Iterator[float]:
    """m: from `first` down to the least of the arena."""
    least = getattr(arena, _grows(arena))[0]
    if not (first - least) / step <= _MOST:
        raise ConfigError(
            f"--step {step:g} is not possible: it tries more than {_MOST} obstacles from {first:g} m "
            f"to {least:g} m; give a longer step, or less to --from."
        )
    size = first
    while size > least + 1e-6:
        yield size
        size -= step
    yield least


def _words(size: float, arena: ArenaOptions) -> list[str]:
    """What puts an obstacle of so many m there. Above the target the arena is made greater, with the ρ
    of the target."""
    low, high = getattr(arena, _grows(arena))
    if size <= high:
        return [f"difficulty={(size - low) / (high - low)!r}"]
    begin, end = ((high - low) / (size - low) * edge for edge in arena.schedule)
    return [
        f"arena.{_grows(arena)}=[{low!r},{size!r}]",
        f"arena.schedule=[{begin!r},{end!r}]",
        "difficulty=1.0",
    ]


def _judged(path: str, wanted: float, words: list[str]) -> tuple[Judgement, int]:
    """The final evaluation, given up where `wanted` is out of reach; and the samples of the training."""
    training, _, _, _ = load(path, words, {})
    try:
        episodes = training.experiment.root.evaluation.final_episodes
        found = training.job.evaluate("heights", episodes, give_up_below=wanted)
    finally:
        training.close()
    return found, training.progress.samples

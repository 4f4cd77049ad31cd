"""``understudy pose_vae naturalness``: how natural the motion of finished runs is (thesis, figure 4.8)."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from typing import Any

from understudy.command.command import Command
from understudy.errors import RunError
from understudy_judging.commands import load

#: In the run folder: the evaluation.
FILE = "naturalness.json"
_FIGURES = ("pose_distance", "jerk")


class Naturalness(Command):
    """Judges runs by how far the character's poses are from captured ones, and by its jerk."""

    example = "understudy pose_vae naturalness runs/poses runs/walk runs/walk_with_poses"

    takes_overrides = True

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("poses", help="folder of the run that trained a pose auto-encoder")
        # overrides behind them are taken by this one, too
        parser.add_argument(
            "run", nargs="+", help="run folder of any task on a character, or a skill"
        )

    def run(self, options: argparse.Namespace) -> int:
        distance = f"{{name: pose_vae/distance, run: {json.dumps(options.poses)}, reduce: mean}}"
        words = [
            "+memory.jerk={name: pose_vae/jerk}",
            f"+measure.pose_distance={distance}",
            "+measure.jerk={name: value, reads: {value: jerk}}",
            *(word for word in options.run if "=" in word),
            *options.overrides,
        ]
        head = "degrees to the nearest captured pose, a joint's mean; jerk of the links, m/s³\n"
        for path in (word for word in options.run if "=" not in word):
            training, run, _, _ = load(path, words, {})
            try:
                found, _ = training.judge()
            finally:
                training.close()
            result = found.as_json(training.progress.samples)
            if not result["measures"].keys() >= {*_FIGURES}:
                raise RunError(
                    f"{path} is judged by figures of its own, as no character moves in it. Name runs of tasks of a character."
                )
            run.write_json(FILE, result)
            print(f"{head}{_row(result)}  {path}", flush=True)
            head = ""
        return 0


def _row(found: Mapping[str, Any]) -> str:
    """Of what is written into the file."""
    figures = [found["measures"][name] for name in _FIGURES]
    texts = [
        "{:.1f} [{:.1f}, {:.1f}]".format(m["mean"], *m["mean_95"]) if m["mean_95"] else "none"
        for m in figures
    ]
    rate = f"  {found['success_rate']:.0%} succeeded" if "success_rate" in found else ""
    return f"{texts[0]}°  {texts[1]} m/s³{rate}"

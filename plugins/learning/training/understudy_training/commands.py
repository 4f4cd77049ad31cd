"""The commands that begin or continue a training.

They import what trains only when they run, so that help and the list of experiments need no torch.
"""

from __future__ import annotations

import argparse

from understudy.command.cli import main
from understudy.command.command import Command


class Train(Command):
    """Trains what the overrides compose; without overrides, lists the experiments."""

    takes_overrides = True
    example = "understudy train experiment=spacetime/walk"

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        pass

    def run(self, options: argparse.Namespace) -> int:
        if not options.overrides:
            return main(["experiments"])
        from understudy_training.workflow import train

        return train(options.overrides)


class Resume(Command):
    """Continues a run, as overrides change it."""

    takes_overrides = True
    example = "understudy resume runs/spacetime-walk-001"

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("run", help="run folder")

    def run(self, options: argparse.Namespace) -> int:
        from understudy_training.workflow import resume

        return resume(options.run, options.overrides)

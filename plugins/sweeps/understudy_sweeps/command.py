"""``understudy sweep``."""

from __future__ import annotations

import argparse

from understudy.command.command import Command
from understudy_sweeps.sweep import sweep


class Sweep(Command):
    """Runs an outer loop over trainings, or goes on with it."""

    takes_overrides = True

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        pass

    def run(self, options: argparse.Namespace) -> int:
        return sweep(options.overrides)

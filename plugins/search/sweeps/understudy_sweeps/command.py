"""``understudy sweep``."""

from __future__ import annotations

import argparse

from understudy.command.command import Command
from understudy.errors import ConfigError, suggestion
from understudy.setup import plugins as loaded
from understudy.setup.composition import options as choices
from understudy_sweeps.sweep import sweep


class Sweep(Command):
    """Runs an outer loop over trainings, or goes on with it."""

    example = (
        "understudy sweep experiment=miniature/go outer_loop=grid executor=in_process "
        "'outer_loop.variants={ppo: [], trpo: [learner=trpo]}'"
    )

    takes_overrides = True

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        pass

    def run(self, options: argparse.Namespace) -> int:
        asks = ("ablation=", "search=", "outer_loop")
        if not any(word.lstrip("+").startswith(asks) for word in options.overrides):
            plugins = loaded.installed()
            known = [f"{g}={name}" for g in ("ablation", "search") for name in choices(plugins, g)]
            raise ConfigError(f"Give ablation=…, search=… or outer_loop=….{suggestion('', known)}")
        return sweep(options.overrides)

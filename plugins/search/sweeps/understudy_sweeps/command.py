"""``understudy sweep``."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from understudy.command.command import Command
from understudy.errors import ConfigError, suggestion
from understudy.setup import plugins as loaded
from understudy.setup.composition import options as choices


class Sweep(Command):
    """Runs an outer loop over trainings, or continues it."""

    example = "understudy sweep experiment=miniature/go 'variants={ppo: [], trpo: [learner=trpo]}' 'seeds=[0,1]'"

    takes_overrides = True

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        pass

    def run(self, options: argparse.Namespace) -> int:
        words = expanded(options.overrides)
        asks = ("ablation=", "search=", "outer_loop")
        if not any(word.lstrip("+").startswith(asks) for word in words):
            plugins = loaded.installed()
            known = [f"{g}={name}" for g in ("ablation", "search") for name in choices(plugins, g)]
            raise ConfigError(
                f"Give variants={{NAME: [KEY=VALUE]}}, ablation=…, search=… or outer_loop=….{suggestion('', known)}"
            )
        from understudy_sweeps.sweep import sweep  # and torch, which the list does without

        return sweep(words)


def expanded(words: Sequence[str]) -> list[str]:
    """`words` with ``variants=`` and ``seeds=`` as options of the grid, with one trial after the other unless they say
    otherwise, as in nearly every comparison."""
    short = ("variants=", "seeds=")
    found = [f"outer_loop.{word}" if word.startswith(short) else word for word in words]
    if found != list(words):
        chosen = {word.lstrip("+").partition("=")[0] for word in words}
        asked = chosen & {"ablation", "search", "outer_loop"}
        found = [*([] if asked else ["outer_loop=grid"]), *found]
        found = [*([] if asked or "executor" in chosen else ["executor=in_process"]), *found]
    return found

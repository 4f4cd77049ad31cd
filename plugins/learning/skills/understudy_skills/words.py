"""Words of a command line that have no meaning when a policy is judged or played."""

from __future__ import annotations

import re
from collections.abc import Sequence

from understudy.errors import ConfigError

__all__ = ["refuse_of_trainings"]

#: Keys that are a training's alone: no judgement is another one by them.
_OF_TRAININGS = re.compile(
    r"[+~]*(run\.dir|start|budget|learner|resolution|checkpoint\.\w+|outer_loop|executor"
    r"|evaluation\.(criterion|give_up|gate|every_samples))(?=[.=]|$)"
)


def refuse_of_trainings(words: Sequence[str], of: str, beside: str = "") -> None:
    """Raise ConfigError for the first of `words` that changes a training and nothing `of` what was learned; if it names the
    run's folder, the error adds `beside`."""
    for word in words:
        if _OF_TRAININGS.match(word):
            own_folder = beside if "run.dir" in word else ""
            raise ConfigError(
                f"{word} changes a training, and nothing of {of}: leave it out.{own_folder}"
            )

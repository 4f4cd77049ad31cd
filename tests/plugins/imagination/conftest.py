"""Jobs of a small walk."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest
from imagined_walk import WALK

from understudy.errors import UnderstudyError
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import Plugins
from understudy_reinforcement.job import Reinforcement


@pytest.fixture
def job(plugins: Plugins) -> Iterator[Callable[..., Reinforcement]]:
    """The prepared job of the walk, or of another small task, with other options."""
    made: list[Reinforcement] = []

    def make(*overrides: str, task: tuple[str, ...] = WALK) -> Reinforcement:
        one = Reinforcement(None, load_experiment([*task, *overrides], plugins))
        one.prepare()
        made.append(one)
        return one

    yield make
    for one in made:
        one.close()


@pytest.fixture
def refusal(plugins: Plugins) -> Callable[..., str]:
    """The sentence that refuses the walk with other options."""

    def make(*overrides: str) -> str:
        with pytest.raises(UnderstudyError) as caught:
            Reinforcement(None, load_experiment([*WALK, *overrides], plugins)).prepare()
        return str(caught.value)

    return make

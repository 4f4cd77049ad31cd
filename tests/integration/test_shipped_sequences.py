"""Algorithm 1 as experiments have it: what a subtask's harvest waits for can come."""

from __future__ import annotations

from typing import Any

import pytest

from understudy.setup.composition import load_experiment
from understudy.setup.plugins import Plugins
from understudy_sequencing.algorithm import stages_of

SEARCHES = ("miniature", "sitting", "jumping", "dressing")


@pytest.mark.parametrize("paper", SEARCHES)
def test_each_subtask_has_the_ending_that_is_harvested(paper: str, plugins: Plugins) -> None:
    """A turn that ends by its time alone would be waited for in vain, after all of its training."""
    options: Any = (
        load_experiment([f"search={paper}/algorithm_1"], plugins).need("outer_loop").options
    )
    stages = stages_of(options)
    for name in list(options.subtasks)[:-1]:
        words = dict(word.split("=", 1) for word in stages[f"{name}_ends"] if "=" in word)
        if words.get("job.moment") == "change":
            continue
        ending = words["job.ending"]
        terms = load_experiment(options.subtasks[name], plugins).many("termination.terms")
        outcomes = {term.extras["outcome"] for term in terms}
        assert ending in {"truncation", "any", *outcomes, *(term.name for term in terms)}, name

"""Fault 18: building, training and evaluating leave the global random states untouched, and do not
depend on them."""

from __future__ import annotations

import random

import numpy as np
import pytest
import torch
from worlds import PADDLE_TASK, SMALL, assert_same_state, make_training

from understudy.setup.plugins import Plugins
from understudy.testing.fake import FAKE_TASK


@pytest.mark.parametrize("task", [FAKE_TASK, PADDLE_TASK], ids=["fake", "contacts"])
def test_untouched(plugins: Plugins, task: tuple[str, ...]) -> None:
    states = []
    for seed in (1, 2):
        random.seed(seed), np.random.seed(seed), torch.manual_seed(seed)  # noqa: NPY002
        python, legacy, tensor = random.getstate(), np.random.get_state(), torch.get_rng_state()  # noqa: NPY002
        training = make_training(
            plugins, [*task, *SMALL, "budget.samples=400", "evaluation.seconds=0.2"]
        )
        training.train()
        training.judge()
        assert random.getstate() == python
        assert all(np.array_equal(a, b) for a, b in zip(np.random.get_state(), legacy, strict=True))  # noqa: NPY002
        assert torch.equal(torch.get_rng_state(), tensor)
        states.append(training.state_dict())
    assert_same_state(*states)

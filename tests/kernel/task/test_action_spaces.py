"""Actions: named boxes and choices in one tensor."""

from __future__ import annotations

import torch

from understudy.task import ActionSpace, Box, Choice, box


def test_a_box() -> None:
    space = box(3)
    action = torch.arange(6.0).view(2, 3)
    assert (space.size, list(space.split(action))) == (3, ["action"])
    assert torch.equal(space.split(action)["action"], action)
    assert box(0).size == 0


def test_boxes_and_choices() -> None:
    space = ActionSpace({"gait": Choice(4), "joints": Box(2), "hand": Choice(2)})
    assert space.size == 4
    action = torch.tensor([[3.0, 0.5, -0.5, 1.0], [0.0, 1.5, -1.5, 0.0]])
    for shaped in (action, action.expand(5, 2, 4)):
        parts = space.split(shaped)
        assert list(parts) == ["gait", "joints", "hand"]
        assert parts["gait"].dtype == parts["hand"].dtype == torch.int64
        assert parts["gait"].shape == shaped.shape[:-1]
        assert parts["joints"].shape == (*shaped.shape[:-1], 2)
    parts = space.split(action)
    assert parts["gait"].tolist() == [3, 0]
    assert parts["joints"].tolist() == [[0.5, -0.5], [1.5, -1.5]]
    assert parts["hand"].tolist() == [1, 0]


def test_boxes_say_what_bounded_learners_span() -> None:
    plain = box(3).parts["action"]
    assert isinstance(plain, Box)
    assert (plain.reach, plain.around) == (1.0, None)
    assert box(2, 0.3, "reference").parts["action"] == Box(2, reach=0.3, around="reference")

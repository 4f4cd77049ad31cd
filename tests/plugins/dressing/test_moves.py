"""A garment on a person who is led: going on from where another was."""

from __future__ import annotations

import numpy as np

from understudy_dressing.moves import Moves
from understudy_dressing.shirt import ShirtScene

SHIRT = ShirtScene(ShirtScene.Options(edge=0.032, substeps=2))
HELD = (False, True)  #: by the left hand


def test_going_on_is_as_never_having_stopped() -> None:
    """To the bit, from a hand on its way, the hem in it; whoever goes on was elsewhere before, and changes nothing there."""
    target = np.array([0.3, 0.1, -0.3])
    first, second = Moves(SHIRT), Moves(SHIRT)
    first.reach("left", first.patch("left"), 0.05, HELD)
    state = first.state()
    kept = state[0].copy(), {name: value.clone() for name, value in state[1].items()}
    second.hold(0.02, (False, False))
    for moves in (first, second):
        if moves is second:
            moves.go_on(state)
        moves.reach("left", target, 0.05, HELD)
    assert all(np.array_equal(a, b) for a, b in zip(first.found(), second.found(), strict=True))
    assert np.array_equal(state[0], kept[0])
    assert all(bool((state[1][name] == value).all()) for name, value in kept[1].items())
    assert not np.array_equal(first.found()[1], kept[1]["cloth_position"][0].double().numpy())

"""Heads of stick figures, which consist of line segments."""

from __future__ import annotations

import numpy as np

from understudy_characters.character import Character
from understudy_characters.layout import limb_ends, upright_bodies

__all__ = ["head_body", "ring"]

_SIDES = 10
#: Of the ring, in lengths of the figure.
_RADIUS = 0.05


def head_body(character: Character) -> int | None:
    """The body at the trunk's upper end that carries no other, if there is one beside the root."""
    model = character.model
    up = upright_bodies(character, limb_ends(character))
    carriers = {int(model.body_parentid[body]) for body in character.carrier}
    ends = [body for body in up if body not in carriers and body != character.root]
    return max(ends, key=lambda body: character.data.xipos[body, 2]) if ends else None


def ring(centres: np.ndarray, length: float) -> np.ndarray:
    """(T, S, 2, 3) m: the head at `centres` (T, 3) m of a figure `length` m long, seen from the side."""
    angles = np.linspace(0.0, 2.0 * np.pi, _SIDES + 1)
    points = _RADIUS * length * np.stack([np.cos(angles), 0.0 * angles, np.sin(angles)], axis=1)
    return np.asarray(centres)[:, None, None, :] + np.stack([points[:-1], points[1:]], axis=1)

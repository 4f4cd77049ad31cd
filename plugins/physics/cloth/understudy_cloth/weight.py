"""How fine sub-steps have to be, so that cloth carries its own weight."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from understudy.errors import ConfigError
from understudy_cloth.mesh import edges_of
from understudy_cloth.scene import ClothModel

__all__ = ["sub_steps_needed"]

#: Of its own weight cloth becomes longer by this × g × drop × (Δt / edge)², whatever its stiffness: one sweep a sub-step
#: passes on to the next vertex what one fell in it. Measured of strips, sheets and tubes with edges of 12 to 50 mm and Δt of
#: 0.5 to 26 ms: 0.35 to 0.6.
_GIVES = 0.45
#: Beyond the first share longer it is told; beyond the second it is refused, since layers then go through each other.
_LONGER, _TOO_LONG = 0.1, 0.5


def sub_steps_needed(model: ClothModel) -> float:
    """Hz: with so many sub-steps a second the sound mesh of `model` becomes longer by a tenth where it hangs."""
    return math.sqrt(_pull(model)[0] / _LONGER)


def check_sub_step(model: ClothModel, dt: float, finer: str) -> None:
    """Warn if in sub-steps of `dt` s the cloth is far longer than it should be where it hangs; `finer` says what shortens them.

    Raises
    ------
    ConfigError
        if it could not carry itself.
    """
    pull, edge = _pull(model)
    longer = pull * dt**2
    if longer <= _LONGER:
        return
    text = (
        f"The cloth's sub-step of {1e3 * dt:.3g} ms is too long for edges of {1e3 * edge:.3g} mm: its own weight would make the "
        f"cloth some {100 * longer:.0f} % longer, however stiff its fabric. Let it make {math.ceil(math.sqrt(pull / _LONGER))} "
        f"sub-steps a second or more ({finer}), or give it larger edges."
    )
    if longer > _TOO_LONG:
        raise ConfigError(text)
    warnings.warn(text, stacklevel=2)


def _pull(model: ClothModel) -> tuple[float, float]:
    """1/s², times Δt² the share by which it becomes longer; and the mean edge, m."""
    faces = np.asarray(model.faces)
    rest = np.asarray(model.positions if model.rest is None else model.rest, float)
    corners = rest[faces] if rest.ndim == 2 else rest
    edges, index = edges_of(faces)
    length = np.zeros(len(edges))
    length[index.ravel()] = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).ravel()
    held = [
        np.asarray(them, int).ravel() for them in (model.pinned, *(g.vertices for g in model.grips))
    ]
    drop = _drop(edges, length, len(model.positions), np.concatenate(held))
    edge, gravity = float(length.mean()), float(np.linalg.norm(model.gravity))
    return _GIVES * gravity * drop / edge**2, edge


def _drop(edges: np.ndarray, length: np.ndarray, count: int, held: np.ndarray) -> float:
    """m, along edges (E, 2): from the vertices that are `held` to what is farthest from them; half of the way through the
    cloth if none is. What no edge ties to them hangs from nothing."""
    graph = csr_array((length, (edges[:, 0], edges[:, 1])), shape=(count, count))

    def ways(begins: Sequence[int] | np.ndarray) -> np.ndarray:
        found = dijkstra(graph, directed=False, indices=begins, min_only=True)
        return np.where(np.isfinite(found), found, 0.0)

    if len(held):
        return float(ways(held).max())
    return 0.5 * float(ways([int(ways([0]).argmax())]).max())

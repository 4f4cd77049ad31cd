"""How fine sub-steps have to be, so that cloth carries its own weight."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from understudy_cloth.mesh import edges_of
from understudy_cloth.scene import ClothModel
from understudy_warp_torch.compliance import Compliance

__all__ = ["sub_steps_needed"]

#: Of its own weight cloth becomes longer by this × g × drop × (Δt / edge)², whatever its stiffness: one sweep a sub-step
#: passes on to the next vertex what one fell in it. Measured of strips, sheets and tubes with edges of 12 to 50 mm and Δt of
#: 0.5 to 26 ms: 0.35 to 0.6.
_GIVES = 0.45
#: Beyond the first share longer it is told; beyond the second it is refused, since layers then go through each other.
_LONGER, _TOO_LONG = 0.1, 0.5


def sub_steps_needed(model: ClothModel) -> float:
    """Hz: with so many sub-steps a second the sound mesh of `model` becomes longer by a tenth where it hangs."""
    return compliance_of(model).sub_steps(float(np.linalg.norm(model.gravity)))


def compliance_of(model: ClothModel, dt: float = 0.0, finer: str = "") -> Compliance:
    """How far the cloth becomes longer than it should be where it hangs, in sub-steps of `dt` s; `finer` says what shortens
    them."""
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
    edge = float(length.mean())

    def says(share: float, rate: int) -> str:
        return (
            f"The cloth's sub-step of {1e3 * dt:.3g} ms is too long for edges of {1e3 * edge:.3g} mm: its own weight would make "
            f"the cloth some {100 * share:.0f} % longer, however stiff its fabric. Let it make {rate} sub-steps a second or more "
            f"({finer}), or give it larger edges."
        )

    return Compliance(_GIVES * drop / edge**2, drop, _LONGER, _TOO_LONG, says)


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

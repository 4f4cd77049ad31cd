"""Where the maximisation of an acquisition begins."""

from __future__ import annotations

import torch
from torch import Tensor

from understudy_bayes import draws
from understudy_bayes.acquisition import Acquisition, climb, highest
from understudy_bayes.book import Book

__all__ = ["maximise"]


def maximise(
    function: Acquisition, book: Book, seed: int, number: int, raw: int = 512, restarts: int = 8
) -> Tensor:
    """The point (d,) of the unit cube at which `function` is highest: L-BFGS from several starts.

    The starts are the highest of `raw` points spread over the cube, and the highest of those around
    the best trials. Which are looked at depends on `seed`, `number` and the trials alone.
    """
    data, d = book.data(), len(book.space)
    best = data.x[data.y.argsort(descending=True, stable=True)[:4]]
    near = [draws.around(seed, number, centre, raw // 32, 0.05) for centre in best]
    spread = highest(function, draws.many(seed, number, d, raw), restarts // 2)
    return climb(function, torch.cat([spread, highest(function, torch.cat(near), restarts // 2)]))

"""An observation of any field: ``reads: {value: FIELD}`` says which."""

from __future__ import annotations

from torch import Tensor

from understudy.task import Context, Encoder
from understudy_terms.shaped import Shaped


class Value(Encoder):
    """The field itself: (N, …) of the `shape` that it has, a number (N,) as one column, (N, 1)."""

    reads = ("value",)

    Options = Shaped

    def __init__(self, options: Shaped, context: Context) -> None:
        self.shape = options.shape or (1,)

    def encode(self, value: Tensor) -> Tensor:
        return (value.unsqueeze(1) if value.ndim == 1 else value).float()

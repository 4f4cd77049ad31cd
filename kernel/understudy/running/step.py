"""The result of one decision in all worlds."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

__all__ = ["Step"]


@dataclass
class Step:
    """The result of one decision in all worlds. The next one overwrites it."""

    #: Of the states reached; after :meth:`Environment.step`, in ended worlds, of the next episode.
    observations: dict[str, Tensor]
    rewards: Tensor  #: (N,) float32
    terminated: Tensor  #: (N,) bool: failed or succeeded, nothing follows
    failed: Tensor  #: (N,) bool: terminated by a failure
    truncated: Tensor  #: (N,) bool
    unsound: Tensor  #: (N,) bool: failed because numbers went wrong
    returns: Tensor  #: (N,) the episodes' returns up to and with this step
    endings: dict[str, Tensor]  #: by termination term: (N,) bool, whether it holds
    next_fields: dict[str, Tensor]  #: the fields that :attr:`Environment.next_fields` names
    #: After :meth:`Environment.step`: the last observations of ended episodes, None if none ended.
    final_observations: dict[str, Tensor] | None = None

    @property
    def succeeded(self) -> Tensor:
        """(N,) bool"""
        return self.terminated & ~self.failed

    @property
    def ended(self) -> Tensor:
        """(N,) bool"""
        return self.terminated | self.truncated

"""What searches of points have in common: a book of their trials."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, Literal

from understudy_bayes.book import Book
from understudy_sweeps.loops import OuterLoop, Report, Trial

__all__ = ["BookedSearch"]


class BookedSearch(OuterLoop):
    """A search that keeps its trials in a book; which one is next, others say."""

    extendable = ("trials", "budget")
    maximises = True
    _book: Book

    @property
    def ranges(self) -> Mapping[str, tuple[float, float]]:
        return self._book.ranges

    @abstractmethod
    def choose(self, number: int) -> Trial | None:
        """The trial of this `number`, or None until more is known."""

    def ask(self, number: int) -> Trial | None:
        return None if self._book.over(number) else self.choose(number)

    def recall(self, trial: Trial) -> bool:
        return self._book.recall(trial)

    def tell(self, report: Report) -> Literal["stop"] | None:
        answer = self._book.tell(report)
        self.share = self._book.done
        return answer

    def summary(self) -> list[dict[str, Any]]:
        return self._book.summary()

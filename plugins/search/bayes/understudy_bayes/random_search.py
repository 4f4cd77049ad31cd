"""Random search."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from understudy.running.trials import OuterLoop, Report, Trial
from understudy_bayes import draws
from understudy_bayes.book import Book, SearchOptions


class RandomSearch(OuterLoop):
    """Points drawn uniformly, each independently of what the others gave."""

    extendable = ("trials", "budget")

    @dataclass(frozen=True)
    class Options(SearchOptions):
        pass

    def __init__(self, options: Options, seed: int = 0) -> None:
        self._book, self._seed = Book(options), seed

    def ask(self, number: int) -> Trial | None:
        book = self._book
        if book.over(number):
            return None
        return book.ask(number, draws.uniform(self._seed, number, len(book.space)))

    def recall(self, trial: Trial) -> bool:
        return self._book.recall(trial)

    def tell(self, report: Report) -> Literal["stop"] | None:
        answer = self._book.tell(report)
        self.share = self._book.done
        return answer

    def summary(self) -> list[dict[str, Any]]:
        return self._book.summary()

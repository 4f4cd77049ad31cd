"""Random search."""

from __future__ import annotations

from dataclasses import dataclass

from understudy_bayes import draws
from understudy_bayes.book import Book, SearchOptions
from understudy_bayes.search import BookedSearch
from understudy_sweeps.loops import Trial


class RandomSearch(BookedSearch):
    """Points drawn uniformly, each independently of what the others gave."""

    @dataclass(frozen=True)
    class Options(SearchOptions):
        pass

    def __init__(self, options: Options, seed: int = 0) -> None:
        self._book, self._seed = Book(options), seed

    def choose(self, number: int) -> Trial | None:
        book = self._book
        return book.ask(number, draws.uniform(self._seed, number, len(book.space)))

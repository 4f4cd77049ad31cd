"""Two pieces of work at once on a CPU."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import torch


class SideBySide:
    """Runs two pieces of work at once, each on half of torch's threads, while :meth:`sharing`.

    The matrices of a minibatch are too small for several threads to share each of them well; two
    networks of equal size are not. What the pieces write must be apart. On one thread, or on a GPU,
    they run one after the other, with the same results.
    """

    def __init__(self, device: torch.device) -> None:
        self._on_cpu = device.type == "cpu"
        self._pool: ThreadPoolExecutor | None = None

    @contextmanager
    def sharing(self) -> Iterator[None]:
        threads = torch.get_num_threads()
        if not self._on_cpu or threads < 2:
            yield
            return
        half = threads // 2
        with ThreadPoolExecutor(1, initializer=torch.set_num_threads, initargs=(half,)) as pool:
            torch.set_num_threads(half)
            self._pool = pool
            try:
                yield
            finally:
                self._pool = None
                torch.set_num_threads(threads)

    def __call__(self, first: Callable[[], None], second: Callable[[], None]) -> None:
        if self._pool is None:
            first()
            second()
            return
        other = self._pool.submit(second)
        first()
        other.result()

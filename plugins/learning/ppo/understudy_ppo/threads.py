"""Two pieces of work at once."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import torch


class SideBySide:
    """Runs two pieces of work at once: on a CPU on half of torch's threads each, while
    :meth:`sharing`; on a GPU on two streams, which become branches of a graph that is captured.

    The matrices of a minibatch are too small for several threads, or for a whole GPU, to share each
    of them well; two networks of equal size are not. What the pieces write must be apart. On one
    thread they run one after the other, with the same results.
    """

    def __init__(self, device: torch.device) -> None:
        self._on_cpu = device.type == "cpu"
        self._pool: ThreadPoolExecutor | None = None
        self._stream = torch.cuda.Stream(device) if device.type == "cuda" else None

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

    def __call__(self, first: Callable[[], object], second: Callable[[], object]) -> None:
        if self._stream is not None:
            here = torch.cuda.current_stream()
            self._stream.wait_stream(here)
            with torch.cuda.stream(self._stream):
                second()
            first()
            here.wait_stream(self._stream)
        elif self._pool is not None:
            other = self._pool.submit(second)
            first()
            other.result()
        else:
            first()
            second()

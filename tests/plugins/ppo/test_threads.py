from __future__ import annotations

import threading

import pytest
import torch

from understudy_ppo.threads import SideBySide


@pytest.mark.usefixtures("two_threads")
def test_both_run_at_once_on_a_thread_each() -> None:
    beside, meeting = SideBySide(torch.device("cpu")), threading.Barrier(2, timeout=30)
    seen: list[tuple[str, int]] = []

    def work() -> None:
        meeting.wait()  # breaks unless both are here at once
        seen.append((threading.current_thread().name, torch.get_num_threads()))

    with beside.sharing():
        beside(work, work)
        beside(work, work)
    assert len({name for name, _ in seen}) == 2
    assert {threads for _, threads in seen} == {1}
    assert torch.get_num_threads() == 2


@pytest.mark.usefixtures("two_threads")
def test_an_error_in_either_comes_out_and_threads_are_given_back() -> None:
    beside = SideBySide(torch.device("cpu"))

    def fail() -> None:
        raise ArithmeticError

    for first, second in ((fail, lambda: None), (lambda: None, fail)):
        with pytest.raises(ArithmeticError), beside.sharing():
            beside(first, second)
        assert torch.get_num_threads() == 2


@pytest.mark.gpu
def test_on_a_gpu_both_have_seen_what_was_before_and_are_seen_after() -> None:
    if not torch.cuda.is_available():
        pytest.skip("no CUDA GPU")
    device = torch.device("cuda")
    beside, x = SideBySide(device), torch.zeros(1 << 22, device=device)
    one, two = torch.zeros_like(x), torch.zeros_like(x)
    for i in range(50):
        x.add_(1)
        beside(lambda: one.copy_(x).sqrt_(), lambda: two.copy_(x).square_())
        torch.testing.assert_close(one.square() + two.sqrt(), torch.full_like(x, 2.0 * (i + 1)))


def test_on_one_thread_or_unshared_they_follow_one_another() -> None:
    beside, order = SideBySide(torch.device("cpu")), []
    beside(lambda: order.append(1), lambda: order.append(2))
    assert order == [1, 2]

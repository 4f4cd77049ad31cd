"""Kernels compiled before they are launched, side by side."""

from __future__ import annotations

import time
from typing import Any

import pytest
import torch
import warp as wp

import understudy_warp_torch.compiling as compiling
from understudy_warp_torch.kernels import Kernels


@wp.kernel(module="unique", enable_backward=False)
def _add(numbers: wp.array(dtype=float), by: float):  # pyright: ignore
    numbers[wp.tid()] += by


@wp.kernel(module="unique", enable_backward=False)
def _double(numbers: wp.array(dtype=float)):  # pyright: ignore
    numbers[wp.tid()] *= 2.0


def _numbers() -> tuple[torch.Tensor, Any]:
    Kernels(torch.device("cpu"))  # starts Warp
    numbers = torch.ones(3)
    return numbers, wp.from_torch(numbers)


def test_all_that_is_launched_is_loaded_and_nothing_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    numbers, array = _numbers()
    never = wp.array([1], dtype=wp.int32, device="cpu")
    loaded: list[Any] = []
    monkeypatch.setattr(wp, "force_load", lambda device, modules, *_: loaded.extend(modules))

    def add(by: float) -> None:
        wp.launch(_add, 3, inputs=[array, by], device="cpu")

    def double() -> None:
        wp.launch(_double, 3, inputs=[array], device="cpu")

    def work() -> None:
        add(1.0)
        wp.capture_while(never, while_body=add, by=2.0)  # would not end: nothing changes `never`
        wp.capture_if(never, on_false=double)  # the way that is not taken

    compiling.compile_kernels(work, "cpu")
    assert set(loaded) == {_add.module, _double.module}
    assert len(loaded) == 2
    assert numbers.tolist() == [1.0] * 3


def test_afterwards_kernels_run_as_ever() -> None:
    numbers, array = _numbers()
    compiling.compile_kernels(lambda: wp.launch(_double, 3, inputs=[array], device="cpu"), "cpu")
    assert numbers.tolist() == [1.0] * 3
    wp.launch(_double, 3, inputs=[array], device="cpu")
    assert numbers.tolist() == [2.0] * 3


def test_what_fails_leaves_warp_as_it_was() -> None:
    numbers, array = _numbers()

    def work() -> None:
        raise OSError("no")

    with pytest.raises(OSError, match="no"):
        compiling.compile_kernels(work, "cpu")
    wp.launch(_double, 3, inputs=[array], device="cpu")
    assert numbers.tolist() == [2.0] * 3


def test_a_module_that_does_not_compile_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    _, array = _numbers()

    def refuse(*_: Any) -> None:
        raise RuntimeError("the compiler's words")

    monkeypatch.setattr(wp, "force_load", refuse)
    with pytest.raises(RuntimeError, match="the compiler's words"):
        compiling.compile_kernels(
            lambda: wp.launch(_double, 3, inputs=[array], device="cpu"), "cpu"
        )


def test_it_says_what_it_waits_for(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    _, array = _numbers()
    monkeypatch.setattr(compiling, "_QUIET", 0.05)
    monkeypatch.setattr(wp, "force_load", lambda *_: time.sleep(0.3))
    compiling.compile_kernels(lambda: wp.launch(_double, 3, inputs=[array], device="cpu"), "cpu")
    assert "Compiling the simulator's kernels, once a machine" in capsys.readouterr().err
    monkeypatch.setattr(wp, "force_load", lambda *_: None)  # a cache that is full
    compiling.compile_kernels(lambda: wp.launch(_double, 3, inputs=[array], device="cpu"), "cpu")
    assert not capsys.readouterr().err


def test_work_on_a_cpu_finds_its_state_as_it_left_it() -> None:
    kernels = Kernels(torch.device("cpu"))
    numbers = torch.ones(3)
    array = wp.from_torch(numbers)

    def work() -> None:
        array.zero_()  # done, while kernels are looked for
        wp.launch(_add, 3, inputs=[array, 1.0], device="cpu")

    other = torch.full((3,), 7.0)

    def reads() -> None:
        other.mul_(2.0)

    kernels.run("work", work, (numbers,))
    kernels.run("reads", reads, (other,))
    assert numbers.tolist() == [1.0] * 3
    assert other.tolist() == [14.0] * 3

"""How long collecting and learning take where work is done after it was asked for."""

from __future__ import annotations

import time

import pytest
import torch

from understudy_reinforcement.job import _Moment


@pytest.mark.parametrize("kind", ["cpu", pytest.param("cuda", marks=pytest.mark.gpu)])
def test_the_time_is_that_of_the_device(kind: str) -> None:
    if kind == "cuda" and not torch.cuda.is_available():
        pytest.skip("no CUDA GPU")
    device = torch.device(kind)
    _Moment(device)
    began = _Moment(device)
    if kind == "cuda":
        torch.cuda._sleep(200_000_000)  # clock cycles: a tenth of a second, asked for at once
    else:
        time.sleep(0.1)
    assert _Moment(device) - began > 0.05

"""MuJoCo Warp made to repeat itself on a GPU to the last bit, which takes what the product does not do."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import mujoco
import pytest


def repeat_exactly(patch: pytest.MonkeyPatch) -> None:
    """Sums in a fixed order, and no contacts or limits: MuJoCo Warp 4.0 has no order for those."""
    import mujoco_warp as mjw

    from understudy_mujoco_warp.simulator import MujocoWarpSimulator

    put = MujocoWarpSimulator._put_model

    def put_repeatable(self: MujocoWarpSimulator, batch: Mapping[str, int]) -> Any:
        model = put(self, batch)
        model.opt.deterministic = int(mjw.DeterminismType.ALL)
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        return model

    patch.setattr(MujocoWarpSimulator, "_put_model", put_repeatable)


@pytest.fixture
def repeatable(monkeypatch: pytest.MonkeyPatch) -> None:
    repeat_exactly(monkeypatch)

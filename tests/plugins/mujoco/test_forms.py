"""Worlds of one batch that differ in a body's shape."""

from __future__ import annotations

import mujoco
import numpy as np
from forms import FORMS, SIZES, Drop, check_forms

from understudy_mujoco.forms import Forms
from understudy_mujoco.simulator import MujocoSimulator


def test_each_world_has_a_form_of_its_own() -> None:
    check_forms(
        lambda c: MujocoSimulator(MujocoSimulator.Options(threads=1), c), "cpu", 30, atol=1e-5
    )


def test_what_is_seen_is_the_worlds_own_form() -> None:
    model, geoms = Drop().spec().compile(), [FORMS.geom(kind) for kind in FORMS.kinds]
    tracks = {f"active/{geom}": np.zeros(2) for geom in geoms}
    tracks |= {f"geom_size/{g}": np.tile(SIZES[k], (2, 1)) for g, k in zip(geoms, FORMS.kinds, strict=True)}  # fmt: skip
    tracks["active/thing_box"][1] = 1.0
    FORMS.show(model, tracks, 1)
    assert [model.geom(geom).rgba[3] for geom in geoms] == [0, 0, 0, 0, 1]
    np.testing.assert_allclose(model.geom("thing_box").size, SIZES["box"])
    scene = mujoco.MjvScene(model, 10)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    mujoco.mjv_updateScene(
        model, data, mujoco.MjvOption(), None, mujoco.MjvCamera(),
        int(mujoco.mjtCatBit.mjCAT_DYNAMIC), scene,
    )  # fmt: skip
    seen = [geom for geom in scene.geoms[: scene.ngeom] if geom.rgba[3] > 0]
    assert len(seen) == 1
    Forms("thing", ("box",), 1.0).show(model, {}, 0)  # of a run that recorded none: nothing changes
    assert model.geom("thing_box").rgba[3] == 1

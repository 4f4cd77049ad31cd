"""Films in tests have no smoothed edges and no shadows of MuJoCo's: a processor alone draws them in about a quarter of the time.

What asks how pictures look takes the fixture ``fine_films``.
"""

from __future__ import annotations

from typing import Any

import understudy_mujoco  # noqa: F401 # isort: skip - it chooses what draws before mujoco is imported
import mujoco

#: MuJoCo's own, for pictures as the product draws them.
fine = mujoco.Renderer.__init__


def coarse(self: mujoco.Renderer, model: mujoco.MjModel, *given: Any, **named: Any) -> None:
    """As :class:`mujoco.Renderer` is made; the model is left as it is."""
    quality = model.vis.quality
    before = quality.offsamples, quality.shadowsize
    quality.offsamples, quality.shadowsize = 0, 0
    try:
        fine(self, model, *given, **named)
    finally:
        quality.offsamples, quality.shadowsize = before

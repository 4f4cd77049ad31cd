"""MuJoCo on the CPU: all worlds stepped in C threads by ``mujoco.batch.Batch``."""

import os

from understudy_mujoco import opengl

#: Plugins that this one builds on.
REQUIRES = ("tensors",)


def _wait_asleep() -> None:
    """OpenMP reads it when torch is imported, which is later than plugins are.

    The threads that helped with a network would spin for some ten ms on cores that the simulator needs.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")


opengl.choose()
_wait_asleep()

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "simulator": {
        "mujoco": ("simulator:MujocoSimulator", "MuJoCo on CPU threads"),
    },
    "fields": {
        "mujoco/distances": ("distances:Distances", "how far groups of geoms are apart"),
    },
    "scene": {
        "mjcf": ("scene:MjcfFile", "a scene read from an MJCF file"),
    },
}

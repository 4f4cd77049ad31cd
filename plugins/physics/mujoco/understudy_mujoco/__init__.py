"""MuJoCo on the CPU: all worlds stepped in C threads by ``mujoco.batch.Batch``."""

from understudy_mujoco import opengl

#: Plugins that this one builds on.
REQUIRES = ("tensors",)


opengl.choose()

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

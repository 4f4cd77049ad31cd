"""MuJoCo Warp: the same scenes as MuJoCo on the CPU, with all worlds on one GPU."""

REQUIRES = ("mujoco", "tensors", "warp_torch")

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "simulator": {
        "mujoco_warp": ("part:MujocoWarp", "MuJoCo Warp on one GPU"),
    },
}

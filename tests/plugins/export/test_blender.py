"""Blender, where its Python module is installed, opens what was written: the same bones move alike."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest
from motion_files import walker
from moving_figures import boxes

from understudy_export.gltf import GlbWriter
from understudy_export.usd import UsdcWriter
from understudy_motion.kinematics import forward_kinematics

#: A Python interpreter that has the module bpy, which wants a numpy of its own.
PYTHON = os.environ.get("UNDERSTUDY_BLENDER_PYTHON")

OPEN = """
import json, sys
import bpy
bpy.ops.wm.read_factory_settings(use_empty=True)
path = sys.argv[1]
bpy.context.scene.render.fps = 30
if path.endswith(".glb"):
    bpy.ops.import_scene.gltf(filepath=path)
else:
    bpy.ops.wm.usd_import(filepath=path)
(armature,) = [o for o in bpy.data.objects if o.type == "ARMATURE"]
skinned = [o for o in bpy.data.objects if o.type == "MESH" and o.find_armature() == armature]
frames = []
for frame in range(6):
    bpy.context.scene.frame_set(frame)
    posed = armature.evaluated_get(bpy.context.evaluated_depsgraph_get())
    bones = {b.name: list((posed.matrix_world @ b.matrix).translation) for b in posed.pose.bones}
    frames.append(bones)
print("FOUND", json.dumps({"frames": frames, "skinned": len(skinned)}))
"""


@pytest.mark.slow
@pytest.mark.parametrize("writer", [GlbWriter(), UsdcWriter()], ids=lambda w: w.suffix)
def test_blender_shows_the_same_motion(tmp_path: Path, writer: GlbWriter | UsdcWriter) -> None:
    if PYTHON is None:
        pytest.skip("UNDERSTUDY_BLENDER_PYTHON names no Python with the module bpy")
    clip, path = walker(frames=6, rate=30.0), tmp_path / f"clip{writer.suffix}"
    writer.write(clip, path, boxes(clip))
    done = subprocess.run(
        [PYTHON, "-c", OPEN, str(path)], capture_output=True, text=True, timeout=300, check=True
    )
    line = next(x for x in done.stdout.splitlines() if x.startswith("FOUND "))
    found = json.loads(line.removeprefix("FOUND "))
    assert found["skinned"] >= 1
    expected = forward_kinematics(clip)[0].numpy()
    if writer.suffix == ".glb":  # what faced x now faces the viewer, as Blender's own figures do
        expected = expected[..., [1, 0, 2]] * [1.0, -1.0, 1.0]
    for frame, bones in enumerate(found["frames"]):
        shown = np.array([bones[name] for name in clip.joint_names])
        np.testing.assert_allclose(shown, expected[frame], atol=1e-4)

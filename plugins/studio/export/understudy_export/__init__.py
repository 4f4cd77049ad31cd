"""Runs and clips out: motions as BVH, glTF and USD, policies as ONNX."""

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES = ("skills", "characters", "motion", "mujoco", "report", "credits", "play")

_HERE = "understudy_export"


@hookimpl
def understudy_register(register: Registrar) -> None:
    add = register.component
    add(
        "command",
        "export",
        f"{_HERE}.command:Export",
        "write a run's motion or policy, or a clip, as a file",
    )
    add(
        "command",
        "motion export",
        f"{_HERE}.columns:ExportColumns",
        "write a clip on a robot as the table that another trainer reads",
    )
    add("clip_writer", "glb", f"{_HERE}.gltf:GlbWriter", "glTF 2.0, one binary file")
    add("clip_writer", "gltf", f"{_HERE}.gltf:GltfWriter", "glTF 2.0, one JSON file")
    add("clip_writer", "usd", f"{_HERE}.usd:UsdWriter", "USD, binary")
    add("clip_writer", "usda", f"{_HERE}.usd:UsdaWriter", "USD, text")
    add("clip_writer", "usdc", f"{_HERE}.usd:UsdcWriter", "USD, binary")

"""Runs and clips out: motions as BVH, glTF and USD, policies as ONNX."""

#: Plugins that this one builds on.
REQUIRES = (
    "skills",
    "characters",
    "cloth",
    "motion",
    "mujoco",
    "report",
    "credits",
    "play",
    "reinforcement",
)

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "command": {
        "export": ("command:Export", "write a run's motion or policy, or a clip, as a file"),
        "motion export": ("columns:ExportColumns", "write a clip as another trainer's table"),
    },
    "clip_writer": {
        "glb": ("gltf:GlbWriter", "glTF 2.0, one binary file"),
        "gltf": ("gltf:GltfWriter", "glTF 2.0, one JSON file"),
        "usd": ("usd:UsdWriter", "USD, binary"),
        "usda": ("usd:UsdaWriter", "USD, text"),
        "usdc": ("usd:UsdcWriter", "USD, binary"),
    },
}

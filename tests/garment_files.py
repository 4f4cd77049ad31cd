"""A garment's files for tests, made from a pattern."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml

from understudy_cloth.patterns import Shirt, t_shirt


def write_gown(folder: Path) -> Path:
    """``gown.yaml`` and its mesh in `folder`: a T-shirt whose sleeves end in ``left_sleeve`` and ``right_sleeve``; returns its path."""
    shirt = t_shirt(Shirt(edge=0.032))
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in shirt.positions]
    lines += ["f " + " ".join(str(i + 1) for i in face) for face in shirt.faces]
    (folder / "gown.obj").write_text("\n".join(lines) + "\n")
    named = {
        "left_sleeve": "left_end",
        "right_sleeve": "right_end",
        "hem": "hem",
        "collar": "collar",
    }
    loops = {name: {"hole": int(np.min(shirt.loops[loop]))} for name, loop in named.items()}
    path = folder / "gown.yaml"
    path.write_text(yaml.safe_dump({"mesh": "gown.obj", "up": "z", "loops": loops}))
    return path

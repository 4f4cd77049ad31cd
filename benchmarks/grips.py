"""Whether the packaged grips hold without a policy.

``python benchmarks/grips.py`` holds each for ten seconds at each of its angles under fixed targets, measures how far the tool slips in
the palm and how deep anything is in it, and writes ``docs/benchmarks/grips.jsonl``, from which ``make figures`` writes a table on
the page of chopsticks.
"""

from __future__ import annotations

import argparse
import datetime
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from understudy.setup.plugins import load
from understudy_gripping.grip import load_grip
from understudy_gripping.styles import written
from understudy_hand.scene import HandScene

RESULTS = Path(__file__).parents[1] / "docs" / "benchmarks" / "grips.jsonl"
SECONDS, SETTLE = 10.0, 1.0


def row(name: str, path: Path) -> dict[str, Any]:
    """The grip in the file `path`, at the worst of its angles; mm."""
    grip = load_grip(path)
    scene = HandScene(HandScene.Options(**asdict(grip.measures), tool=grip.tool))
    every = [grip.held(scene, k, SECONDS, SETTLE) for k in range(len(grip.angles))]
    return {
        "grip": name,
        "when": datetime.date.today().isoformat(),
        "tool": grip.tool,
        "hand": asdict(grip.measures),
        "style": written(grip.style),
        "seconds": SECONDS,
        "angles": grip.angles.tolist(),
        "fell": sum(held.fell is not None for held in every),
        "slip": 1e3 * float(np.max([held.drift for held in every])),
        "depth": 1e3 * max(held.depth for held in every),
        "links": sorted(frozenset.union(*(held.links for held in every))),
    }


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    registry, lines = load().registry, []
    for one in registry.names("grip"):
        if not load_grip(registry.find("grip", one).factory()).holds:
            continue
        lines.append(json.dumps(row(one, registry.find("grip", one).factory())) + "\n")
        print(lines[-1], end="", flush=True)
    RESULTS.write_text("".join(lines), encoding="utf-8")

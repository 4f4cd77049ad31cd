"""Which starts of DeepMimic's clips cannot be flown, before and after the doctor's repair.

``UNDERSTUDY_DATA=… python benchmarks/flights.py`` lets a body go in each start's state (``let_go``) and writes
``docs/benchmarks/flights.jsonl``.
"""

from __future__ import annotations

import datetime
import json
from pathlib import Path

from understudy.setup.plugins import installed
from understudy_characters.character import load_character
from understudy_characters.letting_go import let_go
from understudy_doctor.examination import examine
from understudy_doctor.repair import repair
from understudy_motion import library
from understudy_motion.reading import ReadOptions

RESULTS = Path(__file__).parents[1] / "docs" / "benchmarks" / "flights.jsonl"
CLIPS = ["walk", "run", "jump", "roll", "cartwheel", "dance_a", "run_jump", "backflip", "spinkick"]

if __name__ == "__main__":
    registry = installed().registry
    humanoid = load_character("humanoid", registry)
    lines = []
    for name in CLIPS:
        clip = humanoid.posed(library.find(f"humanoid3d_{name}", registry, ReadOptions()))
        before = let_go(clip, humanoid)
        row = {
            "clip": name,
            "when": datetime.date.today().isoformat(),
            "floor": "lowest",
            "starts": len(before.times),
            "bad": before.share,
            "by_phase": [float(part) for part in before.by_phase(10)],
        }
        if before.bad.any():
            mended = repair(examine(clip, humanoid))
            after = let_go(mended.clip, humanoid)
            row |= {
                "bad_repaired": after.share,
                "done": list(mended.done),
                "left": list(mended.left),
            }
        lines.append(json.dumps(row))
        print(lines[-1], flush=True)
    RESULTS.write_text("\n".join(lines) + "\n", encoding="utf-8")

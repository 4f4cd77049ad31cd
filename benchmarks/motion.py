"""How long ten minutes of motion capture take: reading, retargeting, checking.

    python benchmarks/motion.py FILE.amc [--character humanoid]

repeats FILE's frames to ten minutes at 120 Hz in a temporary folder (its ASF beside it) and prints
seconds and peak memory as one JSON line, appended to ``docs/benchmarks/motion.jsonl``.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import tempfile
import time
from pathlib import Path
from typing import Any

from rows import append

from understudy.setup.plugins import installed
from understudy_characters.character import load_character
from understudy_motion import library
from understudy_retarget.retarget import retarget

FRAMES = 72_000
RESULTS = Path(__file__).resolve().parents[1] / "docs" / "benchmarks" / "motion.jsonl"


def repeated(source: Path, folder: Path) -> Path:
    """`source`'s frames over and over, :data:`FRAMES` in all; its skeleton beside it."""
    for skeleton in source.parent.glob("*.asf"):
        shutil.copy(skeleton, folder)
    lines = source.read_text().splitlines(keepends=True)
    starts = [i for i, line in enumerate(lines) if line.strip().isdigit()]
    ends = [*starts[1:], len(lines)]
    frames = ["".join(lines[a + 1 : b]) for a, b in zip(starts, ends, strict=True)]
    made = folder / source.name
    with made.open("w") as file:
        file.writelines(lines[: starts[0]])
        for i in range(FRAMES):
            file.write(f"{i + 1}\n{frames[i % len(frames)]}")
    return made


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("file", type=Path)
    parser.add_argument("--character", default="humanoid")
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args()
    registry = installed().registry
    character = load_character(options.character, registry)
    with tempfile.TemporaryDirectory() as folder:
        path = repeated(options.file, Path(folder))
        began = time.perf_counter()
        clip = library.find(str(path), registry)
        read = time.perf_counter() - began
        began = time.perf_counter()
        _, report = retarget(clip, character)
        moved = time.perf_counter() - began
    row: dict[str, Any] = {
        "when": time.strftime("%Y-%m-%d"),
        "cores": os.cpu_count(),
        "clip": options.file.stem,
        "character": character.name,
        "frames": clip.num_frames,
        "read_s": round(read, 2),
        "retarget_s": round(moved, 2),
        "mean_key_point_error_m": round(report.mean_error, 4),
        "peak_memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024,
    }
    append(options.out, row)
    print(json.dumps(row))


if __name__ == "__main__":
    main()

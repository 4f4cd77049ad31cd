"""How long the video of a run takes to draw and encode: wall and processor seconds.

::

    python benchmarks/video.py RUN [--seconds 8]
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from pathlib import Path

import numpy as np

from understudy.setup.plugins import installed


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # type: ignore[union-attr]
    parser.add_argument("run", type=Path)
    parser.add_argument("--seconds", type=float, default=8.0)
    options = parser.parse_args()
    installed()
    from understudy_characters.recording import run_character
    from understudy_characters.scene import CharacterScene
    from understudy_report.maker import HEIGHT, WIDTH
    from understudy_report.video import write_video

    scene = CharacterScene(CharacterScene.Options(run_character(options.run).name))
    with np.load(options.run / "recording.npz", allow_pickle=False) as arrays:
        dt = float(arrays["control_dt"])
        count = round(options.seconds / dt)
        tracks = {k: arrays[k][:count] for k in ("qpos", "reference_qpos") if k in arrays}
    began, before = time.perf_counter(), sum(os.times()[:4])
    with tempfile.TemporaryDirectory() as folder:
        write_video(Path(folder) / "video.mp4", scene.draw(tracks, WIDTH, HEIGHT), 1.0 / dt)
        size = (Path(folder) / "video.mp4").stat().st_size
    wall, cpu = time.perf_counter() - began, sum(os.times()[:4]) - before
    frames = len(tracks["qpos"])
    print(
        f"{frames * dt:.1f} s of {WIDTH} × {HEIGHT} ({frames} frames, {size / 1000:.0f} kB): "
        f"{wall:.1f} s on {len(os.sched_getaffinity(0))} cores, {cpu:.1f} s of processor time"
    )


if __name__ == "__main__":
    main()

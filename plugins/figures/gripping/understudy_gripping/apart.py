"""One grip found in a process of its own: ``python -m understudy_gripping.apart FILE STYLE CLEARANCE PLACE …`` (m)."""

from __future__ import annotations

import sys
from pathlib import Path

from understudy.errors import ConfigError
from understudy_gripping.finding import find_grip
from understudy_gripping.styles import read_style
from understudy_hand.scene import HandScene


def main(file: str, text: str, clearance: str, *places: str) -> int:
    """Find the grip of the style `text` with its fingers at `places` (m), and save it as `file`; the exit
    status, 2 where there is none. Fingers keep `clearance` (m) apart, unless that is ``none``."""
    apart = None if clearance == "none" else float(clearance)
    scene = HandScene(HandScene.Options(len(text)))
    try:
        style, along = read_style(text, len(text)), list(map(float, places))
        find_grip(scene, style, along, finger_clearance=apart).save(Path(file))
    except ConfigError as error:
        print(error, file=sys.stderr)
        return ConfigError.exit_status
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))

"""One grip found in a process of its own: ``python -m understudy_gripping.apart FILE STYLE PLACE …`` (m)."""

from __future__ import annotations

import sys
from pathlib import Path

from understudy.errors import ConfigError
from understudy_gripping.grip import find_grip
from understudy_gripping.styles import read_style
from understudy_hand.scene import HandScene


def main(file: str, text: str, *places: str) -> int:
    scene = HandScene(HandScene.Options(len(text)))
    try:
        find_grip(scene, read_style(text, len(text)), list(map(float, places))).save(Path(file))
    except ConfigError as error:
        print(error, file=sys.stderr)
        return ConfigError.exit_status
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))

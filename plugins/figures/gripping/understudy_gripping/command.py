"""``understudy grip``: finds how a hand holds two sticks in a style."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

from understudy.command.command import Command
from understudy.errors import ConfigError
from understudy_gripping.grip import find_grip
from understudy_gripping.pose import first_guess
from understudy_gripping.styles import read_style, written
from understudy_hand.scene import HandScene
from understudy_hand.tools import HALF_LENGTH


class FindGrip(Command):
    """Solves the pose from straight fingers, balances the sticks, and holds each angle for a second.

    Some seconds of one core. Nothing is written of a grip that does not hold.
    """

    example = "understudy grip 11120 grip.json"

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("style", help="digits from the thumb on (11120), or a name (standard)")
        parser.add_argument("file", type=Path, help="JSON file to write")
        parser.add_argument(
            "--places", type=float, nargs="+", metavar="MM",
            help="mm from the middle of the stick, of each finger that touches, from the thumb on",
        )  # fmt: skip
        parser.add_argument("--fingers", type=int, default=5, help="of the hand (default: 5)")
        parser.add_argument("--finger-length", type=float, default=1.0, help="default: 1")
        parser.add_argument("--size", type=float, default=1.0, help="of the hand (default: 1)")

    def writes(self, options: argparse.Namespace) -> Iterator[Path | None]:
        yield options.file

    def run(self, options: argparse.Namespace) -> int:
        try:
            chosen = HandScene.Options(options.fingers, options.finger_length, options.size)
        except ValueError as error:
            raise ConfigError(
                f"--{str(error).replace('finger_length', 'finger-length')}"
            ) from error
        style = read_style(options.style, options.fingers)
        touching = sum(map(bool, style))
        places = [p / 1e3 for p in options.places or []] or first_guess(style)
        if len(places) != touching:
            raise ConfigError(
                f"--places takes {touching} numbers for the style {written(style)}, one for each finger "
                f"that touches, and not {len(places)}."
            )
        if not all(abs(place) <= HALF_LENGTH for place in places):
            raise ConfigError("--places are mm from the middle of a stick, between -130 and 130.")
        scene = HandScene(chosen)
        grip = find_grip(scene, style, places)
        grip.save(options.file)
        held = grip.held(scene, 0, 10.0, 1.0)
        drift = " and ".join(f"{1e3 * d:.2f}" for d in held.drift)
        print(
            f"{written(style)}: the sticks slip by {drift} mm in 9 s, fingers are at most "
            f"{1e3 * held.depth:.2f} mm in them. Written: {options.file}"
        )
        return 0

"""``understudy grip``: finds how a hand holds a tool in a style."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from understudy.command.command import Command
from understudy.errors import ConfigError, FileError
from understudy.setup.composition import load_experiment
from understudy_gripping.finding import FORCE, find_grip, search_grip
from understudy_gripping.grip import Grip
from understudy_gripping.holding import holding
from understudy_gripping.section import MOST_CLEARANCE
from understudy_gripping.styles import read_style, written
from understudy_hand.scene import HandScene
from understudy_hand.tools import HALF_LENGTH

#: Of a search, at most: they are solved side by side.
MOST_TRIES = 1000


def _of_scene(name: str) -> HandScene.Options:
    """What the config group's scene `name` is."""
    found = load_experiment([f"scene={name}"]).need("scene").options
    if not isinstance(found, HandScene.Options):
        raise ConfigError(f"--scene {name} has no hand. Give one that has, such as hand/adroit.")
    return found


class FindGrip(Command):
    """Solves the pose from straight fingers, balances the tool, and holds each angle for a second.

    Some seconds of one core; with --tries as much for each of them. Nothing is written of a grip that does not hold.
    """

    example = "understudy grip 11120 grip.json"

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("style", help="digits from the thumb on (11120), or a name (standard)")
        parser.add_argument("file", type=Path, help="JSON file to write")
        parser.add_argument(
            "--places", type=float, nargs="+", metavar="MM",
            help="mm from the middle of the stick, of each finger that touches, from the thumb on",
        )  # fmt: skip
        parser.add_argument(
            "--tries", type=int, default=0, metavar="N",
            help="draw N places about these and keep the grip that slips least in 10 s (default: these alone)",
        )  # fmt: skip
        parser.add_argument(
            "--seed", type=int, default=0, help="of the N draws of --tries (default: 0)"
        )
        parser.add_argument(
            "--force", type=float, default=FORCE, metavar="N",
            help=f"with which each finger presses on the tool, N (default: {FORCE:g}); the more, the faster sticks creep",
        )  # fmt: skip
        parser.add_argument(
            "--finger-clearance", type=float, metavar="MM",
            help="mm that links of different fingers keep from one another (default: they may lie in one another)",
        )  # fmt: skip
        parser.add_argument(
            "--tool", default="sticks", help="sticks, tongs or brush (default: sticks)"
        )
        parser.add_argument(
            "--scene", default="hand", metavar="NAME",
            help="whose hand it is, such as hand/adroit (default: hand, the human one)",
        )  # fmt: skip
        parser.add_argument(
            "--fingers",
            type=int,
            metavar="N",
            help="how many the hand has, with the thumb (default: 5)",
        )
        parser.add_argument(
            "--finger-length", type=float, metavar="TIMES",
            help="how many times as long the fingers are as the hand's own (default: 1)",
        )  # fmt: skip
        parser.add_argument(
            "--size", type=float, metavar="TIMES",
            help="how many times as large the whole hand is (default: 1)",
        )  # fmt: skip

    def writes(self, options: argparse.Namespace) -> Iterator[Path | None]:
        yield options.file

    def run(self, options: argparse.Namespace) -> int:
        own = holding(options.tool)
        if not 0 <= options.tries <= MOST_TRIES or options.seed < 0:
            raise ConfigError(f"--tries is a number from 0 to {MOST_TRIES}, and --seed at least 0.")
        if not 0.1 <= options.force <= 10.0:
            raise ConfigError(f"--force {options.force:g} is not from 0.1 to 10 N.")
        apart = options.finger_clearance
        if apart is not None and not 0.0 <= apart <= 1e3 * MOST_CLEARANCE:
            raise ConfigError(
                f"--finger-clearance {apart:g} is not from 0 to {1e3 * MOST_CLEARANCE:g} mm."
            )
        apart = None if apart is None else apart / 1e3
        try:
            given = {name: getattr(options, name) for name in ("fingers", "finger_length", "size")}
            given = {name: value for name, value in given.items() if value is not None}
            chosen = replace(_of_scene(options.scene), tool=options.tool, **given)
        except ValueError as error:
            said = str(error).replace("finger_length", "finger-length")
            if said.startswith("robot "):  # which is what --scene names
                said = f"scene {options.scene}{said.removeprefix('robot')}"
            raise ConfigError(f"--{said}") from error
        style = read_style(options.style, chosen.fingers, options.tool)
        touching = sum(map(bool, style))
        places = [p / 1e3 for p in options.places or []] or own.first_guess(style)
        if len(places) != touching:
            raise ConfigError(
                f"--places takes {touching} numbers for the style {written(style)}, one for each finger "
                f"that touches, and not {len(places)}."
            )
        if not all(abs(place) <= HALF_LENGTH for place in places):
            raise ConfigError("--places are mm from the middle of a stick, between -130 and 130.")
        if options.file.is_dir() or not options.file.parent.is_dir():  # not after minutes of search
            raise FileError(
                f"{options.file} cannot be written: it is a folder, or in none. Name a file in a folder that is there."
            )
        scene = HandScene(chosen)
        if options.tries:
            grip = search_grip(
                scene, style, places, options.tries, options.seed, force=options.force,
                finger_clearance=apart,
            )  # fmt: skip
        else:
            grip = find_grip(scene, style, places, force=options.force, finger_clearance=apart)
        grip.save(options.file)
        print(f"{written(style)}: {_held(grip, scene)}. Written: {options.file}")
        return 0


def _held(grip: Grip, scene: HandScene) -> str:
    """What becomes of the tool in ten seconds, in a sentence."""
    every = [grip.held(scene, row, 10.0, 1.0) for row in range(len(grip.angles))]
    parts = [name.replace("_", " ") for name in scene.tool_bodies]
    fell = [(held.fell, angle) for held, angle in zip(every, grip.angles, strict=True) if held.fell]
    if fell:
        after, angle = min(fell)
        return (
            f"it holds for a second and not for ten: at {len(fell)} of {len(every)} angles "
            f"{'a part' if len(parts) > 1 else 'the ' + parts[0]} falls, first after {after:.2f} s (at {angle:g} rad). Other "
            "--places, or drawn ones (--tries 16), may hold longer"
        )
    slip = " and ".join(f"{1e3 * d:.2f}" for d in np.max([held.drift for held in every], axis=0))
    depth = max(held.depth for held in every)
    return (
        f"{' and '.join(parts)} slip{'s' * (len(parts) == 1)} by {slip} mm in 9 s at the worst of {len(every)} "
        f"angles; anything is at most {1e3 * depth:.2f} mm in them"
    )

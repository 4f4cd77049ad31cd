"""``understudy motion export``: a clip on a robot as the columns that other trainers read.

mjlab (``mjlab.scripts.csv_to_npz``, version 1.6, after Unitree's retargeted LAFAN1): no header; the
root's position in m, its quaternion as xyzw, then the joints' angles in rad.

ProtoMotions (``data/scripts/convert_g1_csv_to_proto.py`` with its defaults): a header; the frame's
number, the root's position in cm, its rotation as extrinsic turns about x, y and z in degrees, then the
joints' angles in degrees.

Both take world frames with z up, evenly spaced frames (30 a second unless told otherwise), and the
joints in the order of the robot's MJCF.
"""

from __future__ import annotations

import argparse
import io
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from understudy.command.command import Command
from understudy.errors import ConfigError
from understudy.folders import write_atomically
from understudy.setup.plugins import installed
from understudy_characters.character import Character
from understudy_characters.recording import chosen_character
from understudy_export.command import timed
from understudy_motion.arguments import add_reading, frame_rate, open_clip
from understudy_motion.readers.angles import RATE


class ExportColumns(Command):
    """Writes a clip as a table whose columns are in the order that another trainer reads."""

    example = "understudy motion export walk.npz robot.xml walk.csv --for mjlab"

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("clip", metavar="CLIP", help="a clip's file or name")
        parser.add_argument(
            "character",
            metavar="CHARACTER",
            help="a robot's MJCF file, its name, or a run folder of it",
        )
        parser.add_argument(
            "destination", metavar="OUT", type=Path, help="the table to write, .csv"
        )
        parser.add_argument(
            "--for", dest="trainer", choices=sorted(TABLES), required=True, help="who reads it"
        )
        parser.add_argument(
            "--rate", type=frame_rate, default=RATE, metavar="HZ", help="frames per second (30)"
        )
        add_reading(parser)

    def writes(self, options: argparse.Namespace) -> Iterator[Path | None]:
        yield options.destination

    def run(self, options: argparse.Namespace) -> int:
        registry = installed().registry
        character = chosen_character(options.character, registry)
        clip = timed(open_clip(options.clip, options, registry), rate=options.rate)
        names = joint_columns(character)
        qpos = root_first(character, character.qpos(clip).numpy())
        write_atomically(options.destination, TABLES[options.trainer](qpos, names).encode())
        print(
            f"{options.destination}: {len(qpos)} frames at {clip.frame_rate:.4g} Hz · {len(names)} joints "
            f"of {character.name} · licence: {clip.licence}"
        )
        return 0


def joint_columns(character: Character) -> list[str]:
    """Names of the joints that have a column each, in the order of the model.

    Raises
    ------
    ConfigError
        a joint is a ball.
    """
    for joint in character.joints[1:]:
        if len(joint.axes) == 0:
            raise ConfigError(
                f"Character {character.name}: its joint '{joint.name}' is no hinge, and tables for other "
                "trainers have an angle for each joint; give a robot of hinges."
            )
    return list(character.hinges)


def root_first(character: Character, qpos: np.ndarray) -> np.ndarray:
    """Of ``qpos`` (F, nq) the root's seven columns, then those of the figure's hinges."""
    at = character.root_address
    return qpos[:, [*range(at, at + 7), *character.hinges.values()]]


def mjlab(qpos: np.ndarray, names: list[str]) -> str:
    """The table for mjlab of ``qpos`` (F, 7 + J), root first."""
    return _csv(np.concatenate([qpos[:, :3], qpos[:, [4, 5, 6, 3]], qpos[:, 7:]], axis=1))


def protomotions(qpos: np.ndarray, names: list[str]) -> str:
    """The table for ProtoMotions of ``qpos`` (F, 7 + J), root first."""
    turns = Rotation.from_quat(qpos[:, 3:7], scalar_first=True).as_euler("xyz", degrees=True)
    frames = np.arange(len(qpos))[:, None]
    rows = np.concatenate([frames, 100.0 * qpos[:, :3], turns, np.degrees(qpos[:, 7:])], axis=1)
    root = [f"root_{what}{axis}" for what in ("translate", "rotate") for axis in "XYZ"]
    return ",".join(["Frame", *root, *(f"{name}_dof" for name in names)]) + "\n" + _csv(rows)


def _csv(rows: np.ndarray) -> str:
    text = io.StringIO()
    np.savetxt(text, rows, fmt="%.9g", delimiter=",")
    return text.getvalue()


TABLES = {"mjlab": mjlab, "protomotions": protomotions}

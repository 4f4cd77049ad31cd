"""``understudy motion retarget``: a clip of any skeleton becomes a clip of a character."""

from __future__ import annotations

import argparse
import json
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from understudy.command.command import Command, tell
from understudy.errors import ConfigError
from understudy.setup.plugins import installed
from understudy.setup.registry import Registry
from understudy_characters.recording import chosen_character
from understudy_doctor.clip_checks import check_clip
from understudy_doctor.findings import Severity
from understudy_motion.arguments import add_reading, open_clip
from understudy_motion.clip import Clip
from understudy_motion.editing import cut
from understudy_motion.reading import readers
from understudy_motion.writing import write_clip
from understudy_retarget.retarget import Options, Report, retarget


class Retarget(Command):
    """Transfers a motion to a character, with its feet on the floor, and reports how well the result fits."""

    example = "understudy motion retarget walk robot.xml robot_walk.npz"

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("clip", metavar="CLIP", help="a clip's file or name")
        parser.add_argument(
            "character",
            metavar="CHARACTER",
            help="a character, an MJCF file, or a run folder of one",
        )
        parser.add_argument(
            "destination", metavar="OUT", type=Path, help="the clip to write: .npz, .csv or .bvh"
        )
        parser.add_argument(
            "--map",
            nargs="+",
            action="extend",
            default=[],
            metavar="JOINT=JOINT",
            help="for a joint of the character, or a part of the body, the clip's joint that it follows, such as "
            "left_knee=LeftLeg",
        )
        parser.add_argument(
            "--scale",
            type=float,
            metavar="S",
            help="multiply travel and height by this, instead of by the ratio of the legs",
        )
        parser.add_argument(
            "--start", type=float, metavar="S", help="leave out what is before this time, s"
        )
        parser.add_argument(
            "--end", type=float, metavar="S", help="leave out what is after this time, s"
        )
        parser.add_argument("--json", action="store_true", help="print the report as JSON")
        add_reading(parser)

    def writes(self, options: argparse.Namespace) -> Iterator[Path | None]:
        yield options.destination

    def run(self, options: argparse.Namespace) -> int:
        registry = installed().registry
        how = Options(map=_pairs(options.map), scale=options.scale)
        character = chosen_character(options.character, registry)
        clip = _load(options, registry)
        for finding in check_clip(clip):
            if finding.severity == Severity.MAJOR:
                tell(f"{clip.name}: {finding.line()}")
        result, report = retarget(clip, character, how)
        result = replace(result, name=options.destination.stem)
        write_clip(result, options.destination, registry)
        if not report.fits:
            tell(_misfit(report, options.character))
        if options.json:
            print(json.dumps(_as_json(report, options.destination), indent=1))
        else:
            print(_as_text(report, result, options.character, options.destination))
        return 0


def _pairs(texts: Sequence[str]) -> dict[str, str]:
    pairs = {}
    for text in texts:
        ours, equals, theirs = text.partition("=")
        if not (ours and equals and theirs):
            raise ConfigError(f"--map {text} is not possible: it is OURS=THEIRS, two joints.")
        if pairs.setdefault(ours, theirs) != theirs:
            raise ConfigError(f"--map names {ours} twice: it follows {pairs[ours]} or {theirs}.")
    return pairs


def _load(options: argparse.Namespace, registry: Registry) -> Clip:
    clip = open_clip(options.clip, options, registry)
    if options.start is None and options.end is None:
        return clip
    start = 0.0 if options.start is None else options.start
    return cut(clip, start, clip.duration if options.end is None else options.end)


def _misfit(report: Report, character: str) -> str:
    missed = f"key points are missed by {100 * report.mean_error:.0f} cm on average, "
    missed += f"{100 * report.mean_error / report.leg:.0f} % of the length of its legs"
    return (
        f"Warning: {character} is not built for this motion: {missed}"
        f"{'' if report.upright else ', and its trunk does not stand'}. It would learn something else; "
        "take a clip of a figure like it."
    )


def _as_json(report: Report, destination: Path) -> dict[str, Any]:
    return {
        "file": str(destination),
        "mapping": {part: list(joints) for part, joints in report.mapping.items()},
        "missing": list(report.missing),
        "unused": list(report.unused),
        "still": list(report.still),
        "fits": report.fits,
        "no_stance": list(report.no_stance),
        "scale": report.scale,
        "key_point_error_m": {
            "mean": report.mean_error,
            "worst": report.worst_error,
            "points": {p: {"mean": m, "worst": w} for p, (m, w) in report.errors.items()},
        },
        "contact_share": report.contact_share,
        "skate_m_per_s": report.skate,
        "penetration_m": report.penetration,
        "peak_joint_speed_rad_per_s": {"clip": report.source_speed[0], "result": report.speed[0]},
    }


def _as_text(report: Report, result: Clip, character: str, destination: Path) -> str:
    lines = [_row("part", "character", "clip", "mean cm", "worst")]
    for part, (ours, theirs) in report.mapping.items():
        distances = [f"{100 * error:.1f}" for error in report.errors.get(part, ())]
        lines.append(_row(part, ours, theirs, *distances))
    if report.missing:
        lines.append(f"Not in the clip, left as in the zero pose: {', '.join(report.missing)}.")
    if report.still:
        lines.append(
            "Of the character, left as in the zero pose, since their names and places say no part of a body: "
            f"{', '.join(report.still)}."
        )
    if report.unused:
        lines.append(f"Not on the character, left out: {', '.join(report.unused)}.")
    if report.no_stance:
        lines.append(
            f"The clip's zero pose is no stance ({', '.join(report.no_stance)}): how these are turned "
            "is taken from how they move on average. Look at the result."
        )
    worst = max(report.errors, key=lambda part: report.errors[part][1])
    speed, joint = report.speed
    before, joint_before = report.source_speed
    lines += [
        f"Scale {report.scale:.3f}. Key points are met within {100 * report.mean_error:.1f} cm on "
        f"average, {100 * report.worst_error:.1f} cm at worst ({worst}).",
        f"A foot is on the floor in {100 * report.contact_share:.0f} % of the frames, where it slides "
        f"at {100 * report.skate:.1f} cm/s. The deepest point is {1000 * report.penetration:.0f} mm "
        "below the floor.",
        f"The fastest joint: {speed:.1f} rad/s ({joint}); in the clip {before:.1f} ({joint_before}).",
        f"Written: {destination}, {result.num_frames} frames, {result.duration:.2f} s.",
    ]
    return "\n".join([*lines, *_next(result, character, destination, report.fits)])


def _next(result: Clip, character: str, destination: Path, fits: bool) -> list[str]:
    """What can be done with the file, as commands, if it is of a format that is read; learning it is not
    offered to a character that it does not fit."""
    known = readers(installed().registry).values()
    if destination.suffix.lower() not in {ending for reader in known for ending in reader.suffixes}:
        return [f"'{destination.suffix}' files are only shown: to learn the clip, write .npz."]
    said = " --unit cm --up y" if destination.suffix.lower() == ".bvh" else ""
    file, who = shlex.quote(str(destination)), shlex.quote(character)
    lines = [f"Next: understudy motion check {file}{said} --character {who}"]
    if not fits:
        return lines
    settings = [f"scene.character={character}", f"motion.file={destination}"]
    settings += ["motion.unit=cm", "motion.up=y"] if said else []
    settings += ["motion.loop=true"] if said and result.loop else []
    words = " ".join(map(shlex.quote, ["experiment=spacetime/walk", *settings]))
    return [*lines, f"To learn it: understudy train {words}"]


def _row(part: str, ours: str, theirs: str, mean: str = "", worst: str = "") -> str:
    return f"{part:15} {ours:26} {theirs:26} {mean:>7} {worst:>6}".rstrip()

"""``understudy motion check``: what is wrong with a clip, and a repaired copy of it."""

from __future__ import annotations

import argparse
import json
import typing
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from understudy.command.command import Command, tell
from understudy.errors import ConfigError
from understudy.folders import write_atomically
from understudy.setup.plugins import installed
from understudy.setup.registry import Registry
from understudy_characters.character import Character, load_character
from understudy_characters.recording import chosen_character, recorded_clips, run_character
from understudy_credits.walk import in_a_line, open_made
from understudy_doctor.character_checks import missing_joints
from understudy_doctor.examination import Examination, examine, final
from understudy_doctor.findings import Severity
from understudy_doctor.page import page
from understudy_doctor.repair import Repair, make_loop, repair
from understudy_doctor.summary import as_json, comparison, findings_as_json, text, verdict
from understudy_motion.arguments import add_reading, open_clip, refuse_reading
from understudy_motion.clip import Clip, angle_names
from understudy_motion.section import Floor
from understudy_motion.writing import write_clip
from understudy_skills.folder import run_folder

DEFAULT_CHARACTER = "humanoid"


class Check(Command):
    """Examines a clip, or a learned motion; the exit status is 1 if there is a major finding."""

    example = "understudy motion check walk.npz --loop --fix cycle.npz"

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument(
            "clip", metavar="CLIP", help="a clip's file or name, a run folder, or a skill"
        )
        parser.add_argument(
            "--character",
            metavar="NAME",
            help="the character, MJCF file, or run folder, whose body is to move like the clip; by default the run's own, or the "
            f"{DEFAULT_CHARACTER}, if the clip has its joints",
        )
        parser.add_argument("--json", action="store_true", help="print the findings as JSON")
        parser.add_argument(
            "--page",
            type=Path,
            metavar="OUT.html",
            help="write the findings as a page with pictures",
        )
        parser.add_argument(
            "--fix", type=Path, metavar="OUT", help="write the clip, repaired as far as possible"
        )
        parser.add_argument(
            "--loop", action="store_true", help="with --fix: cut out the best loop and close it"
        )
        parser.add_argument(
            "--floor",
            choices=typing.get_args(Floor),
            default="lowest",
            help="how training will put the clip on the floor (motion.floor); this decides where flights land",
        )
        add_reading(parser, loop=False)

    def writes(self, options: argparse.Namespace) -> Iterator[Path | None]:
        yield from (options.fix, options.page)

    def run(self, options: argparse.Namespace) -> int:
        registry = installed().registry
        if options.loop and options.fix is None:
            raise ConfigError(
                f"--loop makes a new clip of {options.clip}: say where it is to be written, --fix OUT."
            )
        clip, character, level = _moving(options, registry)
        if character is not None:
            clip = character.posed(clip)
        elif angle_names(clip) is not None:
            tell(f"{clip.name}: a robot's angles; --character ROBOT.xml says how it moves by them.")
        before = examine(clip, character, options.floor, level)
        after, done = before, None
        if options.fix is not None:
            done = _repaired(before, options.loop)
            done = replace(done, clip=replace(done.clip, name=options.fix.stem))
            _write(done.clip, options, registry)
            after = final(examine(done.clip, character, options.floor, level))
        if options.page is not None:
            content = page(after, done.done if done else ())
            write_atomically(options.page, content)
        if options.json:
            print(json.dumps(_as_json(before, after, done, options.fix), indent=1))
        else:
            print(_as_text(before, after, done, options.fix))
        return 1 if after.worst == Severity.MAJOR else 0


def _moving(
    options: argparse.Namespace, registry: Registry
) -> tuple[Clip, Character | None, float | None]:
    """What the command's arguments name, and the character that moves so: the one asked for, a run's own, or
    the default one if the clip has its joints. And the height of its floor, m, where physics has played it."""
    named = options.character and chosen_character(options.character, registry)
    source = run_folder(options.clip, registry=registry)
    if (Path(source) / "run.json").is_file():
        refuse_reading(options, options.clip)
        learned, _ = recorded_clips(run_folder(options.clip, recorded=True, registry=registry))
        licence, attribution = in_a_line(open_made(options.clip, registry), registry)
        learned = replace(learned, licence=licence, attribution=attribution)
        return learned, named or run_character(source), None if named else 0.0
    clip = open_clip(options.clip, options, registry)
    return clip, named or _fitting(clip, registry), None


def _fitting(clip: Clip, registry: Registry) -> Character | None:
    if DEFAULT_CHARACTER not in registry.names("character"):
        return None
    character = load_character(DEFAULT_CHARACTER, registry)
    return None if missing_joints(clip, character) else character


def _repaired(before: Examination, loop: bool) -> Repair:
    if not loop:
        return repair(before)
    # Frames and spikes first: a loop is found by matching frames.
    mended = repair(before)
    cut = make_loop(mended.clip, before.character)
    again = repair(examine(cut.clip, before.character, before.floor, before.level))
    return Repair(again.clip, (*mended.done, *cut.done, *again.done), again.left)


def _write(clip: Clip, options: argparse.Namespace, registry: Registry) -> None:
    destination = options.fix
    for source in (Path(options.clip), Path(clip.source)):
        if source.exists() and destination.exists() and destination.samefile(source):
            raise ConfigError(
                f"--fix {destination} would replace the clip itself; name another file."
            )
    write_clip(clip, destination, registry)


def _as_json(
    before: Examination, after: Examination, done: Repair | None, file: Path | None
) -> dict[str, typing.Any]:
    result = as_json(after)
    if done is not None:
        result["repair"] = {
            "file": str(file),
            "done": list(done.done),
            "left": list(done.left),
            "before": findings_as_json(before.findings),
        }
    return result


def _as_text(
    before: Examination, after: Examination, done: Repair | None, file: Path | None
) -> str:
    if done is None:
        return text(before)
    lines = [text(before), ""]
    lines += [f"repaired: {what}" for what in done.done] or ["repaired: nothing"]
    lines += [f"left: {what}" for what in done.left]
    for kind, (was, now) in comparison(before.findings, after.findings).items():
        lines.append(f"{kind}: {was} → {now}")
    lines += [f"remains: {finding.line()}" for finding in after.findings]
    return "\n".join([*lines, f"{file}: {verdict(after.findings)}"])

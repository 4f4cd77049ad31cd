"""``understudy sitting room``: a finished controller sits down in a room that was seen in a picture."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

from hydra.core.override_parser.types import Quote, QuotedString

from understudy.command.command import Command
from understudy.errors import FileError
from understudy.setup.composition import replaced
from understudy_characters.room_drawing import draw
from understudy_characters.rooms import read_room
from understudy_characters.scene import CharacterScene
from understudy_report.video import video_file, write_video
from understudy_sitting.examples import watch
from understudy_sitting.room import CHAIR, EXAMPLE, Room, chair_sizes
from understudy_sitting.trials import SEATED, built_for, check_trials
from understudy_skills.skill import open_skill

#: Frames per second of the video.
_RATE = 30


class SitInRoom(Command):
    """Writes a video of the controller RUN sitting down on a chair of a scene of boxes."""

    example = "understudy sitting room sitting/meta room.mp4"

    takes_overrides = True

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        add = parser.add_argument
        add("run", help="a finished run's folder, or a skill")
        add("video", type=video_file, metavar="OUT", help="the video to write, such as room.mp4")
        add("--scene", type=Path, default=EXAMPLE, help="a JSON file with boxes and a camera")
        add("--chair", type=int, default=0, help="which of the scene's chairs, from 0")
        add("--plan", action="store_true", help="draw the room from above")
        add(
            "--trials",
            type=int,
            default=64,
            help="how many trials are made; a success among them is shown, if there is one",
        )

    def writes(self, options: argparse.Namespace) -> Iterator[Path | None]:
        yield options.video

    def run(self, options: argparse.Namespace) -> int:
        check_trials(options.trials, 1)
        chairs = read_room(options.scene, CHAIR).labelled(CHAIR)
        if not 0 <= options.chair < len(chairs):
            raise FileError(f"{options.scene} has {len(chairs)} chairs, from 0.")
        scene = QuotedString(str(options.scene), Quote.single).with_quotes()
        sizes = chair_sizes(chairs[options.chair])
        furnished = [
            f"chair={{{','.join(f'{name}:{size}' for name, size in sizes.items())}}}",
            f"+room={{file:{scene},chair:{options.chair}}}",
            "initial_states.zone=1",
        ]
        skill = open_skill(options.run, replaced(furnished, options.overrides))
        built = built_for(skill, options.trials)
        try:
            watched = watch(built, skill, "room")
        finally:
            built.environment.close()
        share = float(watched.success.float().mean())
        track = watched.track(int(watched.seated.argmax()))["qpos"]
        room = built.context.need_section("room", Room, "understudy sitting room")
        assert isinstance(built.scene, CharacterScene)
        frames = draw(built.scene, track, room.camera, plan=options.plan)
        write_video(options.video, frames, _RATE)
        print(
            f"{share:.0%} of {len(watched.seated)} trials sat for {SEATED:g} s; video: {options.video}"
        )
        return 0

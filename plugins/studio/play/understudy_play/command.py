"""``understudy play``: a trained policy, live in the browser or as a video."""

from __future__ import annotations

import argparse
import importlib.util
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from understudy.command.command import Command, tell
from understudy.errors import ConfigError, UnderstudyError, shown
from understudy.setup.plugins import installed
from understudy.setup.root import Root
from understudy_characters.scene import CharacterScene
from understudy_credits.walk import answer, open_made
from understudy_motion.arguments import finite, port
from understudy_mujoco.scene import MujocoScene
from understudy_play.player import Player, World
from understudy_reinforcement.long_work import LongWork
from understudy_report.values import mapping, number
from understudy_report.video import length, video_file, write_video
from understudy_skills import bank
from understudy_skills.as_run import unpack
from understudy_skills.pack import gathering, others_named, pack, refuse_of_others, rounded
from understudy_skills.pack_inputs import PackInputs
from understudy_skills.packing import BITS, is_left_over
from understudy_skills.rounding import Rounding, enough_bits, judged
from understudy_skills.skill import Skill, names, open_skill, read_card, with_own_starts
from understudy_skills.words import refuse_of_trainings

__all__ = ["add_page_arguments", "film", "record", "serve"]

#: s between pushes, which go to the left and to the right in turn.
_EVERY = 3.0
#: Of a video: s, as of a training's, and pixels.
_SECONDS = Root().run.video_seconds
_WIDTH, _HEIGHT = 800, 450


class Play(Command):
    """Plays until interrupted, or for some seconds into a video."""

    example = "understudy play runs/spacetime-walk-001 --video walk.mp4 --push 30"

    takes_overrides = True

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument(
            "skill",
            metavar="SKILL",
            nargs="?",
            help="a skill that comes with the package, a packed skill (.json), or the folder of a run; "
            "without SKILL, the skills that come with the package are listed",
        )
        parser.add_argument(
            "--video",
            metavar="FILE",
            type=video_file,
            help="write a video (.mp4) instead of opening a page",
        )
        parser.add_argument("--seconds", type=length, help=f"length of the video ({_SECONDS:g})")
        parser.add_argument(
            "--push", type=finite, metavar="NS",
            help="push the character sideways every 3 s, in newton seconds (video only)",
        )  # fmt: skip
        parser.add_argument(
            "--pack",
            metavar="FILE",
            type=Path,
            help="write the policy, rounded, and the states that its task begins in (.json), and say what the rounding costs",
        )
        parser.add_argument(
            "--bits", type=int, choices=BITS,
            help="bits of a packed weight, whatever success they cost (by default 8, or more where 8 cost success)",
        )  # fmt: skip
        parser.add_argument(
            "--unpack", metavar="FOLDER", type=Path,
            help="write the skill as a run folder, for actuation.runs, start.run and job.run of other trainings",
        )  # fmt: skip
        parser.add_argument(
            "--follow", action="store_true",
            help="while the run trains: show its newest checkpoint, and draw its curves",
        )  # fmt: skip
        add_page_arguments(parser)

    def writes(self, options: argparse.Namespace) -> Iterator[Path | None]:
        yield options.video
        if options.pack is not None:
            file = _packed_file(options.pack)
            tensors = file.with_suffix(".safetensors")
            yield from (file, None if is_left_over(tensors) else tensors)

    def run(self, options: argparse.Namespace) -> int:
        for option in ("seconds", "push"):
            if getattr(options, option) is not None and options.video is None:
                raise ConfigError(f"--{option} is for videos. Add --video FILE, or leave it out.")
        asked = [o for o in ("video", "pack", "unpack", "follow") if getattr(options, o)]
        if options.skill is None and asked:
            raise ConfigError(
                f"--{asked[0]} needs a skill. Name one; `understudy play` alone lists them."
            )
        if options.skill is None:
            _list()
            return 0
        if options.follow and (options.video or options.pack or options.unpack):
            raise ConfigError("--follow shows a page. Leave out --video, --pack and --unpack.")
        if options.bits is not None and options.pack is None:
            raise ConfigError("--bits is for packed weights. Add --pack FILE, or leave it out.")
        if options.follow and not (Path(options.skill) / "run.json").is_file():
            raise ConfigError(
                f"--follow takes the folder of a run, such as runs/spacetime-walk-001, and {options.skill} is none."
            )
        if options.pack is options.unpack is None:
            refuse_of_trainings(options.overrides, "what is played")
        skill = open_skill(options.skill, options.overrides)
        with others_named(skill, options.skill, "give yours, {}"):
            return self._shown(skill, options)

    def _shown(self, skill: Skill, options: argparse.Namespace) -> int:
        if options.pack is not None:
            skill = gathering(skill)
            licence = _licence(skill, options.skill)
            skill = replace(skill, card={**skill.card, "licence": licence})
            return _pack(skill, options)
        if options.unpack is not None:
            unpack(skill, options.unpack)
            print(f"run: {options.unpack}")
            return 0
        if options.video is not None:
            return _film(skill, options)
        return serve(lambda: Player(skill), options)


def _list() -> None:
    """The skills that come with plugins, a line each; one whose card is damaged is named and left out."""
    for name in names():
        try:
            card = read_card(name)
        except UnderstudyError as error:
            tell(f"understudy: {name} is left out: {error}")
            continue
        clip = clip_of(card)
        needs = f"; needs the clip {clip}" if clip else ""
        print(shown(f"{name}: {describe(card)}{needs}"))


def clip_of(card: Mapping[str, Any]) -> str | None:
    """The clip of the data folder that the skill of this `card` needs to be played; none where it is generated."""
    name = mapping(mapping(card.get("config")).get("motion")).get("name")
    known = installed().registry.names("clip")
    return name if isinstance(name, str) and name not in known else None


def add_page_arguments(parser: argparse.ArgumentParser) -> None:
    """Where the page is served, as :func:`serve` takes it."""
    parser.add_argument("--host", default="127.0.0.1", help="address to serve at (%(default)s)")
    parser.add_argument(
        "--port", type=port, default=8080, help="the first port to try (%(default)s)"
    )
    parser.add_argument("--no-browser", action="store_true", help="do not open the page")


def serve(make: Callable[[], World], options: argparse.Namespace) -> int:
    """Show the world that `make` makes in the browser until interrupted.

    Raises
    ------
    ConfigError
        if viser is missing, or as the page.
    """
    if importlib.util.find_spec("viser") is None:
        raise ConfigError(
            "Playing in the browser needs viser: pip install 'understudy[view]', or --video FILE."
        )
    from understudy_play.following import Following
    from understudy_play.page import Page
    from understudy_play.scene_page import ScenePage
    from understudy_viewer.page import free_port
    from understudy_viewer.serving import serve as serve_page

    port = free_port(options.host, options.port)
    world, following = make(), None
    if isinstance(world, Player) and (Path(world.skill.name) / "run.json").is_file():
        following = Following(world, world.skill.name, growing=options.follow)
    any_scene = isinstance(world.scene, MujocoScene) and not isinstance(world.scene, CharacterScene)
    page = (ScenePage if any_scene else Page)(world, options.host, port, following)
    serve_page(page, f"plays {world.name}", browser=not options.no_browser)
    return 0


def describe(card: Mapping[str, Any]) -> str:
    """A sentence about the skill of this `card`."""
    found = mapping(card.get("evaluation"))
    rate, judged = number(found.get("success_rate")), ""
    if rate is not None:
        judged = (
            f"; {rate:.0%} of {found.get('episodes')} held-out episodes: {found.get('success')}"
        )
    seed = mapping(card.get("config")).get("seed", 0)
    return f"{card['samples']:,} samples, seed {seed}{judged}"


def _packed_file(path: Path) -> Path:
    name = path.name.removesuffix(".json").removesuffix(".safetensors")
    if not name:
        raise ConfigError(f"--pack {path} names no file. Give one: FILE.json.")
    return path.with_name(f"{name}.json")


def _pack(skill: Skill, options: argparse.Namespace) -> int:
    """What is judged is what is written: the rounded weights."""
    file = _packed_file(options.pack)
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(
            f"--pack {options.pack} cannot be written there: {error.strerror}."
        ) from error
    rounding = _from_own_starts(skill, options)
    if rounding is None:
        rounding = enough_bits(skill, skill.experiment, options.bits, _say)
        found = rounding.evaluation
    else:  # the pack's starts may be easier: its card tells of these
        found = judged(rounded(skill, rounding.bits), skill.experiment)
    refuse_of_others(skill)
    _say_banks(skill)
    licence = _licence(skill, options.skill)  # again: now its banks are known
    card = {**skill.card, "weights": rounding.as_json(), "licence": licence}
    skill = replace(skill, card=card)
    pack(skill, file, found.as_json(skill.samples), rounding.bits)
    print(shown(f"{file}: {describe(open_skill(str(file)).card)}"))
    return 0


def _licence(skill: Skill, source: str) -> dict[str, Any]:
    """On what terms the pack may be used: what `source` was made of, and banks that overrides gave `skill`."""
    made, inputs = open_made(source), skill.experiment.inputs
    asked = inputs.given() if isinstance(inputs, PackInputs) else []
    given = {a: _files_of(a) for a in asked if a not in inputs.kept}
    return answer(made, more=given)


def _files_of(asked: str) -> list[Path]:
    """The files of a bank or a policy that an override named."""
    kind, _, path = asked.partition(" ")
    if kind == "bank":
        return bank.files(path)
    return [file] if (file := Path(path)).is_file() else [file / "run.json"]


def _from_own_starts(skill: Skill, options: argparse.Namespace) -> Rounding | None:
    """What rounding costs from the starts that were the skill's own before overrides gave it others; None where none
    did, or its own are gone, do not go with the rest, or are such that it succeeds from too few."""
    try:
        experiment = with_own_starts(skill, options.skill)
        found = experiment and enough_bits(skill, experiment, options.bits, _say)
    except UnderstudyError as error:
        tell(f"It is compared from the pack's starts, since from its own it cannot be: {error}")
        return None
    if found and found.paired and not found.paired.can_fall:
        tell("It is compared from the pack's starts, since from its own it has too little to lose.")
        return None
    return found


def _say_banks(skill: Skill) -> None:
    """Which policies and other files the pack has, and which banks, and how much of them."""
    inputs = skill.experiment.inputs
    for asked in inputs.policies if isinstance(inputs, PackInputs) else ():
        _say(
            f"The pack has the policy of {asked.partition(' ')[2]}, whose weights are as they are."
        )
    for asked, held in (inputs.banks if isinstance(inputs, PackInputs) else {}).items():
        whole = inputs.sizes.get(asked, len(held)) if isinstance(inputs, PackInputs) else 0
        drawn = f"{len(held)} of the {whole}" if whole > len(held) else f"all {len(held)}"
        evenly = ", drawn evenly, and is judged from these" if whole > len(held) else ""
        _say(f"The pack has {drawn} states of the {asked}{evenly}.")
    for asked, files in (inputs.carried() if isinstance(inputs, PackInputs) else {}).items():
        size = sum(map(len, files.values()))
        _say(f"The pack has a copy of {asked}, {size / 1000:,.0f} kB.")


def _say(line: str) -> None:
    print(shown(line))


def _film(skill: Skill, options: argparse.Namespace) -> int:
    player, seconds = Player(skill), options.seconds or _SECONDS
    try:
        tracks = record(player, seconds, options.push or 0.0)
    finally:
        player.close()
    film(player, tracks, options.video)
    print(f"{options.video}: {seconds:g} s of {skill.name}, {player.fallen}")
    return 0


def film(world: World, tracks: Mapping[str, np.ndarray], path: Path) -> None:
    """Write what was recorded of `world` (:func:`record`) as a video."""
    every = max(1, round(1.0 / (30.0 * world.dt)))
    frames = world.scene.draw({k: v[::every] for k, v in tracks.items()}, _WIDTH, _HEIGHT)
    write_video(path, frames, 1.0 / (every * world.dt))


def record(player: World, seconds: float, push: float = 0.0) -> dict[str, np.ndarray]:
    """What `player` does for `seconds`, by field (T, …), pushed by `push` N s now and then."""
    count, frames = max(2, round(seconds / player.dt)), []
    work = LongWork(f"Playing {seconds:g} s")
    for frame in _frames(player, count, push):
        frames.append(frame)
        work.done(len(frames) / count)
    return {name: np.stack([frame[name] for frame in frames]) for name in frames[0]}


def _frames(player: World, count: int, push: float) -> Iterator[dict[str, np.ndarray]]:
    given, due, side = 0, 0.5 * _EVERY, 1.0
    shown = [player.shown()]
    while True:
        for fields in shown:
            yield {name: value.numpy() for name, value in fields.items()}
            given += 1
            if given == count:
                return
        if push and given * player.dt >= due:
            player.push((0.0, side * push, 0.0))
            side, due = -side, due + _EVERY
        shown = player.step()

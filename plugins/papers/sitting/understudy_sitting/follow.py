"""``understudy sitting follow``: the figure goes where the visitor clicks, by the skills walk and turn."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from hydra.core.override_parser.types import Quote, QuotedString
from torch import Tensor

from understudy.command.command import Command
from understudy.errors import ConfigError
from understudy.setup.building import build_sections
from understudy.setup.composition import load_experiment
from understudy_motion.clip import Clip
from understudy_play.command import add_page_arguments, film, record, serve
from understudy_play.player import World
from understudy_report.video import length, video_file
from understudy_skills.skill import open_skill
from understudy_tensors import rotations

WALK, LEFT, RIGHT = 0, 1, 2
#: rad, of the target's azimuth: from the first on it turns in place, until the second is reached. The
#: walk's targets are within 60 degrees.
_BEGIN_TO_TURN, _TURNED = math.radians(75.0), math.radians(30.0)
#: m, at which a target is reached; then it turns on the spot until it is that far away again.
_REACHED, _LEFT_BEHIND = 0.4, 0.8
#: What comes with the package.
_SKILLS = ("sitting/walk", "sitting/turn_left_mirrored", "sitting/turn_right_learned")
_TAKES = "Give first what experiment=sitting/walk learned, then maybe what sitting/turn_left and sitting/turn_right did."
#: Where a sentence begins that says what to set.
_ADVICE = re.compile(r"(?<=\.) (?=(?:Set|It would|Train) )")
#: Of a video, in s.
_SECONDS = 24.0
#: m, in the world: where a video sends it, one after the other.
_ROUND = ((3.0, 0.0), (3.0, 3.0), (0.0, 3.0), (0.0, 0.0))


class Follower(World):
    """One world in which finished skills, walk and maybe turns to the left and to the right, take the
    figure to ``target``.

    No skill stands still: at its target the figure turns on the spot, or without turns walks around it.

    Raises
    ------
    ConfigError
        if there are not one or three runs or skills, or one does not fit the figure.
    RunError
        if one is neither.
    """

    def __init__(self, runs: Sequence[str], seed: int = 0) -> None:
        _count(runs)
        _check_walk(runs[0])
        _check_turns(runs[1:])
        named = ",".join(QuotedString(run, Quote.single).with_quotes() for run in runs)
        experiment = load_experiment(["task=sitting/follow", f"actuation.runs=[{named}]"])
        try:
            super().__init__(f"walking to a target, {runs[0]}", experiment, seed)
        except ConfigError as error:  # it tells what to set, and nothing can be set here
            why = _ADVICE.split(str(error))[0].rstrip(".")
            raise ConfigError(f"{why}. {_TAKES}") from error
        self._turns, self._switch, self._there = len(runs) == 3, WALK, False
        self._fell = 0
        self.target = _ROUND[0]

    @property
    def switch(self) -> int:
        """Which of the runs is at work, from 0."""
        return self._switch

    def act(self, observations: Mapping[str, Tensor]) -> Tensor:
        assert self.target is not None
        if self.falls > self._fell:  # it begins anew, walking
            self._fell, self._switch, self._there = self.falls, WALK, False
        table = self.environment.table
        away = torch.tensor(self.target) - table["torso_position"][0, :2]
        azimuth = float(torch.atan2(away[1], away[0]) - table["torso_yaw"][0])
        self._choose(math.remainder(azimuth, 2 * math.pi), float(away.norm()))
        return torch.tensor([[float(self._switch), *self.target]])

    def _choose(self, azimuth: float, distance: float) -> None:
        if not self._turns:
            return
        self._there = distance < (_LEFT_BEHIND if self._there else _REACHED)
        turning = self._switch != WALK
        if self._there:
            self._switch = self._switch if turning else LEFT
        elif abs(azimuth) < (_TURNED if turning else _BEGIN_TO_TURN):
            self._switch = WALK
        elif not turning:
            self._switch = LEFT if azimuth > 0 else RIGHT


class Follow(Command):
    """Shows the figure in the browser, where a click on the floor sends it, or films a walk around."""

    example = "understudy sitting follow sitting/walk"

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument(
            "runs", nargs="*", metavar="RUN", default=_SKILLS,
            help=f"the run folders or skills of walk, and of turn_left and turn_right (default: {' '.join(_SKILLS)})",
        )  # fmt: skip
        parser.add_argument(
            "--video",
            metavar="FILE",
            type=video_file,
            help="write a video (.mp4) of a walk along a square instead of opening a page",
        )
        parser.add_argument("--seconds", type=length, help=f"length of the video ({_SECONDS:g})")
        add_page_arguments(parser)

    def writes(self, options: argparse.Namespace) -> Iterator[Path | None]:
        yield options.video

    def run(self, options: argparse.Namespace) -> int:
        _count(options.runs)
        if options.video is None:
            if options.seconds is not None:
                raise ConfigError("--seconds is for videos. Add --video FILE, or leave it out.")
            return serve(lambda: Follower(options.runs), options)
        return self._film(options)

    def _film(self, options: argparse.Namespace) -> int:
        world, seconds = Follower(options.runs), options.seconds or _SECONDS
        try:
            parts = []
            for place in _ROUND:
                world.target = place
                parts.append(record(world, seconds / len(_ROUND)))
        finally:
            world.close()
        tracks = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        film(world, tracks, options.video)
        print(f"{options.video}: {seconds:g} s, {world.fallen}")
        return 0


def _check_walk(run: str) -> None:
    """Refuse as the walk what does not look where it is to go."""
    encoders = open_skill(run, without=("simulator",)).experiment.many("encoder")
    if not any(getattr(encoder.options, "goal", False) for encoder in encoders):
        raise ConfigError(
            f"{run} does not see where it is to go, so it cannot be the walk. {_TAKES}"
        )


def _check_turns(runs: Sequence[str]) -> None:
    """Refuse as the turn to a side one whose clip turns to the other."""
    for run, side, other, sign in zip(
        runs, ("left", "right"), ("right", "left"), (1, -1), strict=False
    ):
        experiment = open_skill(run, without=("simulator",)).experiment
        if "motion" not in experiment.sections:
            continue
        turned = sign * _turned(build_sections(experiment)["motion"].clip)
        if turned < -_BEGIN_TO_TURN:
            raise ConfigError(
                f"{run} turns to the {other}, {math.degrees(-turned):.0f}° in its clip, and it is given as the turn to the "
                f"{side}. The order is walk, turn_left, turn_right."
            )


def _turned(clip: Clip) -> float:
    """rad by which the root of `clip` turns from its beginning to its end, to the left."""
    steps = rotations.heading(clip.rotations[:, 0]).diff()
    return float(rotations.wrapped(steps).sum())


def _count(runs: Sequence[str]) -> None:
    if len(runs) not in (1, 3):
        raise ConfigError("Give the run of walk, or those of walk, turn_left and turn_right.")

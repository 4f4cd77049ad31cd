"""``understudy sitting kinematics``: Table 3's baseline without physics.

"We align the first frame of the sequence to the humanoid's initial pose by aligning the yaw of the root. Once
aligned, we simply use the following frames of the sequence as the kinematic trajectory of the trial"
(section 7).
"""

from __future__ import annotations

import argparse
import json

import torch
from torch import Tensor

from understudy.command.command import Command
from understudy.setup.building import Built, build_environment
from understudy.setup.composition import load_experiment
from understudy_characters.scene import reference_motion
from understudy_sitting.trials import check_trials
from understudy_tensors import rotations

_FRAMES = 400  #: of the clip that are looked at
_ZONE = ("experiment=sitting/whole", "initial_states=sitting/around_chair", "initial_states.zone=1")


class Kinematics(Command):
    """Prints how near the pelvis comes to the seat when the clip is simply played."""

    example = "understudy sitting kinematics --trials 1000"

    takes_overrides = True

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--trials", type=int, default=10_000, help="how many")

    def run(self, options: argparse.Namespace) -> int:
        check_trials(options.trials, 2)
        experiment = load_experiment([*_ZONE, *options.overrides])
        built = build_environment(experiment, num_worlds=options.trials, evaluating=True)
        built.environment.reset(experiment.root.seed, "trials")
        distance = minimum_distances(built)
        mean, spread = float(distance.mean()), float(distance.std())
        found = {"trials": len(distance), "distance_mean": mean, "distance_spread": spread}
        print(json.dumps(found, indent=1))
        return 0


def minimum_distances(built: Built) -> Tensor:
    """(N,) m: of the pelvis to the seat's middle, over the clip as it is played from where each world
    has its figure now."""
    reference, table = reference_motion(built.context), built.environment.table
    times = torch.linspace(0.0, reference.duration, _FRAMES, device=built.environment.device)
    played = reference.sample(times)
    path = played["reference_root_position"]
    turn = table["root_heading"] - played["reference_root_heading"][0]
    nearest = torch.full_like(turn, torch.inf)
    for place in path:  # frames, not worlds
        ahead = rotations.turned_flat((place - path[0])[:2].expand(len(turn), 2), turn)
        flat = table["root_position"][:, :2] + ahead
        pelvis = torch.cat([flat, place[2].expand(len(turn), 1)], dim=1)
        nearest = nearest.minimum((pelvis - table["seat_position"]).norm(dim=1))
    return nearest

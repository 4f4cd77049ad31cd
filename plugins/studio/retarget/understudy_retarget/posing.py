"""The character's poses that come nearest to the goals."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from scipy.ndimage import gaussian_filter1d, maximum_filter1d
from torch import Tensor

from understudy_characters.character import Character
from understudy_characters.kinematics import Kinematics
from understudy_motion.editing import smooth
from understudy_retarget import solver
from understudy_retarget.anatomy import path_up
from understudy_retarget.feet import Sole
from understudy_retarget.figure import Figure, Place
from understudy_retarget.goals import Goals
from understudy_tensors import rotations

POINT_WEIGHTS: Mapping[str, float] = {
    "pelvis": 1.0, "chest": 1.0, "head": 0.5, "knee": 0.5, "shoulder": 0.5, "elbow": 1.0, "wrist": 1.0,
}  # fmt: skip
TURN_WEIGHTS: Mapping[str, float] = {
    "pelvis": 0.2, "chest": 0.2, "head": 0.15, "foot": 0.2,
    "thigh": 0.03, "upper_arm": 0.03, "forearm": 0.03,
}  # fmt: skip
"""What a radian is worth in metres. Upper limbs are turned by where their lower ones are; their own
turn decides when the limb is straight."""
SOLE_WEIGHT = 5.0
STEADY_WEIGHT, STEADY_CUTOFF = 0.2, 8.0
"""m/rad and Hz: how firmly every joint is held to its own motion below that frequency."""

COVER_SECONDS = 0.15
"""How smoothly the body is lifted out of the floor."""


def pose(
    kinematics: Kinematics,
    target: Figure,
    goals: Goals,
    planted: Mapping[str, tuple[Tensor, Tensor]],
    soles: Mapping[str, Sole],
) -> Tensor:
    """``qpos`` (F, nq) of the character whose figure is `target`.

    `planted` are ankles (F, 3) and rotations (F, 4) of the feet by side, which come first.
    """
    character, turns = kinematics.character, dict(goals.turns)
    for side, (_, turn) in planted.items():
        if f"{side}_foot" in turns:
            turns[f"{side}_foot"] = turn
    guess = _first_guess(kinematics, target, goals.points["pelvis"], turns)

    places: list[tuple[Place, Tensor, float]] = []
    for part, goal in goals.points.items():
        weight = POINT_WEIGHTS.get(part.split("_")[-1])
        if weight is not None and part in target.points:
            places.append((target.points[part], goal, weight))
    for side, (ankle, turn) in planted.items():
        sole = soles[side]
        for point in (sole.heel, sole.toe):
            goal = ankle + rotations.rotate(turn, point)
            places.append((Place(sole.joint, (sole.ankle + point).numpy()), goal, SOLE_WEIGHT))
    points = solver.PointGoals(
        torch.tensor([place.joint for place, _, _ in places]),
        torch.stack([torch.from_numpy(place.offset) for place, _, _ in places]),
        torch.stack([goal for _, goal, _ in places], dim=1),
        torch.tensor([weight for _, _, weight in places], dtype=torch.float64),
    )
    weighted = [
        (target.segments[segment], turn, weight)
        for segment, turn in turns.items()
        if (weight := TURN_WEIGHTS.get(segment.removeprefix("left_").removeprefix("right_")))
    ]
    rotation_goals = solver.RotationGoals(
        torch.tensor([joint for joint, _, _ in weighted]),
        torch.stack([turn for _, turn, _ in weighted], dim=1),
        torch.tensor([weight for _, _, weight in weighted], dtype=torch.float64),
    )
    rough = solver.solve(kinematics, guess, points, rotation_goals)
    # Near a straight limb or a hinge's limit two poses may be as good; frames must not alternate.
    calm = character.qpos(smooth(character.clip(rough, goals.times, name="rough"), STEADY_CUTOFF))
    joints = torch.arange(len(character.joints))
    steady = solver.RotationGoals(
        torch.cat((rotation_goals.joints, joints)),
        torch.cat((rotation_goals.goals, kinematics.forward(calm).rotations), dim=1),
        torch.cat((rotation_goals.weights, torch.full(joints.shape, STEADY_WEIGHT).double())),
    )
    return solver.solve(kinematics, calm, points, steady)


def _first_guess(
    kinematics: Kinematics, target: Figure, pelvis: Tensor, turns: Mapping[str, Tensor]
) -> Tensor:
    """``qpos`` (F, nq): the segments turned, and what is between them turned by shares."""
    wanted: dict[int, Tensor] = {}
    for segment, turn in turns.items():
        for joint in target.carriers(segment):
            wanted.setdefault(joint, turn)
    for start, end in (("pelvis", "chest"), ("chest", "head")):
        if start in turns and end in turns:
            way = _way(target, target.segments[start], target.segments[end])
            for step, joint in enumerate(way[1:-1], start=1):
                share = torch.tensor(step / (len(way) - 1), dtype=torch.float64)
                wanted.setdefault(joint, rotations.slerp(turns[start], turns[end], share))
    wanted.setdefault(0, turns["pelvis"])
    guess = kinematics.aimed(torch.zeros_like(pelvis), wanted)
    poses = kinematics.forward(guess)
    there = target.points["pelvis"].track(poses.positions, poses.rotations)
    at = kinematics.character.root_address
    guess[:, at : at + 3] = pelvis - there
    return guess


def _way(figure: Figure, start: int, end: int) -> list[int]:
    """The joints from one to another through the tree."""
    up, down = list(path_up(figure.skeleton, start)), list(path_up(figure.skeleton, end))
    meeting = next(joint for joint in up if joint in down)
    return [*up[: up.index(meeting) + 1], *reversed(down[: down.index(meeting)])]


def lifted(character: Character, qpos: Tensor, times: Tensor) -> Tensor:
    """The poses, raised where something is below the floor."""
    sunk = (-character.clearance(qpos).amin(dim=1)).clamp(min=0.0)
    result = qpos.clone()
    result[:, character.root_address + 2] += _cover(sunk, times)
    return result


def _cover(values: Tensor, times: Tensor) -> Tensor:
    """(F,): a smooth curve that is nowhere below `values` (F,) and goes back to zero with them."""
    sigma = max(COVER_SECONDS * (len(times) - 1) / float(times[-1]), 0.5)
    reach = round(2.0 * sigma)
    widened = maximum_filter1d(values.numpy(), 2 * reach + 1)
    return torch.from_numpy(gaussian_filter1d(widened, sigma, radius=reach))

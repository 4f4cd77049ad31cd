"""Finding a grip: a pose at each of the tool's angles, forces that balance there, and a second of holding (thesis, section 5.5)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np
import torch

from understudy.errors import ConfigError
from understudy_gripping.balance import Balance, balance
from understudy_gripping.grip import THE_TOOL, Grip, rounded
from understudy_gripping.hold import Held, hold, nearest_fingers, placed
from understudy_gripping.pose import Candidate, Poses, PoseSolver
from understudy_gripping.styles import Style, written
from understudy_hand.scene import HandScene
from understudy_hand.table import ARM_POSE
from understudy_hand.tools import GRIPPERS, HALF_LENGTH, upper_pose
from understudy_tensors import rotations

__all__: list[str] = []

#: N, wanted of each contact, and the share of it that each bears at least; 2 N and a quarter lose the sticks of a human hand under 40 mrad
#: of noise, these do not at 60.
FORCE, LEAST_SHARE = 3.0, 1 / 3
#: m: a wider gap between what shall touch, or less clearance, is no grip.
WIDEST_GAP, LEAST_CLEARANCE = 2e-3, 0.0
#: m: how far each place may be from a first guess in a search, in a human hand.
SPREAD = 0.025
#: Candidates of a search of which all angles are solved, at most.
MOST_HELD = 4


def find_grip(
    scene: HandScene,
    style: Style,
    places: Sequence[float],
    iterations: int = 400,
    force: float = FORCE,
    finger_clearance: float | None = None,
) -> Grip:
    """A grip from the T-pose: its poses at the tool's angles, targets that hold them by some `force` N a contact, held for a second.

    In its poses links of different fingers keep `finger_clearance` m apart, if that is given.

    Raises
    ------
    ConfigError
        fingers do not reach, are in each other's way, or the tool falls; the sentence says what.
    """
    return _find(
        PoseSolver(scene, finger_clearance), Candidate(style, tuple(places)), iterations, force
    )


def search_grip(
    scene: HandScene,
    style: Style,
    places: Sequence[float],
    tries: int,
    seed: int = 0,
    iterations: int = 200,
    force: float = FORCE,
    finger_clearance: float | None = None,
) -> Grip:
    """Of `tries` places and starts, drawn about `places` and the tool's own, the grip that slips least in ten
    seconds at any of its angles.

    Where the links lie that bear the tool is drawn as well, and so is where the tool's search begins: another hand
    has them elsewhere, and the thesis gives none. Those whose fingers reach are balanced and held for two seconds at
    the last angle, where most is to be borne; of :data:`MOST_HELD` that slip least the other angles are solved.

    Raises
    ------
    ConfigError
        none holds; the sentence says how far they came.
    """
    solver, generator = PoseSolver(scene, finger_clearance), np.random.default_rng(seed)
    own, size = solver.holding, scene.measures.size
    named = [place for name, (_, place) in own.supports.items() if name in scene.links]
    candidates, nominal = [], []
    for number in range(tries):
        wide = 0.0 if number == 0 else 1.0  # the first one is what there is without a search
        drawn = wide * generator.uniform(-1.0, 1.0, (len(places) + len(named) + 6,))
        along = np.array([*places, *named]) + SPREAD * size * drawn[:-6]
        along = along.clip(-HALF_LENGTH, HALF_LENGTH).tolist()
        turn = rotations.from_exponential_map(torch.tensor(own.turned * drawn[-3:]) + 1e-12)
        turn = rotations.multiply(torch.tensor(own.turn, dtype=torch.float64), turn)
        place = size * (np.array(own.place) + own.far * drawn[-6:-3])
        nominal.append([*place, *turn.tolist()])
        supports = tuple(along[len(places) :])
        candidates.append(Candidate(style, tuple(along[: len(places)]), supports))
    first = solver.solve(
        candidates,
        iterations,
        angles=own.angles[-1:] * tries,
        nominal=torch.tensor(nominal, dtype=torch.float64),
    )
    reach = (first.gaps <= WIDEST_GAP) & (first.clearance >= LEAST_CLEARANCE)
    idle = tuple(f for f, part in zip(scene.measures.names, style, strict=True) if not part)
    slips = dict[int, float]()
    for row in reach.nonzero()[:, 0].tolist():
        data, found = _balanced(solver, style, first, row, force)
        slips[row] = _slip(hold(scene, data, found.targets, 2.0, 0.5), idle)
    best, least, said = None, math.inf, "it falls within two seconds, or other fingers hold it too"
    for row in sorted((r for r, s in slips.items() if s < math.inf), key=slips.__getitem__)[
        :MOST_HELD
    ]:
        try:
            grip = _find(solver, candidates[row], iterations, force, _rows(first, row))
        except ConfigError as error:
            said = str(error)
            continue
        slip = max(_slip(grip.held(scene, k, 10.0, 1.0), idle) for k in range(len(grip.angles)))
        if slip < least:
            best, least = grip, slip
    if best is None:
        raise ConfigError(
            f"None of {tries} places of the style {written(style)} holds; the fingers reach {len(slips)} of them. Of the "
            f"last one: {said}"
        )
    return best


def _rows(poses: Poses, *rows: int) -> Poses:
    """Those of the candidates `rows`."""
    chosen = list(rows)
    return replace(
        poses, **{n: getattr(poses, n)[chosen] for n in ("pose", "lower", "angle", "gaps", "clearance", "cost")}
    )  # fmt: skip


def _slip(held: Held, idle: tuple[str, ...]) -> float:
    """m, infinite where something fell, or a finger touches that the style has `idle`."""
    helped = any(link.partition("_")[0] in idle for link in held.links if "metacarpal" not in link)
    return float(held.drift.max()) if held.fell is None and not helped else math.inf


def _balanced(
    solver: PoseSolver, style: Style, poses: Poses, row: int, force: float
) -> tuple[mujoco.MjData, Balance]:
    """The scene in the pose number `row`, and what balances the tool there."""
    scene, lower = solver.scene, poses.lower[row : row + 1]
    upper = lower
    if (gripper := GRIPPERS.get(solver.tool)) is not None:
        angle = poses.angle[row : row + 1]
        upper = torch.cat(upper_pose(lower[:, :3], lower[:, 3:], angle, gripper), dim=1)
    pose = poses.pose[row].numpy()
    data = placed(scene, np.array(ARM_POSE), pose, upper[0].numpy(), lower[0].numpy())
    return data, balance(scene, data, style, force, LEAST_SHARE * force)


def _find(
    solver: PoseSolver,
    candidate: Candidate,
    iterations: int,
    force: float,
    base: Poses | None = None,
) -> Grip:
    """The grip of `candidate`, whose pose at one of the angles is `base`."""
    scene, style, angles = solver.scene, candidate.style, solver.holding.angles
    what = f"The style {written(style)} with places {rounded(candidate.places)}"
    if base is None:
        base = solver.solve([candidate], iterations, angles=angles[:1])
    _refuse_unreachable(what, base)
    count = len(angles)
    start = replace(_rows(base, *[0] * count), angle=torch.tensor(angles, dtype=torch.float64))
    poses = solver.solve([candidate] * count, iterations, start, angles)
    _refuse_unreachable(what, poses)
    arm, targets = len(ARM_POSE), []
    for row in range(count):
        data, found = _balanced(solver, style, poses, row, force)
        if solver.finger_clearance is not None:
            _refuse_entangled(what, *nearest_fingers(scene, data), solver.finger_clearance)
        targets.append(found.targets[arm:])
    grip = Grip(
        scene.measures, style, candidate.places, poses.hinges, poses.lower[0].numpy(),
        np.array(angles), poses.pose.numpy(), np.array(targets), solver.tool, robot=scene.robot,
    )  # fmt: skip
    for row, angle in enumerate(angles):
        if (fell := grip.held(scene, row, 1.0).fell) is not None:
            raise ConfigError(
                f"{what} does not hold {THE_TOOL[solver.tool]}: at an angle of {angle:g} rad one falls after "
                f"{fell:.2f} s. Try other places."
            )
    return grip


def _refuse_unreachable(what: str, poses: Poses) -> None:
    gap, clearance = float(poses.gaps.max()), float(poses.clearance.min())
    if not gap <= WIDEST_GAP:
        raise ConfigError(
            f"{what} has no pose: {1e3 * gap:.1f} mm are left between a stick and what shall touch it. "
            "Try other places."
        )
    if not clearance >= LEAST_CLEARANCE:
        raise ConfigError(
            f"{what} has no pose: a finger is {-1e3 * clearance:.1f} mm inside a stick. Try other places."
        )


def _refuse_entangled(what: str, distance: float, pair: tuple[str, str], clearance: float) -> None:
    if distance < clearance:
        names = " and ".join(name.replace("_", " ") for name in pair)
        far = (
            f"{1e3 * distance:.1f} mm apart"
            if distance >= 0
            else f"{-1e3 * distance:.1f} mm in each other"
        )
        raise ConfigError(
            f"{what} has no pose: {names} are {far}, and {1e3 * clearance:g} mm were asked for. Try other places, or less "
            "clearance."
        )

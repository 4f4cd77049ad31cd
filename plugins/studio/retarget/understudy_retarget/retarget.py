"""Retargeting: a clip of any skeleton becomes a clip of a character, on the floor, its feet at rest
where they touch it.

1. Parts of the body are found in both skeletons (:mod:`understudy_retarget.anatomy`).
2. *Key points* are the source's pose on the character's limbs: each bone points where the source's
   does and has the character's length; the pelvis travels at the scale of the legs. Pelvis, chest,
   head and feet turn as the source's do, from how each of the two stands in its zero pose.
   A clip's zero pose that is no stance is replaced by one that is (:mod:`understudy_retarget.stance`); a character's soles,
   knees and shoulders say how it would stand. What is smaller or larger than people is posed in their size.
3. Feet that touch the floor are planted on it (:mod:`understudy_retarget.feet`).
4. Inverse kinematics finds the poses that come nearest (:mod:`understudy_retarget.solver`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from understudy.errors import ConfigError, suggestion
from understudy_characters.character import Character
from understudy_characters.contacts import foot_points
from understudy_characters.kinematics import Kinematics
from understudy_motion.clip import Clip, Skeleton, sample, velocities
from understudy_motion.kinematics import forward_kinematics, need_skeleton
from understudy_retarget import feet
from understudy_retarget.anatomy import PARTS, SIDES, Parts, find_parts, path_up
from understudy_retarget.feet import Contacts, Sole
from understudy_retarget.figure import BONES, Figure, Place
from understudy_retarget.goals import Goals
from understudy_retarget.posing import lifted, pose
from understudy_retarget.stance import standing

__all__ = ["retarget"]

NEEDED: tuple[str, ...] = tuple(
    f"{side}_{part}"
    for part in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")
    for side in SIDES
)
"""Parts that the clip must have if the character has them."""


#: Of the length of the character's legs: a mean error beyond it is no motion of the clip's any more. On
#: humanoids and robots it is 0.002 to 0.025, on a quadruped 0.09.
POOR = 0.05
#: Of the cosines of trunk and legs with the vertical, by how much more they stand in another frame.
_BETTER = 0.3
#: m: legs of people and robots of their size; and what others are made as long as, while they are posed.
_LEAST_LEG, _LONGEST_LEG, _USUAL_LEG = 0.5, 1.3, 0.85


@dataclass(frozen=True)
class Options:
    """What to do otherwise than by default.

    Raises
    ------
    ConfigError
        the scale is not above zero.
    """

    #: By the character's joint, or a part of the body: the clip's joint.
    map: Mapping[str, str] = field(default_factory=dict)
    scale: float | None = None  #: of travel and height; None takes the ratio of the legs

    def __post_init__(self) -> None:
        if self.scale is not None and not 0.0 < self.scale < float("inf"):
            raise ConfigError(f"--scale {self.scale} is not possible: it is a number above 0.")


@dataclass(frozen=True)
class Report:
    """What was done, and how well."""

    mapping: Mapping[str, tuple[str, str]]  #: by part: the character's joint, the clip's joint
    missing: tuple[str, ...]  #: parts of the character that the clip does not have
    unused: tuple[str, ...]  #: joints of the clip that no part of the character follows
    still: tuple[str, ...]  #: joints of the character in which no part of a body is recognised
    no_stance: tuple[str, ...]  #: limbs of the clip whose zero pose is none to stand in
    scale: float
    errors: Mapping[str, tuple[float, float]]  #: m, by key point: mean and worst over the frames
    mean_error: float  #: m, over all key points and frames
    worst_error: float
    leg: float  #: m, the length of the character's legs
    upright: bool  #: whether the character's shoulders, if it has some, are above its hips
    contact_share: float  #: of the frames: how often a foot touches the floor
    skate: float  #: m/s, mean over the contacts, of the points that rest
    penetration: float  #: m, the deepest point below the floor
    source_speed: tuple[float, str]  #: rad/s, the fastest joint of the clip
    speed: tuple[float, str]  #: rad/s, the fastest joint of the result

    @property
    def fits(self) -> bool:
        """Whether the character is built so that it can make the motion."""
        return self.upright and self.mean_error <= POOR * self.leg


def retarget(clip: Clip, character: Character, options: Options = Options()) -> tuple[Clip, Report]:
    """The motion of `clip` on `character`.

    Raises
    ------
    FileError
        the clip has no skeleton.
    ConfigError
        a part that matters is not found in the clip, or could be several joints; or the
        options name joints that do not exist.
    """
    skeleton = need_skeleton(clip)
    own_parts, stood = _stance(character)
    given = _given(options.map, character, own_parts, clip)
    parts = find_parts(skeleton, given, f"Clip {clip.source}")
    target, soles = _target(character, own_parts, stood)
    size = _size(target)
    if size != 1.0:
        target, soles = _target(character, own_parts, stood, size)
    source = Figure(skeleton, parts)
    _check(source, target, clip, character)
    clip, turned = standing(clip, parts)
    source = Figure(need_skeleton(clip), parts)

    own_frames = slice(None)
    wide = clip
    if clip.loop:
        wide, own_frames = _with_neighbours(clip)
    goals = Goals(wide, source, target, options.scale and size * options.scale)
    touching = goals.stand(soles)
    planted = {
        side: feet.planted(wide.times, *goals.foot(side), sole, touching[side])
        for side, sole in soles.items()
    }
    kinematics = Kinematics(character, size)
    qpos = pose(kinematics, target, goals, planted, soles)
    root = slice(character.root_address, character.root_address + 3)
    qpos[:, root] /= size
    qpos = lifted(character, qpos, wide.times)[own_frames]
    about = {
        key: getattr(clip, key) for key in ("source", "licence", "sha256", "url", "attribution")
    }
    result = character.clip(qpos, clip.times, name=clip.name, loop=clip.loop, **about)
    if clip.loop:
        result = _closed(result)
    points = {part: track[own_frames] for part, track in goals.points.items()}
    sized = qpos.clone()
    sized[:, root] *= size
    errors = {part: e / size for part, e in _errors(kinematics, target, sized, points).items()}
    skate, share = _skate(result, soles, touching, own_frames, size)
    report = Report(
        mapping=_mapping(target, source),
        missing=tuple(p for p in own_parts if p not in source.points and p not in source.segments),
        unused=_unused(source, target),
        still=_still(target),
        scale=goals.scale / size,
        errors={part: (float(e.mean()), float(e.max())) for part, e in errors.items()},
        mean_error=float(torch.stack(list(errors.values())).mean()),
        worst_error=float(torch.stack(list(errors.values())).max()),
        leg=_leg(target) / size,
        upright=_upright(target),
        contact_share=share,
        skate=skate,
        penetration=max(0.0, -float(character.clearance(qpos).min())),
        no_stance=turned,
        source_speed=_fastest(clip),
        speed=_fastest(result),
    )
    return result, report


# ---------------------------------------------------------------------- what is what


def _given(
    names: Mapping[str, str], character: Character, own_parts: Parts, clip: Clip
) -> dict[str, int]:
    """By part: the joint of the clip that the user says it is."""
    by_joint = {
        character.joint_names[joint]: part
        for part, chain in reversed(list(own_parts.items()))
        for joint in chain
    }
    given = {}
    for ours, theirs in names.items():
        part = ours if ours in PARTS else by_joint.get(ours)
        if part is None:
            raise ConfigError(
                f"--map {ours}={theirs}: {character.name} has no part '{ours}' that follows a joint."
                f"{suggestion(ours, {*PARTS, *by_joint})}"
            )
        if theirs not in clip.joint_names:
            raise ConfigError(
                f"--map {ours}={theirs}: clip {clip.source} has no joint '{theirs}'."
                f"{suggestion(theirs, clip.joint_names)}"
            )
        given[part] = clip.joint_names.index(theirs)
    return given


def _check(source: Figure, target: Figure, clip: Clip, character: Character) -> None:
    legs = [part for part in NEEDED if part.endswith(("hip", "knee", "ankle"))]
    if unknown := [part for part in legs if part not in target.points]:
        only = "" if unknown == legs else f" (missing: {', '.join(unknown)})"
        raise ConfigError(
            f"Character {character.name}: its legs are not recognised{only}; name the bodies that their "
            "joints move left_thigh, left_shin, left_foot and so on."
        )
    missing = [
        part
        for part in NEEDED
        if part in target.points and part not in source.points and not _turn_is_known(source, part)
    ]
    if missing:
        part = missing[0]
        more = f" (and {', '.join(missing[1:])})" if missing[1:] else ""
        raise ConfigError(
            f"Clip {clip.source}: none of its joints is recognised as the {part}{more}, which "
            f"{character.name} has; say which one it is with --map {part}=JOINT."
            f"{suggestion(part, clip.joint_names)}"
        )
    for bone, (start, end) in BONES.items():
        if start in source.points and end in source.points and source.length(start, end) < 1e-6:
            raise ConfigError(
                f"Clip {clip.source}: its {bone} has no length, from {start} to {end}; say which "
                f"joints they are with --map {start}=JOINT {end}=JOINT."
            )


def _turn_is_known(source: Figure, part: str) -> bool:
    """Whether the part is a hand that the clip lacks, but how the forearm turns is known."""
    side, _, name = part.partition("_")
    elbow = f"{side}_elbow"
    return name == "wrist" and elbow in source.parts and source.ends_at(elbow)


def _stance(character: Character) -> tuple[Parts, np.ndarray]:
    """The character's parts, and (3, 3) forward, left and up of its zero pose, as columns, in the root's frame: those of
    the frame itself, or of the model's world, where its trunk and legs stand better in that."""
    at, skeleton = character.root_address, character.skeleton
    turn = Rotation.from_quat(character.model.qpos0[at + 3 : at + 7], scalar_first=True)
    found, best = None, -np.inf
    for axes in (np.eye(3), turn.inv().as_matrix()):
        tips = {name: tip @ axes for name, tip in skeleton.tips.items()}
        turned = replace(skeleton, offsets=skeleton.offsets @ axes, tips=tips)
        parts = find_parts(turned, {}, f"Character {character.name}")
        figure = Figure(turned, parts)
        pairs = [(f"{side}_ankle", f"{side}_hip") for side in SIDES] + 2 * [("pelvis", "chest")]
        spans = [
            figure.at_rest(high) - figure.at_rest(low)
            for low, high in pairs
            if low in figure.points and high in figure.points
        ]
        stands = sum(float(span[2] / max(np.linalg.norm(span), 1e-9)) for span in spans)
        if found is None or stands > best + _BETTER:
            found, best = (parts, axes), stands
    assert found is not None
    return found


def _sized(skeleton: Skeleton, size: float) -> Skeleton:
    tips = {name: size * tip for name, tip in skeleton.tips.items()}
    return (
        skeleton if size == 1.0 else replace(skeleton, offsets=size * skeleton.offsets, tips=tips)
    )


def _size(figure: Figure) -> float:
    """By what a character is made larger so that what counts in m for feet and bones of people counts for it, too: 1 for
    one with legs such as people's and full-grown robots'."""
    if not all(
        f"{side}_{part}" in figure.points for side in SIDES for part in ("hip", "knee", "ankle")
    ):
        return 1.0
    leg = _leg(figure)
    return 1.0 if _LEAST_LEG <= leg <= _LONGEST_LEG or leg <= 0.0 else _USUAL_LEG / leg


def _target(
    character: Character, parts: Parts, stood: np.ndarray, size: float = 1.0
) -> tuple[Figure, dict[str, Sole]]:
    """The character's figure, made larger by `size`, and by side the soles of its feet.

    Its toes are the front edges of the soles. A foot that is a piece of the shin has its ankle there,
    too.
    """
    figure, soles = Figure(_sized(character.skeleton, size), parts, stood), {}
    below: dict[str, set[str]] = {}  # of each foot, the joints that carry it
    for side in SIDES:
        joint = figure.segments.get(f"{side}_foot", figure.segments.get(f"{side}_shin"))
        if joint is not None:
            names = figure.skeleton.joint_names
            below[side] = {
                n for row, n in enumerate(names) if joint in path_up(figure.skeleton, row)
            }
        knee = parts.get(f"{side}_knee", (0,))[-1]
        if len(character.joints[knee].axes) == 1:
            axis = character.rest_rotations[knee].apply(character.joints[knee].axes[0])
            figure.knees[side] = axis @ figure.axes
    carried = foot_points(character, {name for names in below.values() for name in names})
    for side in below:
        foot, ankle = f"{side}_foot", f"{side}_ankle"
        joint = figure.segments.get(foot, figure.segments[f"{side}_shin"])
        points = [
            size * vertices + torch.from_numpy(figure.rest[row] - figure.rest[joint])
            for row, name in enumerate(figure.skeleton.joint_names)
            if (vertices := carried.get(name)) is not None and name in below[side]
        ]
        if not points and ankle in figure.points:  # which then is what rests on the floor
            place = torch.from_numpy(figure.at_rest(ankle) - figure.rest[joint])
            soles[side] = Sole.point(joint, place[None], figure.axes)
        if not points:
            continue
        vertices = torch.cat(points)
        if foot in figure.segments:
            place = torch.from_numpy(figure.at_rest(ankle) - figure.rest[joint])
            axes, shin = figure.axes, figure.between(ankle, f"{side}_knee")
            turn = feet.flattening((vertices - place).numpy() @ axes, shin)
            if turn is not None:
                figure.flat[side] = turn
                axes = axes @ turn.inv().as_matrix()
            sole = Sole.of(joint, place, vertices, axes)
            figure.points[f"{side}_toe"] = Place(joint, (sole.ankle + sole.toe).numpy())
        else:
            sole = Sole.point(joint, vertices, figure.axes)
            figure.points[ankle] = Place(joint, sole.ankle.numpy())
        soles[side] = sole
    return figure, soles


def _leg(figure: Figure) -> float:
    """m: the length of the longer leg."""
    return max(
        figure.length(f"{side}_hip", f"{side}_knee")
        + figure.length(f"{side}_knee", f"{side}_ankle")
        for side in SIDES
    )


def _upright(figure: Figure) -> bool:
    """Whether the chest, if there is one, is above the pelvis in the zero pose."""
    if "chest" not in figure.points or "pelvis" not in figure.points:
        return True
    trunk = figure.at_rest("chest") - figure.at_rest("pelvis")
    up = float(trunk @ figure.stood[:, 2])
    return up > 0.3 * max(float(np.linalg.norm(trunk)), 1e-6)


def _mapping(target: Figure, source: Figure) -> dict[str, tuple[str, str]]:
    def name(figure: Figure, part: str) -> str:
        if part in figure.parts:
            return figure.skeleton.joint_names[figure.parts[part][0]]
        return f"tip of {figure.skeleton.joint_names[figure.points[part].joint]}"

    return {
        part: (name(target, part), name(source, part))
        for part in PARTS
        if all(part in figure.points or part in figure.parts for figure in (target, source))
    }


def _unused(source: Figure, target: Figure) -> tuple[str, ...]:
    """Joints of the clip on no way from the pelvis to a part that the character has."""
    used: set[int] = set()
    for part, chain in source.parts.items():
        if part in target.parts or part in target.points:
            used.update(path_up(source.skeleton, chain[-1]))
    names = source.skeleton.joint_names
    return tuple(name for joint, name in enumerate(names) if joint not in used)


def _still(target: Figure) -> tuple[str, ...]:
    """Joints of the character on no way from its root to a part of the body."""
    used = {0}
    for chain in target.parts.values():
        used.update(path_up(target.skeleton, chain[-1]))
    names = target.skeleton.joint_names
    return tuple(name for joint, name in enumerate(names) if joint not in used)


# ---------------------------------------------------------------------- loops


def _with_neighbours(clip: Clip) -> tuple[Clip, slice]:
    """The clip between the cycle before and the one after, not looping, and its own frames there."""
    before, after = clip.times[:-1] - clip.duration, clip.times[1:] + clip.duration
    times = torch.cat((before, clip.times, after))
    position, rotation = sample(clip, times)
    wide = replace(
        clip, times=times - times[0], root_position=position, rotations=rotation, loop=False
    )
    return wide, slice(len(before), len(before) + clip.num_frames)


def _closed(clip: Clip) -> Clip:
    """The loop with the last pose exactly the first one's, its root's place and heading its own."""
    rotation = clip.rotations.clone()
    rotation[-1, 1:] = rotation[0, 1:]
    return replace(clip, rotations=rotation)


# ---------------------------------------------------------------------- how well


def _errors(
    kinematics: Kinematics, target: Figure, qpos: Tensor, points: Mapping[str, Tensor]
) -> dict[str, Tensor]:
    """By key point: (F,) m, how far the character is from it."""
    poses = kinematics.forward(qpos)
    return {
        part: torch.linalg.vector_norm(
            target.points[part].track(poses.positions, poses.rotations) - goal, dim=-1
        )
        for part, goal in points.items()
        if part in target.points
    }


def _skate(
    clip: Clip,
    soles: Mapping[str, Sole],
    touching: Mapping[str, Contacts],
    frames: slice,
    size: float,
) -> tuple[float, float]:
    """Mean horizontal speed, m/s, of heels and toes from frame to frame of contact, and how often
    a foot is in contact."""
    positions, world = forward_kinematics(clip)
    speeds, shares = [], []
    for side, sole in soles.items():
        for point, touches in ((sole.heel, touching[side].heel), (sole.toe, touching[side].toe)):
            place = Place(sole.joint, (sole.ankle + point).numpy() / size)
            track = place.track(positions, world)[:, :2]
            both = touches[frames][1:] & touches[frames][:-1]
            speed = torch.linalg.vector_norm(track.diff(dim=0), dim=-1) / clip.times.diff()
            speeds.append(speed[both])
        shares.append(touching[side].any[frames].double().mean())
    if not speeds or not sum(map(len, speeds)):
        return 0.0, 0.0
    return float(torch.cat(speeds).mean()), float(torch.stack(shares).mean())


def _fastest(clip: Clip) -> tuple[float, str]:
    """rad/s and name of the joint that turns fastest against its parent."""
    speed = torch.linalg.vector_norm(velocities(clip)[1][:, 1:], dim=-1).amax(dim=0)
    return float(speed.max()), clip.joint_names[1 + int(speed.argmax())]

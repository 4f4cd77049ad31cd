"""A figure at a table that holds the tool of a recorded run (section 4.4).

The particles' world is larger than a kitchen: the scraper is 1.2 m wide. A scale brings it to the
figure's size, and a placement to where the figure's hand reaches. The frames:

- the *run's*, in which tool and particles were recorded;
- the figure's, MJCF's world: z up, the figure on its floor, facing x;
- the *hand's*, that of a site (or body) of the figure;
- the tool's, as everywhere in this plugin.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from understudy.errors import ConfigError, FileError, suggestion
from understudy.options import check_range
from understudy.setup.registry import Registry
from understudy_characters import staging
from understudy_characters.character import Character, character_spec
from understudy_pbd.scene import Box, Capsule, Tool

#: Names of the bodies that are added.
TOOL, TABLE = "tool", "table"
_STEEL, _WOOD = (0.45, 0.50, 0.56, 1.0), (0.30, 0.20, 0.13, 1.0)
_MASS = 0.2  #: kg, the tool's
_TOP, _BASE = (0.60, 0.47, 0.36, 1.0), (0.86, 0.86, 0.84, 1.0)
#: m: half the table's width and depth, its thickness, and how far the figure's front is from its edge.
_HALF, _THICKNESS, _OVERHANG = (0.30, 0.5), 0.03, 0.06


def build_cook() -> mujoco.MjSpec:
    """A standing figure whose joints have people's ranges (`cook.xml`)."""
    return mujoco.MjSpec.from_string(
        (Path(__file__).parent / "cook.xml").read_text(encoding="utf-8")
    )


@dataclass(frozen=True)
class Grip:
    """How a hand holds a tool, and where the table is."""

    #: m of the figure's world, of one m of the run's
    scale: float
    #: m, the tool's frame in the hand's; then rad, roll, pitch and yaw, the yaw last
    tool: tuple[float, float, float, float, float, float]
    #: m, the middle of the table's top in front of the figure, to its left, above its floor
    table: tuple[float, float, float]
    #: rad, which way from the figure's the tool faces on average; None leaves the run as it is
    facing: float | None = 0.0
    #: m, how far a rod in the hand reaches beyond its middle, down and up
    rod: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        check_range(self, "scale", above=0)


#: By tool. The fist is upright around a rod on the scraper's blade; with the arm forward the scraper faces
#: to the left, from where it can turn either way. The pan's handle lies across the palm, half a right angle
#: from the fist's axis and from the figure's front.
GRIPS: Mapping[str, Grip] = {
    "scraper": Grip(
        scale=0.06,
        tool=(0.0, 0.0, -0.103, 0.0, 0.0, 0.0),
        table=(0.42, -0.10, 0.96),
        facing=0.8,
        rod=(0.056, 0.055),
    ),
    "pan": Grip(
        scale=0.12,
        tool=(0.1504, 0.0127, 0.1324, -0.25 * np.pi, 0.25 * np.pi, np.pi),
        table=(0.50, -0.05, 0.90),
        facing=1.25 * np.pi,
    ),
}


@dataclass(frozen=True)
class Figure:
    """A compiled model of figure, table and tool in hand, and what inverse kinematics needs of it."""

    character: Character
    start: np.ndarray  #: (nq,) the pose before the first frame
    still: tuple[int, ...]  #: degrees of freedom that do not move
    apart: tuple[tuple[tuple[int, ...], tuple[int, ...]], ...]  #: geoms that do not touch
    limbs: tuple[str, ...] = field(default=())  #: joints from the trunk to the hand

    @property
    def model(self) -> mujoco.MjModel:
        return self.character.model


def figure(
    named: str, hand: str, tool: Tool, grip: Grip, registry: Registry, *, turning: bool = False
) -> Figure:
    """The character (a registered name or an MJCF file) with `tool` in its `hand`, at a table.

    Parameters
    ----------
    hand
        a site of the character, or a body of it.
    turning
        whether the tool turns in the hand, about the hand's z axis.

    Raises
    ------
    ConfigError
        no such character or hand, a hand that no joint moves, or a tool that cannot be shown.
    FileError
        the model does not compile.
    """
    name, spec = character_spec(named, registry)
    bare = _compiled(name, spec)
    body, place, turn = _hand(bare, name, hand)
    holding = next(b for b in spec.bodies if b.id == body)
    in_hand = Rotation.from_euler("xyz", grip.tool[3:])
    held = holding.add_body(
        name=TOOL,
        pos=place + turn.apply(grip.tool[:3]),
        quat=(turn * in_hand).as_quat(scalar_first=True),
    )
    if turning:
        held.add_joint(
            name=f"{TOOL}_turn",
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=in_hand.inv().apply([0.0, 0.0, 1.0]),
            pos=-in_hand.inv().apply(grip.tool[:3]),
        )
    _add_tool(held, tool, grip, in_hand)
    _add_table(spec, grip)
    staging.stage(spec, Character(name, _compiled(name, spec)))
    spec.visual.map.shadowclip, spec.visual.quality.shadowsize = 6.0, 8192  # the table's, too
    return _figure(Character(name, _compiled(name, spec)))


def _compiled(name: str, spec: mujoco.MjSpec) -> mujoco.MjModel:
    try:
        return spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        reason = str(error).strip().splitlines()[0]
        raise FileError(f"The model of {name} with a tool does not compile: {reason}") from error


def _hand(model: mujoco.MjModel, name: str, hand: str) -> tuple[int, np.ndarray, Rotation]:
    """The body of the hand, and the hand's place and rotation in the body's frame."""
    sites = [model.site(i).name for i in range(model.nsite)]
    bodies = [model.body(i).name for i in range(1, model.nbody)]
    if hand in sites:
        site = model.site(hand)
        turn = Rotation.from_quat(site.quat, scalar_first=True)
        return int(site.bodyid[0]), np.array(site.pos), turn
    if hand in bodies:
        return model.body(hand).id, np.zeros(3), Rotation.identity()
    known = [n for n in (*sites, *bodies) if n]
    raise ConfigError(
        f"{name} has no site or body '{hand}' to hold a tool.{suggestion(hand, known)}"
    )


def _add_tool(held: mujoco.MjsBody, tool: Tool, grip: Grip, in_hand: Rotation) -> None:
    for layer, shape in enumerate(tool.shapes):
        if isinstance(shape, Box):
            size = grip.scale * np.array(shape.half_extents)
            # of boxes with a common side one is in front
            size[size.argmin()] *= 1 - 0.02 * (layer % 8)
            kind = mujoco.mjtGeom.mjGEOM_BOX
        elif isinstance(shape, Capsule):
            size = grip.scale * np.array([shape.radius, shape.half_length, 0.0])
            kind = mujoco.mjtGeom.mjGEOM_CAPSULE
        else:
            raise ConfigError("The tool is a grid of distances, which a hand cannot be shown with.")
        held.add_geom(
            type=kind,
            size=size,
            pos=grip.scale * np.array(shape.position),
            quat=shape.orientation,
            contype=0,
            conaffinity=0,
            mass=_MASS / len(tool.shapes),
            rgba=_STEEL,
        )
    if any(grip.rod):
        middle, along = -in_hand.inv().apply(grip.tool[:3]), in_hand.inv().apply([0.0, 0.0, 1.0])
        held.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            fromto=[*(middle - grip.rod[0] * along), *(middle + grip.rod[1] * along)],
            size=[0.011, 0.0, 0.0],
            contype=0,
            conaffinity=0,
            mass=0,
            rgba=_WOOD,
        )


def _add_table(spec: mujoco.MjSpec, grip: Grip) -> None:
    """A counter whose top is at the run's z = 0: a slab on a narrower base."""
    x, y, z = grip.table
    table = spec.worldbody.add_body(name=TABLE, pos=[x, y, 0.0])
    table.add_geom(
        name=TABLE,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=[0.0, 0.0, z - 0.5 * _THICKNESS],
        size=[*_HALF, 0.5 * _THICKNESS],
        rgba=_TOP,
        contype=0x7FFF,
        conaffinity=0x7FFF,
    )
    height = 0.5 * (z - _THICKNESS)
    table.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=[_OVERHANG, 0.0, height],
        size=[_HALF[0] - _OVERHANG, _HALF[1] - _OVERHANG, height],
        rgba=_BASE,
        contype=0,
        conaffinity=0,
    )


def _figure(character: Character) -> Figure:
    model = character.model
    start = model.key_qpos[0].copy() if model.nkey else model.qpos0.copy()
    chain = [model.body(TOOL).id]
    while model.body_parentid[chain[-1]] not in (0, character.root):
        chain.append(int(model.body_parentid[chain[-1]]))
    free = model.jnt_dofadr[model.body_jntadr[character.root]]
    jointed = [b for b in chain[1:] if model.body_jntnum[b]]
    if not jointed:
        raise ConfigError(
            f"{character.name} has no joint between its root and the hand; give --hand a site or body "
            "at the end of an arm."
        )
    geoms = {b: tuple(np.flatnonzero(model.geom_bodyid == b).tolist()) for b in range(model.nbody)}

    def of(bodies: Sequence[int]) -> tuple[int, ...]:
        return tuple(g for b in bodies for g in geoms[b] if model.geom_contype[g])

    # hand and forearm against what is not the upper arm; whatever moves, the other arm too, the table
    cut = chain.index(jointed[min(2, len(jointed) - 1)])
    trunk = [*chain[cut + 1 :], character.root]
    apart = [
        (of([b for b, row in character.carrier.items() if row]), (model.geom(TABLE).id,)),
        (of(chain[:cut]), of(trunk)),
    ]
    names = [
        model.joint(int(model.body_jntadr[b]) + k).name
        for b in reversed(chain)
        for k in range(int(model.body_jntnum[b]))
    ]
    return Figure(
        character,
        start,
        tuple(range(free, free + 6)),
        tuple(pair for pair in apart if pair[0] and pair[1]),
        tuple(names),
    )


@dataclass(frozen=True)
class Placement:
    """Where the run's frame is in the figure's: scaled, turned about z, moved."""

    scale: float
    turn: float  #: rad about z
    origin: np.ndarray  #: (3,) m

    def points(self, points: np.ndarray) -> np.ndarray:
        """(…, 3) m of the run, in the figure's frame."""
        turned = Rotation.from_euler("z", self.turn).as_matrix()
        return self.origin + self.scale * points @ turned.T

    def orientations(self, wxyz: np.ndarray) -> np.ndarray:
        """(T, 4) of the run, in the figure's frame."""
        turned = Rotation.from_quat(wxyz, scalar_first=True)
        return (Rotation.from_euler("z", self.turn) * turned).as_quat(scalar_first=True)


def placed(grip: Grip, orientations: np.ndarray) -> Placement:
    """The run's frame, turned so that the tool of `orientations` (T, 4) faces where `grip` says.

    The table has no front: which side of it the figure stands at is free.
    """
    turn = 0.0
    if grip.facing is not None:
        forward = Rotation.from_quat(orientations, scalar_first=True).apply([1.0, 0.0, 0.0])
        mean = forward[:, :2].mean(axis=0)
        turn = grip.facing - float(np.arctan2(mean[1], mean[0]))
    return Placement(grip.scale, turn, np.array(grip.table))

"""The humanoid: one table of bodies, and what it is in MuJoCo.

34 degrees of freedom (a free root, 8 ball joints, 4 hinges), 15 links, 45 kg (thesis, section 3.5).
Frames: z up, x forward, y left; all body frames are parallel in the zero pose, which stands with
the arms hanging. Lengths in m, masses in kg, angles in rad, torques in N m.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import mujoco

from understudy_characters.table import Joint, Link, Vector, add_joining, build_figure
from understudy_mujoco.studio import LEARNED

__all__ = ["joining"]

_KNEE = Joint("hinge", 150, 500, 50, axis=(0, 1, 0), range=(0.0, 3.0))
_ELBOW = Joint("hinge", 60, 300, 30, axis=(0, -1, 0), range=(0.0, 3.0))


def _leg(side: str, y: float) -> Iterator[Link]:
    hip, ankle = Joint("ball", 200, 500, 50), Joint("ball", 90, 400, 40)
    yield Link(
        f"{side}_hip", "root", (0, y, 0), "capsule", (0.055, 0.15), (0, 0, -0.21), 4.5, (hip,)
    )
    yield Link(
        f"{side}_knee",
        f"{side}_hip",
        (0, 0, -0.422),
        "capsule",
        (0.05, 0.155),
        (0, 0, -0.2),
        3.0,
        (_KNEE,),
    )
    yield Link(
        f"{side}_ankle",
        f"{side}_knee",
        (0, 0, -0.41),
        "box",
        (0.0885, 0.045, 0.0275),
        (0.045, 0, -0.0225),
        1.0,
        (ankle,),
    )


def _arm(side: str, y: float) -> Iterator[Link]:
    shoulder = Joint("ball", 100, 400, 40)
    yield Link(
        f"{side}_shoulder",
        "chest",
        (-0.024, y, 0.2435),
        "capsule",
        (0.045, 0.09),
        (0, 0, -0.14),
        1.5,
        (shoulder,),
    )
    yield Link(
        f"{side}_elbow",
        f"{side}_shoulder",
        (0, 0, -0.275),
        "capsule",
        (0.04, 0.0675),
        (0, 0, -0.12),
        1.0,
        (_ELBOW,),
    )
    yield Link(f"{side}_wrist", f"{side}_elbow", (0, 0, -0.259), "sphere", (0.04,), (0, 0, 0), 0.5)


#: The character, parents before children. Proportions and gains follow the humanoid that the
#: DeepMimic clips were made for, so that those clips fit without retargeting.
BODIES: tuple[Link, ...] = (
    Link("root", None, (0, 0, 0), "sphere", (0.09,), (0, 0, 0.07), 6.0),
    Link(
        "chest",
        "root",
        (0, 0, 0.236),
        "sphere",
        (0.11,),
        (0, 0, 0.12),
        14.0,
        (Joint("ball", 200, 1000, 100),),
    ),
    Link(
        "neck",
        "chest",
        (0, 0, 0.224),
        "sphere",
        (0.1025,),
        (0, 0, 0.175),
        2.0,
        (Joint("ball", 50, 100, 10),),
    ),
    *_leg("right", -0.085),
    *_arm("right", -0.183),
    *_leg("left", 0.085),
    *_arm("left", 0.183),
)

#: Height of the root above the soles in the zero pose: thigh, shin, and the foot's depth.
STANDING_HEIGHT = 0.422 + 0.41 + 0.05

COLOUR = LEARNED


def joining(**limbs: tuple[float, float]) -> tuple[tuple[str, Vector, Vector, float], ...]:
    """What joins the links of a figure with this trunk in pictures: body, a capsule's ends in its frame, and
    its radius. By name `limbs` has how far down those end that differ from the humanoid's, and their radius."""
    ends = {
        "shoulder": (-0.1, 0.047), "elbow": (-0.24, 0.036), "hip": (-0.12, 0.06), "knee": (-0.06, 0.051),
        "ankle": (-0.01, 0.04),
    }  # fmt: skip
    return (
        ("root", (0, 0, 0.08), (0, 0, 0.21), 0.078),
        ("chest", (0, 0, 0.02), (0, 0, 0.13), 0.09),
        ("chest", (-0.015, -0.125, 0.215), (-0.015, 0.125, 0.215), 0.052),
        ("neck", (0, 0, -0.02), (0, 0, 0.1), 0.045),
        *(
            (f"{side}_{name}", (0, 0, 0), (0, 0, end), radius)
            for side in ("right", "left")
            for name, (end, radius) in (ends | limbs).items()
        ),
    )


_TRUNK = (("root", (0, -0.06, 0.03), (0, 0.06, 0.03), 0.075), *joining())


def build_spec(
    *,
    timestep: float = 1 / 600,
    self_collision: bool = False,
    bodies: Sequence[Link] = BODIES,
    name: str = "humanoid",
) -> mujoco.MjSpec:
    """The humanoid on a floor, or another character of these `bodies` and standing height, as a model
    specification to be compiled or added to (:func:`understudy_characters.table.build_figure`)."""
    return build_figure(
        bodies, name=name, standing_height=STANDING_HEIGHT, timestep=timestep, colour=COLOUR,
        self_collision=self_collision,
    )  # fmt: skip


def build_humanoid() -> mujoco.MjSpec:
    """The humanoid as it is seen."""
    spec = build_spec()
    add_trunk(spec)
    return spec


def add_trunk(spec: mujoco.MjSpec) -> None:
    """Join the character's links by shapes without mass or contact, for pictures only."""
    add_joining(spec, _TRUNK, COLOUR)

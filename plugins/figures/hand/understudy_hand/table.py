"""The arm and the hand as a table: links, hinges, shapes (thesis, section 5.4.1 and figure 5.9).

In the zero pose fingers are straight along the palm's z; x points to the index finger's side, and fingers
bend about x, towards -y, where the palm's inside is. m, kg, rad. The thesis gives no measures; these are
those of the authors' public release.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from understudy.options import check_range

__all__ = ["ARM", "ARM_POSE", "FEWEST", "FINGERS", "Measures", "can_meet"]

Vector = tuple[float, float, float]
Quaternion = tuple[float, ...]

#: From the thumb on. A hand has the first N of them.
FINGERS = ("thumb", "index", "middle", "ring", "little")
FEWEST = 3
"""Fingers that two sticks need: thumb, and one more for each stick."""
#: rad: shoulder, elbow and wrist at the beginning of the standard grip.
ARM_POSE = (0.161, -0.019, 0.121, 0.426, -0.728, 0.168, -2.875)
#: kg/m³, of what has no mass of its own.
DENSITY = 1000.0


@dataclass(frozen=True)
class Hinge:
    """A hinge with a position servo."""

    name: str
    axis: Vector
    range: tuple[float, float]
    anchor: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Shape:
    """A capsule along z, a sphere (no half length), or a box of half sizes; then turned by `tilt` about y,
    or laid along y."""

    radius: float = 0.0
    half_length: float = 0.0
    centre: Vector = (0.0, 0.0, 0.0)
    tilt: float = 0.0
    box: Vector | None = None
    along_y: bool = False
    turn: Quaternion | None = None  #: in place of both


@dataclass(frozen=True)
class Link:
    name: str
    parent: str
    offset: Vector  #: in the parent's frame
    hinges: tuple[Hinge, ...] = ()
    shape: Shape | None = None
    mass: float | None = None  #: None: by density
    turn: Quaternion = (1.0, 0.0, 0.0, 0.0)  #: in the parent's frame


@dataclass(frozen=True)
class Measures:
    """What hands differ in."""

    fingers: int = 5  #: how many there are, from the thumb on: 3 to 5
    finger_length: float = 1.0  #: of all fingers' links, in those of the human hand
    size: float = 1.0  #: of the whole hand, in that of the human hand; the arm stays as it is

    def __post_init__(self) -> None:
        check_range(self, "fingers", least=FEWEST, most=len(FINGERS))
        check_range(self, "finger_length", "size", above=0, most=4)

    @property
    def names(self) -> tuple[str, ...]:
        """The fingers', from the thumb on."""
        return FINGERS[: self.fingers]


ARM = (
    Link(
        "upper_arm", "base", (0, -0.2, 0),
        (
            Hinge("shoulder_1", (1, 0, 0), (-1.57, 1.57)),
            Hinge("shoulder_2", (0, 0, 1), (-1.57, 0)),
            Hinge("shoulder_3", (0, -1, 0), (-1.57, 1.57)),
        ),
        Shape(0.04, 0.15, (0, 0.15, 0), along_y=True),
    ),
    Link(
        "forearm", "upper_arm", (0, 0.3, 0), (Hinge("elbow", (1, 0, 0), (-1.57, 1.57)),),
        Shape(0.0325, 0.12, (0, 0, 0.15)), 4.0,
    ),
    Link(
        "wrist", "forearm", (0, 0, 0.3),
        (
            Hinge("wrist_1", (1, 0, 0), (-1.0, 1.0)),
            Hinge("wrist_2", (0, 1, 0), (-1.2, 1.2)),
            Hinge("wrist_3", (0, 0, 1), (-3.14, 0)),
        ),
        Shape(0.025, 0.0, (0, 0, 0.01)), 0.365,
    ),
)  # fmt: skip
PALM = Link("palm", "wrist", (0, 0, 0.034))


@dataclass(frozen=True)
class _Finger:
    """A finger other than the thumb: a bone in the palm, and three links."""

    root: Vector
    cmc: tuple[float, float]  #: x and z of the axis across the bone; the other is along it
    wrist: float  #: x of the bone's end at the wrist, about which it turns
    across: tuple[float, float]  #: range
    along: tuple[float, float]  #: range
    bone: Shape
    bone_mass: float
    #: By link: length to the next, radius, half length and middle of the capsule, mass.
    links: tuple[tuple[float, float, float, float, float], ...]


_KNUCKLE = 0.008
_LONG = (
    (0.045, 0.010, 0.0225, 0.0225, 0.014 + _KNUCKLE),
    (0.025, 0.00805, 0.0125, 0.0125, 0.012),
    (0.0, 0.0075, 0.011, 0.012, 0.010),
)
_SHORT = (
    (0.025, 0.008, 0.015, 0.0125, 0.0082 + _KNUCKLE),
    (0.025, 0.00705, 0.0125, 0.0125, 0.0054),
    (0.0, 0.006, 0.011, 0.012, 0.0043),
)


def _bone(half_length: float, x: float, z: float, tilt: float) -> Shape:
    return Shape(box=(0.013, 0.010, half_length), centre=(x, 0, z), tilt=tilt)


_ROWS = {
    # The index finger's bone is the valley in which the lower stick lies. It hardly moves.
    "index": _Finger(
        (0.033, 0, 0.095), (0.095, -0.02), -0.02, (0, 0.001), (-0.001, 0.001),
        Shape(0.013, 0.0475, (-0.01, 0, -0.0475), 0.16), 0.0597, _LONG,
    ),
    "middle": _Finger(
        (0.011, 0, 0.099), (0.099, -0.011), -0.011, (0, 0.01), (-0.2, 0.2),
        _bone(0.052, -0.0055, -0.0495, 0.11), 0.054, _LONG,
    ),
    "ring": _Finger(
        (-0.011, 0, 0.095), (0.095, 0.011), 0.011, (0, 0.2), (0, 0.69),
        _bone(0.055, 0.0055, -0.0475, -0.11), 0.057, _LONG,
    ),
    "little": _Finger(
        (-0.030, 0, 0.095), (0.095, 0.02), 0.03, (0, 0.2), (0, 0.9),
        _bone(0.052, 0.01, -0.0475, -0.2), 0.054, _SHORT,
    ),
}  # fmt: skip
_THUMB = (
    Link(
        "thumb_proximal", "palm", (0.034, -0.009, 0.029),
        (
            Hinge("thumb_roll", (0, 0, -1), (-0.01, 0.01)),
            Hinge("thumb_spread", (0, 1, 0), (-1.0, 1.0)),
            Hinge("thumb_bend", (1, 0, 0), (0, 1.0)),
        ),
        Shape(0.013, 0.019, (0, 0, 0.019)), 0.026,
    ),
    Link(
        "thumb_middle", "thumb_proximal", (0, 0, 0.038),
        (Hinge("thumb_middle", (0, 1, 0), (-1.57, 0)),), Shape(0.011, 0.016, (0, 0, 0.016)), 0.016,
    ),
    Link(
        "thumb_distal", "thumb_middle", (0, 0, 0.032),
        (Hinge("thumb_distal", (0, 1, 0), (-1.571, -0.1)),), Shape(0.010, 0.015, (0, 0, 0.0168)), 0.016,
    ),
)  # fmt: skip


def _finger(name: str, row: _Finger) -> Iterator[Link]:
    x, z = row.cmc
    wrist: Vector = (row.wrist, 0.0, -row.root[2])
    yield Link(
        f"{name}_metacarpal", "palm", row.root,
        (
            Hinge(f"{name}_metacarpal_across", (x, 0, z), row.across, wrist),
            Hinge(f"{name}_metacarpal_along", (-z, 0, x), row.along, wrist),
        ),
        row.bone, row.bone_mass,
    )  # fmt: skip
    above, place = f"{name}_metacarpal", 0.0
    for part, (length, radius, half, middle, mass) in zip(
        ("proximal", "middle", "distal"), row.links, strict=True
    ):
        hinge = Hinge(f"{name}_{part}", (1, 0, 0), (0, 1.571))
        spread = Hinge(f"{name}_spread", (0, 1, 0), (-0.136, 0.136))
        yield Link(
            f"{name}_{part}", above, (0, 0, place), (spread, hinge) if part == "proximal" else (hinge,),
            Shape(radius, half, (0, 0, middle)), mass,
        )  # fmt: skip
        above, place = f"{name}_{part}", length


def links(measures: Measures) -> tuple[Link, ...]:
    """Arm and hand, parents before children."""
    hand = [PALM, *_THUMB]
    for name in measures.names[1:]:
        hand += _finger(name, _ROWS[name])
    return (*ARM, *(_scaled(link, measures) for link in hand))


def _scaled(link: Link, measures: Measures) -> Link:
    """`link` of a hand of other `measures`; angles stay, masses follow volumes."""
    size = measures.size
    own = size * (measures.finger_length if _of_finger(link.name) else 1.0)
    before = size * (measures.finger_length if _of_finger(link.parent) else 1.0)
    shape = link.shape
    if shape is not None:
        shape = replace(
            shape,
            radius=size * shape.radius,
            half_length=own * shape.half_length,
            centre=_times(own, shape.centre),
            box=None if shape.box is None else _times(size, shape.box),
        )
    return replace(
        link,
        offset=_times(before, link.offset),
        hinges=tuple(replace(h, anchor=_times(size, h.anchor)) for h in link.hinges),
        shape=shape,
        mass=None if link.mass is None else link.mass * size * size * own,
    )


def _of_finger(link: str) -> bool:
    return link.endswith(("_proximal", "_middle", "_distal"))


def can_meet(one: str, other: str) -> bool:
    """Whether the links of these names are of different fingers and may touch: bones of the palm lie in one another and in
    the first links of their neighbours, and do not count."""
    fingers = {name.partition("_")[0] for name in (one, other)}
    within = [name.endswith("_metacarpal") for name in (one, other)]
    rooted = [name.endswith(("_metacarpal", "_proximal")) for name in (one, other)]
    return len(fingers) == 2 and fingers <= set(FINGERS) and not (any(within) and all(rooted))


def _times(factor: float, vector: Vector) -> Vector:
    x, y, z = vector
    return (factor * x, factor * y, factor * z)

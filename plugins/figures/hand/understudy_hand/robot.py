"""A hand of somebody else's model: of an MJCF file in an installed package, whose links are named as the table's.

Nothing of the package is imported or copied; its file is read as any stranger's. The hand hangs on the table's arm, and has the table's servos: what is
taken are its links, hinges and shapes. m, kg, rad.
"""

from __future__ import annotations

import importlib.util
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import mujoco

from understudy.errors import ConfigError, suggestion
from understudy_hand.table import ARM, FINGERS, PALM, Hinge, Link, Shape
from understudy_mujoco.mjcf import read_mjcf
from understudy_mujoco.trial import spec_of, try_out

__all__ = ["Robot", "robot_links"]

_ROUND, _CAPSULE, _BOX = (
    int(getattr(mujoco.mjtGeom, f"mjGEOM_{name}")) for name in ("SPHERE", "CAPSULE", "BOX")
)


@dataclass(frozen=True)
class Robot:
    """Where the model is, and what of it is what."""

    package: str  #: that has the file: the name by which Python imports it
    file: str  #: path of the MJCF file in it
    #: the body on which the fingers hang. Fingers point along its z, its x to the index finger's side, and its inside is towards -y
    palm: str = "palm"
    #: by name of the table (``thumb_distal``): the model's body. Tips are FINGER_distal; what has no name there keeps its own
    links: Mapping[str, str] = field(default_factory=dict)
    #: by name of the table (``index_metacarpal``): a shape of the palm that tools lie on
    inner: Mapping[str, str] = field(default_factory=dict)
    #: rad, by link: hinges of the T-pose from which grips are searched, where not the table's
    rest: Mapping[str, float] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """By which grips know it."""
        return f"{self.package}/{self.file}"


def _path(robot: Robot) -> Path:
    """Of its file; the package is found and not imported."""
    try:
        found = importlib.util.find_spec(robot.package) if robot.package.isidentifier() else None
    except ValueError:  # of what is imported and has no file
        found = None
    if found is None or not found.submodule_search_locations:
        raise ConfigError(
            f"This hand is one of the package {robot.package}, which is not installed: pip install --no-deps {robot.package.replace('_', '-')}"
        )
    path = Path(found.submodule_search_locations[0]) / robot.file
    outside = Path(robot.file).is_absolute() or ".." in Path(robot.file).parts
    if outside or not path.is_file():
        raise ConfigError(
            f"The package {robot.package} has no file '{robot.file}'. Set scene.robot.file."
        )
    return path


def robot_links(robot: Robot) -> tuple[Link, ...]:
    """Arm and hand, parents before children.

    Raises
    ------
    ConfigError
        the package is missing, its model has no such body or shape, or they make no hand.
    FileError
        the file is no model.
    """
    for option, given in (("links", robot.links), ("inner", robot.inner)):
        for part, count in Counter(given.values()).items():
            if count > 1:
                raise ConfigError(f"scene.robot.{option} has two names for '{part}'. Keep one.")
    path = _path(robot)
    read = read_mjcf(path)
    try_out(path, path.parent, read)
    model = spec_of(read).compile()
    names = {model.body(body).name: body for body in range(model.nbody)}
    for name in (robot.palm, *robot.links.values()):
        if name not in names or not names[name]:
            raise ConfigError(f"{robot.file} has no body '{name}'. Change scene.robot.")
    palm = _shapes(model, names[robot.palm], "palm", robot.inner)
    for name, shape in robot.inner.items():
        if name not in {link.name for link in palm}:
            raise ConfigError(
                f"The palm of {robot.file} has no shape '{shape}' that touches anything. Change scene.robot.inner."
            )
    own = {names[body]: name for name, body in robot.links.items()} | {names[robot.palm]: "palm"}
    hand = [body for body in range(model.nbody) if _hangs(model, body, names[robot.palm])]
    _check_names(robot, [model.body(body).name for body in hand])
    found = [*ARM, PALM, *palm]
    for body in hand:
        name = own.setdefault(body, model.body(body).name)
        above = own[int(model.body_parentid[body])]
        shapes = _shapes(model, body, name, {})
        first = shapes[0].shape if shapes else None
        found.append(
            Link(
                name, above, _vector(model.body_pos[body]), tuple(_hinges(model, body, name)), first,
                float(model.body_mass[body]), tuple(model.body_quat[body].tolist()),
            )
        )  # fmt: skip
        found += shapes[1:]
    _check_links(robot, found)
    return tuple(found)


def _check_names(robot: Robot, hand: list[str]) -> None:
    """Refuse what names the bodies `hand`, which hang on the palm, in no way that makes a hand."""
    if "" in hand:
        raise ConfigError(
            f"A body on the palm '{robot.palm}' of {robot.file} has no name. Give it one."
        )
    for name, body in robot.links.items():
        if body not in hand:
            raise ConfigError(
                f"scene.robot.links.{name}: the body '{body}' of {robot.file} does not hang on the palm '{robot.palm}'."
            )


def _check_links(robot: Robot, found: Sequence[Link]) -> None:
    """Refuse links that are no hand on the arm."""
    for name, count in Counter(link.name for link in found).items():
        if count > 1:
            raise ConfigError(
                f"Two links are called '{name}' in arm and hand of {robot.file}. Give one of the hand another name in "
                "scene.robot.links or scene.robot.inner."
            )
    hand = found[len(ARM) + 1 :]
    for finger in FINGERS:
        if f"{finger}_distal" not in {link.name for link in hand}:
            raise ConfigError(
                f"{robot.file} has no body '{finger}_distal', the tip of a finger. Say which it is: "
                f"scene.robot.links.{finger}_distal=BODY."
            )
    for link in hand:
        if link.hinges and link.name.partition("_")[0] not in FINGERS:
            raise ConfigError(
                f"The body '{link.name}' of {robot.file} turns, and it is not said of which finger. Name it in "
                f"scene.robot.links, such as {FINGERS[1]}_middle."
            )
    hinges = {hinge.name: hinge.range for link in hand for hinge in link.hinges}
    for name, angle in robot.rest.items():
        if name not in hinges:
            raise ConfigError(
                f"scene.robot.rest: the hand has no hinge '{name}'.{suggestion(name, hinges)}"
            )
        low, high = hinges[name]
        if not low <= angle <= high:
            raise ConfigError(
                f"scene.robot.rest.{name}={angle:g} is beyond what this hinge of {robot.file} can do, {low:g} to {high:g} rad. "
                "Give an angle within."
            )


def _hangs(model: mujoco.MjModel, body: int, palm: int) -> bool:
    while body > palm:
        body = int(model.body_parentid[body])
        if body == palm:
            return True
    return False


def _hinges(model: mujoco.MjModel, body: int, name: str) -> Iterator[Hinge]:
    first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
    for k in range(first, first + count):
        if model.jnt_type[k] != mujoco.mjtJoint.mjJNT_HINGE:
            raise ConfigError(f"The hand's joint '{model.joint(k).name}' is no hinge.")
        if not model.jnt_limited[k]:
            raise ConfigError(
                f"The hand's hinge '{model.joint(k).name}' turns without end, and grips need a range. Give it one in the model."
            )
        low, high = model.jnt_range[k].tolist()
        title = name if k == first else f"{name}_{1 + k - first}"
        yield Hinge(title, _vector(model.jnt_axis[k]), (low, high), _vector(model.jnt_pos[k]))


def _shapes(model: mujoco.MjModel, body: int, name: str, inner: Mapping[str, str]) -> list[Link]:
    """What of the body `name` touches others, each as a link without hinges."""
    known, found = {geom: title for title, geom in inner.items()}, list[Link]()
    first, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
    for k in range(first, first + count):
        if not (model.geom_contype[k] or model.geom_conaffinity[k]):
            continue
        kind, size = int(model.geom_type[k]), model.geom_size[k].tolist()
        turn = tuple(model.geom_quat[k].tolist())
        if kind == _BOX:
            shape = Shape(centre=_vector(model.geom_pos[k]), box=_vector(size), turn=turn)
        elif kind in (_ROUND, _CAPSULE):
            half = size[1] if kind == _CAPSULE else 0.0
            shape = Shape(size[0], half, _vector(model.geom_pos[k]), turn=turn)
        else:
            raise ConfigError(
                f"The hand's shape '{model.geom(k).name}' is no sphere, capsule or box, as all that touch have to be."
            )
        title = known.get(model.geom(k).name, f"{name}_{k - first}")
        found.append(Link(title, name, (0.0, 0.0, 0.0), (), shape, 0.0))
    return found


def _vector(values: object) -> tuple[float, float, float]:
    x, y, z = map(float, values)  # type: ignore[call-overload]
    return x, y, z

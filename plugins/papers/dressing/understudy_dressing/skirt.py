"""A skirt that any character wears: cloth on a task that knows nothing of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import mujoco
import numpy as np
import torch
from torch import Tensor

from understudy.errors import ConfigError, suggestion
from understudy.options import check_range
from understudy.setup.registry import Registry
from understudy.task import Context, Simulator
from understudy_characters.character import character_spec
from understudy_cloth.scene import ClothModel, ClothScene, Fabric, Grip
from understudy_composite.couplings import Coupling, ToolsFollow
from understudy_dressing.sleeve import tube_faces
from understudy_mujoco.scene import MujocoScene
from understudy_tensors import rotations
from understudy_warp_torch.tools import Box, Capsule, Shape, Tool

#: The most vertices of a skirt: as many as a shirt has.
_MOST = 10_000
#: m: so deep in the body that holds it a skirt may begin, which then gives way.
_DEEP = 0.01


class SkirtScene(ClothScene):
    """A cone of cloth around the character's root body, open at both ends, whose waistband that body holds."""

    floor = 0.0

    @dataclass(frozen=True)
    class Options:
        #: the character, as in the scene of the one who wears the skirt
        character: str = "humanoid"
        waist: float = 0.95  #: m, perimeter of the waistband
        hem: float = 1.9  #: m, perimeter of the lower edge
        length: float = 0.42  #: m, length from waistband to hem along the cloth
        height: float = 0.06  #: m, height of the waist above the root body's frame
        edge: float = 0.04  #: m, edge of a triangle, about
        #: fabric that the skirt is made of; without bending the hinges cost nothing
        fabric: Fabric = field(default_factory=lambda: Fabric(bending=0.0))

        def __post_init__(self) -> None:
            check_range(self, "waist", "hem", "length", "edge", above=0, most=5)
            check_range(self, "height", least=-1, most=1)
            check_range(self, "edge", most=min(self.waist / 6, self.length / 4))
            if abs(self.hem - self.waist) >= 2 * np.pi * self.length:
                raise ValueError(
                    f"hem={self.hem} is not possible: a length of {self.length} m leads from a waist of "
                    f"{self.waist} m to less."
                )
            if 0.5 * (self.waist + self.hem) * self.length / self.edge**2 > _MOST:
                raise ValueError(f"edge={self.edge} gives more than {_MOST} vertices: enlarge it.")

    def __init__(self, options: Options, context: Context) -> None:
        self.options = options
        name, spec = character_spec(options.character, context.registry or Registry(), context)
        model = spec.compile()
        self.bodies, self._tools = _surfaces(model, name)
        deep = max(float(_depth(self.mesh[0], shape).max()) for shape in self._tools[0].shapes)
        if deep > _DEEP:
            raise ConfigError(
                f"The skirt would begin {100 * deep:.1f} cm inside the body '{self.bodies[0]}' that holds it: enlarge waist or hem "
                f"(waist={options.waist:g}, hem={options.hem:g}), or change height={options.height:g}."
            )

    @cached_property
    def mesh(self) -> tuple[np.ndarray, np.ndarray]:
        """Vertices (V, 3) m in the root body's frame, from the waistband down, and triangles (F, 3) facing out."""
        return cone(self.options)

    def model(self) -> ClothModel:
        points, faces = self.mesh
        waistband = Grip(0, np.arange(around(self.options)))
        return ClothModel(points, faces, self.options.fabric, tools=self._tools, grips=(waistband,))


def around(options: SkirtScene.Options) -> int:
    """Vertices of each of its rows, so of the waistband, which is the first."""
    return max(8, round(0.5 * (options.waist + options.hem) / options.edge))


def cone(options: SkirtScene.Options) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) m, rows from the waist down, and triangles (F, 3) facing out."""
    each, rows = around(options), 1 + max(4, round(options.length / options.edge))
    wide, narrow = options.hem / (2 * np.pi), options.waist / (2 * np.pi)
    drop = np.sqrt(options.length**2 - (wide - narrow) ** 2)
    share, angle = np.meshgrid(
        np.linspace(0, 1, rows), 2 * np.pi * np.arange(each) / each, indexing="ij"
    )
    radius = narrow + share * (wide - narrow)
    x, y, z = radius * np.cos(angle), radius * np.sin(angle), options.height - share * drop
    return np.stack([x, y, z], -1).reshape(-1, 3), tube_faces(rows, each)


def _surfaces(model: mujoco.MjModel, name: str) -> tuple[tuple[str, ...], tuple[Tool, ...]]:
    """The bodies of `model` that have a shape, the first of which holds the waistband, and a tool for each."""
    types = mujoco.mjtGeom
    shapes: dict[int, list[Shape]] = {}
    for geom in range(model.ngeom):
        body, kind = int(model.geom_bodyid[geom]), int(model.geom_type[geom])
        size = model.geom_size[geom]
        if body == 0:
            continue  # the floor
        at, turn = tuple(model.geom_pos[geom].tolist()), tuple(model.geom_quat[geom].tolist())
        if kind == types.mjGEOM_BOX:
            shape: Shape = Box(tuple(size.tolist()), at, turn)
        elif kind in (types.mjGEOM_CAPSULE, types.mjGEOM_SPHERE):
            shape = Capsule(float(size[0]), float(size[1]), at, turn)
        else:
            raise ConfigError(
                f"scene 'dressing/skirt' cannot dress '{name}': its body '{model.body(body).name}' has a shape "
                f"that is no box, capsule or sphere. Choose another character."
            )
        shapes.setdefault(body, []).append(shape)
    if not shapes:
        raise ConfigError(f"scene 'dressing/skirt' cannot dress '{name}': it has no shapes.")
    names = tuple(model.body(body).name for body in shapes)
    return names, tuple(Tool(tuple(them)) for them in shapes.values())


def _depth(points: np.ndarray, shape: Shape) -> np.ndarray:
    """(P,) m: how deep `points` (P, 3) m of the body's frame are in a box or capsule of it; negative outside."""
    assert isinstance(shape, (Box, Capsule))
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, np.asarray(shape.orientation, float))
    local = np.abs((points - shape.position) @ turn.reshape(3, 3))
    round_ = isinstance(shape, Capsule)
    half = np.array((0.0, 0.0, shape.half_length) if round_ else shape.half_extents)
    beyond = local - half
    outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
    return (shape.radius if round_ else 0.0) - outside - np.minimum(beyond.max(axis=1), 0.0)


class Worn(Coupling):
    """A skirt follows the character's bodies and never opens. When an episode begins, it hangs around the character's root and
    moves as fast as the root. So the wearer's task does not change."""

    reads = ("xpos", "xquat", "cvel", "subtree_com")
    sets = ("tool_position", "tool_orientation", "cloth_position", "cloth_velocity")

    @dataclass(frozen=True)
    class Options:
        source: str  #: the member with the character
        target: str  #: the member with the skirt

    def __init__(
        self, options: Options, context: Context, simulators: Mapping[str, Simulator]
    ) -> None:
        self.source, self.target = options.source, options.target
        members = context.scene.members if context.scene else {}
        scene, wearer = members.get(self.target), members.get(self.source)
        if not isinstance(scene, SkirtScene):
            skirts = [name for name, one in members.items() if isinstance(one, SkirtScene)]
            raise ConfigError(
                f"coupling 'dressing/worn': member '{self.target}' is a {type(scene).__name__} and no skirt."
                f"{suggestion(self.target, skirts)}"
            )
        follow = ToolsFollow.Options(self.source, self.target, scene.bodies)
        self._tools = ToolsFollow(follow, context, simulators)
        # the tools', and the waistband's grip
        self.columns: Sequence[int] = range(len(self._tools.columns) + 1)
        assert isinstance(wearer, MujocoScene)  # tools follow no other
        model = wearer.compiled(context)
        self._root = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, scene.bodies[0])
        self._laid_out = torch.tensor(scene.mesh[0], dtype=torch.float32, device=context.device)

    def control(self, xpos: Tensor, xquat: Tensor, cvel: Tensor, subtree_com: Tensor) -> Tensor:
        tools = self._tools.control(xpos, xquat)
        return torch.cat([tools, tools.new_ones(len(tools), 1)], dim=1)

    def state(
        self, xpos: Tensor, xquat: Tensor, cvel: Tensor, subtree_com: Tensor
    ) -> Mapping[str, Tensor]:
        place, turn = xpos[:, self._root].unsqueeze(1), xquat[:, self._root].unsqueeze(1)
        local = self._laid_out.expand(len(xpos), -1, -1)
        cloth = place + rotations.rotate(turn.expand(-1, local.shape[1], -1), local)
        # MuJoCo has a body's velocity at the centre of mass of the tree that it belongs to: turning, then moving.
        turning, moving = cvel[:, self._root].unsqueeze(1).split(3, dim=2)
        arm = cloth - subtree_com[:, self._root].unsqueeze(1)
        velocity = moving + torch.linalg.cross(turning.expand_as(arm), arm)
        return {
            **self._tools.state(xpos, xquat),
            "cloth_position": cloth,
            "cloth_velocity": velocity,
        }

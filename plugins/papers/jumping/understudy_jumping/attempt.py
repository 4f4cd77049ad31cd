"""An attempt: what happened to it so far, judged at the end of every control period.

Section 4.6.1: it succeeds when the athlete lands on the mat with all of its body at least 20 cm
behind the obstacle. It fails if any part touches the obstacle, if any but the take-off foot touches
the ground, or if it takes too long.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from understudy.errors import ConfigError, suggestion
from understudy.options import check_range
from understudy.running.soundness import rows
from understudy.task import Context, Fields, Memory, Shape
from understudy_characters.scene import CharacterScene
from understudy_jumping.arena import arena_of
from understudy_jumping.body import FEET, HEAD, TRUNK, body_of, lowest_surface
from understudy_tensors import rotations


class Attempt(Memory):
    """What happened so far.

    - ``crashed`` () 1 once it has touched what it must not
    - ``landed`` () 1 once it has landed as it should
    - ``beyond`` () 1 once all of the body was `behind` m behind the obstacle, over which it had come
    - ``head_first`` () 1 once the head has touched the mat
    - ``lowest_pass`` () m: the least height at which any part of the body passed over the obstacle, the
      height of the highest bar that the same movement had cleared; infinite before
    - ``narrowest_pass`` () m: the least x behind the obstacle's front at which any part was lower than the
      obstacle, the width of the widest box that the same movement had cleared; infinite before
    - ``cleared``, ``cleared_width`` () m: these of an attempt that has landed, else 0
    - ``body_ends`` (S, 2, 2): where the ends of the body's segments were, x and z

    With ``landing: feet`` a landing on anything else fails, but is told how near it came (section 4.6.1 has r_safety engineered for a
    landing on feet):

    - ``came_down`` () 1 once it has landed so, or lies on the mat: by its trunk, or by four links
    - ``on_feet`` () the share of the feet that touched the mat before anything else did
    - ``feet_first`` (2,) 1 of a foot that did; ``others_first`` () 1 once anything else has touched it
    """

    reads = ("geom_xpos", "geom_xmat", "obstacle_height", "obstacle_width", "mat_height")

    @dataclass(frozen=True)
    class Options:
        #: m behind the obstacle, where all of the body must be before anything touches the mat
        behind: float = 0.2
        take_off: str = "right_ankle"  #: the foot that may touch the ground
        #: ``trunk``: the trunk or four links lie on the mat; ``feet``: both feet have touched it, and
        #: nothing else before them (section 4.7.2).
        landing: Literal["trunk", "feet"] = "trunk"
        tolerance: float = 0.003  #: m above a surface, within which a point still touches it
        #: of policies in sequence: the stage, from 0, with which the attempt begins; what was before does not count
        stage: int = 0

        def __post_init__(self) -> None:
            check_range(self, "behind", "tolerance", least=0, most=1e3)
            check_range(self, "stage", least=0)

    def __init__(self, options: Options, context: Context) -> None:
        who = "memory 'jumping/attempt'"
        self._options, self._arena = options, arena_of(context, who)
        if options.stage:
            self.reads = (*self.reads, "stage")
        self._body = body = body_of(context, who)
        if options.take_off not in body.names:
            raise ConfigError(
                f"{who}: take_off={options.take_off} is no part of the athlete."
                f"{suggestion(options.take_off, body.names)}"
            )
        self._widths = body.widths
        self._low = torch.tensor([[0.0], [-torch.inf]], device=context.device)
        self._foot, self._head = body.rows(options.take_off), body.rows(HEAD)
        self._trunk = body.rows(*TRUNK)
        self._feet = torch.stack([body.rows(foot) for foot in FEET])
        segments = len(self._widths)
        self.keeps: Mapping[str, Shape] = {
            "crashed": (), "landed": (), "beyond": (), "head_first": (), "lowest_pass": (),
            "narrowest_pass": (), "cleared": (), "cleared_width": (), "body_ends": (segments, 2, 2),
        }  # fmt: skip
        if options.landing == "feet":
            others = {"came_down": (), "on_feet": (), "others_first": ()}
            self.keeps = {**self.keeps, **others, "feet_first": (len(FEET),)}

    def begin(self, geom_xpos: Tensor, geom_xmat: Tensor, **fields: Tensor) -> dict[str, Tensor]:
        nothing = torch.zeros_like(fields["mat_height"])
        ends = self._body.ends(geom_xpos, geom_xmat)[..., ::2]
        flags = dict.fromkeys(self.keeps, nothing)
        passes = dict.fromkeys(("lowest_pass", "narrowest_pass"), nothing + torch.inf)
        if self._options.landing == "feet":
            flags["feet_first"] = nothing[:, None].expand(-1, len(FEET))
        return {**flags, **passes, "body_ends": ends}

    def advance(
        self, kept: Mapping[str, Tensor], *, stage: Tensor | None = None, **fields: Tensor
    ) -> dict[str, Tensor]:
        found = self._so_far(kept, **fields)
        if stage is None:
            return found
        begun = self.begin(**fields)
        early = stage < self._options.stage
        return {
            name: torch.where(rows(early, value), begun[name], value)
            for name, value in found.items()
        }

    def _so_far(
        self,
        kept: Mapping[str, Tensor],
        geom_xpos: Tensor,
        geom_xmat: Tensor,
        obstacle_height: Tensor,
        obstacle_width: Tensor,
        mat_height: Tensor,
    ) -> dict[str, Tensor]:
        body, before = self._body, kept["body_ends"]
        ends = body.ends(geom_xpos, geom_xmat)[..., ::2]
        # the body as it is, and the ways along which its ends came here: (N, 3 S, 2), (x, z) in m
        begin = torch.cat([ends[:, :, 0], before[:, :, 0], before[:, :, 1]], dim=1)
        end = torch.cat([ends[:, :, 1], ends[:, :, 0], ends[:, :, 1]], dim=1)
        # the second time with x and z exchanged: what is before the obstacle does not count
        begin, end = (torch.stack([of, of.flip(-1)], dim=1) for of in (begin, end))
        high = torch.stack([obstacle_width, obstacle_height], dim=1).unsqueeze(2)
        found = lowest_surface(begin, end, self._widths.repeat(3), self._low, high)
        passed, under = found[:, 0].amin(dim=1), found[:, 1]
        struck = passed < obstacle_height
        under = torch.where(under > 0, under, torch.inf).amin(dim=1)

        centre = geom_xpos[:, body.geoms]
        on_mat = self._arena.on_mat(centre[..., 0], centre[..., 1], obstacle_width.unsqueeze(1))
        surface = torch.where(on_mat, mat_height.unsqueeze(1), 0.0)
        touches = body.lowest(geom_xpos, geom_xmat) <= surface + self._options.tolerance
        mat, ground = touches & on_mat, touches & ~on_mat
        was_beyond = kept["beyond"] != 0
        behind = (ends[..., 0].amin(dim=2) - self._widths).amin(dim=1)
        lowest = torch.minimum(kept["lowest_pass"], passed)
        # who was there before the attempt began has come over nothing
        over = torch.isfinite(lowest) & (behind >= obstacle_width + self._options.behind)
        beyond = was_beyond | over
        fallen = (ground & ~self._foot).any(dim=1) | (mat.any(dim=1) & ~beyond)
        crashed = (kept["crashed"] != 0) | struck | fallen
        lies = (mat & self._trunk).any(dim=1) | (mat.sum(dim=1) >= 4)
        well = beyond & ~crashed
        on_feet = self._on_feet(kept, mat, lies, well) if self._options.landing == "feet" else {}
        landed = on_feet["on_feet"] == 1.0 if on_feet else lies
        head = (kept["head_first"] != 0) | (mat & self._head).any(dim=1)
        landed = (kept["landed"] != 0) | (landed & well)
        narrowest = torch.minimum(kept["narrowest_pass"], under)
        return {
            "crashed": crashed.float(),
            "landed": landed.float(),
            "beyond": beyond.float(),
            "head_first": head.float(),
            "lowest_pass": lowest,
            "narrowest_pass": narrowest,
            "cleared": torch.where(landed, lowest, 0.0),
            "cleared_width": torch.where(landed, narrowest, 0.0),
            "body_ends": ends,
            **on_feet,
        }

    def _on_feet(
        self, kept: Mapping[str, Tensor], mat: Tensor, lies: Tensor, well: Tensor
    ) -> dict[str, Tensor]:
        """What of a landing on feet is kept. `mat` (N, G) bool: the links that touch the mat; `lies` (N,) bool: it lies there; `well`
        (N,) bool: it came over without a fault."""
        others = (kept["others_first"] != 0) | (mat & ~self._feet.any(dim=0)).any(dim=1)
        touch = (mat[:, None] & self._feet).any(dim=2)
        first = (kept["feet_first"] != 0) | (touch & ~others[:, None])
        down = (kept["came_down"] != 0) | (well & (lies | first.all(dim=1)))
        return {
            "feet_first": first.float(),
            "others_first": others.float(),
            "on_feet": first.float().mean(dim=1),
            "came_down": down.float(),
        }


class Jump(Fields):
    """How the athlete is over the obstacle, and what of its movement counts.

    - ``root_axes`` (6,): where the root's x axis points in the world, then its z axis
    - ``facing_up`` () rad, in [0, pi]: between where the root faces and up; 0 is on its back
    - ``crossing`` () 1 where the centre of mass is past the middle of the obstacle, else 0
    - ``root_spin`` () rad/s, the size of the root's angular velocity
    - ``target_offset`` () rad: sum of how far all servos' targets are from where the joints are
    - ``offset_limit`` () rad: c_offset, linear in ρ between the two of `limit`; by default 48 - 33 ρ
    """

    reads = (
        "qpos",
        "qvel",
        "subtree_com",
        "obstacle_width",
        "ctrl",
        "actuator_length",
        "difficulty",
    )
    provides: Mapping[str, Shape] = {
        "root_axes": (6,), "facing_up": (), "crossing": (), "root_spin": (),
        "target_offset": (), "offset_limit": (),
    }  # fmt: skip

    @dataclass(frozen=True)
    class Options:
        limit: tuple[float, float] = (48.0, 15.0)  #: rad, c_offset at ρ = 0 and at ρ = 1

        def __post_init__(self) -> None:
            check_range(self, "limit", least=0, most=100)

    def __init__(self, options: Options, context: Context) -> None:
        who = "fields 'jumping/jump'"
        layout = context.need_scene(CharacterScene, who).layout
        self._at, self._dof, self._root = layout.root_address, layout.root_dof, layout.root_body
        self._arena, self._limit = arena_of(context, who), options.limit

    def compute(
        self,
        qpos: Tensor,
        qvel: Tensor,
        subtree_com: Tensor,
        obstacle_width: Tensor,
        ctrl: Tensor,
        actuator_length: Tensor,
        difficulty: Tensor,
    ) -> dict[str, Tensor]:
        rotation = qpos[:, self._at + 3 : self._at + 7]
        facing = rotations.to_matrix(rotation)[:, 2, 0]
        low, high = self._limit
        return {
            "root_axes": rotations.tangent_normal(rotation),
            "facing_up": torch.acos(facing.clamp(-1.0, 1.0)),
            "crossing": (subtree_com[:, self._root, 0] >= 0.5 * obstacle_width).float(),
            "root_spin": torch.linalg.vector_norm(qvel[:, self._dof + 3 : self._dof + 6], dim=1),
            "target_offset": (ctrl - actuator_length).abs().sum(dim=1),
            "offset_limit": low + (high - low) * self._arena.rho(difficulty),
        }

"""Flipping: a pan tosses a disk so that it turns over (section 4.3). Heights are along z."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.task import Context, Fields, Memory
from understudy.task.terms import ranges
from understudy_pbd.scene import ParticleScene
from understudy_tensors.limits import limits


def angular_velocity(position: Tensor, velocity: Tensor) -> Tensor:
    """ω = 1/n Σ (x_i − x̄) × v_i / ‖x_i − x̄‖² (section 4.3), rad/s. (N, P, 3) each -> (N, 3)

    A particle within a millimetre of the centre of mass counts as still: its direction says nothing.
    """
    arm = position - position.mean(dim=1, keepdim=True)
    square = arm.square().sum(dim=2, keepdim=True)
    turning = torch.linalg.cross(arm, velocity) / square.clamp(min=1e-6)
    return torch.where(square > 1e-6, turning, 0.0).mean(dim=1)


class Toss(Fields):
    """``clearance`` () m, d_ymin: how high the lowest particle is above the pan, negative where one is
    below it; ``material_angular_velocity`` (3,) rad/s."""

    reads = ("particle_position", "particle_velocity", "tool_position")
    provides = {"clearance": (), "material_angular_velocity": (3,)}

    def __init__(self, options: None, context: Context) -> None:
        pass

    def compute(
        self, particle_position: Tensor, particle_velocity: Tensor, tool_position: Tensor
    ) -> dict[str, Tensor]:
        above = particle_position[..., 2] - tool_position[:, None, 2]
        return {
            "clearance": above.amin(dim=1),
            "material_angular_velocity": angular_velocity(particle_position, particle_velocity),
        }


@limits(c_1=(-1e6, 1e6), w_1=(-1e6, 1e6), w_2=(-1e6, 1e6))
@ranges(-math.inf, math.inf)
def height(
    clearance: Tensor,
    *,
    #: the reward while the material is just above the pan (Table 2)
    c_1: float = 0.1,
    w_1: float = 10.0,  #: 1/m, factor of the height above the pan (Table 2)
    w_2: float = 0.1,  #: 1/m, factor of the height below the pan's, which is negative (Table 2)
) -> Tensor:
    """r_h (eq. 11) of d_ymin (m)."""
    return torch.where(clearance > 0, c_1 + w_1 * clearance, w_2 * clearance)


@limits(axis=(-1, 1), w_3=(-1e6, 1e6), c_2=(-1e3, 1e3), least=(-1e3, 1e3), most=(-1e3, 1e3))
@ranges(-math.inf, math.inf)
def spin(
    clearance: Tensor,
    material_angular_velocity: Tensor,
    *,
    #: unit vector in the world: the axis about which turning counts
    axis: tuple[float, float, float] = (0.0, 1.0, 0.0),
    w_3: float = 4.0,  #: s/rad, factor of the angular velocity (Table 2)
    c_2: float = 0.5,  #: m above the pan: height from which on turning counts (Table 2)
    least: float = -1.0,  #: rad/s, least angular velocity that counts (eq. 12)
    most: float = 1.0,  #: rad/s, greatest angular velocity that counts (eq. 12)
) -> Tensor:
    """r_av (eq. 12): the angular velocity about `axis` (rad/s), between `least` and `most`, while all
    of the material is more than `c_2` (m) above the pan.

    The pan tilts about its y axis; ``axis: [0, -1, 0]`` asks for flips in the other direction.
    """
    about = sum(w * a for w, a in zip(material_angular_velocity.unbind(1), axis, strict=True))
    assert isinstance(about, Tensor)
    return torch.where(clearance > c_2, w_3 * about.clamp(least, most), 0.0)


class Turned(Memory):
    """How far the material has turned about the pan's y axis since the episode began.

    ``turned`` () rad, counted over whole turns; ``angle`` () rad, the same within (−π, π]; ``toss_height``
    () m, the greatest clearance so far; ``caught_turn`` () rad, what ``turned`` was when the material last
    lay in the pan: over it, low, and moving with it. The angle is that of the disk's axis in the x-z
    plane, so turning about this axis does not count as a flip.
    """

    reads = (
        "particle_position",
        "particle_velocity",
        "tool_position",
        "tool_velocity",
        "clearance",
    )
    keeps: Mapping[str, tuple[int, ...]] = {
        "turned": (), "angle": (), "toss_height": (), "caught_turn": ()
    }  # fmt: skip

    @dataclass(frozen=True)
    class Options:
        low: float = 0.3  #: m, the greatest clearance of material that lies in the pan
        slow: float = 2.5  #: m/s, the greatest speed of its centre of mass relative to the pan
        near: float = 0.9  #: m, the greatest distance of its centre of mass from the pan's middle

        def __post_init__(self) -> None:
            check_range(self, "low", "slow", "near", above=0, most=1e3)

    def __init__(self, options: Options, context: Context) -> None:
        self.options = options
        scene = context.need_scene(ParticleScene, "memory 'amorphous/turned'")
        rest = np.asarray(scene.model().positions, np.float32)
        along = rest[:, 2] - rest[:, 2].mean()  # the disk's axis
        if np.ptp(along) < 1e-4 * np.ptp(rest[:, 0]):
            raise ConfigError(
                "memory 'amorphous/turned' cannot tell the two sides of a flat piece of one layer. Give "
                "scene.block two layers or more, such as [5,5,2]."
            )
        self._along = torch.from_numpy(along).to(context.device)

    def _angle(self, position: Tensor) -> Tensor:
        """(N,) rad: about y, positive from z to x."""
        arm = position - position.mean(dim=1, keepdim=True)
        axis = (self._along.unsqueeze(1) * arm).sum(dim=1)  # (N, 3)
        return torch.atan2(axis[:, 0], axis[:, 2])

    def begin(
        self, particle_position: Tensor, clearance: Tensor, **fields: Tensor
    ) -> dict[str, Tensor]:
        nothing = torch.zeros_like(clearance)
        angle = self._angle(particle_position)
        return {"turned": nothing, "angle": angle, "toss_height": nothing, "caught_turn": nothing}

    def advance(
        self,
        kept: Mapping[str, Tensor],
        particle_position: Tensor,
        particle_velocity: Tensor,
        tool_position: Tensor,
        tool_velocity: Tensor,
        clearance: Tensor,
    ) -> dict[str, Tensor]:
        options = self.options
        angle = self._angle(particle_position)
        step = angle - kept["angle"]
        turned = kept["turned"] + torch.atan2(step.sin(), step.cos())
        apart = (particle_position.mean(dim=1) - tool_position)[:, :2].norm(dim=1)
        speed = (particle_velocity.mean(dim=1) - tool_velocity).norm(dim=1)
        low = (clearance > 0) & (clearance < options.low)
        caught = low & (apart < options.near) & (speed < options.slow)
        return {
            "turned": turned,
            "angle": angle,
            "toss_height": torch.maximum(kept["toss_height"], clearance),
            "caught_turn": torch.where(caught, turned, kept["caught_turn"]),
        }


@limits(direction=(-1, 1), least=(0, 100))
def flipped(
    caught_turn: Tensor,
    *,
    direction: float = 1.0,  #: 1 or −1: the direction of the turn
    least: float = 2.4,  #: rad, above 0: least turn that counts; somewhat less than half a turn
) -> Tensor:
    """Whether the material came back into the pan turned over at least once: by `least` rad or more, a
    little less than half a turn, in `direction` (1 or −1)."""
    return (direction * caught_turn >= least).float()

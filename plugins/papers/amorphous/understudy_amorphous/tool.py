"""The tool: driven by accelerations towards a target that the action gives in the tool's own frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.task import Actuation, Context, Encoder, Shape, box
from understudy_tensors import rotations
from understudy_tensors.limits import check_angle

#: q = [x, y, z, φ, ψ, θ] (section 3.5): position in m, then turns about the tool's x, y and z axes.
AXES = ("x", "y", "z", "roll", "pitch", "yaw")
#: What the actuation shares with where episodes begin: by axis, from where to where the tool may go.
LIMITS = "amorphous/limits"


def orientation(angles: Tensor) -> Tensor:
    """Unit quaternions of Euler angles [roll, pitch, yaw] (…, 3): the turn about z after that about y
    after that about x. (…, 4)"""
    cosine, sine = (0.5 * angles).cos().unbind(-1), (0.5 * angles).sin().unbind(-1)
    (cr, cp, cy), (sr, sp, sy) = cosine, sine
    return torch.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ],
        dim=-1,
    )


def euler_angles(q: Tensor) -> Tensor:
    """The inverse of :func:`orientation`, (…, 4) to (…, 3); pitch within a quarter turn."""
    w, x, y, z = q.unbind(-1)
    roll = torch.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = torch.asin((2 * (w * y - z * x)).clamp(-1, 1))
    yaw = torch.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return torch.stack([roll, pitch, yaw], dim=-1)


def integrate(
    pose: Tensor, rate: Tensor, away: Tensor, *, k_p: float, k_d: float, dt: float
) -> tuple[Tensor, Tensor]:
    """Eq. 5, explicit: pose and rate (…, 6) after `dt` s, for targets that are `away` (…, 6)."""
    acceleration = k_p * away - k_d * rate
    return pose + dt * rate, rate + dt * acceleration


def _check_axes(option: str, names: tuple[str, ...]) -> None:
    for name in names:
        if name not in AXES:
            raise ValueError(
                f"{option}: there is no '{name}'; a tool moves along {', '.join(AXES)}."
            )


class ToolTarget(Actuation):
    """Actions are targets for the tool, in its own frame (section 3.3.2); eq. 5 takes it there.

    An action's number, squashed by tanh, is the share of its ``reach`` that the target is away along
    one axis. The frame is the tool's up to its tilt: z is up, x is where it faces. In every control
    period, eq. 5's Δt, the target is as far away again: it moves with the tool for as long as the
    decision lasts. What the tool may not leave stops it. The control is its pose at the end of the
    control period: position and rotation vector.
    """

    reads = ("tool_position", "tool_orientation", "tool_pose", "tool_rate")
    every = "period"
    keeps: Mapping[str, Shape] = {"tool_pose": (6,), "tool_rate": (6,)}

    @dataclass(frozen=True)
    class Options:
        #: By axis of the action: how far away a target may be, m or rad.
        reach: Mapping[str, float] = field(default_factory=lambda: {"x": 0.5, "y": 0.5, "yaw": 0.6})
        #: By axis: the least and the greatest value, m or rad.
        limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)
        frame: Literal["tool", "world"] = "tool"  #: of the action's x and y
        k_p: float = 40.0  #: k_p of eq. 5, 1/s², above 0: how stiffly the target is followed
        k_d: float = 10.0  #: k_d of eq. 5, 1/s, from 0: how much that is damped
        tilt: float = 0.0  #: rad, how far it leans in the direction of its motion (section 4.2)
        tilt_speed: float = 0.5  #: m/s, at which it leans by three quarters of that

        def __post_init__(self) -> None:
            check_range(self, "k_d", most=1e4)
            check_angle(self, "tilt", least=0)
            check_range(self, "tilt_speed", most=1e3)
            check_range(self, "k_p", "tilt_speed", above=0)
            check_range(self, "k_d", least=0)
            _check_axes("reach", tuple(self.reach))
            _check_axes("limits", tuple(self.limits))
            for name, (low, high) in self.limits.items():
                if not low <= high:
                    raise ValueError(
                        f"limits.{name}=[{low}, {high}] is not possible: give least first."
                    )
            if self.tilt and "pitch" in self.reach:
                raise ValueError(
                    "tilt is not possible beside reach.pitch: one of them turns the tool."
                )
            if not self.reach or any(reach <= 0 for reach in self.reach.values()):
                raise ValueError(
                    f"reach={dict(self.reach)} is not possible: give an axis, above 0."
                )

    def __init__(self, options: Options, context: Context) -> None:
        self.options, self._dt = options, context.control_dt
        if options.k_d * self._dt >= 2:
            raise ConfigError(
                f"actuation.k_d={options.k_d:g} is unstable in eq. 5 at control.frequency="
                f"{1 / self._dt:g}. Raise the frequency above {options.k_d / 2:g} Hz, or lower k_d."
            )
        context.once(LIMITS, lambda: dict(options.limits))
        self.action_space = box(len(options.reach))
        place = torch.zeros(len(options.reach), 6)
        for row, (name, reach) in enumerate(options.reach.items()):
            place[row, AXES.index(name)] = reach
        low, high = torch.full((6,), -torch.inf), torch.full((6,), torch.inf)
        for name, (least, most) in options.limits.items():
            low[AXES.index(name)], high[AXES.index(name)] = least, most
        self._place, self._low, self._high = (t.to(context.device) for t in (place, low, high))

    def begin(
        self, tool_position: Tensor, tool_orientation: Tensor, **fields: Tensor
    ) -> dict[str, Tensor]:
        pose = torch.cat([tool_position, euler_angles(tool_orientation)], dim=1)
        return {"tool_pose": pose, "tool_rate": torch.zeros_like(pose)}

    def advance(
        self, action: Tensor, tool_pose: Tensor, tool_rate: Tensor, **fields: Tensor
    ) -> dict[str, Tensor]:
        options = self.options
        away = torch.tanh(action) @ self._place
        cosine, sine = tool_pose[:, 5].cos(), tool_pose[:, 5].sin()
        if options.frame == "tool":
            x, y = cosine * away[:, 0] - sine * away[:, 1], sine * away[:, 0] + cosine * away[:, 1]
            away = torch.cat([x.unsqueeze(1), y.unsqueeze(1), away[:, 2:]], dim=1)
        if options.tilt:
            forward = cosine * tool_rate[:, 0] + sine * tool_rate[:, 1]
            lean = options.tilt * torch.tanh(forward / options.tilt_speed) - tool_pose[:, 4]
            away = torch.cat([away[:, :4], lean.unsqueeze(1), away[:, 5:]], dim=1)
        pose, rate = integrate(
            tool_pose, tool_rate, away, k_p=options.k_p, k_d=options.k_d, dt=self._dt
        )
        inside = pose.clamp(self._low, self._high)
        return {"tool_pose": inside, "tool_rate": torch.where(inside == pose, rate, 0.0)}

    def control(self, action: Tensor, tool_pose: Tensor, **fields: Tensor) -> Tensor:
        turn = rotations.to_exponential_map(orientation(tool_pose[:, 3:]))
        return torch.cat([tool_pose[:, :3], turn], dim=1)


class ToolState(Encoder):
    """O_tool = [x, cos r, sin r, ẋ, cos ṙ, sin ṙ] (section 3.3.1), of the axes that the task uses.

    Rates ṙ (rad/s) beyond ±π look like others within.
    """

    @dataclass(frozen=True)
    class Options:
        axes: tuple[str, ...] = ("x", "y", "yaw")  #: those that the tool moves along or turns about
        #: Also the material's angular velocity, as for flipping (section 4.3).
        material_spin: bool = False

        def __post_init__(self) -> None:
            _check_axes("axes", self.axes)

    def __init__(self, options: Options, context: Context) -> None:
        place = [AXES.index(name) for name in options.axes]
        self._along = torch.tensor([i for i in place if i < 3], device=context.device)
        self._about = torch.tensor([i for i in place if i >= 3], device=context.device)
        self.reads = ("tool_pose", "tool_rate")
        size = 2 * len(self._along) + 4 * len(self._about)
        if options.material_spin:
            self.reads, size = (*self.reads, "material_angular_velocity"), size + 3
        self.shape: Shape = (size,)

    def encode(
        self, tool_pose: Tensor, tool_rate: Tensor, material_angular_velocity: Tensor | None = None
    ) -> Tensor:
        parts: list[Tensor] = []
        for values in (tool_pose, tool_rate):
            turns = values.index_select(1, self._about)
            parts += [values.index_select(1, self._along), turns.cos(), turns.sin()]
        if material_angular_velocity is not None:
            parts.append(material_angular_velocity)
        return torch.cat(parts, dim=1)

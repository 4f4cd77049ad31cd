"""A toy jump over a bar, in the plane, in which strategies are how the body is turned above the bar.

A body flies from its take-off over a bar, tucks and stretches, and turns the faster the more it is tucked.
Where the take-off's spin takes it decides whether it passes the bar upright, as a dive, on its back, or
after a somersault. SI units; x is towards the bar at 0, z up; pitch is 0 upright, positive head first.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from understudy.options import check_range
from understudy.random import WorldStreams
from understudy.task import Actuation, Context, Encoder, Fields, InitialStates, Scene, box
from understudy_tensors.limits import check_angle, limits
from understudy_tensors.simulator import TensorSimulator

START, RUN_UP = -1.05, 3.0  #: m, where take-offs are; m/s, how fast all are along x
GRAVITY, HEIGHT = 9.81, 1.0  #: m/s²; m, of the centre of mass at take-off
PUSHING = -0.75  #: m, up to where the foot is on the floor and gives spin
HALF, THICK = 0.85, 0.12  #: m, of the stretched body
SHORTER, TURNS = 0.45, 0.6  #: by which share being tucked makes it shorter, and its inertia smaller
MAT = 0.45  #: m, how high the mat behind the bar is


class VaultScene(Scene):
    """A jumper and a bar."""

    recorded = ("position", "pitch", "tuck", "bar_height")

    @dataclass(frozen=True)
    class Options:
        bar: float = 1.25  #: m, above 0, the bar's height

        def __post_init__(self) -> None:
            check_range(self, "bar", above=0, most=1e3)

    def __init__(self, options: Options, context: Context) -> None:
        self.options = options

    def describe(self) -> dict[str, Any]:
        return {"bar_m": self.options.bar, "length_m": 2 * HALF}

    def draw(
        self, tracks: Mapping[str, np.ndarray], width: int = 640, height: int = 360
    ) -> Iterator[np.ndarray]:
        limbs = _limbs(tracks)
        for frame, bar in zip(limbs, tracks["bar_height"], strict=True):
            yield _picture(frame, float(bar), width, height)

    def outlines(
        self, tracks: Mapping[str, np.ndarray]
    ) -> tuple[np.ndarray | None, np.ndarray | None]:
        limbs = _limbs(tracks)
        return np.stack([limbs[..., 0], np.zeros_like(limbs[..., 0]), limbs[..., 1]], axis=-1), None


class Vault(TensorSimulator):
    """A body in flight, semi-implicit Euler; a control is (N, 2): how tucked to be, in [0, 1], and the
    angular acceleration in rad/s² while the foot is on the floor.

    *Limits:* two dimensions; nothing stops it but the floor, which its middle does not
    pass.
    """

    state_fields = ("position", "velocity", "pitch", "spin", "tuck")
    control_size = 2
    fields = {"position": (2,), "velocity": (2,), "pitch": (), "spin": (), "tuck": ()}

    def __init__(self, options: None, context: Context) -> None:
        context.need_scene(VaultScene, "simulator 'diversity/vault'")
        self._dt, self._substeps = context.control_dt / context.substeps, context.substeps
        n, device = context.num_worlds, context.device
        self._state = {
            name: torch.zeros(n, *shape, device=device) for name, shape in self.fields.items()
        }

    def step(self, control: Tensor, substeps: int | None = None) -> None:
        position, velocity, pitch, spin, tuck = self._state.values()
        dt = self._dt
        for _ in range(substeps or self._substeps):
            spin += dt * torch.where(position[:, 0] < PUSHING, control[:, 1], 0.0)
            tuck += (control[:, 0] - tuck).clamp(-6.0 * dt, 6.0 * dt)
            velocity[:, 1] -= dt * GRAVITY
            position += dt * velocity
            position[:, 1].clamp_(min=0.0)
            pitch += dt * spin / (1 - TURNS * tuck)

    def failed(self) -> Tensor:
        return ~(self._state["position"].abs() < 1e6).all(dim=1)


class TakeOff(InitialStates):
    """The take-off state: what a search varies, and a little noise."""

    @dataclass(frozen=True)
    class Options:
        spin: float = 0.0  #: rad/s, angular velocity of the body at take-off
        climb: float = 4.0  #: m/s, from 0: velocity upwards at take-off
        lean: float = 0.0  #: rad, the body's pitch at take-off
        noise: float = 0.05  #: largest deviation of each of these, in its unit

        def __post_init__(self) -> None:
            check_range(self, "climb", most=1e3)
            check_range(self, "climb", "noise", least=0)
            check_range(self, "spin", least=-1e3, most=1e3)
            check_angle(self, "lean")

    def __init__(self, options: Options, context: Context) -> None:
        context.need_scene(VaultScene, "initial_states 'diversity/take_off'")
        self._options = options
        self._begin = torch.tensor([START, HEIGHT], device=context.device)

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        options = self._options
        noise = options.noise * (2 * streams.uniform(3) - 1)
        climb = (options.climb + noise[:, 0]).clamp(min=0)
        return {
            "position": self._begin.expand(len(noise), 2),
            "velocity": torch.stack([torch.full_like(climb, RUN_UP), climb], dim=1),
            "pitch": options.lean + noise[:, 1],
            "spin": options.spin + noise[:, 2],
            "tuck": torch.zeros_like(climb),
        }


class Bar(Fields):
    """``cleared`` is how high a bar the body would just pass where it is, m; ``crossing`` is 1 at the
    control period in which its centre passes the bar; ``landed`` 1 on the mat."""

    reads = ("position", "previous_position", "pitch", "tuck")
    provides = {"bar_height": (), "cleared": (), "crossing": (), "clearance": (), "landed": ()}

    def __init__(self, options: None, context: Context) -> None:
        scene = context.need_scene(VaultScene, "fields 'diversity/bar'")
        self._bar = scene.options.bar

    def compute(
        self, position: Tensor, previous_position: Tensor, pitch: Tensor, tuck: Tensor
    ) -> dict[str, Tensor]:
        reach = THICK + HALF * (1 - SHORTER * tuck) * pitch.cos().abs()
        cleared = position[:, 1] - reach
        crossing = (previous_position[:, 0] < 0) & (position[:, 0] >= 0)
        landed = (position[:, 0] > 0) & (position[:, 1] <= MAT + THICK)
        return {
            "bar_height": torch.full_like(cleared, self._bar),
            "cleared": cleared,
            "crossing": crossing.float(),
            "clearance": cleared - self._bar,
            "landed": landed.float(),
        }


class BodyState(Encoder):
    """Where the body is, how it moves and turns, (N, 8)."""

    reads = ("position", "velocity", "pitch", "spin", "tuck")
    shape = (8,)

    def __init__(self, options: None, context: Context) -> None:
        pass

    def encode(
        self, position: Tensor, velocity: Tensor, pitch: Tensor, spin: Tensor, tuck: Tensor
    ) -> Tensor:
        angles = torch.stack([pitch.sin(), pitch.cos(), 0.2 * spin, tuck], dim=1)
        return torch.cat([position, velocity, angles], dim=1)


class Limbs(Actuation):
    """The action (N, 2), squashed: how tucked to be, and how hard the take-off foot turns the body."""

    @dataclass(frozen=True)
    class Options:
        #: rad/s², largest angular acceleration that the take-off foot gives the body
        push: float = 12.0

        def __post_init__(self) -> None:
            check_range(self, "push", least=0, most=1e5)

    def __init__(self, options: Options, context: Context) -> None:
        context.need_scene(VaultScene, "actuation 'diversity/limbs'")
        self._push, self.action_space = options.push, box(2)

    def control(self, action: Tensor) -> Tensor:
        tuck = torch.sigmoid(2 * action[:, :1])
        return torch.cat([tuck, self._push * torch.tanh(action[:, 1:])], dim=1)


@limits(scale=(1e-9, 1e3))
def passing(
    crossing: Tensor,
    cleared: Tensor,
    *,
    scale: float = 1.0,  #: m, above 0: passing higher by so much is worth a factor e
) -> Tensor:
    """When the bar is passed, e^{(cleared - 1 m) / scale}: sparse, and more for passing higher."""
    return crossing * ((cleared - 1.0) / scale).exp()


def knocked(crossing: Tensor, clearance: Tensor) -> Tensor:
    """The bar is passed too low."""
    return (crossing > 0) & (clearance < 0)


def landed(landed: Tensor) -> Tensor:
    """On the mat behind the bar; to be used with ``outcome: success``."""
    return landed > 0


# -------------------------------------------------------------------------- pictures


def _limbs(tracks: Mapping[str, np.ndarray]) -> np.ndarray:
    """(T, 6, 2, 2) m: spine, neck to head, thigh, shin, upper arm, forearm in the plane."""
    pitch, tuck, centre = tracks["pitch"], tracks["tuck"], tracks["position"]

    def along(angle: np.ndarray, length: float) -> np.ndarray:
        return length * np.stack([np.sin(pitch + angle), np.cos(pitch + angle)], axis=-1)

    hip, neck = centre - along(0 * tuck, 0.12), centre + along(0 * tuck, 0.42)
    head = neck + along(0.15 * tuck, 0.24)
    knee = hip + along(np.pi - 0.15 - 1.9 * tuck, 0.42)
    foot = knee + along(np.pi + 0.05 + 0.4 * tuck, 0.42)
    elbow = neck + along(np.pi - 0.5 - 0.5 * tuck, 0.3)
    hand = elbow + along(np.pi - 0.9 - 1.1 * tuck, 0.27)
    pairs = [(hip, neck), (neck, head), (hip, knee), (knee, foot), (neck, elbow), (elbow, hand)]
    return np.stack([np.stack(pair, axis=1) for pair in pairs], axis=1)


_PAPER, _FLOOR, _BAR, _CUSHION = (246, 247, 249), (150, 158, 170), (213, 94, 0), (196, 215, 232)
_BODY, _SKIN, _ARM = (0, 114, 178), (222, 165, 120), (86, 180, 233)
_LOOKS = ((_BODY, 0.1), (_SKIN, 0.11), ((40, 60, 90), 0.085), ((40, 60, 90), 0.07),
          (_ARM, 0.055), (_SKIN, 0.045))  # fmt: skip

#: m: left, right, low and high.
_Within = tuple[float, float, float, float]
_Inside = Callable[[np.ndarray, np.ndarray], np.ndarray]


def _picture(limbs: np.ndarray, bar: float, width: int, height: int) -> np.ndarray:
    """(height, width, 3) uint8: the limbs (6, 2, 2) from the side, the bar and the mat."""
    metre = min(width / 3.9, height / 2.75)  # in pixels
    x = (np.arange(width) - 0.42 * width) / metre
    z = (0.94 * height - np.arange(height)[:, None]) / metre
    frame = np.empty((height, width, 3), np.float32)
    frame[:] = _PAPER

    def paint(within: _Within, inside: _Inside, colour: Sequence[int]) -> None:
        """`inside` (h, w) m, what is negative outside, at pixels x (w,) and z (h, 1); beyond `within` nothing is covered."""
        left, right, low, high = within
        columns = slice(*np.searchsorted(x, (left - 1 / metre, right + 1 / metre)))
        rows = slice(*np.searchsorted(-z[:, 0], (-high - 1 / metre, -low + 1 / metre)))
        here = frame[rows, columns]
        cover = np.clip(inside(x[columns], z[rows]) * metre + 0.5, 0.0, 1.0)[..., None]
        here += cover * (np.array(colour, np.float32) - here)

    def mat(x: np.ndarray, z: np.ndarray) -> np.ndarray:
        return np.minimum(np.minimum(x - 0.12, 2.2 - x), np.minimum(z, MAT - z))

    def post(x: np.ndarray, z: np.ndarray) -> np.ndarray:
        return np.minimum(0.012 - np.abs(x), np.minimum(z, bar - z))

    paint((0.12, 2.2, 0.0, MAT), mat, _CUSHION)
    paint((-np.inf, np.inf, -0.012, 0.012), lambda x, z: 0.012 - np.abs(z) + 0 * x, _FLOOR)
    paint((-0.012, 0.012, 0.0, bar), post, _FLOOR)
    round_it = (-0.028, 0.028, bar - 0.028, bar + 0.028)
    paint(round_it, lambda x, z: 0.028 - np.hypot(x, z - bar), _BAR)
    for row in (2, 3, 0, 1, 4, 5):
        colour, radius = _LOOKS[row]
        # the head is a ball at its end
        begin, end = limbs[row, [1, 1]] if row == 1 else limbs[row]
        (left, low), (right, high) = (
            np.minimum(begin, end) - radius,
            np.maximum(begin, end) + radius,
        )
        paint((left, right, low, high), partial(_limb, begin, end, radius), colour)
    return frame.round().astype(np.uint8)


def _limb(
    begin: np.ndarray, end: np.ndarray, radius: float, x: np.ndarray, z: np.ndarray
) -> np.ndarray:
    """(h, w) m, how deep in a limb between those points (2,) the pixels x (w,) and z (h, 1) are."""
    (ax, az), (bx, bz) = begin, end
    length = max((bx - ax) ** 2 + (bz - az) ** 2, 1e-9)
    t = np.clip(((x - ax) * (bx - ax) + (z - az) * (bz - az)) / length, 0, 1)
    return radius - np.hypot(x - ax - t * (bx - ax), z - az - t * (bz - az))

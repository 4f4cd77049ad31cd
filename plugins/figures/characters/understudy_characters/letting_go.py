"""What happens to a body that is let go in a clip's own state: whether its flights are physically possible.

In flight only gravity acts: a body that begins there flies along a parabola and keeps its angular momentum,
whatever its muscles do. If that ends farther from the clip than a learner's bounds allow, most episodes that begin
there fail.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import mujoco
import numpy as np
import torch

from understudy_characters.character import Character
from understudy_characters.layout import Layout, layout_of
from understudy_characters.reference import ReferenceMotion
from understudy_characters.shapes import surface_points
from understudy_motion.clip import Clip
from understudy_motion.section import Floor
from understudy_tensors import rotations

__all__ = ["ASTRAY", "LOW", "TURNED", "Bodies", "LettingGo", "bodies_of", "landed", "let_go"]

ASTRAY, TURNED = 0.2, 0.7
"""m along an axis, rad: the bounds on centre of mass and root orientation of Ma et al. 2021."""
STARTS = 60.0
"""Hz: how many starts a second are let go, and in what steps they fall."""
LOW = 0.05
"""m: who is no higher is down within 0.1 s, and gets nowhere."""
CONTROL = 1.0 / 30.0
"""s: the control period of training, from which the reference has its height and its velocities."""
FALL = 1.5
"""s: nobody is longer in the air."""


@dataclass(frozen=True)
class LettingGo:
    """N starts, evenly spread over a clip, each let go in the clip's state."""

    times: np.ndarray  #: (N,) s
    falls: np.ndarray  #: (N,) s until the lowest point is down; 0 of starts on the floor
    away: np.ndarray  #: (N,) m along an axis: the centre of mass is so far from the clip's then
    turned: np.ndarray  #: (N,) rad: the root is so far from the clip's then

    @property
    def bad(self) -> np.ndarray:
        """(N,) bool: those that land outside of the bounds."""
        return (self.away > ASTRAY) | (self.turned > TURNED)

    @property
    def share(self) -> float:
        """The share of bad starts."""
        return float(self.bad.mean())

    def by_phase(self, bins: int) -> np.ndarray:
        """(bins,) the share of bad starts in each part of the clip."""
        return np.array(
            [part.mean() if len(part) else 0.0 for part in np.array_split(self.bad, bins)]
        )


def landed(clip: Clip) -> LettingGo:
    """For a clip in which the figure never gets higher than :data:`LOW`."""
    count = max(2, round(clip.duration * STARTS))
    nothing = np.zeros(count)
    return LettingGo(clip.duration / count * np.arange(count), nothing, nothing, nothing)


@dataclass(frozen=True)
class Bodies:
    """A figure at F times as one body: its place, its rotation and its inertia."""

    centres: np.ndarray  #: (F, 3) m, the centre of mass
    speeds: np.ndarray  #: (F, 3) m/s
    spins: np.ndarray  #: (F, 3) kg m²/s, angular momentum about the centre of mass
    inverses: np.ndarray  #: (F, 3, 3) 1/(kg m²), of the inertia, along world axes


def bodies_of(character: Character, qpos: np.ndarray, qvel: np.ndarray) -> Bodies:
    """The figure as one body in the states `qpos` (F, nq), `qvel` (F, nv)."""
    return _bodies_and_frames(character, qpos, qvel)[0]


def _bodies_and_frames(
    character: Character, qpos: np.ndarray, qvel: np.ndarray
) -> tuple[Bodies, np.ndarray, np.ndarray]:
    """:func:`bodies_of`, and where all the model's bodies are (F, B, 3) m, and their axes (F, B, 3, 3)."""
    model, data = character.model, mujoco.MjData(character.model)
    parts, root = sorted(character.carrier), character.root
    centres, speeds, spins = np.zeros((3, len(qpos), 3))
    places, middles = np.zeros((2, len(qpos), model.nbody, 3))
    axes, principal = np.zeros((2, len(qpos), model.nbody, 9))
    state, found = (data.qpos, data.qvel), (
        (centres, data.subtree_com[root]), (speeds, data.subtree_linvel[root]),
        (spins, data.subtree_angmom[root]), (places, data.xpos), (middles, data.xipos),
        (axes, data.xmat), (principal, data.ximat),
    )  # fmt: skip
    for frame in range(len(qpos)):
        state[0][:], state[1][:] = qpos[frame], qvel[frame]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        mujoco.mj_subtreeVel(model, data)
        for rows, now in found:
            rows[frame] = now
    axes, principal = (a.reshape(*places.shape, 3) for a in (axes, principal))
    inertia = _inertia(model, parts, middles[:, parts] - centres[:, None], principal[:, parts])
    whole = Bodies(centres, speeds, spins, np.linalg.inv(inertia))
    return whole, places, axes


def let_go(clip: Clip, character: Character, floor: Floor = "lowest") -> LettingGo:
    """Let the character go in the state of `clip` at each of :data:`STARTS` a second.

    Parameters
    ----------
    clip
        has the character's joints.
    character
        moves as the clip says.
    floor
        which height of the motion training puts on the floor (``motion.floor``).
    """
    layout = _layout_of(character)
    reference = ReferenceMotion(clip, character, layout, control_dt=CONTROL, floor=floor)
    count = max(2, round(clip.duration * STARTS))
    dt = clip.duration / count
    ahead = math.ceil(FALL / dt)
    rows = count + ahead if clip.loop else count
    state = reference.sample(torch.arange(rows, dtype=torch.float64).float() * dt)
    qpos, qvel = (state[f"reference_{n}"].double() for n in ("qpos", "qvel"))
    whole, places, axes = _bodies_and_frames(character, qpos.numpy(), qvel.numpy())
    lowest = state["reference_link_clearances"].amin(1).double().numpy()
    arms = _surface(character, places - whole.centres[:, None], axes)
    deepest = arms[..., 2].min(1)
    gravity = np.asarray(character.model.opt.gravity)

    falls, away, turned = np.zeros((3, count))
    aloft = np.flatnonzero(lowest[:count] > 0.0)
    turns = np.repeat(np.array([[1.0, 0.0, 0.0, 0.0]]), len(aloft), axis=0)
    for step in range(1, ahead + 1):
        now = aloft + step
        inside = now < rows
        aloft, turns, now = aloft[inside], turns[inside], now[inside]
        if len(aloft) == 0:
            break
        turns = _turned(turns, whole, aloft, now, dt)
        clock = step * dt
        centres = whole.centres[aloft] + whole.speeds[aloft] * clock + 0.5 * gravity * clock**2
        beside = centres - whole.centres[now]
        falls[aloft] = clock
        away[aloft] = np.abs(beside).max(1)
        turned[aloft] = 2.0 * np.arccos(np.clip(np.abs(turns[:, 0]), 0.0, 1.0))
        # As low as in the clip, but for where the body is instead and how it is turned.
        up = _upward(turns)
        low = (arms[now] @ up[..., None])[..., 0].min(1) - deepest[now]
        still = lowest[now] + beside[:, 2] + low > 0.0
        aloft, turns = aloft[still], turns[still]
    return LettingGo(dt * np.arange(count), falls, away, turned)


@lru_cache(maxsize=8)  # each clip of a character asks for it anew
def _layout_of(character: Character) -> Layout:
    return layout_of(character)


def _turned(
    turns: np.ndarray, whole: Bodies, began: np.ndarray, now: np.ndarray, dt: float
) -> np.ndarray:
    """(N, 4) the turns by which bodies that keep their angular momentum differ from the clip's, a step on.

    A body turned by D moves as the clip's, joint by joint, and turns at δ besides, both in its own
    frame: its angular momentum is D (L + I δ), so that δ = I⁻¹ (Dᵀ L₀ - L).
    """
    turn = torch.from_numpy(turns)
    kept = torch.from_numpy(whole.spins[began])
    own = rotations.rotate(rotations.conjugate(turn), kept).numpy()
    rates = np.einsum("nij,nj->ni", whole.inverses[now], own - whole.spins[now])
    step = rotations.from_exponential_map(torch.from_numpy(rates * dt))
    return rotations.normalize(rotations.multiply(turn, step)).numpy()


def _upward(turns: np.ndarray) -> np.ndarray:
    """(N, 3): the world's z in the frames turned by `turns` (N, 4)."""
    up = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).expand(len(turns), 3)
    return rotations.rotate(rotations.conjugate(torch.from_numpy(turns)), up).numpy()


def _surface(character: Character, places: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """(F, P, 3) m: points of the figure's surface, of bodies at `places` (F, B, 3) with `axes` (F, B, 3, 3)."""
    owners, points = surface_points(character)
    found = np.zeros((len(places), len(points), 3))
    edges = np.searchsorted(owners, np.arange(len(character.joints) + 1))
    for joint, first, last in zip(character.joints, edges, edges[1:], strict=False):
        turned = points[first:last].numpy() @ axes[:, joint.body].swapaxes(1, 2)
        np.add(places[:, joint.body, None], turned, out=found[:, first:last])
    return found


def _inertia(
    model: mujoco.MjModel, parts: list[int], arms: np.ndarray, axes: np.ndarray
) -> np.ndarray:
    """(F, 3, 3) kg m² of the bodies `parts`, P of them, as one, along world axes: `arms` (F, P, 3) m from
    the point about which it is, with the principal `axes` (F, P, 3, 3)."""
    own = (axes * model.body_inertia[parts][:, None] @ axes.swapaxes(2, 3)).sum(1)
    mass = model.body_mass[parts]
    across = np.einsum("p,fpi,fpj->fij", mass, arms, arms)
    return own + np.trace(across, axis1=1, axis2=2)[:, None, None] * np.eye(3) - across

"""A network that predicts what a decision does to positions and velocities."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from understudy_imagination.rigid import Posed, Rigid
from understudy_networks import averages
from understudy_networks.nn import mlp

#: m: by how much a point's distance from the floor changes whether it touches, and where it half does.
_SOFT, _HALF = 0.01, 0.005
#: Least deviations by which inputs and outputs are divided, in their units.
_LEAST_IN, _LEAST_OUT = 0.05, 0.01
_CLIP = 8.0


class Scaling(nn.Module):
    """Mean and deviation of D numbers."""

    mean: Tensor
    deviation: Tensor

    def __init__(self, size: int, least: float) -> None:
        super().__init__()
        self._least = least
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("deviation", torch.ones(size))

    @torch.no_grad()
    def fit(self, rows: Tensor) -> None:
        _, mean, variance = averages.moments(rows)
        self.mean.copy_(mean)
        self.deviation.copy_(variance.sqrt().clamp(min=self._least))

    def forward(self, rows: Tensor) -> Tensor:
        return (rows - self.mean) / self.deviation

    def back(self, rows: Tensor) -> Tensor:
        return rows * self.deviation + self.mean


class WorldModel(nn.Module):
    """The change of velocity in a decision, and by how much the mean velocity on the way deviates from
    the mean of the velocities at both ends; linear velocities of free joints as the root sees them.

    Its inputs do not change when the whole figure stands elsewhere or faces another way: the joints' angles and
    displacements, height and the direction up, velocities, how far each servo is from its target, and, of the points
    that touch the floor most, their heights, velocities, and whether they touch.
    """

    #: (K,) the points that count as near the floor.
    near: Tensor

    def __init__(self, rigid: Rigid, *, hidden: tuple[int, ...], points: int, dt: float) -> None:
        super().__init__()
        self._rigid, self._dt = rigid, dt
        self.register_buffer("near", torch.arange(min(points, rigid.touching)))
        size = rigid.lengths_size + rigid.shape_size + rigid.nv + rigid.nu + 8 * len(self.near)
        self.size = size  #: D, of the inputs
        self.into, self.out = Scaling(size, _LEAST_IN), Scaling(2 * rigid.nv, _LEAST_OUT)
        self.network = mlp([size, *hidden, 2 * rigid.nv], activation=nn.ELU, final_scale=0.1)

    @torch.no_grad()
    def look(self, posed: Posed) -> None:
        """Choose the points that touch the floor most in these states."""
        rigid = self._rigid
        if rigid.touching:
            every = torch.arange(rigid.touching, device=self.near.device)
            height, _ = rigid.touch(posed.bodies, every)
            touches = averages.mean(_touching(height).nan_to_num().mean(0))
            self.near.copy_(touches.argsort(descending=True, stable=True)[: len(self.near)])

    def inputs(self, posed: Posed, control: Tensor) -> Tensor:
        """(B, D), of states and controls (B, U)."""
        rigid, qpos = self._rigid, posed.qpos
        lengths = rigid.lengths(qpos)
        found = [
            lengths,
            rigid.shape(qpos),
            rigid.in_root(qpos, posed.qvel),
            rigid.deflection(control, lengths),
        ]
        if len(self.near):
            height, speed = rigid.touch(posed.bodies, self.near)
            touches = _touching(height)
            speed = (speed @ posed.turn).flatten(1)
            found += [height, touches, speed, speed * touches.repeat_interleave(3, dim=1)]
        return torch.cat(found, dim=1)

    def targets(self, qpos: Tensor, qvel: Tensor, qpos_after: Tensor, qvel_after: Tensor) -> Tensor:
        """(B, 2 nv): what :meth:`advance` has to be given to go from one to the other."""
        rigid = self._rigid
        change = rigid.in_root(qpos, qvel_after - qvel)
        rate = rigid.difference(qpos, qpos_after) / self._dt - 0.5 * (qvel + qvel_after)
        return torch.cat([change, rigid.in_root(qpos, rate)], dim=1)

    def advance(self, qpos: Tensor, qvel: Tensor, outputs: Tensor) -> tuple[Tensor, Tensor]:
        """``qpos`` and ``qvel`` one decision later, by `outputs` (B, 2 nv)."""
        rigid = self._rigid
        change, rate = (rigid.in_root(qpos, x, back=True) for x in outputs.chunk(2, dim=1))
        after = qvel + change
        step = self._dt * (0.5 * (qvel + after) + rate)
        return rigid.moved(qpos, step), after

    def raw(self, inputs: Tensor) -> Tensor:
        """(B, 2 nv) in units of the targets' deviations."""
        return self.network(self.into(inputs).clamp(-_CLIP, _CLIP))

    def forward(self, posed: Posed, control: Tensor) -> tuple[Tensor, Tensor]:
        outputs = self.out.back(self.raw(self.inputs(posed, control)))
        return self.advance(posed.qpos, posed.qvel, outputs)

    def loss(self, inputs: Tensor, targets: Tensor) -> Tensor:
        """(B,)"""
        errors = nn.functional.smooth_l1_loss(self.raw(inputs), self.out(targets), reduction="none")
        return errors.mean(1)


def _touching(height: Tensor) -> Tensor:
    return torch.sigmoid((_HALF - height) / _SOFT)

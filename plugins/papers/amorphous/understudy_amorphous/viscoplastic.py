"""Visco-plastic material: springs between particles that are made, changed and removed as the
simulation runs (Zhang et al. 2020, section 3.5.1, algorithms 1 and 2)."""

# ruff: noqa: UP018, RUF046 - Warp changes only those local numbers that were made by int(…)
# pyright: reportInvalidTypeForm=false

from __future__ import annotations

from dataclasses import dataclass

import warp as wp

from understudy.options import check_range
from understudy_pbd.rules import Particles, Rule
from understudy_warp_torch.shapes import Tools, tool_between


@dataclass(frozen=True)
class Plasticity:
    """The four thresholds of section 3.5.1, of which the paper gives no values."""

    merge: float = 1.5  #: d_m, of the particles' distance at rest: nearer ones become tied
    split: float = 2.2  #: d_b, of the particles' distance at rest: farther ones come apart
    compress: float = 0.8  #: r_c: a spring that is shorter than this share takes its new length
    stretch: float = 1.15  #: r_s: one that is longer than this share does, too
    stiffness: float = 0.9  #: share of an error that a sub-step corrects

    def __post_init__(self) -> None:
        check_range(self, "merge", "compress", above=0)
        check_range(self, "split", above=self.merge)
        check_range(self, "compress", most=1)
        check_range(self, "stretch", least=1)
        check_range(self, "stiffness", above=0, most=1)


@wp.func
def rest_length(d: float, length: float, r_c: float, r_s: float) -> float:
    """Algorithm 2: the length of a spring that is `d` long now."""
    ratio = d / length
    if ratio <= r_c or ratio >= r_s:
        return d
    return length


@wp.kernel
def update_springs(
    position: wp.array2d(dtype=wp.vec3),
    tools: Tools,
    partner: wp.array3d(dtype=int),
    length: wp.array3d(dtype=float),
    d_b: float,
    r_c: float,
    r_s: float,
):
    """Algorithm 1, lines 1 to 8. Both ends of a spring come to the same result, each in its own slot.

    A spring that is in no slot of its partner, which had none left, is removed too.
    """
    world, i = wp.tid()
    slots = partner.shape[2]
    for k in range(slots):
        j = partner[world, i, k]
        if j >= 0:
            d = wp.length(position[world, i] - position[world, j])
            keep = d < d_b and not tool_between(
                tools, world, position[world, i], position[world, j]
            )
            mutual = int(0)
            for other in range(slots):
                if partner[world, j, other] == i:
                    mutual = 1
                    break
            if keep and mutual == 1:
                length[world, i, k] = rest_length(d, length[world, i, k], r_c, r_s)
            else:
                partner[world, i, k] = -1


@wp.kernel
def create_springs(
    position: wp.array2d(dtype=wp.vec3),
    tools: Tools,
    neighbour: wp.array3d(dtype=int),
    neighbour_count: wp.array2d(dtype=int),
    partner: wp.array3d(dtype=int),
    length: wp.array3d(dtype=float),
    d_m: float,
):
    """Algorithm 1, lines 9 to 16."""
    world, i = wp.tid()
    slots = partner.shape[2]
    for n in range(neighbour_count[world, i]):
        j = neighbour[world, i, n]
        d = wp.length(position[world, i] - position[world, j])
        if d < d_m:
            free = int(-1)
            exists = int(0)
            for k in range(slots):
                if partner[world, i, k] == j:
                    exists = 1
                    break
                if partner[world, i, k] < 0 and free < 0:
                    free = k
            if (
                exists == 0
                and free >= 0
                and not tool_between(tools, world, position[world, i], position[world, j])
            ):
                partner[world, i, free] = j
                length[world, i, free] = d


class ViscoPlastic(Rule):
    """Algorithms 1 and 2 after every sub-step, for particles that are `distance` (m) apart at rest.

    Springs are made before they are looked through, so that one for which only one particle had a slot
    left is gone again before anything is solved with it.
    """

    def __init__(self, plasticity: Plasticity, distance: float) -> None:
        self.plasticity, self._distance = plasticity, distance
        self.reach = plasticity.merge * distance

    def after(self, particles: Particles) -> None:
        p, size = self.plasticity, (particles.worlds, particles.count)
        springs = [particles.spring_partner, particles.spring_length]
        near = [particles.neighbour, particles.neighbour_count]
        wp.launch(
            create_springs,
            dim=size,
            inputs=[particles.position, particles.tools, *near, *springs, p.merge * self._distance],
            device=particles.device,
        )
        wp.launch(
            update_springs,
            dim=size,
            inputs=[
                particles.position,
                particles.tools,
                *springs,
                p.split * self._distance,
                p.compress,
                p.stretch,
            ],
            device=particles.device,
        )

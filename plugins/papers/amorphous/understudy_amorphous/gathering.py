"""Gathering: the scraper pushes all material to a goal on the table (section 4.1)."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from understudy.task import Context, Fields
from understudy.task.terms import ranges
from understudy_tensors.limits import limits


def distance_to(goal: Tensor, particle_position: Tensor) -> Tensor:
    """How far particles (N, P, 3) are from the goal (N, 2), seen from above: (N, P) m."""
    return (particle_position[..., :2] - goal.unsqueeze(1)).norm(dim=2)


class Farthest(Fields):
    """The particle that is farthest from the goal, seen from above.

    ``farthest_distance`` () m from the goal, ``farthest_position`` (2,) m, x_far, and
    ``tool_distance`` () m, d_tool, from it to the tool.
    """

    reads = ("particle_position", "active_particles", "tool_position", "goal")
    provides = {"farthest_distance": (), "farthest_position": (2,), "tool_distance": ()}

    def __init__(self, options: None, context: Context) -> None:
        pass

    def compute(
        self,
        particle_position: Tensor,
        active_particles: Tensor,
        tool_position: Tensor,
        goal: Tensor,
    ) -> dict[str, Tensor]:
        flat = particle_position[..., :2]
        distance = distance_to(goal, particle_position)
        far, which = torch.where(active_particles > 0, distance, -1.0).max(dim=1)
        position = flat.gather(1, which.view(-1, 1, 1).expand(-1, 1, 2)).squeeze(1)
        return {
            "farthest_distance": far.clamp(min=0.0),
            "farthest_position": position,
            "tool_distance": (position - tool_position[:, :2]).norm(dim=1),
        }


@limits(within=(0, 1e3))
def gathered_share(
    particle_position: Tensor,
    active_particles: Tensor,
    goal: Tensor,
    *,
    #: m, above 0: greatest distance from the goal that counts; Table 3 reports 1.06 m on average
    within: float = 1.5,
) -> Tensor:
    """The share (N,) of the material that is at most `within` (m) from the goal."""
    near = (distance_to(goal, particle_position) <= within).float() * active_particles
    return near.sum(dim=1) / active_particles.sum(dim=1).clamp(min=1.0)


@limits(share=(1e-9, 1))
def share_distance(
    particle_position: Tensor,
    active_particles: Tensor,
    goal: Tensor,
    *,
    share: float = 0.95,  #: share of all particles, above 0, at most 1
) -> Tensor:
    """How far from the goal `share` of the material reaches, (N,) m: the distance of the particle than
    which that share of all particles is no farther. One that was left behind does not count."""
    distance = distance_to(goal, particle_position)
    ordered = torch.where(active_particles > 0, distance, torch.inf).sort(dim=1).values
    count = active_particles.sum(dim=1)
    last = ((share * count - 1e-3).ceil() - 1).long()  # 0.95 · 200 are 190, not 191
    last = last.clamp(0, ordered.shape[1] - 1)
    found = ordered.gather(1, last.unsqueeze(1)).squeeze(1)
    return torch.where(count > 0, found, 0.0)


def path_length(
    particle_position: Tensor,
    previous_particle_position: Tensor,
    active_particles: Tensor,
    *,
    mean: bool,
) -> Tensor:
    """How far particles moved in this decision, (N,) m: their sum ``Σ‖Δx‖`` or their mean."""
    moved = (particle_position - previous_particle_position).norm(dim=2) * active_particles
    total = moved.sum(dim=1)
    return total / active_particles.sum(dim=1).clamp(min=1.0) if mean else total


@limits(
    c_1=(0, 1e3),
    c_2=(-1e6, 1e6),
    c_3=(0, 1e3),
    c_4=(0, 1e6),
    c_5=(0, 1e3),
    w_1=(-1e6, 1e6),
    w_2=(-1e6, 1e6),
    w_3=(-1e6, 1e6),
    w_4=(-1e6, 1e6),
)
@ranges(-math.inf, math.inf)
def gathering(
    farthest_distance: Tensor,
    previous_farthest_distance: Tensor,
    tool_distance: Tensor,
    particle_position: Tensor,
    previous_particle_position: Tensor,
    active_particles: Tensor,
    *,
    c_1: float = 10.0,  #: m, which is added to the distance before it is squared (Table 2)
    c_2: float = 0.03,  #: number that is added to r_p at every decision (Table 2)
    c_3: float = 1.0,  #: m from the goal within which the farthest particle is home (Table 2)
    #: m², which divided by the farthest particle's distance is d_thr, how near the tool must be
    #: (Table 2)
    c_4: float = 4.0,
    #: m, the least d_thr (Table 2)
    c_5: float = 1.0,
    w_1: float = 1.0,  #: 1/m², factor of the decrease of d_part (Table 2)
    w_2: float = 5.0,  #: 1/m, factor of the particles' motion (Table 2)
    w_3: float = 0.01,  #: 1/m, factor of the tool's distance, which is subtracted (Table 2)
    #: the reward while the farthest particle is home (Table 2)
    w_4: float = 1.0,
    #: whether the particles' motion is divided by their number
    mean: bool = True,
) -> Tensor:
    """Eq. 6: r_p where the tool is near the farthest particle, else r_tool. Constants are Table 2's.

    Of ``d_part = (c_1 + ‖x − x̂‖)²`` the decrease in this decision counts. Its two comparisons,
    with c_3 and with d_thr, take the distance ‖x − x̂‖ itself: with c_1 = 10 and the constants of
    Table 2, d_part would make the first never true and the second always c_5. `mean` divides the sum
    of the particles' motion by their number: the sum itself, ``mean: false``, outweighs everything.
    """
    before = (c_1 + previous_farthest_distance).square()
    nearer = before - (c_1 + farthest_distance).square()
    motion = path_length(particle_position, previous_particle_position, active_particles, mean=mean)
    vicinity = (farthest_distance < c_3).float()
    r_p = c_2 + w_1 * nearer + w_2 * motion + w_4 * vicinity
    r_tool = -w_3 * tool_distance
    threshold = (c_4 / farthest_distance.clamp(min=1e-3)).clamp(min=c_5)
    return torch.where(tool_distance < threshold, r_p, r_tool)

"""What a scene may add to the dynamics: kernels of its own at fixed places of a sub-step."""

from __future__ import annotations

from abc import ABC
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from torch import Tensor

__all__ = ["Particles", "Rule"]


@dataclass(frozen=True)
class Particles:
    """The device arrays of N worlds with P particles each, as Warp sees them (``wp.array``).

    A rule may write positions, velocities and springs, and only read the rest. World first:
    ``position[world, particle]``.
    """

    dt: float  #: s, of a sub-step
    position: Any  #: (N, P) vec3, m
    velocity: Any  #: (N, P) vec3, m/s
    active: Any  #: (N, P) float: 0 is a particle that is not there
    radius: Any  #: (P,) float, m
    inverse_mass: Any  #: (P,) float, 1/kg
    material: Any  #: (P,) int, index of the scene's materials
    #: Springs are *slots*: slot k of particle i names its partner j, or is -1; the same spring stands
    #: in a slot of j. Both have the same length. Whoever makes or removes one does it on both sides,
    #: each particle its own slots, so that nothing needs an atomic and results never depend on order.
    spring_partner: Any  #: (N, P, K) int; K, how many a particle can have
    spring_length: Any  #: (N, P, K) float, m
    #: Particles within ``reach`` of a particle (and within touching distance) when the sub-step
    #: began to be solved, itself left out, ascending.
    neighbour: Any  #: (N, P, M) int
    neighbour_count: Any  #: (N, P) int
    tools: Any  #: the struct of tools and shapes that functions of ``shapes`` take
    substep: Any  #: (N,) int: sub-steps done in the control period; 0 once it is over

    @property
    def worlds(self) -> int:
        """N"""
        return self.position.shape[0]

    @property
    def count(self) -> int:
        """P"""
        return self.position.shape[1]

    @property
    def device(self) -> Any:
        """Warp's."""
        return self.position.device


class Rule(ABC):  # noqa: B024 - each of its places may be left empty
    """Kernels that a scene adds to every sub-step: plasticity, bonds that break, sources, winds.

    They are launched in order on the simulator's stream, and captured in CUDA graphs: a rule
    launches Warp kernels (``wp.launch``, of size N·P, or tiled by worlds) on fixed arrays and does no
    work of the host. What is to happen only when a control period ends asks ``substep[world] == 0``
    in :meth:`after`.
    """

    #: m: how far apart particles may be that stand in each other's neighbours.
    reach: float = 0.0

    def build(self, particles: Particles) -> None:  # noqa: B027 - not all keep something
        """Called once, when the simulator is built: allocate here."""

    def before(self, particles: Particles) -> None:  # noqa: B027
        """Before a sub-step: forces on velocities."""

    def after(self, particles: Particles) -> None:  # noqa: B027
        """After a sub-step: positions and velocities are new, neighbours those of the solve."""

    def state(self) -> Mapping[str, Tensor]:
        """What the rule keeps beside the particles and springs, each (N, …), as views of its arrays:
        part of snapshots, and zero when a world's state is set."""
        return {}

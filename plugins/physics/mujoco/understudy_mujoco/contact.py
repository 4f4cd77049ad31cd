"""How contacts are solved, as options of any MuJoCo scene: integrator, cone, iterations, softness."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import mujoco

from understudy.errors import ConfigError
from understudy.options import check_range

__all__ = ["Contact"]

_INTEGRATORS = {
    "euler": mujoco.mjtIntegrator.mjINT_EULER,
    "rk4": mujoco.mjtIntegrator.mjINT_RK4,
    "implicit": mujoco.mjtIntegrator.mjINT_IMPLICIT,
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
    "discrete": mujoco.mjtIntegrator.mjINT_DISCRETE,
}
_CONES = {
    "pyramidal": mujoco.mjtCone.mjCONE_PYRAMIDAL,
    "elliptic": mujoco.mjtCone.mjCONE_ELLIPTIC,
}
_NO_NOSLIP = (
    "is not possible with the integrator 'discrete', which has no such iterations. Set it to 0, or "
    "choose another integrator, such as implicitfast."
)


#: s and m: nothing that is walked on gives way for longer, or deeper.
_SLOWEST, _DEEPEST = 1.0, 0.5


@dataclass(frozen=True)
class Contact:
    """What is null stays as the scene has it.

    ``discrete`` solves contacts in the inertia that includes damping and stiffness, so that stiff
    servos and firm contacts bear each other, as long as no servo is at its limit.
    """

    #: which of MuJoCo's integrators steps the physics
    integrator: Literal["euler", "rk4", "implicit", "implicitfast", "discrete"] | None = None
    cone: Literal["pyramidal", "elliptic"] | None = None  #: shape of MuJoCo's friction cone
    #: how much harder friction is than normal forces; more slips less
    impratio: float | None = None
    iterations: int | None = None  #: the most that the solver does a step
    ls_iterations: int | None = None  #: the most of a line search in each of them
    noslip_iterations: int | None = None  #: afterwards, against slip; not with ``discrete``
    tolerance: float | None = None  #: at which the solver is done
    #: s, and damping ratio, with which a penetration is undone, of everything that collides.
    solref: tuple[float, float] | None = None
    #: Least and most of a contact's force that resists at once, and m of depth from one to the other.
    solimp: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        check_range(self, "impratio", "tolerance", above=0)
        check_range(self, "iterations", "ls_iterations", least=1)
        check_range(self, "noslip_iterations", least=0)
        if self.integrator == "discrete" and self.noslip_iterations:
            raise ValueError(f"noslip_iterations={self.noslip_iterations} {_NO_NOSLIP}")
        check_range(self, "solref", most=1e3)
        if self.solref is not None and min(self.solref) <= 0:
            raise ValueError(f"solref={list(self.solref)} is not possible: both must be positive.")
        if self.solref is not None and (slow := self.solref[0]) > _SLOWEST:
            raise ValueError(
                f"solref={list(self.solref)} is not possible: what touches would sink in for {slow:g} s; its first number is in "
                f"seconds, at most {_SLOWEST:g}. If these are ms, give {slow / 1e3:g}."
            )
        if self.solimp is not None:
            low, high, depth = self.solimp
            if not (0 < low <= high < 1 and depth > 0):
                raise ValueError(
                    f"solimp={list(self.solimp)} is not possible: give two shares between 0 and 1, "
                    "the lower first, and a depth in metres."
                )
            if depth > _DEEPEST:
                raise ValueError(
                    f"solimp={list(self.solimp)} is not possible: its depth is in metres, at most {_DEEPEST:g}. If it is in mm, "
                    f"give {depth / 1e3:g}."
                )

    def apply(self, spec: mujoco.MjSpec) -> None:
        """Set what is given in `spec`.

        Raises
        ------
        ConfigError
            if the scene's own settings do not go with it.
        """
        option = spec.option
        if self.integrator is not None:
            option.integrator = _INTEGRATORS[self.integrator]
        if self.cone is not None:
            option.cone = _CONES[self.cone]
        for name in ("impratio", "iterations", "ls_iterations", "noslip_iterations", "tolerance"):
            if (value := getattr(self, name)) is not None:
                setattr(option, name, value)
        if option.integrator == _INTEGRATORS["discrete"] and option.noslip_iterations:
            raise ConfigError(
                f"scene.contact.noslip_iterations={option.noslip_iterations} {_NO_NOSLIP}"
            )
        if self.solref is None and self.solimp is None:
            return
        colliding = [g for body in spec.bodies for g in body.geoms if g.contype or g.conaffinity]
        for one in [*colliding, *spec.pairs]:
            if self.solref is not None:
                one.solref = self.solref
            if self.solimp is not None:
                one.solimp[:3] = self.solimp

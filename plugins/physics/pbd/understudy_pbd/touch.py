"""What a tool feels of particles: forces at sensors, and on which face (Clegg et al. 2018, sections 6.3 and 6.4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.task import Context, Encoder
from understudy_pbd.scene import ParticleScene
from understudy_tensors import rotations

__all__ = ["felt"]


def felt(places: Tensor, forces: Tensor, sensors: Tensor, face: Tensor) -> tuple[Tensor, Tensor]:
    """Equations 4 and 5 for a tool: each contact goes to the nearest sensor.

    Parameters
    ----------
    places : (N, P, 3) m, of particles in the tool's frame
    forces : (N, P, 3) N, of the tool on each, in the same frame; 0 is no contact
    sensors : (S, 3) m, in the same frame
    face : (3,) unit, out of the face that counts as 1

    Returns
    -------
    tuple of (N, S, 3) and (N, S)
        N, the particles' forces on the tool; and 1 where more contacts press on this face than on the other, −1
        where fewer do, 0 where as many do or nothing touches.
    """
    away = (places.unsqueeze(1) - sensors[:, None]).square().sum(dim=-1)  # (N, S, P)
    number = torch.arange(len(sensors), device=places.device).unsqueeze(1)
    # products, not scatter_add, whose order differs from run to run on a GPU
    to = (away.argmin(dim=1, keepdim=True) == number).float()  # (N, S, P)
    touched = (forces != 0).any(dim=-1)
    against = (forces * face).sum(dim=-1) < 0  # into this face: the other one is touched
    side = torch.where(touched, torch.where(against, -1.0, 1.0), 0.0)
    return to @ -forces, (to @ side.unsqueeze(-1)).squeeze(-1).sign()


class Touch(Encoder):
    """[forces, signs] of S sensors, 4 S numbers: what the one tool of a scene feels, in its own frame, mean over the
    last control period (Clegg et al. 2018, equations 4 and 5)."""

    @dataclass(frozen=True)
    class Options:
        #: m, where sensors are in the tool's frame; each contact goes to the nearest, so one feels all of them
        sensors: tuple[tuple[float, float, float], ...] = ((0.0, 0.0, 0.0),)
        #: along the tool's axes, out of the face whose touch has the sign 1: a pan's upper one
        face: tuple[float, float, float] = (0.0, 0.0, 1.0)
        force: float | None = None  #: N that is 1 to the policy; null: what all particles weigh

        def __post_init__(self) -> None:
            check_range(self, "force", above=0)
            if not self.sensors:
                raise ValueError("sensors=[] is not possible: give at least one place.")
            if not any(self.face):
                raise ValueError(f"face={list(self.face)} is no direction.")

    reads = ("particle_position", "contact_force", "tool_position", "tool_orientation")

    def __init__(self, options: Options, context: Context) -> None:
        model = context.need_scene(ParticleScene, "encoder 'pbd/touch'").model()
        if len(model.tools) != 1:
            raise ConfigError(
                f"encoder 'pbd/touch' is for scenes with one tool; this one has {len(model.tools)}."
            )
        mass = np.broadcast_to(np.asarray(model.mass, float), len(model.positions)).sum()
        weight = float(mass * np.linalg.norm(model.gravity))
        if options.force is None and not weight:
            raise ConfigError("Nothing weighs anything here: give encoder 'pbd/touch' a force, N.")
        self._force = weight if options.force is None else options.force
        self._sensors = torch.tensor(options.sensors, device=context.device)
        face = torch.tensor(options.face, device=context.device)
        self._face = face / face.norm()
        self.shape = (4 * len(options.sensors),)

    def encode(
        self, particle_position: Tensor, contact_force: Tensor, tool_position: Tensor, tool_orientation: Tensor
    ) -> Tensor:  # fmt: skip
        turn = tool_orientation.unsqueeze(1)
        places = rotations.inverse_rotate(turn, particle_position - tool_position.unsqueeze(1))
        forces = rotations.inverse_rotate(turn, contact_force)
        force, sign = felt(places, forces, self._sensors, self._face)
        return torch.cat([force.flatten(1) / self._force, sign], dim=1)

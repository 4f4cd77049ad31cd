"""How far a model is off when it goes on by itself, beside what the simulator did."""

from __future__ import annotations

import torch
from torch import Tensor

from understudy_imagination.adjoint import Window
from understudy_imagination.imagined import Imagined
from understudy_imagination.model import WorldModel
from understudy_imagination.rigid import Rigid

#: Decisions after which it is compared.
HORIZONS = (1, 4, 8, 16)


@torch.no_grad()
def model_errors(
    rigid: Rigid, imagined: Imagined, model: WorldModel, window: Window
) -> dict[int, Tensor]:
    """By horizon: how far each body (nbody,) is from where it was, m, in the mean over the worlds
    whose episodes lasted so long; NaN if none did.

    The model begins in the window's first states and takes its actions.
    """
    first = {name: value[0] for name, value in window.before.items()}
    qpos, qvel = first["qpos"], first["qvel"]
    running = torch.ones_like(window.ended[0])
    found: dict[int, Tensor] = {}
    for t in range(min(len(window), HORIZONS[-1])):
        taken = {name: value[t] for name, value in window.before.items()}
        posed = rigid.posed(qpos, qvel)
        action = window.actions[t]
        fields = imagined.fields(posed, imagined.constants(taken), action)
        qpos, qvel = model(posed, imagined.control(action, fields))
        if t + 1 in HORIZONS:
            real = {name: window.reached[name][t] for name in ("qpos", "qvel")}
            places = (rigid.posed(*state).field("xpos") for state in ((qpos, qvel), real.values()))
            off = torch.linalg.vector_norm(torch.sub(*places), dim=-1)
            off = torch.where(running.unsqueeze(1) & off.isfinite(), off, torch.nan)
            found[t + 1] = off.nanmean(0)
        running = running & ~window.ended[t]
    return found

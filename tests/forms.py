"""A body that has another shape in each world, for both engines' tests."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import torch

from understudy.task import Context, Simulator
from understudy_mujoco.forms import KINDS, Forms, lie_along_x
from understudy_mujoco.scene import MujocoScene

FORMS = Forms("thing", tuple(KINDS), density=700.0)
#: m, MuJoCo's sizes.
SIZES: dict[str, tuple[float, float, float]] = {
    "sphere": (0.08, 0.0, 0.0),
    "capsule": (0.04, 0.09, 0.0),
    "cylinder": (0.06, 0.05, 0.0),
    "ellipsoid": (0.05, 0.09, 0.07),
    "box": (0.05, 0.1, 0.03),
}


class Drop(MujocoScene):
    """The thing above a floor: in any form, or in `only` one, compiled by MuJoCo from its density."""

    def __init__(self, only: str | None = None) -> None:
        self.only: str | None = only

    def spec(self) -> mujoco.MjSpec:
        spec = mujoco.MjSpec()
        spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[5, 5, 1])
        body = spec.worldbody.add_body(name="thing", pos=[0.3, 0.2, 0.1])
        body.add_freejoint(name="thing")
        if self.only is None:
            FORMS.add(body)
        else:
            size, kind = SIZES[self.only], KINDS[self.only]
            lie_along_x(body.add_geom(type=kind, size=size, density=FORMS.density))
        return spec


def check_forms(
    build: Callable[[Context], Simulator], device: str, steps: int, atol: float
) -> None:
    """Each world's thing has the mass and inertia of its form, falls, and lands as MuJoCo's own of that form does;
    worlds that begin anew have another form."""
    n = len(SIZES)
    context = Context(0, torch.device(device), n, control_dt=0.02, substeps=10)
    context.scene = Drop()
    simulator = build(context)
    simulator.vary(FORMS.varies)
    start = torch.tensor([0, 0, 0.16, 0.9, 0.3, 0.2, 0.1]).repeat(n, 1)
    start[:, 3:] /= start[:, 3:].norm(dim=1, keepdim=True)
    every, sizes = torch.ones(n, dtype=torch.bool), torch.tensor(list(SIZES.values()))
    ends = {}
    for order in (list(range(n)), list(reversed(range(n)))):
        values = FORMS.values(torch.tensor(order), sizes[order])
        begin = {"qpos": start, "qvel": torch.zeros(n, 6), **values}
        simulator.set_state(every.to(device), {k: v.to(device) for k, v in begin.items()})
        for _ in range(steps):
            simulator.step(torch.zeros(n, 0, device=device))
        for world, number in enumerate(order):
            kind = list(SIZES)[number]
            model = Drop(kind).spec().compile()
            model.opt.timestep, data = 0.002, mujoco.MjData(model)
            mass = values["body_mass/thing"][world]
            assert abs(float(mass) / model.body("thing").mass[0] - 1) < 1e-5, kind
            own = torch.from_numpy(model.body("thing").inertia.copy()).float().sort().values
            found = values["body_inertia/thing"][world].sort().values
            torch.testing.assert_close(found, own, rtol=1e-5, atol=1e-9)
            data.qpos[:] = start[world]
            mujoco.mj_step(model, data, 10 * steps)
            ends[kind] = simulator.read("qpos")[world].cpu()
            error = (ends[kind] - torch.from_numpy(data.qpos).float()).abs().max()
            assert error < atol, f"{kind}: {error}"
    heights = [float(end[2]) for end in ends.values()]
    assert min(heights) > 0.02, "the floor holds every form"
    assert len({round(h, 3) for h in heights}) == n, "forms land alike: the test shows nothing"

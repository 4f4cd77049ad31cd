"""Where initial states have evolved to, on the report page (thesis, figure 3.13)."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape

import numpy as np
import torch
from torch import Tensor

from understudy.records.runs import Run
from understudy.setup.building import build_scene
from understudy.task import Context
from understudy_characters.layout import Layout
from understudy_characters.scene import CharacterScene, reference_motion
from understudy_characters.state import joint_rotations
from understudy_report.charts import Axes, grid, svg
from understudy_report.section import ReportSection
from understudy_report.values import mapping
from understudy_spacetime.evolution import evolved_states
from understudy_tensors.rotations import angle_between


class EvolvedSection(ReportSection):
    """How far evolved initial states are from the reference, and both in the plane of their first two
    principal components where that is farthest. The paper projects by locally linear embedding."""

    title = "Evolved initial states"
    order = 50

    def html(self, run: Run) -> str | None:
        chosen = mapping(mapping(run.info.get("config")).get("initial_states")).get("name")
        if chosen != "spacetime/evolution" or not any(run.checkpoints.glob("*")):
            return None
        found = evolution_of(run)
        segment = int(found.distances.mean(1).argmax())
        count = len(found.distances)
        where = f"phase {segment / count:.2f} to {(segment + 1) / count:.2f}"
        return (
            '<div class="charts">'
            + _card("Mean angle of a joint from the reference, rad", _by_phase(found.distances))
            + _card(f"Poses of {where}: evolved, and the reference", _projected(found, segment))
            + "</div><p>Dots are evolved initial states, the line is the reference, both in the plane "
            "of their first two principal components, in the segment where they are farthest apart.</p>"
        )


@dataclass(frozen=True)
class Evolved:
    """Evolved states beside the reference at the same moments; n segments of m states, J joints."""

    joints: Tensor  #: (n, m, J, 4)
    reference: Tensor  #: (n, m, J, 4), in order of time within a segment

    distances: np.ndarray  #: (n, m) rad, the mean over the joints of how far they are apart


def evolution_of(run: Run) -> Evolved:
    """What the newest checkpoint of `run` has evolved to."""
    states = evolved_states(run.path.as_posix())
    context = context_of(run)
    layout = context.need_scene(CharacterScene, "the report of evolved states").layout
    start, order = states["motion_start"].cpu().sort(dim=1)
    qpos = torch.gather(
        states["qpos"].cpu(), 1, order.unsqueeze(2).expand(-1, -1, states["qpos"].shape[2])
    )
    sampled = reference_motion(context).sample(start.flatten().float())
    joints = _joints(layout, qpos.flatten(0, 1)).unflatten(0, start.shape)
    reference = sampled["reference_joint_rotations"].unflatten(0, start.shape)
    return Evolved(joints, reference, angle_between(joints, reference).mean(2).numpy())


def context_of(run: Run) -> Context:
    """With the scene and the clip of `run`, on the CPU."""
    experiment = run.experiment()
    motion = experiment.registry.sections["motion"].build.factory(
        experiment.sections["motion"], experiment.registry, experiment.inputs
    )
    return build_scene(experiment, {"motion": motion})


def _joints(layout: Layout, qpos: Tensor) -> Tensor:
    return joint_rotations(layout.to(torch.device("cpu")), qpos.float())


def _by_phase(distances: np.ndarray) -> str:
    """The mean of each segment, over the phase."""
    means = distances.mean(axis=1)
    axes = Axes(0.0, max(1.1 * float(means.max()), 1e-3), 1.0)
    edges = np.linspace(0.0, 1.0, len(means) + 1)
    steps = [(x, y) for i, y in enumerate(means) for x in (edges[i], edges[i + 1])]
    return svg(
        grid(axes, "phase") + f'<path class="line" d="{axes.path(steps)}"/>',
        "how far evolved states are from the reference, by phase",
    )


def _projected(found: Evolved, segment: int) -> str:
    """Evolved states and the reference of `segment` by their first two principal components."""
    reference = found.reference[segment]
    sign = torch.where((found.joints[segment] * reference).sum(-1, keepdim=True) < 0, -1.0, 1.0)
    evolved = (sign * found.joints[segment]).flatten(1)
    both = torch.cat([evolved, reference.flatten(1)])
    centred = both - both.mean(0)
    _, _, axes_of = torch.linalg.svd(centred, full_matrices=False)
    places = (centred @ axes_of[:2].T).numpy()
    places[:, 0] -= places[:, 0].min()
    low, high = float(places[:, 1].min()), float(places[:, 1].max())
    pad = 0.07 * (high - low) + 1e-3
    axes = Axes(low - pad, high + pad, 1.07 * float(places[:, 0].max()) + 1e-3)
    line = [(float(x), float(y)) for x, y in places[len(evolved) :]]
    dots = "".join(
        f'<circle class="dot" cx="{axes.across(x):.1f}" cy="{axes.down(y):.1f}" r="2.5"/>'
        for x, y in places[: len(evolved)]
    )
    return svg(
        grid(axes, "first principal component")
        + f'<path class="axis" stroke-width="2.5" d="{axes.path(line)}"/>{dots}',
        "evolved initial states and the reference",
    )


def _card(title: str, picture: str) -> str:
    return f'<div class="card chart"><h4>{escape(title)}</h4>{picture}</div>'

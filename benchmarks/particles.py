"""Particles per second of the simulator ``pbd`` beside Newton's ``SolverXPBD``, in one run.

The scene is granular: 216 particles on a table and a box that pushes them, 8 iterations of each of 4
sub-steps of 1/60 s. Both sides step the same number of worlds from the same positions, on a GPU as a
captured CUDA graph of a control period. Newton looks for contacts with the box and the table once a
control period, which is the least that it needs; ``pbd`` does so in every iteration. Prints
particle-sub-steps per second and their ratio, and appends them to ``docs/benchmarks/particles.jsonl``.
"""

from __future__ import annotations

import argparse
import os
import platform
import statistics
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import torch
import warp as wp
from rows import append

from understudy.records.runs import versions
from understudy.task import Context
from understudy_pbd.scene import Box, Material, ParticleModel, ParticleScene, Table, Tool
from understudy_pbd.simulator import ParticleSimulator

RESULTS = Path(__file__).resolve().parents[1] / "docs" / "benchmarks" / "particles.jsonl"
RADIUS, MASS, FRICTION = 0.01, 0.01, 0.4
PERIOD, SUBSTEPS, ITERATIONS = 1 / 60, 4, 8
HALF_EXTENTS, BOX_FROM, BOX_SPEED = (0.01, 0.1, 0.05), -0.2, 0.15
SIDE = 6
PARTICLES = SIDE**3


def positions() -> np.ndarray:
    """(216, 3) m: a block of grains, a little disturbed."""
    axis = np.arange(SIDE) * 2.05 * RADIUS
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    grid += (-2.5 * 2.05 * RADIUS, -2.5 * 2.05 * RADIUS, RADIUS)
    return grid + np.random.default_rng(0).uniform(-0.05, 0.05, grid.shape) * RADIUS


class Grains(ParticleScene):
    def model(self) -> ParticleModel:
        return ParticleModel(
            positions(),
            RADIUS,
            MASS,
            materials=(Material(friction=FRICTION),),
            table=Table(friction=FRICTION),
            tools=(
                Tool((Box(HALF_EXTENTS),), (BOX_FROM, 0.0, HALF_EXTENTS[2]), friction=FRICTION),
            ),
        )


@dataclass(frozen=True)
class Side:
    period: Callable[[int], None]  #: simulates the control period of that number
    places: Callable[[], np.ndarray]  #: (N, 216, 3), m


def ours(device: str, worlds: int, traversal: Any, threads: int) -> Side:
    context = Context(0, torch.device(device), worlds, PERIOD, SUBSTEPS, scene=Grains())
    options = ParticleSimulator.Options(iterations=ITERATIONS, traversal=traversal, threads=threads)
    simulator = ParticleSimulator(options, context)
    control = torch.zeros(worlds, 6, device=device)
    control[:, 2] = HALF_EXTENTS[2]

    def period(number: int) -> None:
        control[:, 0] = BOX_FROM + BOX_SPEED * PERIOD * (number + 1)
        simulator.step(control)

    return Side(period, lambda: simulator.read("particle_position").cpu().numpy())


def newtons(device: str, worlds: int) -> Side:
    import newton

    one = newton.ModelBuilder()
    for x in positions():
        one.add_particle(wp.vec3(*x), wp.vec3(0.0), MASS, RADIUS)
    shape = newton.ModelBuilder.ShapeConfig(mu=FRICTION)
    place = wp.transform(wp.vec3(BOX_FROM, 0.0, HALF_EXTENTS[2]), wp.quat_identity())
    box = one.add_body(xform=place, is_kinematic=True)
    half = dict(zip(("hx", "hy", "hz"), HALF_EXTENTS, strict=True))
    one.add_shape_box(box, **half, cfg=shape)
    builder = newton.ModelBuilder()
    apart = 1.0  # particles of different worlds share one hash grid
    across = int(np.ceil(np.sqrt(worlds)))
    places = np.array([(k % across * apart, k // across * apart, 0.0) for k in range(worlds)])
    for place in places:
        builder.add_world(one, xform=wp.transform(wp.vec3(*place), wp.quat_identity()))
    builder.add_ground_plane(cfg=shape)
    with wp.ScopedDevice(device):
        model = builder.finalize()
        model.particle_mu = FRICTION
        solver = newton.solvers.SolverXPBD(model, iterations=ITERATIONS)
        now, then, control = model.state(), model.state(), model.control()
        pipeline = newton.CollisionPipeline(model)
        contacts = pipeline.contacts()
    body_q, body_qd = wp.to_torch(now.body_q), wp.to_torch(now.body_qd)
    body_qd[:, 0] = BOX_SPEED
    begin = body_q[:, 0].clone()
    states = [now, then]

    def simulate() -> None:
        pipeline.collide(states[0], contacts)
        for _ in range(SUBSTEPS):  # an even number: the same state is first again
            states[0].clear_forces()
            solver.step(states[0], states[1], control, contacts, PERIOD / SUBSTEPS)
            states.reverse()

    graph: list[Any] = []

    def period(number: int) -> None:
        body_q[:, 0] = begin + BOX_SPEED * PERIOD * number
        if device == "cpu" or number == 0:
            simulate()
            return
        if not graph:
            with wp.ScopedDevice(device), wp.ScopedCapture() as capture:
                simulate()
            graph.append(capture.graph)
        torch.cuda.current_stream().synchronize()  # Warp's stream is not torch's
        wp.capture_launch(graph[0])
        wp.synchronize_device(device)

    def found() -> np.ndarray:
        return states[0].particle_q.numpy().reshape(worlds, PARTICLES, 3) - places[:, None]

    return Side(period, found)


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def rate(side: Side, worlds: int, device: str, periods: int, repeats: int) -> float:
    """Particle-sub-steps per second, the median of `repeats`; kernels are compiled before."""

    def settle() -> None:
        if device != "cpu":
            torch.cuda.synchronize()

    number, rates = 0, []
    for measured in range(repeats + 1):
        count = periods if measured else 3
        settle()
        began = time.perf_counter()
        for _ in range(count):
            side.period(number)
            number += 1
        settle()
        if measured:
            took = time.perf_counter() - began
            rates.append(worlds * PARTICLES * SUBSTEPS * count / took)
    return statistics.median(rates)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--worlds", type=int, help="default: 1024, or 1 on the CPU")
    parser.add_argument("--periods", type=int, default=20, help="control periods of a measurement")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--traversal", choices=("block", "launches"), default="block")
    parser.add_argument("--threads", type=int, default=256, help="of a block, at most")
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args()
    device, on_gpu = options.device, options.device != "cpu"
    worlds = options.worlds or (1024 if on_gpu else 1)
    warnings.filterwarnings("ignore", category=DeprecationWarning)
    wp.config.log_level = wp.LOG_WARNING
    record: dict[str, Any] = {
        "when": time.strftime("%Y-%m-%d"),
        "device": torch.cuda.get_device_name() if on_gpu else platform.processor() or "cpu",
        "cores": os.cpu_count(),
        "worlds": worlds,
        "particles": PARTICLES,
        "iterations": ITERATIONS,
        "substeps": SUBSTEPS,
        "traversal": options.traversal,
        "threads": options.threads,
        "versions": {**versions(), "newton": _version("newton")},
    }
    sides = {"pbd": ours(device, worlds, options.traversal, options.threads)}
    try:
        sides["newton"] = newtons(device, worlds)
    except ImportError as error:
        print(f"Newton is not installed ({error}): pip install 'understudy[bench]'.")
    for name, side in sides.items():
        speed = rate(side, worlds, device, options.periods, options.repeats)
        deepest = float((RADIUS - side.places()[..., 2]).max() / RADIUS)
        record[f"{name}_particle_substeps_per_second"] = speed
        record[f"{name}_deepest_in_the_table"] = deepest  # of a radius
        print(f"{name}: {speed:.3g} particle-sub-steps/s, {deepest:.0%} of a radius in the table")
    if "newton" in sides:
        ratio = (
            record["pbd_particle_substeps_per_second"]
            / record["newton_particle_substeps_per_second"]
        )
        record["pbd_to_newton"] = ratio
        print(f"pbd / newton: {ratio:.1f}")
    append(options.out, record)


if __name__ == "__main__":
    main()

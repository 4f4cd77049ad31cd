"""Garments per second of the simulator ``cloth`` beside Newton's ``SolverVBD``, in one run.

The garment is as large as a shirt, 2 649 vertices: a sleeve 0.36 m round into which an arm goes 0.8 m deep at
0.4 m/s, and a torso's tube that a torso pushes; 13 shapes, 0.2 kg/m², friction 0.5. ``cloth`` takes 20 sub-steps
in 10 ms, VBD (untuned) 4 of 8 iterations each. Speed is measured while the arm is in the sleeve. With each speed go the
largest strain, area ratio and depth within the arm that the first worlds had on the way. Appends a line to
``docs/benchmarks/cloth.jsonl``.

    python benchmarks/cloth.py --worlds 64 256 1024 4096            # and --self-contact, --traversal launches
"""

from __future__ import annotations

import argparse
import os
import platform
import time
import warnings
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
import warp as wp
from rows import append

from understudy.records.runs import versions
from understudy.task import Context
from understudy_cloth.mesh import edges_of, face_areas
from understudy_cloth.scene import Capsule, ClothModel, ClothScene, Fabric, TaperedCapsule, Tool
from understudy_cloth.simulator import ClothSimulator

RESULTS = Path(__file__).resolve().parents[1] / "docs" / "benchmarks" / "cloth.jsonl"
EDGE, PERIOD, SPEED = 0.0225, 0.01, 0.4
#: Of the arm, from the fingertips up: ends above the fingertip (m), and radii there.
ARM = (
    (0.0, 0.06, 0.046, 0.04),
    (0.06, 0.10, 0.04, 0.0365),
    (0.10, 0.45, 0.0365, 0.05),
    (0.45, 0.75, 0.05, 0.065),
)
ARM_FROM, TORSO_FROM, TORSO_SPEED = 0.10, (0.6, 0.0, -0.275), 0.05
#: s: until then the arm goes in; then its speed is measured until it is where it should be.
IN_AFTER, SECONDS = 1.0, 2.0
#: Worlds that strain and depth are measured of.
LOOKED_AT = 8


def tube(around: int, rows: int, radius: float, flare: float) -> tuple[np.ndarray, np.ndarray]:
    """A tube that hangs from z = 0, wider by `flare` on top and less so down to the sixth row."""
    angle = 2 * np.pi * np.arange(around) / around
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    x = [(radius + flare * max(0.0, 1 - r / 6)) * ring - (0, 0, EDGE * r) for r in range(rows)]
    faces = []
    for r in range(rows - 1):
        for k in range(around):
            p, q = r * around + k, r * around + (k + 1) % around
            s, t = p + around, q + around
            faces += [(p, t, q), (p, s, t)] if (r + k) % 2 == 0 else [(p, s, q), (q, s, t)]
    return np.concatenate(x), np.array(faces)


def garment() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, triangles, and the vertices that are held: the sleeve's entrance, six of the torso's."""
    x, faces = tube(16, 40, 0.0573, 0.0197)
    y, more = tube(49, 41, 0.175, 0.0)
    held = np.concatenate([np.arange(16), len(x) + np.arange(0, 49, 8)])
    return (
        np.concatenate([x, y + np.array([0.6, 0, 0])]),
        np.concatenate([faces, more + len(x)]),
        held,
    )


class Sleeve(ClothScene):
    def model(self) -> ClothModel:
        x, faces, held = garment()
        arm = tuple(
            TaperedCapsule((a, b), 0.5 * (high - low), (0, 0, 0.5 * (low + high)))
            for low, high, a, b in ARM
        )
        far = tuple(Capsule(0.05, 0.15, (0.3 * k, 0, 0)) for k in range(8))
        tools = (
            Tool(arm, (0, 0, ARM_FROM), friction=0.5),
            Tool((TaperedCapsule((0.15, 0.07), 0.225),), TORSO_FROM, friction=0.5),
            Tool(far, (0, 0, 9)),
        )
        return ClothModel(x, faces, Fabric(density=0.2), pinned=held, tools=tools)


class Side(Protocol):
    def period(self, number: int) -> None:
        """Simulates the control period of that number."""
        ...

    def positions(self) -> np.ndarray:
        """(…, 2649, 3) m, of the first worlds."""
        ...

    #: Radii of the arm, where the side has others.
    arm: tuple[tuple[float, float, float, float], ...]


def offsets(worlds: int) -> np.ndarray:
    """(N, 2) m: where the arm goes down."""
    return np.random.default_rng(0).uniform(-0.006, 0.006, (worlds, 2))


class Ours:
    arm = ARM

    def __init__(self, device: str, worlds: int, substeps: int, **options: Any) -> None:
        context = Context(0, torch.device(device), worlds, PERIOD, substeps, scene=Sleeve())
        self.simulator = ClothSimulator(ClothSimulator.Options(**options), context)
        self.control = torch.zeros(worlds, 18, device=device)
        self.control[:, :2] = torch.tensor(offsets(worlds), device=device)
        self.control[:, 6:9] = torch.tensor(TORSO_FROM, device=device)
        self.control[:, 14] = 9.0
        state = {name: self.simulator.read(name).clone() for name in self.simulator.state_fields}
        state["tool_position"][:, 0, :2] = self.control[:, :2]
        self.simulator.set_state(torch.ones(worlds, dtype=torch.bool, device=device), state)

    def period(self, number: int) -> None:
        self.control[:, 2] = ARM_FROM - SPEED * PERIOD * (number + 1)
        self.control[:, 6] = TORSO_FROM[0] + TORSO_SPEED * PERIOD * (number + 1)
        self.simulator.step(self.control)

    def positions(self) -> np.ndarray:
        return self.simulator.read("cloth_position")[:LOOKED_AT].cpu().numpy()


class Newtons:
    """VBD with the garment's stretch and bending as Newton has them; its capsules have one radius."""

    arm = tuple((low, high, 0.5 * (a + b), 0.5 * (a + b)) for low, high, a, b in ARM)

    def __init__(self, device: str, worlds: int, self_contact: bool) -> None:
        import newton

        x, faces, held = garment()
        one = newton.ModelBuilder()
        shape = newton.ModelBuilder.ShapeConfig(mu=0.5)
        speeds = []
        for low, high, radius, _ in self.arm:
            place = wp.transform(wp.vec3(0, 0, ARM_FROM + 0.5 * (low + high)), wp.quat_identity())
            body = one.add_body(xform=place, is_kinematic=True, mass=1.0)
            one.add_shape_capsule(body, radius=radius, half_height=0.5 * (high - low), cfg=shape)
            speeds.append((0, 0, -SPEED))
        place = wp.transform(wp.vec3(*TORSO_FROM), wp.quat_identity())
        body = one.add_body(xform=place, is_kinematic=True, mass=1.0)
        one.add_shape_capsule(body, radius=0.11, half_height=0.225, cfg=shape)
        speeds.append((TORSO_SPEED, 0, 0))
        one.add_cloth_mesh(
            pos=wp.vec3(0.0), rot=wp.quat_identity(), scale=1.0, vel=wp.vec3(0.0),
            vertices=[wp.vec3(*map(float, p)) for p in x], indices=[int(i) for i in faces.ravel()],
            density=0.2, tri_ke=2e3, tri_ka=2e3, tri_kd=1e-4, edge_ke=1e-3, edge_kd=1e-4, particle_radius=0.003,
        )  # fmt: skip
        for i in held:
            one.particle_mass[int(i)] = 0.0
            one.particle_flags[int(i)] = one.particle_flags[int(i)] & ~newton.ParticleFlags.ACTIVE
        one.color(include_bending=True)
        builder = newton.ModelBuilder()
        for _ in range(worlds):
            builder.add_world(one)
        with wp.ScopedDevice(device):
            model = builder.finalize()
            model.soft_contact_ke, model.soft_contact_kd, model.soft_contact_mu = 1e4, 1e-2, 0.5
            radii = {"particle_self_contact_radius": 0.006, "particle_self_contact_margin": 0.009}
            self.solver = newton.solvers.SolverVBD(
                model,
                iterations=8,
                particle_enable_self_contact=self_contact,
                integrate_with_external_rigid_solver=True,
                **(radii if self_contact else {}),
            )
            self.pipeline = newton.CollisionPipeline(model, soft_contact_margin=0.01)
            self.states = [model.state(), model.state()]
            self.rules, self.contacts = model.control(), self.pipeline.contacts()
        across = torch.zeros(worlds, len(speeds), 2)
        across[:, :4] = torch.tensor(offsets(worlds))[:, None]
        self.speed = torch.tensor(speeds * worlds, device=device, dtype=torch.float32)
        for state in self.states:
            wp.to_torch(state.body_q)[:, :2] += across.reshape(-1, 2).to(device)
            wp.to_torch(state.body_qd)[:, :3] = self.speed
        self.begin = wp.to_torch(self.states[0].body_q)[:, :3].clone()
        self.device, self.worlds, self.graph = device, worlds, None

    def simulate(self) -> None:
        self.pipeline.collide(self.states[0], self.contacts)
        for _ in range(4):  # an even number: the same state is first again
            self.states[0].clear_forces()
            self.solver.step(self.states[0], self.states[1], self.rules, self.contacts, PERIOD / 4)
            self.states.reverse()

    def period(self, number: int) -> None:
        for state in self.states:
            wp.to_torch(state.body_q)[:, :3] = self.begin + moved_for(number) * self.speed
        if self.device == "cpu" or number == 0:
            self.simulate()
            return
        if self.graph is None:
            with wp.ScopedDevice(self.device), wp.ScopedCapture() as capture:
                self.simulate()
            self.graph = capture.graph
        torch.cuda.current_stream().synchronize()  # Warp's stream is not torch's
        wp.capture_launch(self.graph)
        wp.synchronize_device(self.device)

    def positions(self) -> np.ndarray:
        x = self.states[0].particle_q.numpy().reshape(self.worlds, -1, 3)
        return x[:LOOKED_AT]


def moved_for(number: int) -> float:
    """s that bodies have moved when the control period of that number ends."""
    return PERIOD * (number + 1)


@dataclass
class Measured:
    """The worst on the way."""

    strain: float = -1.0  #: of an edge
    area_ratio: float = 0.0  #: of a triangle, to that at rest
    depth_mm: float = -1e3  #: of vertices, middles of edges and of triangles within the arm
    finite: bool = True

    def look(self, side: Side, number: int) -> None:
        rest, faces, _ = garment()
        edges, _ = edges_of(faces)
        i, j = edges.T
        tip = ARM_FROM - SPEED * moved_for(number)
        for x, at in zip(side.positions().astype(float), offsets(LOOKED_AT), strict=False):
            length = np.linalg.norm(x[i] - x[j], axis=1) / np.linalg.norm(rest[i] - rest[j], axis=1)
            self.strain = max(self.strain, float(length.max()) - 1)
            ratio = face_areas(x[faces]) / face_areas(rest[faces])
            self.area_ratio = max(self.area_ratio, float(ratio.max()))
            points = np.concatenate([x, 0.5 * (x[i] + x[j]), x[faces].mean(axis=1)])
            for low, high, a, b in side.arm:
                u = np.clip((points[:, 2] - tip - low) / (high - low), 0, 1)
                axis = np.stack([at[0] + 0 * u, at[1] + 0 * u, tip + low + u * (high - low)], 1)
                depth = a + u * (b - a) - np.linalg.norm(points - axis, axis=1)
                self.depth_mm = max(self.depth_mm, 1e3 * float(depth.max()))
            self.finite &= bool(np.isfinite(x).all())


def measure(side: Side, worlds: int, device: str) -> tuple[float, Measured]:
    """Simulated seconds per second of all worlds while the arm is in the sleeve, and the worst seen."""
    found, took, timed = Measured(), 0.0, 0
    for number in range(round(SECONDS / PERIOD)):
        timing = number >= round(IN_AFTER / PERIOD)
        if device != "cpu":
            torch.cuda.synchronize()
        began = time.perf_counter()
        side.period(number)
        if device != "cpu":
            torch.cuda.synchronize()
        if timing:
            took, timed = took + time.perf_counter() - began, timed + 1
        if number % 10 == 9:
            found.look(side, number)
    return worlds * PERIOD * timed / took, found


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--worlds", type=int, nargs="+", help="default: 1024, or 1 on the CPU")
    parser.add_argument("--substeps", type=int, default=20, help="of 10 ms")
    parser.add_argument("--self-contact", action="store_true")
    parser.add_argument("--traversal", choices=("block", "launches"), default="block")
    parser.add_argument("--threads", type=int, help="of a block; default: the simulator's choice")
    parser.add_argument(
        "--bending-every", type=int, help="sub-steps between sweeps over hinges; default: same"
    )
    parser.add_argument("--newton-worlds", type=int, help="default: as many, at most 256; 0: none")
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args()
    device, on_gpu = options.device, options.device != "cpu"
    warnings.filterwarnings("ignore", category=DeprecationWarning)
    wp.config.log_level = wp.LOG_WARNING
    newton: dict[int, tuple[float, Measured]] = {}
    for worlds in options.worlds or [1024 if on_gpu else 1]:
        ours = Ours(
            device, worlds, options.substeps, self_contact=options.self_contact,
            traversal=options.traversal, threads=options.threads, bending_every=options.bending_every,
        )  # fmt: skip
        speeds = {"cloth": measure(ours, worlds, device)}
        record: dict[str, Any] = {
            "when": time.strftime("%Y-%m-%d"),
            "device": torch.cuda.get_device_name() if on_gpu else platform.processor() or "cpu",
            "cores": os.cpu_count(),
            "worlds": worlds,
            "substeps": options.substeps,
            "self_contact": options.self_contact,
            "traversal": options.traversal,
            "threads": options.threads,
            "bending_every": options.bending_every,
            "report": ours.simulator.report(),
            "versions": {**versions(), "newton": _version("newton")},
        }
        del ours
        others = min(worlds, 256) if options.newton_worlds is None else options.newton_worlds
        try:
            if others and others not in newton:
                newton[others] = measure(
                    Newtons(device, others, options.self_contact), others, device
                )
        except ImportError as error:
            print(f"Newton is not installed ({error}): pip install 'understudy[bench]'.")
        if others in newton:
            speeds["newton"] = newton[others]
            record["newton_worlds"] = others
        for name, (speed, found) in speeds.items():
            record[name] = {"simulated_seconds_per_second": speed, **vars(found)}
            print(
                f"{name}: {worlds if name == 'cloth' else others} worlds, {speed:.3g} simulated s/s; at worst "
                f"strain {found.strain:.0%}, area ratio {found.area_ratio:.2f}, {found.depth_mm:.1f} mm in the arm",
                flush=True,
            )
        if "newton" in speeds:
            record["cloth_to_newton"] = speeds["cloth"][0] / speeds["newton"][0]
            print(f"cloth / newton: {record['cloth_to_newton']:.1f}")
        append(options.out, record)


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


if __name__ == "__main__":
    main()

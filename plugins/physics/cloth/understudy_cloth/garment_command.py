"""``understudy garment check``: whether a garment's files can be used, and what they hold."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from understudy.command.command import Command
from understudy_cloth.garments import read_garment
from understudy_cloth.mesh import SHARED_VERTICES, edges_of, face_areas


class Check(Command):
    """Prints a garment's size, loops and patches; exit status 2 and one sentence if it cannot be used."""

    example = "understudy garment check gown.yaml"

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument(
            "file", type=Path, metavar="GARMENT.yaml", help="the file that names mesh and loops"
        )

    def run(self, options: argparse.Namespace) -> int:
        found = read_garment(options.file)
        x, faces = found.positions, found.faces
        edges, _ = edges_of(faces)
        length = np.linalg.norm(x[edges[:, 0]] - x[edges[:, 1]], axis=1)
        size = " × ".join(f"{side:.2f}" for side in x.max(axis=0) - x.min(axis=0))
        memory = "shared" if len(x) <= SHARED_VERTICES else "global, slower"
        print(
            f"{found.name}: {len(x)} vertices, {len(faces)} triangles, {face_areas(x[faces]).sum():.2f} m²"
        )
        print(f"  {size} m (forward, left, up); edges {1e3 * length.mean():.0f} mm, ", end="")
        print(f"{1e3 * length.min():.0f} to {1e3 * length.max():.0f}; {memory} memory on a GPU")
        for name, loop in found.loops.items():
            print(f"  loop {name}: {len(loop)} vertices, {found.perimeter(name):.2f} m")
        for name, patch in found.patches.items():
            print(f"  patch {name}: {len(patch)} vertices")
        return 0

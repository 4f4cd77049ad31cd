"""The recorded motion as the policy saw it: its maps, at some moments of the episode."""

from __future__ import annotations

import base64
import struct
import zlib
from collections.abc import Mapping
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from understudy.options import make_options
from understudy.records.runs import Run
from understudy_motion.readers.npz import Archive
from understudy_report.section import ReportSection

if TYPE_CHECKING:  # it brings Warp, without which the pages of other runs can do
    from understudy_amorphous.maps import MaterialMaps

#: Moments that are shown, evenly over the first episode.
MOMENTS = 6
#: Pixels of the page for the side of a map.
SIDE = 160
#: Of the recorded fields that maps are drawn from, in each frame.
_SHAPES = {
    "particle_position": (None, 3),
    "tool_position": (3,),
    "tool_orientation": (4,),
    "goal": (2,),
}


class MapsSection(ReportSection):
    """Density, height and goal maps of the recorded world, each at the same moments."""

    title = "What the policy sees"
    order = 30

    def html(self, run: Run) -> str | None:
        file = run.path / "recording.npz"
        encoders = run.config.get("encoder") or {}
        options = [o for o in encoders.values() if o and o.get("name") == "amorphous/maps"]
        if not options or not file.is_file():
            return None
        archive = Archive(file)
        frames = len(archive.floats("tool_position", None, 3))
        tracks = {
            name: archive.floats(name, frames, *rest)
            for name, rest in _SHAPES.items()
            if name in archive.names
        }
        episode = int(np.clip(archive.number("first_episode"), 1, frames))
        dt = archive.number("control_dt")
        return "".join(_rows(_options(o), tracks, episode, dt) for o in options) or None


def _options(chosen: Mapping[str, Any]) -> MaterialMaps.Options:
    from understudy_amorphous.maps import MaterialMaps

    own = {k: v for k, v in chosen.items() if k not in ("name", "reads")}
    return make_options(MaterialMaps.Options, own, "encoder")


def _rows(
    options: MaterialMaps.Options, tracks: Mapping[str, np.ndarray], episode: int, dt: float
) -> str:
    from understudy_amorphous.maps import draw_maps

    moments = np.unique(np.linspace(0, episode - 1, MOMENTS).round().astype(int))
    seen = {name: torch.from_numpy(track[moments]).float() for name, track in tracks.items()}
    maps = draw_maps(options, **seen).numpy()  # (M, C, N, N)
    seconds = (moments + 1) * dt
    frame = "the tool's frame, which faces up" if options.frame == "tool" else "the world's frame"
    rows = []
    for channel, name in enumerate(options.channels):
        images = maps[:, channel]
        low, high = min(0.0, float(images.min())), max(float(images.max()), 1e-6)
        pictures = "".join(
            f'<figure><img alt="{escape(name)} at {at:.1f} s" width="{SIDE}" '
            f'style="image-rendering:pixelated" src="{_address((image - low) / (high - low))}">'
            f"<figcaption>{at:.1f} s</figcaption></figure>"
            for image, at in zip(images, seconds, strict=True)
        )
        rows.append(
            f'<div class="card"><h3>{escape(name.capitalize())}, in {frame}</h3>'
            f'<div style="display:flex;flex-wrap:wrap;gap:12px">{pictures}</div></div>'
        )
    return "".join(rows)


def _address(image: np.ndarray) -> str:
    """A data: address of a map (N, N) in [0, 1] as PNG; x points up, y to the left."""
    upright = np.flip(image, (0, 1))
    return f"data:image/png;base64,{base64.b64encode(png(coloured(upright))).decode()}"


def coloured(image: np.ndarray) -> np.ndarray:
    """(H, W) in [0, 1] as (H, W, 3) uint8, dark blue over green to yellow."""
    stops = np.array([[20, 20, 60], [40, 90, 140], [50, 160, 120], [180, 210, 70], [250, 240, 120]])
    at = np.linspace(0.0, 1.0, len(stops))
    rgb = [np.interp(image, at, stops[:, colour]) for colour in range(3)]
    return np.stack(rgb, axis=-1).round().astype(np.uint8)


def png(image: np.ndarray) -> bytes:
    """A PNG file of `image` (H, W, 3) uint8 (PNG specification, sections 5 and 11)."""
    height, width, _ = image.shape

    def chunk(kind: bytes, data: bytes) -> bytes:
        check = zlib.crc32(kind + data)
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", check)

    lines = b"".join(b"\0" + row.tobytes() for row in image)  # no filter
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(lines, 9))
        + chunk(b"IEND", b"")
    )

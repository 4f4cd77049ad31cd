"""``understudy amorphous character``: a figure whose hand moves the tool of a finished run."""

from __future__ import annotations

import argparse
import itertools
import shlex
import typing
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
import torch

from understudy.command.command import Command, tell
from understudy.errors import ConfigError, FileError, PluginError, UnderstudyError
from understudy.options import make_options
from understudy.records import runs
from understudy.records.runs import Run
from understudy.setup.building import build_scene
from understudy.setup.plugins import installed
from understudy_amorphous.character import GRIPS, TOOL, Figure, Grip, figure, placed
from understudy_amorphous.scene import AmorphousScene
from understudy_characters.shapes import shapes
from understudy_motion.arguments import finite, positive
from understudy_motion.clip import Clip
from understudy_motion.readers.npz import Archive
from understudy_motion.writing import write_clip
from understudy_report.video import write_video
from understudy_skills.folder import run_folder

if typing.TYPE_CHECKING:
    from understudy_amorphous.inverse_kinematics import Motion

#: m and rad by which the tool may be away from the recorded one before it counts as not reached.
TOLERANCE = (1e-3, float(np.radians(0.5)))
#: rad from the end of its range at which a joint counts as at its limit.
AT_LIMIT = float(np.radians(0.5))


class HoldTool(Command):
    """Writes the figure's motion as a clip, and a video of figure, tool and material."""

    example = "understudy amorphous character runs/gather cook.glb --no-video"

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        add = parser.add_argument
        add("run", help="a finished run's folder, or a skill")
        add(
            "destination",
            nargs="?",
            type=Path,
            metavar="OUT",
            help="the clip to write, such as cook.npz, .bvh or .glb; by default RUN/character.npz. The "
            "video is beside it, as .mp4",
        )
        add(
            "--character",
            default="amorphous/cook",
            metavar="NAME",
            help="a registered figure, or an MJCF file",
        )
        add(
            "--hand",
            default="right_grip",
            metavar="SITE",
            help="the site or body that holds the tool",
        )
        add(
            "--grip",
            nargs=6,
            type=finite,
            metavar=("X", "Y", "Z", "ROLL", "PITCH", "YAW"),
            help="the tool's frame in the hand's, m and degrees",
        )
        add(
            "--table",
            nargs=3,
            type=finite,
            metavar=("X", "Y", "Z"),
            help="the table's middle, m: in front of the figure, to its left, and above its floor",
        )
        add("--facing", type=finite, metavar="DEGREES", help="where the tool faces on average")
        add(
            "--scale",
            type=positive,
            metavar="S",
            help="metres of the figure's world for one metre of the run's",
        )
        add("--turn-in-hand", action="store_true", help="the tool may turn about the hand's z axis")
        add(
            "--cost",
            choices=("mass", "equal"),
            default="mass",
            help="the cost of a joint's turn in eq. 13",
        )
        add("--relax", type=finite, default=2.0, metavar="S", help="seconds in which joints that need not move return to the first pose; 0: never")  # fmt: skip
        add(
            "--speed",
            type=positive,
            default=10.0,
            metavar="RAD/S",
            help="the greatest speed of any joint",
        )
        add(
            "--nearest",
            action="store_true",
            help="write the nearest motion where the tool is out of reach",
        )
        add("--no-video", action="store_true", help="write only the clip")

    def writes(self, options: argparse.Namespace) -> Iterator[Path | None]:
        if options.destination is not None:
            yield options.destination
            if not options.no_video:
                yield options.destination.parent / f"{options.destination.stem}.mp4"

    def run(self, options: argparse.Namespace) -> int:
        try:
            from understudy_amorphous import inverse_kinematics
        except ImportError as error:
            raise PluginError(
                "The character needs mink, which is not installed: pip install 'understudy[ik]'."
            ) from error
        registry = installed().registry
        how = make_options(
            inverse_kinematics.Options,
            {"cost": options.cost, "relax": options.relax, "speed": options.speed},
            "inverse kinematics",
        )
        options.run = run_folder(options.run, recorded=True)
        recorded = _recorded(runs.open_run(options.run))
        if not options.no_video and "particle_position" not in recorded.tracks:
            raise FileError(
                f"{options.run}: its recording has no material to draw (particle_position); leave the "
                f"video out (--no-video), or make another with `understudy render {options.run}`."
            )
        grip = _grip(options, recorded.scene)
        particles = recorded.scene.model()
        held = figure(
            options.character,
            options.hand,
            particles.tools[0],
            grip,
            registry,
            turning=options.turn_in_hand,
        )
        placement = placed(grip, recorded.tool_orientation)
        motion = inverse_kinematics.follow(
            held.model,
            TOOL,
            placement.points(recorded.tool_position),
            placement.orientations(recorded.tool_orientation),
            dt=recorded.dt,
            start=held.start,
            still=held.still,
            apart=held.apart,
            options=how,
        )
        if not options.nearest:
            _check_reached(motion, recorded.dt)
        clip = _clip(held, motion, recorded)
        path = options.destination or Path(options.run) / "character.npz"
        write_clip(clip, path, registry, shapes(held.character))
        written = str(path)
        if not options.no_video:
            from understudy_amorphous.character_drawing import draw

            video = path.with_suffix(".mp4")
            frames = draw(held, motion.qpos, particles, recorded.tracks, placement)
            try:
                write_video(video, frames, 1.0 / recorded.dt)
                written += f" and {video}"
            except UnderstudyError as error:  # the clip is there all the same
                tell(f"No video: {error}")
        print(report(held, motion, recorded.dt))
        print(f"Written: {written}, {clip.num_frames} frames, {clip.duration:.2f} s.")
        if path.suffix.lower() in (".npz", ".csv", ".bvh"):
            source = shlex.quote(str(path))
            character = shlex.quote(options.character)
            print(f"Next: understudy export {source} cook.glb --character {character}")
        return 0


@dataclass(frozen=True)
class _Recorded:
    """The first episode of a recording, T frames."""

    source: str
    scene: AmorphousScene
    dt: float  #: s
    tool_position: np.ndarray  #: (T, 3) m
    tool_orientation: np.ndarray  #: (T, 4)
    tracks: dict[str, np.ndarray]  #: what else is shown


def _recorded(run: Run) -> _Recorded:
    file = run.path / "recording.npz"
    if not file.is_file():
        raise FileError(
            f"{run.path} has no recording (recording.npz); make one with `understudy render {run.path}`."
        )
    scene = _scene(run)
    archive = Archive(file)
    dt, frames = archive.number("control_dt"), max(0, int(archive.number("first_episode")))
    position = archive.floats("tool_position", None, 3)
    if min(len(position), frames) < 2 or not dt > 0:
        raise FileError(f"{file}: the recorded episode ended before its second frame.")
    orientation = archive.floats("tool_orientation", len(position), 4)
    lengths = np.linalg.norm(orientation, axis=1)
    if np.abs(lengths - 1.0).max() > 0.1:
        raise FileError(f"{file}: 'tool_orientation' is not one unit quaternion a frame.")
    particles = len(scene.model().positions)
    shape = {"particle_position": (particles, 3), "active_particles": (particles,), "goal": (2,)}
    tracks = {
        name: archive.floats(name, len(position), *rest)[:frames]
        for name, rest in shape.items()
        if name in archive.names
    }
    return _Recorded(
        source=str(run.path),
        scene=scene,
        dt=dt,
        tool_position=position[:frames],
        tool_orientation=(orientation / lengths[:, None])[:frames],
        tracks=tracks,
    )


def _scene(run: Run) -> AmorphousScene:
    experiment = run.experiment()
    chosen = experiment.need("scene")
    scene = build_scene(experiment, {}).scene
    if not isinstance(scene, AmorphousScene):
        raise ConfigError(
            f"The run's scene '{chosen.component.name}' has no tool for a hand; give a run of "
            "amorphous/gather, amorphous/spread or amorphous/flip."
        )
    return scene


def _grip(options: argparse.Namespace, scene: AmorphousScene) -> Grip:
    grip = GRIPS[scene.options.tool]
    if options.scale is not None:
        grip = replace(grip, scale=options.scale)
    if options.grip is not None:
        angles = np.radians(options.grip[3:])
        grip = replace(grip, tool=(*options.grip[:3], *map(float, angles)))
    if options.table is not None:
        grip = replace(grip, table=tuple(options.table))
    if options.facing is not None:
        grip = replace(grip, facing=float(np.radians(options.facing)))
    return grip


def _check_reached(motion: Motion, dt: float) -> None:
    """Raises ConfigError if the hand cannot be where the tool has to be."""
    place, turn = motion.position_error, motion.orientation_error
    missed = (place > TOLERANCE[0]) | (turn > TOLERANCE[1])
    if not missed.any():
        return
    first, worst = int(missed.argmax()), int((place / TOLERANCE[0] + turn / TOLERANCE[1]).argmax())
    raise ConfigError(
        f"The tool is out of reach from {first * dt:.2f} s on, in {missed.sum()} of {len(missed)} "
        f"frames; the hand stays {1000 * place[worst]:.0f} mm and {np.degrees(turn[worst]):.0f}° away "
        f"from it at {worst * dt:.2f} s: let the tool turn in the hand (--turn-in-hand), change --table, "
        "--facing, --scale or --grip, or take the nearest motion (--nearest)."
    )


def _clip(held: Figure, motion: Motion, recorded: _Recorded) -> Clip:
    times = recorded.dt * torch.arange(len(motion.qpos), dtype=torch.float64)
    name = f"{Path(recorded.source).resolve().name}-character"
    qpos = torch.from_numpy(motion.qpos)
    return held.character.clip(qpos, times, name=name, source=recorded.source)


def report(held: Figure, motion: Motion, dt: float) -> str:
    """How well the tool is followed, and how the joints move."""
    place, turn = 1000 * motion.position_error, np.degrees(motion.orientation_error)
    missed = (motion.position_error > TOLERANCE[0]) | (motion.orientation_error > TOLERANCE[1])
    at_limit, often = limits_met(held, motion.qpos)
    speed, fastest = top_speed(held, motion.qpos, dt)
    lines = [
        f"The tool is met within {place.mean():.3f} mm and {turn.mean():.3f}° on average, "
        f"{place.max():.3f} mm and {turn.max():.3f}° at worst.",
        f"A joint is at its limit in {100 * at_limit:.0f} % of the frames"
        + (f", most often {often}." if often else "."),
        f"The fastest joint: {speed:.1f} rad/s ({fastest}).",
    ]
    if missed.any():
        lines.insert(1, f"It is out of reach in {missed.sum()} of {len(missed)} frames.")
    return "\n".join(lines)


def limits_met(held: Figure, qpos: np.ndarray) -> tuple[float, str]:
    """Share of the frames ``qpos`` (T, nq) in which a hinge between trunk and hand is at its limit, and
    the one that most often is."""
    model, met = held.model, {}
    for name in held.limbs:
        joint = model.joint(name)
        if joint.type[0] == mujoco.mjtJoint.mjJNT_HINGE and model.jnt_limited[joint.id]:
            angle, (low, high) = qpos[:, joint.qposadr[0]], joint.range
            met[name] = (angle < low + AT_LIMIT) | (angle > high - AT_LIMIT)
    any_met = np.any(list(met.values()), axis=0) if met else np.zeros(len(qpos), bool)
    often = max(met, key=lambda name: met[name].sum()) if any_met.any() else ""
    return float(any_met.mean()), often


def top_speed(held: Figure, qpos: np.ndarray, dt: float) -> tuple[float, str]:
    """rad/s and name of the joint that turns fastest from one of the frames ``qpos`` (T, nq) to the next."""
    model, step = held.model, np.zeros(held.model.nv)
    fastest = (0.0, "")
    for before, after in itertools.pairwise(qpos):
        mujoco.mj_differentiatePos(model, step, dt, before, after)
        dof = int(np.abs(step).argmax())
        name = model.joint(int(model.dof_jntid[dof])).name
        fastest = max(fastest, (float(abs(step[dof])), name))
    return fastest

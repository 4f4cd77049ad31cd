"""Whether the motions that ship are to be believed: each packaged skill of a character, played, beside its clip.

``python benchmarks/shipped.py`` plays every skill of a character that `understudy play` lists, `EPISODES` times from other starts, measures
feet, ground, flights and jerk of what it does and of the clip that it follows (slide and jerk in the mean, depth and time in the air the most), and writes ``docs/benchmarks/shipped.jsonl``, from which
``make figures`` writes the table in ``docs/conventions.md`` and the gallery. ``THRESHOLDS`` are those there. With ``--materials`` it writes
``docs/benchmarks/materials.jsonl``: what the skills that move a material come to on the starts that they were packed with.
"""

from __future__ import annotations

import argparse
import datetime
import json
from collections.abc import Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
import torch

from understudy.setup.plugins import installed
from understudy_characters.character import Character, load_character
from understudy_doctor.examination import examine
from understudy_doctor.findings import Severity, intervals
from understudy_doctor.measurements import Measurements
from understudy_motion.clip import Clip
from understudy_play.command import record
from understudy_play.player import Player
from understudy_skills.skill import names, open_skill

RESULTS = Path(__file__).parents[1] / "docs" / "benchmarks" / "shipped.jsonl"
MATERIALS = RESULTS.with_name("materials.jsonl")
SECONDS = 8.0
EPISODES = 4  #: one tells little: of a start that stands, or of the machine's rounding
FLOOR = 0.0  #: m: where physics has it; who sits with feet in the air tells nothing of it
SHORTEST = 0.5  #: seconds of an episode that is checked
WORST = ("sink", "air", "skates", "major", "minor")
#: What a motion may have to ship: its clip's own and so much more, or so much in all where that is more.
THRESHOLDS = {
    "slide": (0.10, 0.30),  # m/s, mean of feet that touch the floor
    "sink": (0.005, 0.02),  # m, the deepest point
    "air": (0.07, 0.10),  # s, the longest time without the floor
    "jerk": (0.0, 400.0),  # m/s³, median of the joints'; see `believable`
}
RATIO = 2.0  # of jerk to the clip's


def clip_of(qpos: np.ndarray, dt: float, character: Character) -> Clip:
    """A motion (T, nq) as a clip."""
    times = dt * torch.arange(len(qpos), dtype=torch.float64)
    poses = torch.from_numpy(qpos[:, : character.model.nq]).double()
    return character.clip(poses, times, name="played")


def checked(qpos: np.ndarray, dt: float, character: Character) -> dict[str, float]:
    """What `understudy motion check` finds in a motion (T, nq): how far a foot slides at most while it stands (m), and
    how many findings are major and minor; episode by episode, since between two of them a figure is moved."""
    found = [
        finding
        for part in episodes(qpos)
        if len(part) * dt >= SHORTEST
        for finding in examine(clip_of(part, dt, character), character, level=FLOOR).findings
    ]
    severities = [finding.severity for finding in found]
    return {
        "skates": max((f.value for f in found if f.kind == "foot_skate"), default=0.0),
        "major": severities.count(Severity.MAJOR),
        "minor": severities.count(Severity.MINOR),
    }


def episodes(qpos: np.ndarray) -> list[np.ndarray]:
    """A motion (T, nq) cut where the root moves by more than 0.3 m, or turns by more than 1 rad, from a frame to the next."""
    moved = np.linalg.norm(np.diff(qpos[:, :3], axis=0), axis=1)
    along = np.abs((qpos[1:, 3:7] * qpos[:-1, 3:7]).sum(1))
    turned = 2 * np.arccos(np.clip(along, 0.0, 1.0))
    return np.split(qpos, np.flatnonzero((moved > 0.3) | (turned > 1.0)) + 1)


def measured(
    qpos: np.ndarray, dt: float, character: Character, level: float | None = None
) -> dict[str, float]:
    """Foot slide, penetration, air time and jerk of a motion (T, nq), episode by episode: where a figure is put back it
    does not slide. `level`: of the floor, where it is known, as of what physics played; a clip's is estimated."""
    parts = [
        Measurements(clip_of(part, dt, character), character, level=level)
        for part in episodes(qpos)
        if len(part) > 3  # of fewer there is no jerk
    ]
    slides, sink, air, jerks = [np.zeros(0)], 0.0, 0.0, []
    for found in parts:
        lowest = np.where(np.isfinite(found.heights), found.heights, np.inf).min(1)
        feet = list(found.feet)
        speed = np.linalg.norm(found.slides, axis=-1)[:, feet] / found.dt
        slides.append(speed[(found.touching[:-1] & found.touching[1:])[:, feet]])
        aloft = (lowest > 0.02) & ~found.supported  # who sits is carried by the chair
        up = [(last - first + 1) * found.dt for first, last in intervals(aloft, close=1)]
        third = np.diff(found.kinematics[0].numpy(), n=3, axis=0) / found.dt**3
        jerks.append(np.linalg.norm(third, axis=-1).ravel())
        sink, air = max(sink, -float(lowest.min())), max(air, *up, 0.0)
    stands = np.concatenate(slides)
    return {
        "slide": float(stands.mean()) if len(stands) else 0.0,
        "sink": sink,
        "air": float(air),
        "jerk": float(np.median(np.concatenate(jerks))),
    }


def believable(played: dict[str, float], clip: dict[str, float] | None) -> list[str]:
    """What keeps a motion from shipping; without a clip to compare with, the limits alone count."""
    beyond = []
    for name, (more, most) in THRESHOLDS.items():
        own = clip[name] if clip is not None else 0.0
        limit = max(most, RATIO * own) if name == "jerk" else max(most, own + more)
        beyond += [name] if played[name] > limit else []
    return beyond


def characters() -> list[str]:
    """The packaged skills of characters; what a hand does with sticks has neither feet nor falls."""
    return [name for name in names() if "character" in open_skill(name).card["config"]["scene"]]


def materials() -> list[str]:
    """The packaged skills that move a material, which has neither feet nor falls."""
    return [name for name in names() if "material" in open_skill(name).card["config"]["scene"]]


def material_row(name: str) -> dict[str, Any]:
    """What the packed policy came to, judged as it was packed, on starts that no training saw."""
    card = open_skill(name).card
    found = card["evaluation"]
    return {
        "skill": name,
        "when": datetime.date.today().isoformat(),
        "samples": card["samples"],
        "minutes": card["config"]["budget"]["minutes"],
        "episodes": found["episodes"],
        "success": found["success_rate"],
        "success_95": found["success_rate_95"],
        "measures": {name: one["mean"] for name, one in found["measures"].items()},
    }


def together(plays: Sequence[dict[str, float]]) -> dict[str, float]:
    """Of several plays: the most of `WORST`, the mean of all else."""
    how = {name: max if name in WORST else fmean for name in plays[0]}
    return {name: float(how[name](one[name] for one in plays)) for name in how}


def row(name: str, overrides: Sequence[str] = ()) -> dict[str, Any]:
    """The skill `name`, played from where it begins, by each of the seeds 0 to `EPISODES` - 1; with
    `overrides` as it does not ship, so nobody knows how often it succeeds."""
    skill = open_skill(name, list(overrides))
    scene = skill.card["config"]["scene"]
    character = load_character(str(scene["character"]), installed().registry)
    plays: list[dict[str, float]] = []
    clips: list[dict[str, float]] = []
    checks: list[dict[str, float]] = []
    falls = 0
    for seed in range(EPISODES):
        player = Player(skill, seed)
        try:
            tracks = record(player, SECONDS)
            dt = player.dt
            falls += player.falls
        finally:
            player.close()
        plays.append(measured(tracks["qpos"], dt, character, FLOOR))
        checks.append(checked(tracks["qpos"], dt, character))
        if "reference_qpos" in tracks:
            clips.append(measured(tracks["reference_qpos"], dt, character))
    played, clip = together(plays), together(clips) if clips else None
    alone = zip(plays, clips or [None] * EPISODES, strict=True)
    return {
        "skill": name,
        **({"overrides": list(overrides)} if overrides else {}),
        "when": datetime.date.today().isoformat(),
        "seconds": SECONDS,
        "seeds": list(range(EPISODES)),
        "samples": skill.samples,
        "success": None if overrides else skill.card["evaluation"]["success_rate"],
        "falls": falls,
        "played": played,
        "clip": clip,
        "check": together(checks),
        "beyond": ", ".join(believable(played, clip)) or "–",
        "episodes_beyond": sum(bool(believable(*pair)) for pair in alone),
    }


def saved(rows: Sequence[dict[str, Any]]) -> None:
    """Put `rows` in place of what is recorded of their skills; what does not ship any more goes."""
    ship = characters()
    known = [json.loads(line) for line in RESULTS.read_text(encoding="utf-8").splitlines()]
    latest = {one["skill"]: one for one in [*known, *rows]}
    lines = [json.dumps(latest[name]) + "\n" for name in ship if name in latest]
    RESULTS.write_text("".join(lines), encoding="utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--skills", nargs="*", help="those alone; files (.json) are printed and not saved"
    )
    parser.add_argument(
        "--tried",
        nargs="+",
        default=[],
        metavar="KEY=VALUE",
        help="as they do not ship: to tried.jsonl",
    )
    parser.add_argument("--materials", action="store_true", help="those of materials alone")
    given = parser.parse_args()
    if given.materials:
        lines = [json.dumps(material_row(name)) + "\n" for name in materials()]
        parser.exit(not MATERIALS.write_text("".join(lines), encoding="utf-8"))
    for one in given.skills or characters():
        print(json.dumps(found := row(one, given.tried)), flush=True)
        if given.tried:
            with RESULTS.with_name("tried.jsonl").open("a", encoding="utf-8") as file:
                file.write(json.dumps(found) + "\n")
        elif one in characters():
            saved([found])

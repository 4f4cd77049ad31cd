"""``understudy sitting trials``: the main task judged as section 7 judges it.

Success is 3.0 s of uninterrupted sitting: contact of the pelvis with the seat, upright and facing as the
chair does (:class:`~understudy_sitting.state.Seat`). The paper's is of the contact alone, which a figure
that has fallen across the seat has, too; it is reported beside it. The minimum distance is that of the
pelvis to the seat's middle. All by the zone in which a trial began, and how often which skill followed
which, by the side of the chair (figure 7).
"""

from __future__ import annotations

import argparse
import base64
import json
import re
from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from understudy.command.command import Command
from understudy.errors import ConfigError
from understudy.folders import read
from understudy.records import runs
from understudy.records.runs import Run
from understudy.running.environment import Environment
from understudy.running.step import Step
from understudy.setup.building import Built, build_environment
from understudy.setup.config import Experiment
from understudy_reinforcement.evaluation import wilson_interval
from understudy_reinforcement.policy import Policy
from understudy_report.section import ReportSection
from understudy_skills.episodes import act_out, policy_of
from understudy_skills.skill import Skill, open_skill

#: s of uninterrupted sitting, or contact.
SEATED = 3.0
#: Trials of which some are filmed.
_FILMED = 64
FILE = "trials.json"
#: Fields of a task in which one sits down.
_READ = ("zone", "side", "seated_seconds", "contact_seconds", "seat_distance", "switch")
SIDES = ("right", "left")
#: Trials at most; they are simulated at once.
_MOST = 1_000_000


def check_trials(trials: int, least: int) -> None:
    """Refuse so many trials where they are fewer than `least`, or more than are simulated at once.

    Raises
    ------
    ConfigError
        if they are.
    """
    if not least <= trials <= _MOST:
        raise ConfigError(f"--trials={trials} is not possible: give {least} to {_MOST}.")


class Trials(Command):
    """Judges a controller that sits down, over many trials in one batch; writes RUN/trials.json."""

    example = "understudy sitting trials sitting/meta"

    takes_overrides = True

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("run", help="a finished run's folder, or a skill")
        parser.add_argument(
            "--trials", type=int, default=10_000, help="how many trials are made, all at once"
        )
        parser.add_argument(
            "--film", action="store_true",
            help="film a success of each zone and the commonest failure, out of 64 further trials, for the report",
        )  # fmt: skip

    def run(self, options: argparse.Namespace) -> int:
        check_trials(options.trials, 1)
        run = runs.open_run(options.run) if Path(options.run).is_dir() else None
        if options.film and run is None:
            raise ConfigError(
                f"--film keeps its videos in a run's folder, and {options.run} is none. Unpack a skill "
                "(understudy play SKILL --unpack FOLDER) and give that folder."
            )
        skill = open_skill(options.run, options.overrides)
        judged = {
            "overrides": options.overrides,
            "seed": skill.experiment.root.seed,
            "samples": skill.samples,
        }
        found = {"judged": judged, **judge(skill, options.trials)}
        if run is not None:
            if options.film:
                from understudy_sitting.examples import film

                found["films"] = film(skill, run.path, _FILMED)
            run.write_json(FILE, found)
        print(json.dumps(found, indent=1))
        return 0


def judge(skill: Skill, trials: int) -> dict[str, Any]:
    """The figures of `trials` trials of `skill`, acting by its mode."""
    built = built_for(skill, trials)
    try:
        policy = policy_of(skill, built)
        return _figures(*_carry_out(built.environment, policy, skill.experiment))
    finally:
        built.environment.close()


def built_for(skill: Skill, trials: int) -> Built:
    """A world for each of as many `trials` of `skill`.

    Raises
    ------
    ConfigError
        if it does not sit down.
    """
    experiment = skill.experiment
    built = build_environment(
        experiment, num_worlds=trials, episode_seconds=experiment.root.evaluation.seconds, evaluating=True
    )  # fmt: skip
    missing = [name for name in _READ if name not in built.environment.table.shapes]
    if missing:
        built.environment.close()
        raise ConfigError(f"{skill.name} is no controller that sits down: it has no {missing[0]}.")
    return built


def _carry_out(
    environment: Environment, policy: Policy, experiment: Experiment
) -> tuple[dict[str, Tensor], Tensor]:
    """Of each trial: zone, longest time on the seat, longest contact with it, minimum distance; and counts (2, S, S) by side of which
    skill (row) was followed by which (column), of decisions that did not end the trial."""
    environment.reset(experiment.root.seed, "trials")
    table = environment.table
    n, device = environment.num_worlds, environment.device
    skills = len(skills_of(experiment))
    side = table["side"].clone().long()
    found = {
        "zone": table["zone"].clone(),
        "seated": torch.zeros(n, device=device),
        "contact": torch.zeros(n, device=device),
        "distance": torch.full((n,), torch.inf, device=device),
    }
    counts = torch.zeros(2 * skills * skills, device=device)
    before: list[Tensor] = []  # the skill at work at the last decision

    def see(running: Tensor) -> None:
        """Of each control period: sitting may begin and end between decisions."""
        for name in ("seated", "contact"):
            longest = found[name].maximum(table[f"{name}_seconds"])
            found[name] = torch.where(running, longest, found[name])
        distance = table["seat_distance"]
        nearer = running & (distance < found["distance"])  # never NaN, of a world that went wrong
        found["distance"] = torch.where(nearer, distance, found["distance"])

    def decided(running: Tensor, step: Step) -> None:
        switch = table["switch"].long()
        for last in before:
            place = (side * skills + last) * skills + switch
            counts.index_add_(0, place, running.float())
        before[:] = [switch.clone()]
        see(running)

    seconds = experiment.root.evaluation.seconds
    act_out(environment, policy, seconds, see=see, decided=decided)
    return found, counts.view(2, skills, skills).cpu()


def skills_of(experiment: Experiment) -> tuple[str, ...]:
    """The skills that there are to choose from."""
    skills = tuple(getattr(experiment.need("actuation").options, "runs", ()))
    if not skills:
        raise ConfigError("This controller chooses among no skills (actuation.runs).")
    return skills


def _figures(found: dict[str, Tensor], counts: Tensor) -> dict[str, Any]:
    success, contact = (found[name] >= SEATED - 1e-3 for name in ("seated", "contact"))

    def row(chosen: Tensor) -> dict[str, Any]:
        n, rate = int(chosen.sum()), float(success[chosen].float().mean())
        distance = found["distance"][chosen]
        return {
            "trials": n,
            "success_rate": rate,
            "success_rate_95": list(wilson_interval(rate, n)),
            "contact_rate": float(contact[chosen].float().mean()),
            "distance_mean": float(distance.mean()),
            "distance_spread": float(distance.std()) if n > 1 else 0.0,
        }

    zones = sorted({int(zone) for zone in found["zone"].tolist()})
    return {
        "all": row(torch.ones_like(success)),
        "zones": {str(zone): row(found["zone"] == zone) for zone in zones},
        "transitions": {name: counts[k].int().tolist() for k, name in enumerate(SIDES)},
    }


class TransitionsSection(ReportSection):
    """The trials by zone, and which skill followed which, by the side of the chair (figure 7)."""

    title = "Trials"
    order = 45

    def html(self, run: Run) -> str | None:
        file = run.path / FILE
        if not file.is_file():
            return None
        found = json.loads(read(file))
        rows = "".join(_zone(f"zone {zone}", row) for zone, row in found["zones"].items())
        head = "<tr><th></th><th>trials</th><th>success</th><th>3 s of contact</th><th>minimum distance, m</th></tr>"
        table = f"<table>{head}{_zone('all', found['all'])}{rows}</table>"
        names = [
            str(run).rpartition("/")[2]
            for run in (run.config.get("actuation") or {}).get("runs", [])
        ]
        matrices = "".join(
            _matrix(f"Beginning on the {side}", counts, names)
            for side, counts in found["transitions"].items()
        )
        flow = "display:flex;flex-wrap:wrap;gap:24px"
        judged = found.get("judged", {})
        words = escape(" ".join(map(str, judged.get("overrides", ()))))
        given = f"<p>Judged with {words}</p>" if words else ""
        films = "".join(_film(run, shown) for shown in found.get("films", ()))
        cards = (f"{given}{table}", ""), (films, f' style="{flow}"'), (matrices, f' style="{flow}"')
        return "".join(
            f'<div class="card"{style}>{inside}</div>' for inside, style in cards if inside
        )


def _film(run: Run, shown: Mapping[str, Any]) -> str:
    file = run.path / str(shown["file"])
    if not re.fullmatch(r"trials_\d+\.mp4", str(shown["file"])) or not file.is_file():
        return ""
    try:
        data = base64.b64encode(read(file)).decode()
    except OSError:  # larger than any film of ours
        return ""
    video = f'<video muted loop controls playsinline width="480" src="data:video/mp4;base64,{data}"></video>'
    return f'<figure style="margin:0">{video}<figcaption>{escape(str(shown["title"]))}</figcaption></figure>'


def _zone(name: str, row: Mapping[str, Any]) -> str:
    low, high = (100 * float(share) for share in row["success_rate_95"])
    return (
        f"<tr><th>{escape(name)}</th><td>{int(row['trials'])}</td>"
        f"<td>{100 * float(row['success_rate']):.1f} % ({low:.1f} to {high:.1f})</td>"
        f"<td>{100 * float(row['contact_rate']):.1f} %</td>"
        f"<td>{float(row['distance_mean']):.3f} ± {float(row['distance_spread']):.3f}</td></tr>"
    )


def _matrix(title: str, counts: list[list[int]], names: list[str]) -> str:
    """Shares of each row's changes, darker for more."""
    labels = names if len(names) == len(counts) else [str(k) for k in range(len(counts))]
    head = "".join(f"<th>{escape(label)}</th>" for label in labels)
    rows = []
    for label, row in zip(labels, counts, strict=True):
        total = max(1, sum(int(count) for count in row))
        cells = "".join(_cell(int(count) / total) for count in row)
        rows.append(f"<tr><th>{escape(label)}</th>{cells}</tr>")
    caption = f"<caption>{escape(title)}: from (row) to (column)</caption>"
    return f"<table>{caption}<tr><th></th>{head}</tr>{''.join(rows)}</table>"


def _cell(share: float) -> str:
    return f'<td style="background:rgba(60,120,200,{share:.2f})">{share:.2f}</td>'

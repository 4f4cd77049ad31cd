"""The miniatures by name, and what they are composed of."""

from __future__ import annotations

from pathlib import Path

from understudy.command.cli import main

#: Stages that others build on: experiment, and iterations of 1024 samples.
BUILT_ON = {"go": 4, "stop": 4, "sleeve": 10}

#: Every miniature and stage of one that is a training.
TRAININGS = ("go", "sitting", "amorphous", "dressing", "jumping", "chopsticks", "styles")

#: Those that are something else.
JOBS = ("sleeve_bank", "poses")

#: So that the last evaluation takes no time.
QUICK = (
    "evaluation.episodes=8",
    "evaluation.final_episodes=8",
    "evaluation.seconds=1.0",
    "checkpoint.minutes=0",
)

#: So that a pack is judged on all its episodes at once.
AT_ONCE = ("evaluation.episodes=32", "evaluation.final_episodes=32")


def train(*overrides: str) -> None:
    assert main(["train", *overrides]) == 0


def overrides_of(name: str, built_on: Path) -> tuple[str, ...]:
    """The miniature `name`, above the runs that it needs."""
    needs = {
        "sitting": (f"actuation.runs=[{built_on / 'go'},{built_on / 'stop'}]",),
        "dressing": (
            f"start.run={built_on / 'sleeve'}",
            f"initial_states.file={built_on / 'bank'}",
        ),
        "styles": (f"actuation.run={built_on / 'poses'}",),
        "sleeve_bank": (f"job.run={built_on / 'sleeve'}",),
    }
    return (f"experiment=miniature/{name}", *needs.get(name, ()))


def make_stages(folder: Path) -> Path:
    """Make the runs ``go``, ``stop``, ``sleeve``, ``bank`` and ``poses`` in `folder`, by the command
    line."""
    for name, iterations in BUILT_ON.items():
        budget = f"budget.samples={1024 * iterations}"
        train(f"experiment=miniature/{name}", budget, *QUICK, f"run.dir={folder / name}")
    bank = (f"job.run={folder / 'sleeve'}", "job.count=64")
    train("experiment=miniature/sleeve_bank", *bank, *QUICK, f"run.dir={folder / 'bank'}")
    budget = "budget.samples=50000"
    train("experiment=miniature/poses", budget, *QUICK[:3], f"run.dir={folder / 'poses'}")
    return folder

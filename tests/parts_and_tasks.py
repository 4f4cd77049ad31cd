"""Which of the bundled parts go with which of the bundled tasks, found by trying: run as a program, it
writes ``docs/parts-and-tasks.md``."""

from __future__ import annotations

import itertools
import re
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import torch
from miniatures import make_stages, overrides_of

from understudy.errors import UnderstudyError
from understudy.running.training import Training
from understudy.setup.composition import load_experiment, replaced
from understudy.setup.config import Experiment
from understudy.setup.plugins import Plugins, installed, load

PAGE = Path(__file__).resolve().parents[1] / "docs" / "parts-and-tasks.md"

#: The groups whose options are swapped in.
GROUPS = ("policy", "learner", "termination", "initial_states", "curriculum", "reward")

#: What an option's file leaves to be given. RUNS stands for the folder of the stages' runs.
GIVEN = {
    "initial_states=bank": ("initial_states.file=RUNS/bank",),
    "initial_states=sequencing/gaussian": ("initial_states.file=RUNS/bank",),
    "curriculum=linear": ("curriculum.samples=1000",),
    "curriculum=adaptive": ("curriculum.threshold=0.5",),
    "curriculum=staggered": ("curriculum.seconds=1.0",),
    "initial_states=sitting/where_others_ended": ("initial_states.banks=[RUNS/bank]",),
}

#: Tasks that need runs of other tasks, and what they are given.
ABOVE = {
    f"miniature/{name}": overrides_of(name, Path("RUNS"))[1:]
    for name in ("sitting", "dressing", "styles")
}

#: So that an iteration and an evaluation take next to no time.
TINY = (
    "num_worlds=8",
    "learner.rollout_steps=32",
    "evaluation.episodes=2",
    "evaluation.final_episodes=2",
    "evaluation.seconds=0.5",  # a decision of sitting's controller
)

#: Parts whose batches are larger than such an iteration.
SMALLER = {
    f"learner=deepmimic/{name}_gpu": ("learner.batch_size=128",)
    for name in ("released", "optimised_walk", "optimised_backflip", "found_walk")
}


def bundled() -> Plugins:
    """The plugins of this distribution, without others that are installed."""
    return load(only=[p.name for p in installed().loaded if p.distribution == "understudy"])


def options(plugins: Plugins, group: str) -> list[str]:
    """The options that the plugins' files offer for `group`, as one writes them."""
    return sorted(
        file.relative_to(folder / group).with_suffix("").as_posix()
        for _, folder in plugins.folders()
        for file in (folder / group).rglob("*.yaml")
    )


def parts(plugins: Plugins) -> list[str]:
    """The rows: every option as a word of the command line."""
    return [f"{group}={option}" for group in GROUPS for option in options(plugins, group)]


def tasks(plugins: Plugins) -> list[str]:
    """The columns: every registered task, and those above other runs."""
    return sorted({*(t.name for t in plugins.registry.tasks.values()), *ABOVE})


def once_through(experiment: Experiment) -> Experiment:
    """With a learner that goes through its batch once, if it is one that goes through it again and again."""
    learner = experiment.one("learner")
    if learner is None or not hasattr(learner.options, "epochs"):
        return experiment
    chosen = replace(learner, options=replace(learner.options, epochs=1))
    return replace(experiment, choices={**experiment.choices, "learner": (chosen,)})


def attempt(
    task: str, part: str, runs: Path, plugins: Plugins, more: Sequence[str] | None = None
) -> str:
    """What comes of training `task`, or the experiment of that name, with `part` swapped in: "" if an
    iteration and an evaluation can be made, else the sentence that refuses it.

    `more` replaces what :data:`GIVEN` has for the part.
    """
    experiment = task in options(plugins, "experiment")
    learns = () if experiment else ("policy=mlp", "learner=ppo")
    given = GIVEN.get(part, ()) if more is None else more
    chosen = f"{'experiment' if experiment else 'task'}={task}"
    group = part.partition("=")[0]
    above = [item for item in ABOVE.get(task, ()) if not item.startswith(f"{group}.")]
    overrides = replaced([chosen, *learns, *above, *TINY], [part, *given, *SMALLER.get(part, ())])
    training = None
    try:
        overrides = [item.replace("RUNS", str(runs)) for item in overrides]
        training = Training(once_through(load_experiment(overrides, plugins))).prepare()
        training.iterate()
        training.job.evaluate("parts", 2)
    except UnderstudyError as error:
        return str(error).replace(str(runs), "RUNS")
    finally:
        if training is not None:
            training.close()
    return ""


def page(outcomes: Mapping[tuple[str, str], str]) -> str:
    """The Markdown page of `outcomes`, by (part, task)."""
    rows = list(dict.fromkeys(part for part, _ in outcomes))
    columns = list(dict.fromkeys(task for _, task in outcomes))
    notes = list(dict.fromkeys(sentence for sentence in outcomes.values() if sentence))

    def cell(sentence: str) -> str:
        return f"[{notes.index(sentence) + 1}](#why-not)" if sentence else "✓"

    def row(cells: Iterable[str]) -> str:
        return f"| {' | '.join(cells)} |"

    table = [
        row(["", *(f"`{task}`" for task in columns)]),
        row(["---"] * (len(columns) + 1)),
        *(
            row([f"`{' '.join((part, *GIVEN.get(part, ())))}`"]
                + [cell(outcomes[part, task]) for task in columns])
            for part in rows
        ),
    ]  # fmt: skip
    return "\n".join([
        HEAD, *table, "", "## Why not", "", *(f"{i}. {note}" for i, note in enumerate(notes, 1)), ""
    ])  # fmt: skip


HEAD = """# Parts and tasks

Every part that the bundled plugins offer as a word of the command line, swapped into every bundled
task (the experiment of that name, if there is one): `understudy train experiment=TASK PART`. ✓ trains
and is evaluated; a number is the sentence that refuses it. RUNS holds the runs that `sitting`,
`dressing` and `styles` build on, and `bank`, harvested from `sleeve`. `make parts-and-tasks` writes this
page, and a test keeps it true.
"""


def read(text: str) -> dict[tuple[str, str], str]:
    """The outcomes, by (part, task), that a page shows."""
    cells = [row.strip("| ").split(" | ") for row in text.splitlines() if row.startswith("|")]
    sentences = dict(re.findall(r"^(\d+)\. (.+)$", text, re.M))
    columns = [name.strip("`") for name in cells[0]]
    return {
        (row[0].strip("`").split()[0], task): sentences.get(cell.partition("]")[0][1:], "")
        for row in cells[2:]
        for task, cell in zip(columns, row[1:], strict=True)
    }


def _row(part: str, runs: Path) -> list[tuple[tuple[str, str], str]]:
    torch.set_num_threads(1)
    plugins = bundled()
    return [((part, task), attempt(task, part, runs, plugins)) for task in tasks(plugins)]


def main() -> None:
    with tempfile.TemporaryDirectory() as folder, ProcessPoolExecutor() as pool:
        runs = make_stages(Path(folder))
        rows = pool.map(_row, parts(bundled()), itertools.repeat(runs))
        outcomes = dict(itertools.chain.from_iterable(rows))
    PAGE.write_text(page(outcomes), encoding="utf-8")


if __name__ == "__main__":
    main()

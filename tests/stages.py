"""Runs for the shipped experiments that build on others: trained next to not at all, since what they can do does not
matter to who only wants the experiment composed."""

from __future__ import annotations

import os
from fnmatch import fnmatch
from pathlib import Path

from garment_files import write_gown
from miniatures import make_stages, train

#: Where the clips are that are not part of the distribution.
DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
if DATA.is_dir():
    os.environ.setdefault("UNDERSTUDY_DATA", str(DATA))

#: The whole person and its cloth in as few steps as a small one's, on the CPU.
COARSE = ("simulators.person={name: mujoco}", "scene.steps.cloth=3")

_BANK = ("job.moment=anywhere", "job.ending=any", "job.count=8", "device=cpu", "num_worlds=4")

#: A generated run in place of the captured one, whose clip is not everywhere.
_RUN = ("motion.name=run", "fields.arrival.at=2.0")

#: Each stage: its words, RUNS standing for the folder of all.
STAGES = {
    "walk": ("experiment=sitting/walk",),
    "ends": ("experiment=sitting/ends", "job.run=RUNS/walk", *_BANK),
    "meta": ("experiment=sitting/meta",),
    "switches": (
        "experiment=sitting/switches", "job.run=RUNS/meta", "job.field=null", "job.value=0", *_BANK
    ),
    "dressed": ("experiment=dressing/sleeve", *COARSE),
    "shirt": ("experiment=dressing/shirt_grip", *COARSE),
    "second": ("experiment=miniature/second_place",),
    "run_up": ("experiment=jumping/run_up_small", *_RUN),
    "run_up_end": ("job=harvest", "job.run=RUNS/run_up", *_BANK),
    "jump": ("experiment=jumping/high_small",),
}  # fmt: skip

_ONE_SAMPLE = (
    "device=cpu", "num_worlds=4", "budget.samples=1", "learner.minibatches=1", "learner.rollout_steps=4",
    "evaluation.episodes=1", "evaluation.final_episodes=1", "evaluation.seconds=0.1",
    "evaluation.criterion=null", "run.video_seconds=0",
)  # fmt: skip

_STAGE = "{{run: RUNS/{run}, until: {{field: {name}_distance, at_most: 0.2}}, seconds: 3, reads: {{offset: {name}_offset}}}}"

_RUN_UP = (
    "{run: RUNS/run_up, until: {field: arrived, at_least: 1}, seconds: 5, reads: {reference_root_position: approached_position, "
    "reference_root_heading: approached_heading}}"
)
_JUMP = "{run: RUNS/jump, until: {field: landed, at_least: 1}, seconds: 1.99}"

#: What experiments are given, by pattern.
GIVEN = {
    "miniature/sitting": ("actuation.runs=[RUNS/go,RUNS/stop]",),
    "miniature/dressing": ("start.run=RUNS/sleeve", "initial_states.file=RUNS/bank"),
    "miniature/styles": ("actuation.run=RUNS/poses",),
    "miniature/sleeve_bank": ("job.run=RUNS/sleeve",),
    "miniature/in_sequence": (
        f"actuation.stages=[{_STAGE.format(run='sleeve', name='first')},{_STAGE.format(run='second', name='second')}]",
    ),
    "jumping/from_run_up_gpu": ("initial_states.file=RUNS/run_ups_ends",),
    "jumping/in_one": (
        "initial_states.file=RUNS/run_up_end",
        f"actuation.stages=[{_RUN_UP}, {_JUMP}]",
        *_RUN,
    ),
    "sitting/ends": ("job.run=RUNS/walk",),
    "sitting/switches": ("job.run=RUNS/meta", "job.value=3"),
    "sitting/*_tuned": ("initial_states.banks=[RUNS/ends]", "start.run=RUNS/walk"),
    "sitting/turn_*_slowed": ("initial_states.banks=[RUNS/ends]", "start.run=RUNS/walk"),
    "sitting/turn_*_switched": ("initial_states.banks=[RUNS/ends]", "start.run=RUNS/walk"),
    "sitting/sit_switched": ("initial_states.banks=[RUNS/switches]", "start.run=RUNS/walk"),
    "sitting/sit_any_chair": ("initial_states.banks=[RUNS/switches]", "start.run=RUNS/walk"),
    "dressing/gown": ("scenes.cloth.file=RUNS/gown.yaml",),
    "dressing/gown_gripper": ("scenes.cloth.file=RUNS/gown.yaml", "actuation.run=RUNS/dressed"),
    "dressing/shirt_sleeve_led": ("initial_states.file=RUNS/led/ends",),
    "dressing/shirt_finish_led": ("initial_states.file=RUNS/led/ends",),
    "dressing/shirt_regrip_led": ("initial_states.file=RUNS/led/ends",),
    "dressing/shirt_sleeve_larger_led": ("initial_states.file=RUNS/led/ends",),
    "dressing/shirt_sleeve_second_larger_led": ("initial_states.file=RUNS/led/ends",),
    "dressing/shirt_sleeve_second_led": ("initial_states.file=RUNS/led/ends",),
    "dressing/shirt_tuck_led": ("initial_states.file=RUNS/led/tucks",),
    "dressing/shirt_tuck_second_led": ("initial_states.file=RUNS/led/tucks",),
    "dressing/gripper": ("actuation.run=RUNS/dressed",),
    "dressing/shirt": (
        "actuation.stages=[{run: RUNS/shirt, until: {field: gripped, at_least: 1.0}, seconds: 4.0}]",
    ),
}


def above(name: str, runs: Path) -> list[str]:
    """What the experiment `name` is given, above the runs in `runs`."""
    found = [words for pattern, words in GIVEN.items() if fnmatch(name, pattern)]
    return [word.replace("RUNS", str(runs)) for words in found for word in words]


def make_all_stages(folder: Path) -> Path:
    """Make every stage, the miniatures' too, in `folder`, by the command line."""
    make_stages(folder)
    write_gown(folder)
    for name, words in STAGES.items():
        given = [word.replace("RUNS", str(folder)) for word in words]
        train(*given, *([] if "job.run" in str(words) else _ONE_SAMPLE), f"run.dir={folder / name}")
    return folder

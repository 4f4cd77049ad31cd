"""Replaying fault dumps: repeats the simulator step in which a training's numbers went wrong."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from understudy.errors import RunError
from understudy.records import checkpoint, runs
from understudy.running.soundness import sound
from understudy.setup.building import build_environment
from understudy.setup.plugins import Plugins, installed
from understudy.setup.validation import refuse_code, validate


@dataclass(frozen=True)
class ReplayedStep:
    """What repeating a dumped step gave; rows are the dumped worlds."""

    worlds: Tensor  #: their numbers in the training
    failed: Tensor  #: (W,) bool: those whose controls or simulation go wrong again
    snapshot: dict[str, Tensor]  #: the simulator's state after the step


def replay_step(path: Path | str, plugins: Plugins | None = None) -> ReplayedStep:
    """Repeat the decision that a run's ``faults/step.json`` holds, in as many worlds as failed in it.

    Raises
    ------
    RunError
        if the dump is missing or damaged.
    """
    state, meta = checkpoint.load(Path(path))
    refuse_code(meta.get("config"))
    try:
        config, worlds, substeps = dict(meta["config"]), state["worlds"], state["substeps"]
        snapshot, controls, count = dict(state["snapshot"]), list(state["controls"]), len(worlds)
    except (LookupError, TypeError, ValueError) as error:
        raise RunError(f"{path} is no dump of a step that went wrong: {error}.") from error
    registry, folder = (plugins or installed()).registry, Path(path).parent.parent
    if (folder / "run.json").is_file():
        experiment = runs.open_run(folder).experiment(registry, config)
    else:
        experiment = validate(config, registry)
    environment = build_environment(experiment, num_worlds=count).environment
    simulator = environment.parts.simulator
    try:
        environment.reset()  # which lets worlds differ in what they differed in
        simulator.restore(snapshot)
        good = torch.ones(count, dtype=torch.bool)
        for control in controls:
            good &= sound(control)
            simulator.step(torch.where(sound(control).unsqueeze(1), control, 0.0), substeps)
            good &= ~simulator.failed()
        return ReplayedStep(worlds, ~good, simulator.snapshot())
    finally:
        environment.close()

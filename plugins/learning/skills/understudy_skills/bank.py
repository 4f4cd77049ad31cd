"""Banks: states in which episodes of one run ended, for episodes of another to begin in."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from understudy.errors import ConfigError, FileError, RunError, suggestion
from understudy.records import checkpoint
from understudy.task import Context, Scene
from understudy_skills.pack_inputs import (
    HELD_OUT,
    MOST,
    MOST_BANKS,
    MOST_BYTES,
    NAME,
    Held,
    PackInputs,
)

__all__ = ["HELD_OUT", "MOST", "NAME", "Held", "files", "fitting", "load", "save", "starts"]

#: Of what harvests keep; of others a simulator or a term would make something without a word.
_KINDS = (torch.float32, torch.float64, torch.int32, torch.int64, torch.bool)


def as_state(banks: Mapping[str, Held]) -> dict[str, Any]:
    """The `banks` of a pack as a checkpoint has them, by name."""
    return {k: {"states": dict(held.states), "of": dict(held.of)} for k, held in banks.items()}


def of_state(state: Any) -> dict[str, Held]:
    """The banks of a pack, from what a checkpoint has of them, whoever wrote that; a ValueError if they are none."""
    if not isinstance(state, dict) or len(state) > MOST_BANKS:
        raise ValueError(f"its banks are none, or more than {MOST_BANKS}")
    found = {}
    for name, bank in state.items():
        if not isinstance(bank, dict) or bank.keys() != {"states", "of"}:
            raise ValueError(f"'{str(name)[:40]}' is no bank")
        try:
            found[name] = held = _checked(f"'{str(name)[:40]}'", bank["states"], bank["of"])
        except FileError as error:
            raise ValueError(str(error)) from error
        size = sum(value.nbytes for value in held.states.values())
        if len(held) > MOST or size > MOST_BYTES:
            raise ValueError(
                f"the bank '{name[:40]}' has {len(held)} states of {size} bytes, too many for a pack"
            )
    return found


def save(
    path: Path, states: Mapping[str, Tensor], about: Mapping[str, Any], scene: Scene | None = None
) -> None:
    """Write `states` of `scene`, fields (M, …) by name, and where they come from, as the bank `path`."""
    of = {} if scene is None else dict(scene.identity())
    checkpoint.save(path, {"states": dict(states)}, {"bank": {**about, "of": of}})


def files(path: str | Path) -> list[Path]:
    """The files of a bank, which is given by one of them or by its run folder."""
    file = Path(path) / NAME if Path(path).is_dir() else Path(path)
    return [file.with_suffix(".json"), file.with_suffix(".safetensors")]


def load(path: str | Path) -> dict[str, Tensor]:
    """The states of a bank, (M, …) by name, from its file or its run folder.

    Raises
    ------
    FileError
        if it is missing, damaged, empty, or no bank.
    """
    return dict(_read(path).states)


def fitting(
    path: str | Path, context: Context, what: str, leave: Collection[str] = ()
) -> dict[str, Tensor]:
    """As :func:`load`, without the fields `leave`, for a bank that is an input of a run; `what` takes it.

    Raises
    ------
    ConfigError
        if a field belongs to another garment or body than the task's, has whole numbers or truth values unlike the
        simulator's, or is one of `leave` and missing.
    FileError
        as :func:`load` does.
    """
    asked, inputs = f"bank {path}", context.inputs

    def find() -> Held:
        return _read(inputs.file(asked, lambda: files(path)))

    held = inputs.bank(asked, find) if isinstance(inputs, PackInputs) else find()
    states, of = dict(held.states), held.of
    for name in leave:
        if name not in states:
            raise ConfigError(
                f"{what}.leave names '{name}', which the bank {path} has not got.{suggestion(name, states)}"
            )
    states = {name: value for name, value in states.items() if name not in leave}
    for name, own in (context.scene.identity() if context.scene else {}).items():
        if name in states and of.get(name, own) != own:
            raise ConfigError(
                f"{what}: the bank {path} does not fit this task: its '{name}' is of {of[name]}, and here it is of "
                f"{own}. Harvest it in a task of this scene."
            )
    simulator = context.simulator
    for name in simulator.state_fields if simulator else ():
        if simulator and name in states:
            kinds = (states[name].dtype, simulator.read(name).dtype)
            if kinds[0].is_floating_point != kinds[1].is_floating_point:
                raise ConfigError(
                    f"{what}: the bank {path} does not fit this simulator: '{name}' is {kinds[0]} there and {kinds[1]} "
                    "here. Harvest it in a task of this scene."
                )
    return states


def starts(
    path: str | Path, context: Context, what: str, leave: Collection[str] = ()
) -> dict[str, Tensor]:
    """The states that episodes may begin in: every fifth in evaluations, the others in trainings, so that an evaluation
    begins where no training did. A single state is for both.
    """
    states = fitting(path, context, what, leave)
    rows = torch.arange(len(next(iter(states.values()))))
    held_out = rows % HELD_OUT == 0
    if len(rows) > 1:
        rows = rows[held_out if context.evaluating else ~held_out]
    return {name: value[rows] for name, value in states.items()}


def _read(path: str | Path) -> Held:
    """The bank of these files, and whose it is, if it says so."""
    try:
        state, about = checkpoint.load(files(path)[0])
    except RunError as error:
        raise FileError(f"The bank {path} cannot be used: {error}") from error
    made = about.get("bank")
    of = made.get("of", {}) if isinstance(made, dict) else {}
    return _checked(str(path), state.get("states"), of)


def _checked(name: str, states: Any, of: Any) -> Held:
    """The bank `name` of what a file has, whoever wrote it; a FileError if it is none, empty or damaged."""
    if not isinstance(states, dict) or not all(isinstance(v, Tensor) for v in states.values()):
        raise FileError(f"{name} is no bank of states.")
    lengths = {len(v) if v.dim() else 0 for v in states.values()}
    if len(lengths) != 1 or 0 in lengths:
        raise FileError(f"The bank {name} has no states, or not equally many of each field.")
    for field_name, value in states.items():
        if value.dtype not in _KINDS or not bool(value.isfinite().all()):
            raise FileError(
                f"The bank {name} is damaged: '{field_name}' has numbers that are not finite, or of a kind that no state has "
                f"({value.dtype}). Harvest it again."
            )
    if not isinstance(of, dict) or not all(isinstance(text, str) for text in of.values()):
        raise FileError(f"{name} is no bank of states.")
    return Held(states, of)

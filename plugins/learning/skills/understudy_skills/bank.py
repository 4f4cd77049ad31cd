"""Banks: states in which episodes of one run ended, for episodes of another to begin in."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from understudy.errors import ConfigError, FileError, RunError, suggestion
from understudy.inputs import Inputs
from understudy.records import checkpoint
from understudy.task import Context, Scene

if TYPE_CHECKING:
    from understudy_skills.skill import Skill

__all__ = ["MOST", "NAME", "BankInputs", "Held", "files", "fitting", "load", "save", "starts"]

#: The bank that a harvest leaves in its run folder.
NAME = "bank"
#: Among a run's copies the policy of a pack from which the run was made.
PACKED = "policy"
#: One of so many states is for evaluations alone.
HELD_OUT = 5
#: Of what harvests keep; of others a simulator or a term would make something without a word.
_KINDS = (torch.float32, torch.float64, torch.int32, torch.int64, torch.bool)
#: States of a bank that a pack has, and bytes of these, at most; and banks of a pack.
MOST, _MOST_BYTES, _MOST_BANKS = 64, 2**23, 16
#: Policies of a pack that act inside its task, at most.
MOST_POLICIES = 16


@dataclass(frozen=True)
class Held:
    """What a bank has: `states`, fields (M, …) by name, and `of` whom they are, as a scene's identity says it."""

    states: Mapping[str, Tensor]
    of: Mapping[str, str] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(next(iter(self.states.values())))


@dataclass
class BankInputs(Inputs):
    """The inputs of a packed skill, which has the banks that its task reads and the policies that act inside it, by what was
    asked for.

    With `gathers` a bank that is read from a file is held, too, with :data:`MOST` of its states at most, and so is a policy:
    what is judged then is what a pack will have.
    """

    banks: dict[str, Held] = field(default_factory=dict)
    policies: dict[str, Skill] = field(default_factory=dict)
    gathers: bool = False
    #: of banks that were gathered: how many states they had
    sizes: dict[str, int] = field(default_factory=dict)
    #: that of the pack from which others are gathered
    had: BankInputs | None = None

    @classmethod
    def gathering(cls, inputs: Inputs) -> BankInputs:
        """As `inputs`, for a skill that will be packed."""
        had = inputs if isinstance(inputs, BankInputs) else None
        return cls(inputs.folder, dict(inputs.kept), gathers=True, had=had)

    def given(self) -> list[str]:
        """What was asked for that is held here and was not in the pack from which it is gathered."""
        had = (*self.had.banks, *self.had.policies) if self.had else ()
        return sorted({*self.banks, *self.policies} - {*had})

    def policy(self, asked: str, find: Callable[[], Skill]) -> Skill:
        """The skill that acts inside the task for what is `asked`: the pack's, else that which `find` opens."""
        if asked in self.policies:
            return self.policies[asked]
        found = (self.had.policies if self.had else {}).get(asked) or find()
        if self.gathers:
            own = BankInputs.gathering(found.experiment.inputs)
            found = replace(found, experiment=replace(found.experiment, inputs=own))
            self.policies[asked] = found
            if len(self.policies) > MOST_POLICIES:
                raise ConfigError(
                    f"--pack: more than {MOST_POLICIES} policies inside one are too many for a pack."
                )
        return found

    def bank(self, asked: str, find: Callable[[], Held]) -> Held:
        """The bank for what is `asked`: the pack's, else that which `find` reads."""
        if asked in self.banks:
            return self.banks[asked]
        found = (self.had.banks if self.had else {}).get(asked) or find()
        if self.gathers:
            self.sizes[asked] = len(found)
            self.banks[asked] = found = _drawn_evenly(asked, found)
            if len(self.banks) > _MOST_BANKS:
                raise ConfigError(f"--pack: more than {_MOST_BANKS} banks are too many for a pack.")
        return found

    def copy(self, folder: Path) -> dict[str, dict[str, str]]:
        """As :meth:`understudy.inputs.Inputs.copy`; banks and policies become files, too."""
        super().copy(folder)
        for asked, held in self.banks.items():
            of = {"bank": {"of": dict(held.of)}}
            self._write(asked, folder, NAME, {"states": dict(held.states)}, of)
        for asked, skill in self.policies.items():
            self._write(asked, folder, PACKED, *skill.packed(inside=True))
        self.banks, self.policies = {}, {}
        return self.kept

    def _write(
        self, asked: str, folder: Path, name: str, state: Mapping[str, Any], card: Mapping[str, Any]
    ) -> None:
        own = folder / str(len(self.kept) + 1)
        own.mkdir(parents=True)
        checkpoint.save(own / name, state, card)
        written = [own / f"{name}{ending}" for ending in (".json", ".safetensors")]
        digests = {f: hashlib.sha256(f.read_bytes()).hexdigest() for f in written}
        self.kept[asked] = {f.relative_to(folder).as_posix(): d for f, d in digests.items()}


def as_state(banks: Mapping[str, Held]) -> dict[str, Any]:
    """The `banks` of a pack as a checkpoint has them, by name."""
    return {k: {"states": dict(held.states), "of": dict(held.of)} for k, held in banks.items()}


def of_state(state: Any) -> dict[str, Held]:
    """The banks of a pack, from what a checkpoint has of them, whoever wrote that; a ValueError if they are none."""
    if not isinstance(state, dict) or len(state) > _MOST_BANKS:
        raise ValueError(f"its banks are none, or more than {_MOST_BANKS}")
    found = {}
    for name, bank in state.items():
        if not isinstance(bank, dict) or bank.keys() != {"states", "of"}:
            raise ValueError(f"'{str(name)[:40]}' is no bank")
        try:
            found[name] = held = _checked(f"'{str(name)[:40]}'", bank["states"], bank["of"])
        except FileError as error:
            raise ValueError(str(error)) from error
        size = sum(value.nbytes for value in held.states.values())
        if len(held) > MOST or size > _MOST_BYTES:
            raise ValueError(
                f"the bank '{name[:40]}' has {len(held)} states of {size} bytes, too many for a pack"
            )
    return found


def _drawn_evenly(asked: str, held: Held) -> Held:
    """As many states as a pack has room for, from all of the bank; those that only evaluations begin in stay these."""
    each = sum(value[0].nbytes for value in held.states.values())
    count = min(len(held), MOST, _MOST_BYTES // max(each, 1))
    if count == len(held):
        return held
    if count < 2:
        raise ConfigError(
            f"--pack: a state of the {asked} has {each / 2**20:.0f} MiB, too much for a pack. Override what begins there, for "
            "example by 'initial_states={name: NAME}'."
        )
    every = torch.arange(len(held))
    kept = torch.arange(count)
    rows = torch.empty_like(kept)
    for own, taken in ((True, kept % HELD_OUT == 0), (False, kept % HELD_OUT != 0)):
        those, number = every[(every % HELD_OUT == 0) == own], int(taken.sum())
        rows[taken] = those[torch.arange(number) * len(those) // number]
    return Held({name: value[rows] for name, value in held.states.items()}, held.of)


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

    held = inputs.bank(asked, find) if isinstance(inputs, BankInputs) else find()
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

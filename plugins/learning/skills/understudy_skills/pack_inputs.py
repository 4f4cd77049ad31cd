"""What a packed skill has beside its policy: banks, policies that act inside it, and other files that its task reads."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import tempfile
import weakref
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from understudy.errors import ConfigError, RunError
from understudy.inputs import Inputs
from understudy.records import checkpoint
from understudy_skills.packing import card_of_no_folder

if TYPE_CHECKING:
    from understudy_skills.skill import Skill

__all__ = [
    "HELD_OUT",
    "MOST",
    "MOST_BANKS",
    "MOST_BYTES",
    "MOST_FILES",
    "MOST_FILE_BYTES",
    "MOST_POLICIES",
    "NAME",
    "OF_OTHERS",
    "PACKED",
    "Held",
    "PackInputs",
    "files_as_state",
    "files_of_state",
]

#: The bank that a harvest leaves in its run folder, and among a run's copies that of a pack from which the run was made.
NAME = "bank"
#: Among a run's copies the policy of a pack from which the run was made.
PACKED = "policy"
#: One of so many states is for evaluations alone.
HELD_OUT = 5
#: States of a bank that a pack has, and bytes of these, at most; and banks of a pack.
MOST, MOST_BYTES, MOST_BANKS = 64, 2**23, 16
#: Policies of a pack that act inside its task, at most.
MOST_POLICIES = 16
#: Other files of a pack, and bytes of these together, at most.
MOST_FILES, MOST_FILE_BYTES = 64, 2**24
#: What no pack has: files of whoever made them, clips and models, which it names and who plays it has.
OF_OTHERS = ("clip ", "motion.", "mjcf ")
#: What a pack has otherwise.
_ELSEWHERE = ("bank ", "controller ")
#: Part of the name of a file in a pack, what no part has, and how many a name has at most.
_PART, _NO_PART = re.compile(r"(?!\.)[\w.@+=, ()-]{1,100}"), re.compile(r"^\.|[^\w.@+=, ()-]")
_DEEPEST = 6


@dataclass(frozen=True)
class Held:
    """What a bank has: `states`, fields (M, …) by name, and `of` whom they are, as a scene's identity says it."""

    states: Mapping[str, Tensor]
    of: Mapping[str, str] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(next(iter(self.states.values())))


#: The content of files by name, the main one first.
Files = Mapping[str, bytes]


@dataclass
class PackInputs(Inputs):
    """The inputs of a packed skill, which has the banks and other files that its task reads and the policies that act inside it,
    by what was asked for.

    With `gathers` a bank that is read from a file is held, too, with :data:`MOST` of its states at most, and so is a policy:
    what is judged then is what a pack will have. Other files are as they are.
    """

    banks: dict[str, Held] = field(default_factory=dict)
    policies: dict[str, Skill] = field(default_factory=dict)
    files: dict[str, Files] = field(default_factory=dict)
    gathers: bool = False
    #: of banks that were gathered: how many states they had
    sizes: dict[str, int] = field(default_factory=dict)
    #: that of the pack from which others are gathered
    had: PackInputs | None = None
    #: what was asked for
    asked: set[str] = field(default_factory=set)

    @classmethod
    def gathering(cls, inputs: Inputs) -> PackInputs:
        """As `inputs`, for a skill that will be packed."""
        had = inputs if isinstance(inputs, PackInputs) else None
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
            own = PackInputs.gathering(found.experiment.inputs)
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
            if len(self.banks) > MOST_BANKS:
                raise ConfigError(f"--pack: more than {MOST_BANKS} banks are too many for a pack.")
        return found

    def file(self, asked: str, find: Callable[[], Iterable[Path]]) -> Path:
        """As :meth:`understudy.inputs.Inputs.file`; the pack's file is written where programs keep what they need for a while."""
        self.asked.add(asked)
        if self.had and asked in self.had.files:
            return self.had.file(asked, find)
        if asked in self.files and asked not in self.kept:
            try:
                if not self.kept:
                    self.folder = Path(tempfile.mkdtemp(prefix="understudy-"))
                    weakref.finalize(self, _remove, self.folder, os.getpid())
                self._write_files(asked, self.folder)
            except OSError as error:
                raise RunError(
                    f"A file of the pack cannot be written among the system's temporary files: {error.strerror}. Make room there, "
                    "or name another folder, TMPDIR=FOLDER."
                ) from error
        return super().file(asked, find)

    def folder_of(self, asked: str, source: Path, fill: Callable[[Path], None]) -> Path:
        """As :meth:`understudy.inputs.Inputs.folder_of`, of the pack's files."""
        self.asked.add(asked)
        if self.had and asked in self.had.files:
            return self.had.folder_of(asked, source, fill)
        if asked in self.files:
            return self.file(asked, list).parent
        return super().folder_of(asked, source, fill)

    def carried(self) -> dict[str, Files]:
        """The files that were asked for, but for :data:`OF_OTHERS`, banks and policies.

        Raises
        ------
        ConfigError
            they are too many, or too large, for a pack.
        """
        try:
            found = self._carried()
        except OSError as error:
            raise ConfigError(
                f"--pack: the files that its task reads cannot be copied: {error.strerror}. Make room among the system's temporary "
                "files, or name another folder, TMPDIR=FOLDER."
            ) from error
        size = sum(len(content) for files in found.values() for content in files.values())
        if size > MOST_FILE_BYTES or sum(map(len, found.values())) > MOST_FILES:
            largest = max(found, key=lambda a: sum(map(len, found[a].values())))
            raise ConfigError(
                f"--pack: the files that its task reads have {size / 2**20:.0f} MiB, and a pack has room for "
                f"{MOST_FILE_BYTES // 2**20}, and for {MOST_FILES} of them. The largest are {largest}: pass on the run folder, "
                "which has a copy of them."
            )
        return {asked: files for asked, files in found.items() if files}

    def _carried(self) -> dict[str, Files]:
        found = dict[str, Files]()
        with tempfile.TemporaryDirectory(prefix="understudy-") as place:
            read = {asked: paths for asked, paths in self._read.items() if _is_carried(asked)}
            fills = {asked: fill for asked, fill in self._fills.items() if _is_carried(asked)}
            new = Inputs(Path(), {}, read, fills)
            new.copy(Path(place))
            for asked in filter(_is_carried, sorted(self.asked)):
                if self.had and asked in self.had.files:
                    had = self.had.files[asked]  # maybe of a version that wrote folders
                    found[asked] = {n: card_of_no_folder(n, c) for n, c in had.items()}
                    continue
                own = new if asked in new.kept else self
                kept = list(own.kept.get(asked, ()))
                plain = [_plain(name.partition("/")[2]) for name in kept]
                if not all(map(_is_plain, plain)) or _collide(plain):
                    raise ConfigError(
                        f"--pack: the files of {asked} are of names that no pack can have, too deep in folders or alike but for their "
                        "signs. Rename them, or pass on the run folder, which has a copy of them."
                    )
                contents = (
                    card_of_no_folder(name, (own.folder / name).read_bytes()) for name in kept
                )
                found[asked] = dict(zip(plain, contents, strict=True))
        return found

    def copy(self, folder: Path) -> dict[str, dict[str, str]]:
        """As :meth:`understudy.inputs.Inputs.copy`; what the pack has becomes files, too."""
        for asked in self.files:
            self.kept.pop(asked, None)
        super().copy(folder)
        for asked in self.files:
            self._write_files(asked, folder)
        for asked, held in self.banks.items():
            of = {"bank": {"of": dict(held.of)}}
            self._write(asked, folder, NAME, {"states": dict(held.states)}, of)
        for asked, skill in self.policies.items():
            self._write(asked, folder, PACKED, *skill.packed(inside=True))
        self.banks, self.policies, self.files = {}, {}, {}
        return self.kept

    def _write_files(self, asked: str, folder: Path) -> None:
        own = folder / str(len(self.kept) + 1)
        for name, content in self.files[asked].items():
            (own / name).parent.mkdir(parents=True, exist_ok=True)
            (own / name).write_bytes(content)
        self._keep(asked, folder, [own / name for name in self.files[asked]])

    def _write(
        self, asked: str, folder: Path, name: str, state: Mapping[str, Any], card: Mapping[str, Any]
    ) -> None:
        own = folder / str(len(self.kept) + 1)
        own.mkdir(parents=True)
        checkpoint.save(own / name, state, card)
        self._keep(asked, folder, [own / f"{name}{ending}" for ending in (".json", ".safetensors")])

    def _keep(self, asked: str, folder: Path, written: Sequence[Path]) -> None:
        digests = {f: hashlib.sha256(f.read_bytes()).hexdigest() for f in written}
        self.kept[asked] = {f.relative_to(folder).as_posix(): d for f, d in digests.items()}


def files_as_state(carried: Mapping[str, Files]) -> list[dict[str, Any]]:
    """The files of a pack as a checkpoint has them."""
    return [
        {
            "asked": asked,
            "names": list(files),
            "contents": [
                torch.from_numpy(np.frombuffer(c, np.uint8).copy()) for c in files.values()
            ],
        }
        for asked, files in carried.items()
    ]


def files_of_state(state: Any) -> dict[str, Files]:
    """The files of a pack, from what a checkpoint has of them, whoever wrote that; a ValueError if they are none."""
    found, count, size = dict[str, Files](), 0, 0
    if not isinstance(state, list) or len(state) > MOST_FILES:
        raise ValueError(f"its files are none, or more than {MOST_FILES}")
    for entry in state:
        if not isinstance(entry, dict) or entry.keys() != {"asked", "names", "contents"}:
            raise ValueError("a file of it is none")
        asked, names, contents = entry["asked"], entry["names"], entry["contents"]
        if not isinstance(asked, str) or asked in found or not _is_carried(asked):
            raise ValueError(f"'{str(asked)[:40]}' is nothing that a pack has a file of")
        if not isinstance(names, list) or not isinstance(contents, list):
            raise ValueError(f"the files of '{asked[:40]}' are none")
        if not names or len(names) != len(contents) or _collide([*map(str, names)]):
            raise ValueError(
                f"the files of '{asked[:40]}' are none, or two have the same name, or that of a folder"
            )
        count += len(names)
        for name, content in zip(names, contents, strict=True):
            if not _is_plain(name):
                raise ValueError(f"'{str(name)[:40]}' is no name of a file in a pack")
            if (
                not isinstance(content, Tensor)
                or content.dtype != torch.uint8
                or content.dim() != 1
            ):
                raise ValueError(f"the file '{name[:40]}' has no bytes")
            size += len(content)
        if count > MOST_FILES or size > MOST_FILE_BYTES:
            raise ValueError(f"its files are {count} of {size} bytes, too many for a pack")
        found[asked] = {n: c.numpy().tobytes() for n, c in zip(names, contents, strict=True)}
    return found


def _is_carried(asked: str) -> bool:
    return not asked.startswith((*OF_OTHERS, *_ELSEWHERE))


def _is_plain(name: Any) -> bool:
    """Whether `name` is one of a file within a folder, on any system."""
    parts = name.split("/") if isinstance(name, str) else []
    return 0 < len(parts) <= _DEEPEST and all(map(_PART.fullmatch, parts))


def _plain(name: str) -> str:
    """A name that is plain for a file that may have another."""
    return "/".join(_NO_PART.sub("_", part[-100:]) for part in name.split("/"))


def _collide(names: Sequence[str]) -> bool:
    """Whether two of the `names` are of the same file, or one is of a folder that has another, on any system."""
    folded = [name.casefold() for name in names]
    folders = {
        "/".join(name.split("/")[:k]) for name in folded for k in range(1, name.count("/") + 1)
    }
    return len({*folded}) != len(folded) or not folders.isdisjoint(folded)


def _remove(folder: Path, maker: int) -> None:
    """Remove a temporary `folder`, but not where a fork of its `maker`, which still reads it, forgets it."""
    if os.getpid() == maker:
        shutil.rmtree(folder, ignore_errors=True)


def _drawn_evenly(asked: str, held: Held) -> Held:
    """As many states as a pack has room for, from all of the bank; those that only evaluations begin in stay these."""
    each = sum(value[0].nbytes for value in held.states.values())
    count = min(len(held), MOST, MOST_BYTES // max(each, 1))
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

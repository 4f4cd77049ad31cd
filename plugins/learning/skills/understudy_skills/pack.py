"""Writing packs: what goes into one, and what it cannot have."""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from understudy.errors import ConfigError, FileError, RunError
from understudy.options import at
from understudy.records import checkpoint
from understudy_skills.pack_inputs import PackInputs
from understudy_skills.packing import packed_tensor, unpacked, words_in
from understudy_skills.skill import OF_THE_RUN, Skill, asks_for

__all__ = ["gathering", "others_named", "pack", "refuse_of_others", "rounded"]

#: What of a run acts inside another task.
_ACTING = re.compile(r"(encoder|actuation|policy)\b")
#: Options that name a clip or a model.
_FILES_OF_OTHERS = ("motion.file", "motion.skeleton", "scene.character")


def gathering(skill: Skill) -> Skill:
    """`skill`, whose task is read with the banks and policies that :func:`pack` will write."""
    inputs = PackInputs.gathering(skill.experiment.inputs)
    return replace(skill, experiment=replace(skill.experiment, inputs=inputs))


@contextlib.contextmanager
def others_named(skill: Skill, source: str, cure: str) -> Iterator[None]:
    """Inside, a clip or a model that is missing is said to be one of those that the pack `source` only names; `cure` says what
    to do, with ``{}`` for the override that gives it."""
    try:
        yield
    except FileError as error:
        config = skill.card.get("config")
        given = {key: at(config, key) for key in _FILES_OF_OTHERS}
        named = [f"{key}=PATH" for key, name in given.items() if name and str(name) in str(error)]
        if Path(source).is_dir() or not named:
            raise
        raise FileError(
            f"{error} A pack names clips and models, and has no copies of them: {cure.format(named[0])}."
        ) from error


def refuse_of_others(skill: Skill) -> None:
    """Refuse to pack `skill`, which was judged (:func:`gathering`), if its task reads of another run what no pack has: what it did
    not ask for as a bank, a policy that acts inside it, or a file. What its training began with (``start.run``), or its job
    read, is not needed any more.

    Raises
    ------
    ConfigError
        it does; the error says what to override.
    """
    _refuse(skill, "")


def _refuse(skill: Skill, inside: str) -> None:
    """As :func:`refuse_of_others`, of the policy `inside` another, too, of which only :data:`_ACTING` counts."""
    inputs = skill.experiment.inputs
    had = inputs if isinstance(inputs, PackInputs) else PackInputs()
    asked = {*had.banks, *had.policies, *had.asked}
    for key, value in words_in(skill.card["config"]):
        if OF_THE_RUN.match(key) or key.startswith("job.") or (inside and not _ACTING.match(key)):
            continue
        if _is_run(value) and not any(asks_for(a, value) for a in asked):
            cure = (
                "Override it, for example by 'initial_states={name: NAME}' or ~reward.terms.NAME: the pack is then judged and "
                "played with that."
            )
            if inside or key.startswith(
                "actuation."
            ):  # without it it does something else, or nothing
                cure = "Pass on the run folder, which has a copy of it."
            raise ConfigError(
                f"--pack: {inside}{key}={value} is another run's, and what is read of it no pack has. {cure}"
            )
    for name, inner in had.policies.items():
        _refuse(inner, f"{inside}{name.partition(' ')[2]}: ")


def _is_run(word: str) -> bool:
    """Whether the word of a configuration, maybe a stranger's, is a run folder."""
    with contextlib.suppress(OSError):  # of a word that is longer than any path
        return bool(word) and (Path(word) / "run.json").is_file()
    return False


def rounded(skill: Skill, bits: int = 8) -> Skill:
    """`skill` as packing with so many `bits` per weight makes it, so that what is judged is what ships."""
    tensors = {k: unpacked(packed_tensor(v, bits)) for k, v in skill.policy.items()}
    return Skill(skill.name, skill.experiment, tensors, skill.samples, skill.card)


def pack(skill: Skill, path: Path, evaluation: Mapping[str, Any], bits: int = 8) -> None:
    """Write the actor of `skill`, and the banks and policies that it was judged with (:func:`gathering`), as ``PATH.safetensors`` and its
    card as ``PATH.json``.

    Matrices get 8 or 16 `bits` per weight and a scale per row; with 32 they are unchanged, as everything else is.
    `evaluation` goes onto the card.

    Raises
    ------
    RunError
        if they cannot be written; what was there is as it was.
    """
    state, card = replace(skill, card={**skill.card, "evaluation": dict(evaluation)}).packed(bits)
    path.parent.mkdir(parents=True, exist_ok=True)
    # Both files are there before one takes its place: without its tensors, a card that was there is of nothing.
    name = path.name.removesuffix(".json").removesuffix(".safetensors")
    made = path.with_name(f".{name}.{os.getpid()}.partial")
    endings = (".safetensors", ".json")
    try:
        checkpoint.save(made, state, card)
        for ending in endings:
            os.replace(made.with_name(made.name + ending), path.with_name(name + ending))
    except RunError as error:
        raise RunError(str(error).replace(made.name, name)) from error
    except OSError as error:
        raise RunError(f"{path} could not be written: {error.strerror}.") from error
    finally:
        for ending in endings:
            with contextlib.suppress(OSError):  # it is there only if that did not end
                made.with_name(made.name + ending).unlink()

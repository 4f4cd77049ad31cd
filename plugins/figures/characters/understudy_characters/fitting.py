"""Chooses the character whose shapes show a clip."""

from __future__ import annotations

import contextlib
from dataclasses import replace

import numpy as np

from understudy.errors import FileError, PluginError, suggestion
from understudy.setup.registry import Registry
from understudy_characters.character import Character, load_character
from understudy_motion.clip import Clip

__all__ = ["fitting_character", "worn"]

#: Metres by which the lengths of a clip's skeleton may differ from those of a character it fits.
TOLERANCE = 1e-3


def fitting_character(clip: Clip, registry: Registry) -> Character | None:
    """The first registered character that `clip` was made for, if there is one.

    It has the clip's joints (whatever the root is called), in the same tree and at the same distances
    if the clip has a skeleton.
    """
    for name in registry.names("character"):
        with contextlib.suppress(PluginError):  # one that cannot be used here fits no clip
            character = load_character(name, registry)
            if _fits(clip, character):
                return character
    return None


def worn(clip: Clip, character: Character) -> Clip:
    """`clip` on the skeleton of `character`, whose joints it takes by name; rotations are unchanged.

    Raises
    ------
    FileError
        the clip lacks a joint of the character.
    """
    clip = character.posed(clip)
    rows = [0]
    for name in character.joint_names[1:]:
        if name not in clip.joint_names[1:]:
            raise FileError(
                f"Clip {clip.source} has no joint '{name}', which {character.name} needs."
                f"{suggestion(name, clip.joint_names)} Retarget it first: "
                f"{character.retargeting(clip)}."
            )
        rows.append(clip.joint_names.index(name))
    return replace(
        clip,
        rotations=clip.rotations[:, rows],
        joint_names=character.joint_names,
        skeleton=character.skeleton,
    )


def _fits(clip: Clip, character: Character) -> bool:
    if set(clip.joint_names[1:]) != set(character.joint_names[1:]):
        return False
    own, other = clip.skeleton, character.skeleton
    if own is None:
        return True
    rows = [0, *(own.joint_names.index(name) for name in other.joint_names[1:])]
    parents = [-1, *(rows.index(own.parents[row]) for row in rows[1:])]
    return list(other.parents) == parents and np.allclose(
        own.offsets[rows], other.offsets, rtol=0.0, atol=TOLERANCE
    )

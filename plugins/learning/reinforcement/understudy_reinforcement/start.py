"""Beginning a training with parts of another run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from torch import Tensor

from understudy.errors import ConfigError, RunError
from understudy.inputs import Inputs
from understudy.records import runs
from understudy.records.checkpoint import misshapen
from understudy.records.runs import newest_state
from understudy.setup.registry import Registry
from understudy.task import Curriculum, InitialStates, State
from understudy_reinforcement.origins import terms_behind
from understudy_reinforcement.policy import Policy

__all__ = ["Part", "load_part"]

#: What a run can take over from another one.
Part = Literal["actor", "critic", "normaliser", "initial_states", "curriculum"]


@dataclass(frozen=True)
class StartOptions:
    """Begin with parts of another run's newest checkpoint."""

    run: str  #: folder of the other run
    parts: tuple[Part, ...] = ("actor", "critic", "normaliser")  #: what is taken over

    def __post_init__(self) -> None:
        if not self.parts:
            raise ValueError(
                "parts=[] is not possible: name what is taken over, or leave start out."
            )


def section(options: StartOptions, registry: Registry, inputs: Inputs) -> StartOptions:
    """The options themselves: the job reads what they name when a training begins."""
    return options


def policy_parts(policy: Policy) -> dict[str, set[str]]:
    """Which entries of the policy's state belong to its actor, its critic, and its normaliser."""
    critic = {id(p) for p in policy.critic_parameters()}
    parts: dict[str, set[str]] = {"actor": set(), "critic": set(), "normaliser": set()}
    parameters = dict(policy.named_parameters(remove_duplicate=False))
    for name in policy.state_dict():
        parameter = parameters.get(name)
        part = (
            "normaliser" if parameter is None else "critic" if id(parameter) in critic else "actor"
        )
        parts[part].add(name)
    return parts


def take_over(
    start: StartOptions,
    policy: Policy,
    initial_states: InitialStates,
    curriculum: Curriculum | None,
    registry: Registry,
) -> dict[str, Any]:
    """Load the parts that `start` names from the newest checkpoint of its run; returns what came from where, for
    provenance.

    Raises
    ------
    ConfigError
        if it is a skill, by its name or as a packed file, which has no critic.
    RunError
        the run lacks one of them, or it has another shape here; the first one is named.
    """
    packed = start.run.endswith(".json") and Path(start.run).is_file()
    if packed or (start.run in registry.names("skill") and not Path(start.run).is_dir()):
        name = Path(start.run).stem if packed else start.run.replace("/", "-")
        raise ConfigError(
            f"start.run={start.run} is a skill, and a training begins with a run: `understudy play {start.run} "
            f"--unpack runs/{name}` makes one of it."
        )
    state = newest_state(start.run)
    found = state.get("policy", {})
    given: Mapping[str, Tensor] = found if isinstance(found, Mapping) else {}
    own = dict(policy.state_dict())
    entries = policy_parts(policy)
    for part in start.parts:
        for name in sorted(entries.get(part, ())):
            for misfit in misshapen(own[name], given.get(name), name):
                raise RunError(
                    f"start.parts: the {part} of {start.run} does not fit: {misfit}. Leave {part} "
                    "out, or train with the same policy and observations."
                )
            own[name] = given[name]
    policy.load_state_dict(own)
    for name, part in (("initial_states", initial_states), ("curriculum", curriculum)):
        if name not in start.parts:
            continue
        if part is None:
            raise RunError(f"start.parts names the {name}, and this task has none ({name}=…).")
        load_part(part, state, name, f"start.parts: the {name} of {start.run}")
    samples = state["progress"]["samples"]
    begun = runs.open_run(start.run)
    return {
        "run": start.run, "parts": list(start.parts), "samples": samples, "sources": begun.info["sources"],
        "behind": terms_behind(begun.info, begun.path),  # on whose terms the weights are
    }  # fmt: skip


def load_part(part: Curriculum | InitialStates, state: State, name: str, what: str) -> None:
    """Load the environment's part `name` from a checkpoint's `state` into `part`.

    Raises
    ------
    RunError
        there is nothing that fits; the error calls it `what`.
    """
    try:
        given = state["environment"][name]
        for misfit in misshapen(part.state_dict(), given, name):
            raise ValueError(misfit)
        part.load_state_dict(given)
    except (LookupError, ValueError, TypeError, RuntimeError) as error:
        raise RunError(f"{what} do not fit those of this task: {error}.") from error

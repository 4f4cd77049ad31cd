"""Trained policies and the tasks that they were trained for: those that come with a plugin, small files,
and finished runs."""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from understudy.command.command import tell
from understudy.errors import ConfigError, RunError, suggestion
from understudy.folders import read
from understudy.records import checkpoint, runs
from understudy.setup.building import build_environment
from understudy.setup.composition import compose_raw, refuse_resolvers, replaced
from understudy.setup.config import Experiment
from understudy.setup.plugins import installed
from understudy.setup.registry import Registry
from understudy.setup.validation import validate
from understudy_reinforcement.policy import Policy, build_policy
from understudy_skills import bank
from understudy_skills.pack_inputs import (
    MOST_POLICIES,
    Held,
    PackInputs,
    files_as_state,
    files_of_state,
)
from understudy_skills.packing import (
    is_of_a_disk,
    names_within,
    of_no_folder,
    packed_tensor,
    renamed,
    renamed_in,
    sources_of_no_folder,
    unpacked,
    without_place,
    words_in,
    words_of_no_folder,
)

__all__ = ["Skill", "names", "open_skill", "read_card", "with_own_starts"]

#: Overrides that say where and how a run was carried out, not what it was.
OF_THE_RUN = re.compile(r"[+~]*(run|checkpoint|start|search|ablation|outer_loop|executor)\b")
#: What of a run a policy that acts inside another task has no use for.
_NOT_OF_CONTROLLERS = (
    "simulator", "initial_states", "reward", "termination", "measure", "curriculum", "learner", "job", "start",
    "evaluation", "outer_loop", "executor",
)  # fmt: skip


@dataclass(frozen=True)
class Skill:
    """A policy and the task that it was trained for."""

    name: str
    experiment: Experiment
    policy: Mapping[str, Tensor]  #: its tensors, of a packed one without the critic's
    samples: int  #: that it learned from
    card: Mapping[str, Any]  #: what is known of it, for people

    def give(self, policy: Policy) -> None:
        """Copy the tensors into `policy`.

        Raises
        ------
        RunError
            they do not fit its actor.
        """
        own = policy.state_dict()
        actor = {id(parameter) for parameter in policy.actor_parameters()}
        needed = {n for n, p in policy.named_parameters() if id(p) in actor}
        needed |= own.keys() - dict(policy.named_parameters()).keys()  # its statistics
        for name in sorted(needed | self.policy.keys()):
            given = self.policy.get(name)
            if given is None or name not in own or _kind(given) != _kind(own[name]):
                raise RunError(
                    f"{self.name} does not fit this configuration: {name} differs. Use the policy and "
                    "the skills that it was trained with."
                )
            if not bool(given.isfinite().all()):
                raise RunError(f"{self.name} is damaged: {name} is not finite.")
        try:
            policy.load_state_dict({**own, **self.policy})
        except ValueError as error:
            raise RunError(f"{self.name} is damaged: {error}.") from error
        policy.schedule(self.samples)

    def packed(
        self, bits: int = 32, *, inside: bool = False
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """The state and the card of a pack of it: its actor, matrices with so many `bits` per weight; the banks that its task
        reads; and, with their numbers as they are, the policies that act inside it. Of one that is `inside`, the card has what
        a controller is built of. No name is of its makers' folders."""
        kept = {k: v for k, v in self.policy.items() if ".critic." not in f".{k}"}
        state: dict[str, Any] = {"policy": {k: packed_tensor(v, bits) for k, v in kept.items()}}
        card, inputs = dict(self.card), self.experiment.inputs
        if inside:
            known = {key: card.get(key) for key in ("samples", "versions", "sources")}
            card = {**known, "config": _less(card["config"], _NOT_OF_CONTROLLERS)}
        card["sources"] = sources_of_no_folder(card.get("sources"))
        # with what its training began is among its sources; what it is has no use for it
        card["config"] = without_place(_less(card["config"], ("start",)))
        banks, policies, files = dict[str, Held](), dict[str, Skill](), dict[str, Any]()
        if isinstance(inputs, PackInputs):
            banks, policies, files = inputs.banks, inputs.policies, inputs.carried()
        paths = {asked: asked.partition(" ")[2] for asked in (*banks, *policies)}
        for _, word in words_in(card["config"]):
            paths |= {asked: word for asked in files if asks_for(asked, word)}
        others = [w for _, w in words_in(card["config"]) if is_of_a_disk(w)]
        names = names_within([*dict.fromkeys([*paths.values(), *others])], card.get("overrides"))
        config = renamed(dict(card["config"]), names)
        if card.get("overrides") is not None:
            card["overrides"] = words_of_no_folder(
                [renamed_in(word, names) for word in card["overrides"]]
            )
        if isinstance(licence := card.get("licence"), Mapping):
            card["licence"] = {**licence, "items": [of_no_folder(i) for i in licence["items"]]}

        def within(asked: str) -> str:
            path = paths.get(asked, "")
            return names.get(path, path)

        if banks:
            state["banks"] = bank.as_state({within(a): held for a, held in banks.items()})
        if policies:
            inner = {within(a): skill.packed(inside=True) for a, skill in policies.items()}
            state["policies"] = {name: own for name, (own, _) in inner.items()}
            card["policies"] = {name: own for name, (_, own) in inner.items()}
        if files:
            as_asked = {a.removesuffix(paths.get(a, "")) + within(a): f for a, f in files.items()}
            state["files"] = files_as_state(as_asked)
        return state, {**card, "config": config}

    def whole(self) -> dict[str, Tensor]:
        """Its tensors with a new critic, since a packed skill has none.

        Raises
        ------
        RunError
            as :meth:`give`.
        """
        # only sizes are asked, whatever it was trained on
        root = replace(self.experiment.root, device="cpu")
        experiment = replace(self.experiment, root=root)
        built = build_environment(experiment, num_worlds=1)
        try:
            policy = build_policy(experiment, built.context)
            self.give(policy)
        finally:
            built.environment.close()
        return dict(policy.state_dict())


def names() -> list[str]:
    """The names of the skills that come with plugins."""
    return installed().registry.names("skill")


def open_skill(
    source: str,
    overrides: Sequence[str] = (),
    *,
    registry: Registry | None = None,
    without: Collection[str] = (),
) -> Skill:
    """The skill of this name, packed file or run folder.

    `overrides` change its configuration, as in ``understudy evaluate``; `without` names parts that are not needed, and
    may be missing here. `registry` is that of the installed plugins.

    Raises
    ------
    ConfigError
        if there is no such skill.
    RunError
        if the run or file is damaged.
    """
    path, registry = Path(source), registry or installed().registry
    packed = path.suffix == ".json" and path.is_file()
    known = registry.names("skill")
    if source in known:
        path = registry.find("skill", source).call()
        return _packed(path, source, registry, without, overrides)
    if packed:
        return _packed(path, path.stem, registry, without, overrides)
    if path.is_dir():
        return _of_run(path, overrides, registry, without)
    card = path.with_name(f"{path.name.removesuffix('.safetensors')}.json") if path.name else path
    if card.is_file():  # of a pack, which is two files
        raise ConfigError(f"There is no skill '{source}'. Did you mean '{card}'?")
    raise ConfigError(
        f"There is no skill '{source}'.{suggestion(source, known)} The folder of a run will do, too."
    )


def read_card(name: str, registry: Registry | None = None) -> Mapping[str, Any]:
    """What is known of a skill that comes with a plugin, for people. Its weights are not read, nor is it found out whether
    its task can be built here.

    Raises
    ------
    ConfigError
        if there is no such skill.
    RunError
        if its card is damaged.
    """
    path: Path = (registry or installed().registry).find("skill", name).call()
    document = checkpoint.read_sealed(path.with_name(f"{path.name}.json"))
    card = document.get("meta") if isinstance(document, Mapping) else None
    if not isinstance(card, Mapping):
        raise RunError(f"{path} is no packed skill: it has no card.")
    _check_card(card, path)
    return card


def _check_card(card: Mapping[str, Any], path: Path) -> None:
    """Refuse a card whose parts are none, whoever wrote it."""
    if "bank" in card:
        raise RunError(
            f"{path} is a bank of states, and no packed skill: name the run folder that has it, as {path.parent}."
        )
    for key in ("config", "sources", "evaluation"):
        if not isinstance(card.get(key) or {}, Mapping):
            raise RunError(f"{path} is no packed skill: its {key} is no mapping.")
    samples = card.get("samples")
    if type(samples) is not int or not 0 <= samples < 2**63:
        raise RunError(f"{path} is no packed skill: its samples are {str(samples)[:40]}.")


def _of_run(
    path: Path, overrides: Sequence[str], registry: Registry, without: Collection[str]
) -> Skill:
    run = runs.open_run(path)
    config, words = run.config, list(run.info["overrides"])
    if overrides:
        words = run.words(overrides)
        config = compose_raw(words)
    state, meta = run.newest()
    policy = state.get("policy")
    if not isinstance(policy, dict) or not all(isinstance(t, Tensor) for t in policy.values()):
        raise RunError(f"{path} is a run that learns no policy.")
    if not (samples := state["progress"]["samples"]) and run.metrics():
        tell(f"{path} has no checkpoint yet but that before training: nothing is learned in it.")
    card = {
        "config": config,
        "overrides": [o for o in words if not OF_THE_RUN.match(o)],
        "samples": samples,
        "versions": meta.get("versions"),
        "sources": meta.get("sources"),
        "evaluation": None if overrides else _evaluation(path),
    }
    experiment = run.experiment(registry, _less(config, without))
    return Skill(str(path), experiment, policy, samples, card)


def _kind(tensor: Tensor) -> tuple[torch.Size, torch.dtype]:
    """What a tensor of a policy must share with the one that it replaces."""
    return tensor.shape, tensor.dtype


def _evaluation(path: Path) -> Any:
    """The evaluation of the run as it was trained; None if the last one was of something else."""
    try:
        found = json.loads(read(path / "evaluation.json"))
    except (OSError, ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) and found and not found.get("changed") else None


def _less(config: Mapping[str, Any], without: Collection[str]) -> dict[str, Any]:
    return {key: value for key, value in config.items() if key not in without}


def _packed(
    path: Path, name: str, registry: Registry, without: Collection[str], overrides: Sequence[str]
) -> Skill:
    state, card, inputs = _loaded(path, registry)
    if overrides:
        words = replaced(words_of(card, name), overrides)
        refuse_resolvers(words[: len(words) - len(overrides)], name)
        card = {**card, "overrides": words, "config": compose_raw(words), "evaluation": None}
    return _made_of(path, name, state, card, inputs, registry, without)


def _made_of(
    path: Path, name: str, state: Mapping[str, Any], card: Mapping[str, Any], inputs: PackInputs,
    registry: Registry, without: Collection[str],
) -> Skill:  # fmt: skip
    """The skill of what the packed file `path` has, whoever wrote that."""
    _check_card(card, path)
    try:
        tensors = {key: unpacked(value) for key, value in state["policy"].items()}
        experiment = replace(validate(_less(card["config"], without), registry), inputs=inputs)
    except ConfigError:
        raise
    except (ArithmeticError, LookupError, TypeError, ValueError, AttributeError) as error:
        raise RunError(f"{path} is no packed skill: {type(error).__name__}: {error}.") from error
    return Skill(name, experiment, tensors, card["samples"], card)


def _loaded(path: Path, registry: Registry) -> tuple[dict[str, Any], dict[str, Any], PackInputs]:
    """What a packed skill's files have, and the banks and policies within."""
    state, card = checkpoint.load(path)
    inputs = _inputs_of(path, state, card, registry, [])
    return state, {key: value for key, value in card.items() if key != "policies"}, inputs


def _inputs_of(
    path: Path, state: Any, card: Any, registry: Registry, seen: list[str]
) -> PackInputs:  # fmt: skip
    """The banks and policies of the packed skill `path`, whoever wrote it; `seen` are the names of all policies so far."""
    wrong = f"{path} is no packed skill"
    if not isinstance(state, Mapping) or not isinstance(card, Mapping):
        raise RunError(f"{wrong}: a policy of it is none.")
    try:
        banks = bank.of_state(state.get("banks", {}))
        files = files_of_state(state.get("files", []))
    except ValueError as error:
        raise RunError(f"{wrong}: {error}.") from error
    states, cards = state.get("policies", {}), card.get("policies", {})
    if not isinstance(states, Mapping) or not isinstance(cards, Mapping) or {*states} != {*cards}:
        raise RunError(f"{wrong}: its policies are none, or not those of its card.")
    seen += states
    if len(seen) > MOST_POLICIES:
        raise RunError(f"{wrong}: it has more than {MOST_POLICIES} policies inside.")
    policies = dict[str, Skill]()
    for name, own in states.items():
        inputs = _inputs_of(path, own, cards[name], registry, seen)
        inner = {key: value for key, value in cards[name].items() if key != "policies"}
        policies[f"controller {name}"] = _made_of(
            path, name, own, inner, inputs, registry, _NOT_OF_CONTROLLERS
        )
    held = {f"bank {name}": states for name, states in banks.items()}
    return PackInputs(banks=held, policies=policies, files=files)


def asks_for(asked: str, word: str) -> bool:
    """Whether the word of a configuration is the path, or name, of what was asked for."""
    return asked.endswith((f" {word}", f"={word}"))


def words_of(card: Mapping[str, Any], name: str) -> list[str]:
    """The overrides that made a packed skill."""
    words = card.get("overrides")
    if words is None:
        raise ConfigError(
            f"{name} was packed by a version that left out what it was made by. Pack it again."
        )
    if not isinstance(words, list) or not all(isinstance(word, str) for word in words):
        raise RunError(f"{name} is no packed skill: its overrides are no list of words.")
    return words


def with_own_starts(
    skill: Skill, source: str, *, registry: Registry | None = None
) -> Experiment | None:
    """The task of `skill`, which is `source` under overrides, but with the starts of `source` without them; None if these
    are the same.

    Raises
    ------
    UnderstudyError
        its own starts are missing.
    """
    registry, path = registry or installed().registry, Path(source)
    if path.is_dir():
        run = runs.open_run(path)
        own = run.config
        experiment = run.experiment(registry, _begun_as(own, skill))
    else:
        if source in registry.names("skill"):
            path = registry.find("skill", source).call()
        _, card, inputs = _loaded(path, registry)
        experiment = replace(validate(_begun_as(card["config"], skill), registry), inputs=inputs)
    return None if _starts(experiment) == _starts(skill.experiment) else experiment


def _begun_as(own: Mapping[str, Any], skill: Skill) -> dict[str, Any]:
    """The configuration of `skill`, with `own` starts."""
    config = dict(skill.card["config"])
    evaluation = {k: v for k, v in (config.get("evaluation") or {}).items() if k != "starts"}
    if starts := (own.get("evaluation") or {}).get("starts"):
        evaluation["starts"] = starts
    return {**config, "initial_states": own.get("initial_states"), "evaluation": evaluation}


def _starts(experiment: Experiment) -> list[Any]:
    config = experiment.effective()
    return [config.get("initial_states"), (config.get("evaluation") or {}).get("starts")]

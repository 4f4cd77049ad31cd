"""A job that keeps states of a trained run's episodes, such as their last ones, for other runs to begin in."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import torch
from torch import Tensor

from understudy.errors import ConfigError, RunError, TrainingError, suggestion
from understudy.options import check_range
from understudy.random import WorldStreams
from understudy.records import runs
from understudy.records.checkpoint import misshapen
from understudy.records.runs import Run, newest_state
from understudy.setup.building import build_environment, device_of
from understudy.setup.config import Chosen, Experiment
from understudy.task import State
from understudy_reinforcement.long_work import LongWork
from understudy_reinforcement.origins import terms_behind
from understudy_reinforcement.policy import Policy, build_policy
from understudy_reinforcement.start import load_part
from understudy_skills.folder import run_folder
from understudy_skills.gathered import Gathered, Gathering


def _simulators(experiment: Experiment) -> Mapping[str, tuple[Chosen, ...]]:
    """What is chosen for slots of simulators, the kernel's and those of plugins."""
    slots = experiment.registry.slots.values()
    return {s.name: experiment.choices[s.name] for s in slots if s.kind == "simulator"}


def _without_simulators(config: Mapping[str, Any], own: Experiment) -> dict[str, Any]:
    """A run's `config` less the simulators that `own` chooses: options of others do not fit these."""
    result = dict(config)
    for slot, chosen in _simulators(own).items():
        if not chosen or slot not in result:
            continue
        if own.registry.slots[slot].many:
            names = {one.name for one in chosen}
            result[slot] = {k: v for k, v in result[slot].items() if k not in names}
        else:
            del result[slot]
    return result


def _with_simulators(found: Experiment, own: Experiment) -> dict[str, tuple[Chosen, ...]]:
    """The choices of `found`, and in their place the simulators that `own` chooses."""
    choices = dict(found.choices)
    for slot, chosen in _simulators(own).items():
        choices[slot] = tuple({one.name: one for one in (*choices[slot], *chosen)}.values())
    return choices


class Harvest(Gathering):
    """Runs the policy of a finished run in its own task until there are enough states of the wanted kind.

    Number of worlds, device and seed are this run's, and so is the simulator if it sets one (``simulator=``, or
    ``simulators.MEMBER.name=`` for a member of a composite). It writes the bank ``bank`` into its folder.
    """

    @dataclass(frozen=True)
    class Options:
        run: str  #: folder of the run whose policy acts
        count: int = 1024  #: how many states are wanted, from 1
        #: Which endings count: a termination term's name, an outcome (``success``, ``failure``,
        #: ``truncation``), or ``any``, which also keeps the states of episodes that go wrong.
        ending: str = "success"
        #: ``end``: the state in which the episode ended; ``anywhere``: one of all its states, each
        #: as likely; ``change``: every state in which a decision changes ``field`` to ``value``,
        #: whatever the ending; the first decision of an episode changes nothing.
        moment: Literal["end", "anywhere", "change"] = "end"
        field: str | None = None  #: the field (N,) that changes, for ``moment=change``
        value: float = 0.0  #: value of ``field`` after the change
        lasting: int = 1  #: decisions for which a change must last to count
        fields: tuple[str, ...] = ()  #: fields that are kept beside the simulator's state
        #: Keep also what was decided from the episode's beginning until then, as ``actions`` (T, A), T decisions of a
        #: whole episode, the last one again from there on: what ``actuation=replay`` plays.
        actions: bool = False
        deterministic: bool = False  #: act by the policy's mode instead of sampling
        #: In the task as it is judged, at its target difficulty and from the starts of evaluations; else as
        #: it was trained, at the difficulty that its curriculum came to (a packed skill does not say: where it
        #: began).
        evaluating: bool = False
        decisions: int = 64  #: decisions of every world in an iteration
        #: iterations in a row without any state after which the harvest gives up
        patience: int = 50

        def __post_init__(self) -> None:
            check_range(self, "count", "decisions", "patience", "lasting", least=1)
            if (self.field is None) is (self.moment == "change"):
                raise ValueError(
                    f"moment={self.moment} with field={self.field} is not possible: moment=change needs a "
                    "field that changes, other moments take none."
                )
            if self.lasting > 1 and self.field is None:
                raise ValueError(
                    f"lasting={self.lasting} is not possible: only moment=change has a field that can last."
                )

    policy: Policy

    def __init__(self, options: Options, experiment: Experiment) -> None:
        self.options, self._root = options, experiment.root
        self.device = device_of(experiment.root.device)
        self._source = runs.open_run(run_folder(options.run, registry=experiment.registry))
        if not isinstance(newest_state(str(self._source.path)).get("policy"), Mapping):
            raise RunError(f"job.run: {options.run} is a run that learns no policy. Name another.")
        own = {name: getattr(self._root, name) for name in ("num_worlds", "device", "seed")}
        config = {**self._source.config, **own, "start": None}
        found = self._source.experiment(
            experiment.registry, _without_simulators(config, experiment)
        )
        self._experiment = replace(found, choices=_with_simulators(found, experiment))
        self._gathered = Gathered(options.count)

    def prepare(self) -> None:
        judged = self._experiment.root.evaluation.seconds if self.options.evaluating else None
        built = self._built = build_environment(
            self._experiment, episode_seconds=judged, evaluating=self.options.evaluating
        )
        self.environment = environment = built.environment
        simulator, table = environment.parts.simulator, environment.table
        self._names = self._keeps(self.options.fields, self.options.run)
        options, field = self.options, self.options.field
        if field is not None and table.shapes.get(field) != ():
            known = [name for name, shape in table.shapes.items() if shape == ()]
            raise ConfigError(
                f"job.field={field} is no field of {options.run} with one number for a world."
                + suggestion(field, known)
            )
        terms = {t.name for t in environment.parts.terminations if t.outcome != "report"}
        outcomes = ("success", "failure", "truncation", "any")
        if options.ending not in (*outcomes, *terms):
            raise ConfigError(
                f"job.ending={options.ending} is no ending of {options.run}."
                + suggestion(options.ending, [*outcomes, *terms])
            )
        met = {t.outcome for t in environment.parts.terminations}
        if options.moment != "change" and options.ending in {"success", "failure"} - met:
            raise ConfigError(
                f"job.ending={options.ending}: no episode of {options.run} can end so, since none of its terminations is a "
                f"{options.ending} ({', '.join(sorted(terms)) or 'it has none'}). Episodes that ran out of time are "
                "job.ending=truncation; job.ending=any takes all."
            )
        state = newest_state(str(self._source.path))
        curriculum = environment.parts.curriculum
        if curriculum is not None and not self.options.evaluating and "environment" in state:
            what = f"job.run: the curriculum of {self.options.run}"
            load_part(curriculum, state, "curriculum", what)
        environment.reset()
        self.policy = build_policy(self._experiment, built.context)
        for misfit in misshapen(dict(self.policy.state_dict()), state["policy"], "policy"):
            raise RunError(
                f"job.run: {self.options.run} does not fit its own configuration: {misfit}."
            )
        self.policy.load_state_dict(state["policy"])
        self.policy.schedule(state["progress"]["samples"])
        self._streams = WorldStreams(
            self._root.seed, "harvest", environment.num_worlds, self.device
        )
        self._decide = simulator.replayed(self._advance, environment)
        self._age = torch.zeros(environment.num_worlds, device=self.device)
        self._begun = torch.zeros_like(self._age, dtype=torch.bool)  # by a decision
        self._lasted = torch.zeros_like(self._age)  # decisions since the change
        self._kept: dict[str, Tensor] = {}  # of each world's present episode
        episode = judged or self._experiment.root.episode.seconds
        count = max(1, round(episode / (environment.control_dt * environment.decision)))
        self._actions = torch.zeros(
            environment.num_worlds, count if self.options.actions else 0, environment.action_size,
            device=self.device,
        )  # fmt: skip

    def _advance(self, action: Tensor) -> tuple[dict[str, Tensor], Tensor, Tensor]:
        """One decision; the states that it reached (or that it changed), which of them count, and which
        episodes ended."""
        environment, options = self.environment, self.options
        table, field = environment.table, options.field
        states = {name: table[name].clone() for name in self._names}
        was = None if field is None else table[field].clone()
        step = environment.advance(action)
        which: dict[str, Tensor] = {
            "success": step.succeeded,
            "failure": step.failed,
            "truncation": step.truncated,
            "any": step.ended,
            **step.endings,
        }
        if field is None or was is None:
            states = {name: table[name].clone() for name in self._names}
            counts = which[options.ending] & step.ended
        else:
            changes = (was != options.value) & self._begun
            lasted = (self._lasted + 1) * (changes | (self._lasted > 0))
            self._lasted.copy_(lasted * (table[field] == options.value))
            counts = self._lasted == options.lasting
            self._lasted.mul_(~step.ended)
        counts, ended = counts & ~step.unsound, step.ended.clone()
        self._begun.copy_(~ended)
        environment.begin(step.ended)
        return states, counts, ended

    def _chosen(self, reached: Mapping[str, Tensor], ended: Tensor) -> Mapping[str, Tensor]:
        """For each world, the state to keep if its episode ends now."""
        if self.options.moment != "anywhere":
            return reached
        # reservoir sampling: the k-th state takes the place of the one kept with 1/k
        self._age += 1.0
        take = self._streams.uniform(1).squeeze(1) * self._age < 1.0
        for name, value in reached.items():
            kept = self._kept.get(name, value)
            self._kept[name] = torch.where(take.view(-1, *[1] * (value.dim() - 1)), value, kept)
        self._age *= ~ended
        return self._kept

    def _remember(self, action: Tensor) -> dict[str, Tensor]:
        """The actions of each world's episode, and this one from here on."""
        if not self.options.actions:
            return {}
        count = self._actions.shape[1]
        at = self.environment.episode_step // self.environment.decision
        left = torch.arange(count, device=self.device) >= at.unsqueeze(1)
        self._actions = torch.where(left.unsqueeze(2), action.unsqueeze(1), self._actions)
        return {"actions": self._actions}

    @torch.no_grad()
    def iterate(self, samples: int) -> dict[str, Any]:
        environment, steps = self.environment, self.options.decisions
        seen: dict[str, list[Tensor]] = defaultdict(list)
        work = LongWork(f"{steps} decisions of {environment.num_worlds} worlds", pause=30.0)
        for step in range(steps):
            work.done(step / steps)
            distribution = self.policy.distribution(environment.observations)
            mode = self.options.deterministic
            action = distribution.mode() if mode else distribution.sample(self._streams)
            actions = self._remember(action)
            reached, counted, ended = self._decide(action)
            reached = {**reached, **actions}
            rows = counted.nonzero().squeeze(1)  # few: all worlds' garments would be gigabytes
            for name, value in self._chosen(reached, ended).items():
                seen[name].append(value[rows].cpu())
        new = {name: torch.cat(values) for name, values in seen.items()}
        self._gathered.add(new)
        if self._gathered.barren >= self.options.patience:
            found = self._gathered.count
            raise TrainingError(
                f"No {'further ' * bool(found)}episode of {self.options.run} {self._wanted()} in "
                f"{self._gathered.barren * steps} decisions of {environment.num_worlds} worlds"
                f"{f', after {found} of {self.options.count} states' * bool(found)}. Train it longer, or "
                "choose another."
            )
        episodes = environment.statistics.collect()
        return {
            "consumed": steps * environment.num_worlds,
            "states": self._gathered.count,
            **{f"episode/{name}": value for name, value in episodes.items()},
        }

    def _wanted(self) -> str:
        options = self.options
        if options.field is not None:
            return f"changed job.field={options.field} to job.value={options.value:g}"
        return f"ended by job.ending={options.ending}"

    def products(self, run: Run) -> None:
        options = self.options
        about: dict[str, Any] = {
            "run": options.run,
            "moment": options.moment,
            "kept": self._wanted(),
            "clips": terms_behind(self._source.info, self._source.path),
        }
        self._gathered.save(run, about, self._built.scene if self._built else None)

    def sources(self) -> Mapping[str, Any]:
        behind = terms_behind(self._source.info, self._source.path)
        return {**self._source.info["sources"], "bank": {"run": self.options.run, "behind": behind}}

    def state_dict(self) -> State:
        return {
            "environment": self.environment.state_dict(),
            "streams": self._streams.state_dict(),
            **self._gathered.state_dict(),
            "age": self._age,
            "begun": self._begun.clone(),
            "lasted": self._lasted.clone(),
            "kept": dict(self._kept),
            "actions": self._actions,
        }

    def load_state_dict(self, state: State) -> None:
        self.environment.load_state_dict(state["environment"])
        self._streams.load_state_dict(state["streams"])
        self._age = state["age"].to(self.device)
        self._begun.copy_(state["begun"])
        self._lasted.copy_(state["lasted"])
        self._kept = {name: value.to(self.device) for name, value in state["kept"].items()}
        self._actions = state["actions"].to(self.device)
        self.load_learned(state, 0)

    def forget_worlds(self) -> None:
        super().forget_worlds()
        self._begun.zero_()

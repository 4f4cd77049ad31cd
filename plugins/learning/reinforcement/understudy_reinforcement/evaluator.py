"""Deterministic episodes from starts that training never saw, judged by measures."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from functools import partial

import numpy as np
import torch
from torch import Tensor

from understudy.running.step import Step
from understudy.setup.building import Built, build_environment
from understudy.setup.config import Experiment
from understudy.task import Context
from understudy.task.terms import Reduction
from understudy_reinforcement.evaluation import Evaluation, Measured
from understudy_reinforcement.long_work import LongWork
from understudy_reinforcement.policy import Policy
from understudy_reinforcement.success import success_of

__all__ = ["Evaluator"]


class Reducer:
    """Reduces a measure's values over the steps of an episode, in place."""

    def __init__(self, reduce: Reduction, num_worlds: int, device: torch.device) -> None:
        self.reduce: Reduction = reduce
        self._value = torch.zeros(num_worlds, device=device)
        self._steps = torch.zeros(num_worlds, device=device)

    def start(self) -> None:
        self._value.fill_({"min": math.inf, "max": -math.inf}.get(self.reduce, 0.0))
        self._steps.zero_()

    def digest(self, value: Tensor, running: Tensor) -> None:
        """One step's `value` (N,) of the episodes that are `running` (N,)."""
        combined = {
            "last": lambda: value,
            "min": lambda: torch.minimum(self._value, value),
            "max": lambda: torch.maximum(self._value, value),
            "any": lambda: torch.maximum(
                self._value, torch.where(value.isnan(), torch.nan, (value != 0).float())
            ),
            "sum": lambda: self._value + value,
            "mean": lambda: self._value + value,
        }[self.reduce]()
        self._value.copy_(torch.where(running, combined, self._value))
        self._steps += running

    def result(self) -> Tensor:
        """(N,); NaN where there was no step."""
        value = self._value / self._steps if self.reduce == "mean" else self._value
        return torch.where(self._steps > 0, value, torch.nan)


class Evaluator:
    """One environment, kept between evaluations of the same training.

    Only failures, successes and truncations end an evaluation's episodes; failure terms that
    ``evaluation.failures`` does not name are reported.
    """

    def __init__(
        self, experiment: Experiment, context: Context | None = None, substeps: int | None = None
    ) -> None:
        """`substeps` are the physics steps of a control period, if not the task's own. It shares the sections of
        `context`, and its scene if the physics is the same."""
        substeps = experiment.root.control.substeps if substeps is None else substeps
        options = experiment.root.evaluation
        self.experiment, self.options, self._seed = experiment, options, experiment.root.seed
        self.success = success_of(experiment)
        self.built: Built = build_environment(
            experiment,
            num_worlds=min(options.episodes, options.final_episodes),
            episode_seconds=options.seconds,
            scene=context.scene if context and context.substeps == substeps else None,
            sections=dict(context.sections) if context else None,
            evaluating=True,
            substeps=substeps,
        )
        environment = self.built.environment
        n, device = environment.num_worlds, environment.device

        def flags() -> Tensor:
            return torch.zeros(n, dtype=torch.bool, device=device)

        self._running, self._failed, self._unsound = flags(), flags(), flags()
        self._fired = {t.name: flags() for t in environment.parts.terminations}
        self._seconds = torch.zeros(n, device=device)
        self._reducers = {"return": Reducer("sum", n, device)}
        for term in environment.parts.measures:
            self._reducers[term.name] = Reducer(term.reduce, n, device)
        self._step = environment.parts.simulator.replayed(self._judge, environment)
        own = self.built.context
        self._starts = {c.name: c.build(own) for c in experiment.many("evaluation.starts")}

    def _judge(self, action: Tensor) -> Step:
        """One step of all worlds; those whose first episode is still running are counted."""
        environment, running = self.built.environment, self._running
        step = environment.advance(action)
        self._seconds.copy_(torch.where(running, environment.table["episode_time"], self._seconds))
        for name, fired in step.endings.items():
            self._fired[name] |= fired & running
        counted = running & ~step.unsound  # its measures may be no numbers
        for name, value in {"return": step.rewards, **environment.measure()}.items():
            self._reducers[name].digest(value, counted)
        self._failed |= step.failed & running
        self._unsound |= step.unsound & running
        ended = step.ended
        self._running &= ~ended
        if environment.device.type != "cpu" or bool(ended.any()):
            step.observations = environment.begin(ended)
        return step

    @torch.no_grad()
    def run(
        self,
        policy: Policy,
        draw: str,
        episodes: int,
        *,
        give_up_below: float | None = None,
        on_period: Callable[[Tensor], None] | None = None,
    ) -> Evaluation:
        """Run `episodes`, as many at once as there are worlds; each world counts until its first episode ends.

        Starts are drawn from the random streams named `draw`, which no training uses: the same
        policy and draw give the same result every time. With `give_up_below`, it stops as soon as that success rate
        is out of reach. Before each control period, `on_period` is called with a mask of the worlds that count (N,), until
        it sets ``environment.on_period`` to None. The other ``evaluation.starts`` are judged, too, each on as many episodes
        as there are worlds.
        """
        begun: dict[str, Measured] = {}
        work = LongWork(f"Judging {episodes} episodes")
        worlds = self.built.environment.num_worlds
        batches = math.ceil(episodes / worlds)
        beside = 0 if give_up_below is not None or not self.success else len(self._starts)
        over = 0  # batches

        def far(share: float) -> None:
            work.done((over + share) / (batches + beside))

        for name, part in reversed(self._starts.items()):  # the first stays, and decides
            self.built.environment.parts.initial_states = part
            if beside:
                there: list[bytes] = []
                rows, _ = self._batch(policy, f"{draw}/{name}", worlds, states=there, far=far)
                over += 1
                won = rows["success"].float()
                begun[f"success_from_{name}"] = Measured.of("any", won, len(set(there)))
        found: list[dict[str, Tensor]] = []
        states: list[bytes] | None = [] if give_up_below is None else None
        lost = done = 0
        complete = True
        while done < episodes and complete:
            count = min(worlds, episodes - done)
            allowed = math.inf if give_up_below is None else episodes * (1 - give_up_below) - lost
            batch, complete = self._batch(
                policy, f"{draw}/{len(found)}", count, allowed + 1e-9, on_period, states, far
            )
            over += 1
            lost += count - int(batch["success"].sum()) if self.success else 0
            done = done + count if complete else episodes  # those that are left could all succeed
            found.append(batch)
            on_period = None
        joined = {name: torch.cat([batch[name] for batch in found]) for name in found[0]}
        rate = None if self.success is None else (done - lost) / done
        return self._evaluation(joined, states, done, rate, complete, begun)

    def _evaluation(
        self,
        joined: dict[str, Tensor],
        states: list[bytes] | None,
        episodes: int,
        rate: float | None,
        complete: bool,
        begun: dict[str, Measured],
    ) -> Evaluation:
        """What the rows of all episodes, `joined`, come to; `states` are their starts, if they are known."""

        def shares(*outcomes: str) -> dict[str, float]:
            return {
                term.name: float(joined[f"fired/{term.name}"].float().mean())
                for term in self.built.environment.parts.terminations
                if term.outcome in outcomes
            }

        different = None if states is None else len(set(states))
        compared = f"measure/{self.options.objective}"
        if self.success is not None:
            compared = "success"
        elif compared not in joined:
            compared = "measure/return"
        return Evaluation(
            episodes=episodes,
            success=self.success.text if self.success else "",
            success_rate=rate,
            mean_episode_seconds=float(joined["seconds"].mean()),
            violated=shares("failure", "report"),
            cut=shares("truncation"),
            measures={
                name: Measured.of(reducer.reduce, joined[f"measure/{name}"], different)
                for name, reducer in self._reducers.items()
            }
            | begun,
            objective=self.options.objective,
            seconds=self.options.seconds,
            complete=complete,
            unsound=float(joined["unsound"].float().mean()),
            different_starts=different,
            outcomes=list(zip(states or (), joined[compared].double().tolist(), strict=False)),
            compared=compared.removeprefix("measure/"),
        )

    def _batch(
        self,
        policy: Policy,
        draw: str,
        count: int,
        allowed: float = math.inf,
        on_period: Callable[[Tensor], None] | None = None,
        states: list[bytes] | None = None,
        far: Callable[[float], None] = lambda share: None,
    ) -> tuple[dict[str, Tensor], bool]:
        """The results of `count` episodes, and whether they were all run to the end; not if more than `allowed` failed.
        Digests of the states in which they begin are added to `states`; `far` hears what share of the steps is done."""
        environment = self.built.environment
        observations = environment.reset(self._seed, draw)
        if states is not None:
            states += self._digests(count)
        self._running.fill_(True)
        self._running[count:] = False
        self._seconds.zero_()
        self._failed.zero_()
        self._unsound.zero_()
        for fired in self._fired.values():
            fired.zero_()
        for reducer in self._reducers.values():
            reducer.start()
        decision_seconds = environment.decision * environment.control_dt
        steps = max(1, math.ceil(self.options.seconds / decision_seconds - 1e-6))
        environment.on_period = partial(on_period, self._running) if on_period else None
        complete = True
        for step in range(steps):
            action = policy.distribution(observations).mode()
            observations = self._step(action).observations
            far((step + 1) / steps)
            if step % 30 == 29 and on_period is None and not bool(self._running.any()):
                break  # all are over, and nobody watches the next ones
            if step % 30 == 29 and allowed < count and not self._within(allowed, count):
                complete = False
                break
        found = {
            "success": self._won() if complete else self._won() | self._running,
            "seconds": self._seconds,
            "unsound": self._unsound,
            **{f"measure/{name}": r.result() for name, r in self._reducers.items()},
            **{f"fired/{name}": fired for name, fired in self._fired.items()},
        }
        return {name: value[:count].clone() for name, value in found.items()}, complete

    def _digests(self, count: int) -> list[bytes]:
        """A digest of the state of each of the first `count` worlds: physics, what an episode keeps, observations."""
        environment = self.built.environment
        state = environment.state_dict()
        columns = [
            np.ascontiguousarray(value[:count].cpu().numpy()).reshape(count, -1).view(np.uint8)
            for of in ("simulator", "tensors", "observations")
            for value in state[of].values()
            if value.numel() and value.shape[:1] == (environment.num_worlds,)
        ]
        return [hashlib.sha256(row.tobytes()).digest() for row in np.concatenate(columns, axis=1)]

    def _within(self, allowed: float, count: int) -> bool:
        """Whether the success rate can still be reached, by the episodes that have ended."""
        return int((~self._running & ~self._won())[:count].sum()) <= allowed

    def _won(self) -> Tensor:
        """(N,) bool: the worlds whose first episode has succeeded so far."""
        if self.success is None:
            return torch.ones_like(self._failed)
        measures = {name: reducer.result() for name, reducer in self._reducers.items()}
        return self.success.of(self._failed, self._fired, measures) & ~self._unsound

    def close(self) -> None:
        self.built.environment.close()

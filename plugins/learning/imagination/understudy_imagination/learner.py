"""Learning by derivatives: a model of the character is trained on what the simulator did, and the policy
follows the task's gradient through it."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import torch
from torch import Tensor, nn

from understudy import distributed
from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.random import generator, private_rng
from understudy.task import Context, Rollout, State
from understudy_imagination.adjoint import Adjoint, Gradients, Weights, Window, limited
from understudy_imagination.errors import model_errors
from understudy_imagination.imagined import Imagined
from understudy_imagination.model import WorldModel
from understudy_imagination.replay import Replay
from understudy_imagination.rigid import Rigid
from understudy_mujoco.scene import MujocoScene
from understudy_networks import averages, optimisers
from understudy_networks.graphs import Captured
from understudy_networks.nn import set_precision
from understudy_networks.policies import check_units
from understudy_networks.returns import digest, explained_variance, observations_of
from understudy_reinforcement.learner import Learner
from understudy_reinforcement.policy import Policy

_WHO = "learner 'imagination'"
#: What rollouts have to bring in any case.
_STATE = ("qpos", "qvel")
#: Iterations after which the model's units of input and output stay as they are.
_SETTLING = 3
#: Of an iteration: decisions, and of each world at least.
_SAMPLES, _FEWEST = 2048, 8
#: Iterations from one look at how far the model goes wrong to the next.
_LOOKS = 8
#: Most optimiser steps of the critic an iteration: with many worlds its batches are larger.
_CRITIC_STEPS = 16
#: What a step of the actor is given.
_SEEN, _GOAL = "seen/", "goal"
#: The parameters of worlds of which kinematics does not know.
_FIXED = ("body_", "mocap_")


@dataclass(frozen=True)
class ModelOptions:
    """The network that predicts what a decision does, and how it is trained."""

    hidden: tuple[int, ...] = (512, 256)  #: units of the hidden layers
    #: how many corners of bodies the model is told of: those that touch the floor most
    points: int = 8
    replay: int = 60_000  #: how many of the newest decisions the model is trained on
    #: decisions after which the training of the model, and of the policy with it, begins
    first_samples: int = 10_240
    first_updates: int = 400  #: optimiser steps when the model is first trained
    updates: int = 60  #: optimiser steps of the model in each later iteration
    batch_size: int = 512  #: decisions of an optimiser step
    learning_rate: float = 1e-3  #: learning rate of the model, by Adam

    def __post_init__(self) -> None:
        check_units("hidden", self.hidden)
        check_range(self, "points", least=0)
        check_range(self, "replay", "first_samples", "first_updates", "updates", least=1)
        check_range(self, "batch_size", least=1)
        check_range(self, "learning_rate", above=0)


@dataclass(frozen=True)
class AnnealOptions:
    """After n samples, steps and learning rate are the share 1 / (1 + (n - `after`) / `samples`) of what they were at
    first, and at least the share `least`."""

    after: int = 30_000  #: samples up to which steps and learning rate stay as they are
    samples: int = 80_000  #: samples from there on after which they are half as large
    least: float = 0.1  #: share of them that stays at least

    def __post_init__(self) -> None:
        check_range(self, "after", least=0)
        check_range(self, "samples", least=1)
        check_range(self, "least", above=0, most=1)

    def at(self, samples: int) -> float:
        return max(self.least, 1.0 / (1.0 + max(0, samples - self.after) / self.samples))


class Imagination(Learner):
    """Real trajectories, derivatives of a learned model, and a policy that is regressed onto better
    actions (SVG(∞), Heess et al. 2015; a model of the character as in SuperTrack, Fussell et al. 2021).

    An iteration trains the model on the newest decisions, goes back once along the newest window for
    the cost's derivative by every action, and fits the policy to its own actions, moved against this derivative
    by ``step``. Defaults are those with which the walk of ``spacetime`` was learned.
    """

    @dataclass(frozen=True)
    class Options:
        #: T, decisions per world and iteration; null makes an iteration of 2,048 decisions, or of 8 of
        #: each world if these are more.
        rollout_steps: int | None = None
        #: For each decision, at least so many later ones of its episode count when derivatives are
        #: taken.
        tail: int = 16
        #: Factor by which derivatives shrink with each decision back, beside what the dynamics does
        #: to them.
        decay: float = 0.97
        clip: float = 3.0  #: Largest size of a world's derivative, in medians over the worlds.
        #: Root mean square by which actions move in an iteration, in units of the action's reach.
        step: float = 1 / 6
        #: how steps and learning rate shrink with the samples
        anneal: AnnealOptions = field(default_factory=AnnealOptions)
        learning_rate: float = 1e-3  #: learning rate of the actor, by Adam
        updates: int = 16  #: optimiser steps of the actor in an iteration
        batch_size: int = 256  #: decisions of one optimiser step of the actor
        margin_weight: float = 1.0  #: weight, in the cost, of what is used of each margin
        #: Norm that makes one number of a margin's several shares (one for each joint, say).
        margin_norm: float = 8.0
        margin_power: float = 2.0  #: exponent, in the cost, of what is used of a margin
        #: Weight of actions' mean square, from the middle of their space in units of their reach.
        action_weight: float = 0.012
        reward_weight: float = 1.0  #: weight, in the cost, of rewards that have a derivative
        #: the learned model of the character
        model: ModelOptions = field(default_factory=ModelOptions)
        gamma: float = 0.95  #: discount of the returns that critic and initial states learn from
        td_lambda: float = 0.95  #: λ of these returns, in [0, 1]
        critic_learning_rate: float = 3e-4  #: learning rate of the critic, by Adam
        patience: int = 20  #: non-finite optimiser steps in a row after which the training stops

        def __post_init__(self) -> None:
            check_range(self, "rollout_steps", "tail", "updates", "batch_size", "patience", least=1)
            check_range(self, "decay", "gamma", "td_lambda", least=0, most=1)
            check_range(self, "clip", "step", "learning_rate", "critic_learning_rate", above=0)
            check_range(self, "margin_norm", "margin_power", least=1.0)
            check_range(self, "margin_weight", "action_weight", "reward_weight", least=0)
            if self.margin_weight == self.reward_weight == 0:
                raise ValueError(
                    "margin_weight=0 is not possible with reward_weight=0: nothing but small actions would be learned. "
                    "Give one of them."
                )

    def __init__(self, options: Options, context: Context, policy: Policy) -> None:
        scene = context.need_scene(MujocoScene, _WHO)
        parts = context.parts
        if parts is None:
            raise ConfigError(f"{_WHO} needs a task's parts, and this one was built without.")
        curriculum = parts.curriculum.provides if parts.curriculum else ()
        for name in (*parts.initial_states.varies, *curriculum):
            if name in parts.simulator.parameters and name.startswith(_FIXED):
                raise ConfigError(
                    f"{_WHO} needs bodies that are alike in all worlds, and '{name}' varies. "
                    "Choose learner=ppo, or let it not vary."
                )
        if parts.actuation.part.keeps:
            kept = ", ".join(parts.actuation.part.keeps)
            raise ConfigError(
                f"{_WHO} needs an actuation that follows from the action and the state alone, and "
                f"{parts.actuation.where} keeps {kept}. Choose learner=ppo."
            )
        self.options, self.policy = options, policy
        self._worlds = context.num_worlds
        usual = max(_FEWEST, _SAMPLES // context.num_worlds)
        self.rollout_steps = options.rollout_steps or usual
        set_precision(policy, "float32")
        device = context.device
        compiled = scene.compiled(context)
        if compiled.nmocap:
            raise ConfigError(
                f"{_WHO} needs bodies that physics alone moves, and this scene has some that the task "
                "moves (mocap). Choose learner=ppo."
            )
        rigid = Rigid(compiled, device)
        self._rigid = rigid
        self._bodies = {
            body: compiled.body(body).name or f"body{body}"
            for body in range(compiled.nbody)
            if compiled.body_weldid[body] != 0
        }
        self._imagined = imagined = Imagined(parts, context, rigid, _seen(policy, context))
        self.rollout_fields = self.next_fields = (*_STATE, *imagined.taken)
        own, seed = options.model, context.seed
        with private_rng(seed, "imagination/model"):
            model = WorldModel(
                rigid,
                hidden=own.hidden,
                points=own.points,
                dt=context.control_dt * context.decision,
            )
        self.model = model.to(device)
        weights = Weights(
            options.margin_weight,
            options.action_weight,
            options.reward_weight,
            options.margin_norm,
            options.margin_power,
        )
        self.adjoint = Adjoint(
            rigid, imagined, self.model, policy, weights, decay=options.decay, clip=options.clip
        )
        self.replay = Replay(own.replay, self.model.size, 2 * rigid.nv, device)
        self._actor = list(policy.actor_parameters())
        self._rate = torch.tensor(options.learning_rate, device=device)
        self._optimisers = {
            "actor": optimisers.adam(self._actor, self._rate),
            "critic": optimisers.adam(
                list(policy.critic_parameters()),
                torch.tensor(options.critic_learning_rate, device=device),
            ),
            "model": optimisers.adam(
                list(self.model.parameters()), torch.tensor(own.learning_rate, device=device)
            ),
        }
        self._generator = generator(seed, "imagination", device)
        #: The newest decisions, whose actions are moved once enough has followed them.
        self._window: Window | None = None
        self._iterations, self._trained = 0, 0
        self._bad = torch.zeros((), dtype=torch.int64, device=device)
        self._skipped = torch.zeros((), device=device)
        self._capture()

    @property
    def flat(self) -> tuple[str, ...]:
        """The task's terms that the policy is not improved by, for want of a derivative."""
        return self._imagined.flat

    def update(self, rollout: Rollout) -> dict[str, float]:
        options, own = self.options, self.options.model
        self._skipped.zero_()
        batch = digest(rollout, self.policy, options.gamma, options.td_lambda, options.td_lambda)
        metrics = {"value_loss": self._fit_critic(batch)}
        metrics["explained_variance"] = explained_variance(rollout)
        newest = Window(
            {name: rollout.fields[name] for name in self.rollout_fields},
            rollout.next_fields,
            rollout.actions,
            rollout.terminated | rollout.truncated,
        )
        metrics |= self._errors(newest)
        before = self._samples
        surprise = self._remember(newest)
        window = self._window.followed_by(newest) if self._window is not None else newest
        if self._samples >= own.first_samples:
            if self._trained < _SETTLING:
                self._settle()
            first = before < own.first_samples
            steps = own.first_updates if first else own.updates
            metrics["model_loss"] = self._fit_model(steps)
            metrics["model_surprise"] = surprise
            self._trained += 1
            if len(window) > options.tail:
                metrics |= self._improve(window)
        self._window = window.newest(options.tail)
        self._iterations += 1
        optimisers.refuse_hopeless(int(self._bad), options.patience)
        return metrics | {"skipped_steps": float(self._skipped)}

    @property
    def _samples(self) -> int:
        """Decisions so far, of all processes."""
        return self.replay.seen * distributed.size()

    @torch.no_grad()
    def _remember(self, window: Window) -> float:
        """Add the window to what the model is trained on; returns the model's loss on it before."""
        state, after = (
            {k: v.flatten(0, 1) for k, v in f.items()} for f in (window.before, window.reached)
        )
        posed = self._rigid.posed(state["qpos"], state["qvel"])
        if self._iterations == 0:
            self.model.look(posed)
        action = window.actions.flatten(0, 1)
        fields = self._imagined.fields(posed, self._imagined.constants(state), action)
        inputs = self.model.inputs(posed, self._imagined.control(action, fields))
        targets = self.model.targets(posed.qpos, posed.qvel, after["qpos"], after["qvel"])
        self.replay.add(inputs, targets)
        return _mean(self.model.loss(inputs, targets))

    def _errors(self, window: Window) -> dict[str, float]:
        """Now and then, of decisions that the model has not seen: ``model_error/BODY/HORIZON``, m, and
        the mean over bodies, ``model_error_HORIZON``."""
        if not self._trained or self._trained % _LOOKS:
            return {}
        found: dict[str, float] = {}
        every = model_errors(self._rigid, self._imagined, self.model, window)
        for horizon, off in ((h, o.tolist()) for h, o in every.items()):
            own = {name: off[b] for b, name in self._bodies.items() if math.isfinite(off[b])}
            found |= {f"model_error/{name}/{horizon}": value for name, value in own.items()}
            if own:
                found[f"model_error_{horizon}"] = sum(own.values()) / len(own)
        return found

    def _settle(self) -> None:
        """Set the model's units by what there is."""
        inputs, targets = self.replay.sound()
        self.model.into.fit(inputs)
        self.model.out.fit(targets)

    def _fit_model(self, steps: int) -> float:
        """Train the model; returns the mean loss."""
        total = torch.zeros_like(self._skipped)
        for _ in range(steps):
            drawn = self.replay.draw(self.options.model.batch_size, self._generator)
            total += self._step(
                "model", dict(zip(("inputs", "targets", "counts"), drawn, strict=True))
            )
        return float(total) / steps

    def _model_loss(self, drawn: Mapping[str, Tensor]) -> Tensor:
        losses, counts = self.model.loss(drawn["inputs"], drawn["targets"]), drawn["counts"]
        return (losses * counts).sum() / counts.sum().clamp(min=1.0)

    def _improve(self, window: Window) -> dict[str, float]:
        """Move the policy's actions against the cost's derivative, where enough followed them."""
        options = self.options
        share = options.anneal.at(self._samples)
        self._rate.fill_(options.learning_rate * share)
        found = self.adjoint(window)
        kept = len(window) - options.tail
        goal = self._goals(found, kept, options.step * share)
        seen = {name: value[:kept].flatten(0, 1) for name, value in found.observations.items()}
        reach = self._imagined.reach
        for _ in range(options.updates):
            rows = torch.randint(
                len(goal), (options.batch_size,), generator=self._generator, device=goal.device
            )
            picked = {f"{_SEEN}{name}": value[rows] for name, value in seen.items()}
            self._step("actor", {**picked, _GOAL: goal[rows]})
        with torch.no_grad():
            now = self.policy.distribution(seen).mode()
            moved = ((now - found.means[:kept].flatten(0, 1)) / reach).square().mean().sqrt()
        return {
            "cost": _mean(found.cost),
            "gradient": float(found.actions[:kept].square().mean().sqrt()),
            "moved": float(moved),
            "step": options.step * share,
        }

    def _actor_loss(self, picked: Mapping[str, Tensor]) -> Tensor:
        seen = {k.removeprefix(_SEEN): v for k, v in picked.items() if k != _GOAL}
        off = (self.policy.distribution(seen).mode() - picked[_GOAL]) / self._imagined.reach
        return off.square().mean() / self.options.step**2

    def _goals(self, found: Gradients, kept: int, step: float) -> Tensor:
        """(kept N, A): the policy's first actions, moved by `step` of their reach in the mean."""
        reach = self._imagined.reach
        slope = limited((found.actions[:kept] * reach).flatten(0, 1), self.options.clip)
        size = averages.mean(slope.square().mean()).sqrt().clamp(min=1e-30)
        return found.means[:kept].flatten(0, 1) - step * reach * slope / size

    def _fit_critic(self, batch: Mapping[str, Tensor]) -> float:
        """One epoch of the critic; returns the mean loss."""
        returns, seen = batch["returns"], observations_of(batch)
        order = torch.randperm(len(returns), generator=self._generator, device=returns.device)
        parts = order.split(max(self.options.batch_size, math.ceil(len(order) / _CRITIC_STEPS)))
        total = torch.zeros_like(self._skipped)
        for rows in parts:
            values = self.policy.value({name: value[rows] for name, value in seen.items()})
            total += self._descend("critic", nn.functional.mse_loss(values, returns[rows]))
        return float(total) / len(parts)

    def _capture(self) -> None:
        """Forget captured steps: they hold the addresses of the optimisers' state. Averages over
        processes are not captured."""
        device = self._bad.device
        self.adjoint.forget_graphs()
        losses = {"model": self._model_loss, "actor": self._actor_loss}
        self._loss = {name: torch.zeros_like(self._skipped) for name in losses}
        works = {
            name: functools.partial(self._take_step, name, loss) for name, loss in losses.items()
        }
        if distributed.size() == 1:
            self._steps = {name: Captured(work, device) for name, work in works.items()}
        else:
            self._steps = works

    def _step(self, name: str, batch: Mapping[str, Tensor]) -> Tensor:
        """One step on `batch`; returns the loss."""
        self._steps[name](batch)
        return self._loss[name]

    def _take_step(
        self, name: str, loss: Callable[[Mapping[str, Tensor]], Tensor], batch: Mapping[str, Tensor]
    ) -> None:
        self._loss[name].copy_(self._descend(name, loss(batch)))

    def _descend(self, name: str, loss: Tensor) -> Tensor:
        """One step down `loss` (); if it or its gradient is not finite, none. Returns it, or 0."""
        optimiser = self._optimisers[name]
        parameters = optimiser.param_groups[0]["params"]
        optimiser.zero_grad(set_to_none=True)
        loss.backward(inputs=parameters)
        loss = averages.average_gradients(parameters, loss.detach().view(1))[0]
        norm = nn.utils.get_total_norm([p.grad for p in parameters if p.grad is not None])
        sound = norm.isfinite() & loss.isfinite()
        skip = (~sound).float()
        optimisers.step(optimiser, skip)
        self._skipped += skip
        self._bad.add_(1).mul_(~sound)
        return torch.where(sound, loss, 0.0)

    def _restored(self, kept: Mapping[str, Tensor]) -> Window:
        """The window that :meth:`state_dict` kept; ValueError if it is of another task."""
        device, steps = self._bad.device, min(self.options.tail, len(kept["actions"]))

        def fields(prefix: str) -> dict[str, Tensor]:
            return {name: kept[f"{prefix}/{name}"].to(device) for name in self.rollout_fields}

        ended = kept["ended"].to(device)
        window = Window(fields("before"), fields("reached"), kept["actions"].to(device), ended)
        for value in (*window.before.values(), *window.reached.values(), window.actions, ended):
            if value.shape[:2] != (steps, self._worlds):
                raise ValueError(f"the newest decisions do not fit: {tuple(value.shape)}")
        return window

    def state_dict(self) -> State:
        window = self._window
        kept = {} if window is None else {
            **{f"before/{k}": v for k, v in window.before.items()},
            **{f"reached/{k}": v for k, v in window.reached.items()},
            "actions": window.actions,
            "ended": window.ended,
        }  # fmt: skip
        return {
            "model": dict(self.model.state_dict()),
            "optimisers": {k: optimisers.state_of(v) for k, v in self._optimisers.items()},
            "replay": self.replay.state_dict(),
            "window": kept,
            "iterations": self._iterations,
            "trained": self._trained,
            "bad_steps": self._bad.clone(),
            "generator": self._generator.get_state(),
        }

    def load_state_dict(self, state: State) -> None:
        self.model.load_state_dict(state["model"])
        if not ((self.model.near >= 0) & (self.model.near < self._rigid.touching)).all():
            raise ValueError("the model is told of points that the bodies do not have")
        for name, optimiser in self._optimisers.items():
            optimisers.load_state(optimiser, state["optimisers"][name])
        self.replay.load_state_dict(state["replay"])
        self._window = self._restored(state["window"]) if state["window"] else None
        for name in ("iterations", "trained"):
            if state[name] < 0:
                raise ValueError(f"'{name}' cannot be {state[name]}")
        self._iterations, self._trained = int(state["iterations"]), int(state["trained"])
        self._bad.copy_(state["bad_steps"])
        self._generator.set_state(state["generator"].cpu())
        self._capture()


def _seen(policy: Policy, context: Context) -> set[str]:
    """The observations that actions follow from: a critic's own are never imagined, so they may be of
    anything."""
    shapes = context.observation_shapes.items()
    none = {name: torch.zeros(1, *shape, device=context.device) for name, shape in shapes}
    return {name for name, who in policy.readers(none).items() if "actor" in who}


def _mean(values: Tensor) -> float:
    """Of those that are finite, in the mean over processes: a world whose numbers went wrong has none."""
    return float(averages.mean(torch.where(values.isfinite(), values, torch.nan).nanmean()))

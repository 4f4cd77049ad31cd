"""The worlds of a task as other learners want them, in torch, on the environment's device."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from torch import Tensor

from understudy.errors import ConfigError
from understudy.running.environment import Environment
from understudy.running.soundness import rows
from understudy.running.step import Step
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.task import ActionSpace, Box

__all__ = ["Worlds", "flattened"]

Actions = Literal["scaled", "raw"]
#: What ``render`` can give.
RENDER_MODES = ("rgb_array",)
_LARGEST = 8192  #: pixels of a picture's side


def undisturbed(method: Callable[..., Any]) -> Callable[..., Any]:
    """Run a method of worlds with torch as it is by default, whatever the program around has set: tensors
    that are made in inference mode could not be changed in place outside, and others would be of another
    type, or elsewhere."""

    @functools.wraps(method)
    def wrapped(self: Any, *args: Any, **options: Any) -> Any:
        kind, device = torch.get_default_dtype(), torch.get_default_device()
        torch.set_default_dtype(torch.float32)
        own = contextlib.nullcontext() if device.type == "cpu" else torch.device("cpu")
        try:
            with torch.inference_mode(False), own:
                return method(self, *args, **options)
        finally:
            torch.set_default_dtype(kind)

    return wrapped


class ActionScale:
    """The affine map from actions in [-1, 1] to those of a task: around + reach · a, column by column.

    `around` and `reach` are what the task's actuation declares
    (:class:`~understudy.task.actions.Box`). Numbers beyond ±1 go as far beyond the reach: nothing is
    clipped here. Columns that hold a choice stay as they are.

    Raises
    ------
    ConfigError
        if an actuation declares a field that the task does not have, or `reach` has
        neither one number nor one for each column.
    """

    def __init__(
        self, environment: Environment, reach: float | Sequence[float] | None = None
    ) -> None:
        space = environment.parts.actuation.part.action_space
        self._environment = environment
        self._fields: list[tuple[slice, str]] = []
        self.reach = torch.ones(space.size, device=environment.device)  #: (A,)
        self._around = torch.zeros(space.size, device=environment.device)
        boxes = torch.zeros(space.size, dtype=torch.bool, device=environment.device)
        column = 0
        for part in space.parts.values():
            columns = slice(column, column + part.columns)
            column = columns.stop
            if not isinstance(part, Box):
                continue
            boxes[columns] = True
            self.reach[columns] = torch.tensor(part.reach, device=environment.device)
            if isinstance(part.around, str):
                environment.table.need("the scale of actions", [part.around], lambda name: ())
                self._fields.append((columns, part.around))
            elif part.around is not None:
                self._around[columns] = torch.tensor(part.around, device=environment.device)
        if reach is not None:
            try:
                given = torch.as_tensor(reach, dtype=torch.float32, device=environment.device)
            except (TypeError, ValueError):
                given = None
            if (
                given is None
                or given.dim() > 1
                or given.numel() not in (1, space.size)
                or isinstance(reach, bool)
                or not bool(((given > 0) & given.isfinite()).all())
            ):
                raise ConfigError(
                    f"action_scale={reach} is not possible: give one number above 0, or "
                    f"{space.size}, one for each column of an action."
                )
            self.reach = torch.where(boxes, given.expand(space.size), self.reach)

    def around(self) -> Tensor:
        """(A,), or (N, A) where it follows a field: the task's actions that 0 stands for now."""
        if not self._fields:
            return self._around
        around = self._around.repeat(self._environment.num_worlds, 1)
        for columns, name in self._fields:
            around[:, columns] = self._environment.table[name]
        return around

    def to_task(self, actions: Tensor) -> Tensor:
        """The task's actions (N, A), in its units, for `actions` (N, A) in [-1, 1]."""
        return torch.addcmul(self.around(), self.reach, actions)

    def from_task(self, actions: Tensor) -> Tensor:
        """The inverse of :meth:`to_task`, at the same state."""
        return (actions - self.around()) / self.reach


class Worlds:
    """`num_worlds` worlds of the task `task`.

    Parameters
    ----------
    task
        as it is typed, for example ``spacetime/walk``.
    num_worlds
        N.
    overrides
        Hydra's, as on the command line (``device=cuda``, ``episode.seconds=5``). With ``seed=3`` the first
        episodes begin as after a reset with this seed, too; so copies of one environment, as in Gymnasium's own vector
        environments, begin alike until a reset has a seed.
    actions
        ``scaled`` takes actions in [-1, 1] by :class:`ActionScale`; ``raw`` takes the task's,
        unbounded and in its units.
    action_scale
        replaces the reach that the actuation declares: one number or one for each
        column, in the action's units. Only with ``scaled``.
    render_mode
        ``rgb_array``, or None: :meth:`pictures` gives none.
    width, height
        of a picture, pixels.

    Raises
    ------
    ConfigError
        for a task, an override, a scale or a mode that is not possible.
    """

    @undisturbed
    def __init__(
        self,
        task: str,
        num_worlds: int,
        overrides: Sequence[str] = (),
        *,
        actions: Actions = "scaled",
        action_scale: float | Sequence[float] | None = None,
        render_mode: str | None = None,
        width: int = 480,
        height: int = 480,
    ) -> None:
        if actions not in ("scaled", "raw"):
            raise ConfigError(f"actions={actions!r} is not possible: write 'scaled' or 'raw'.")
        if actions == "raw" and action_scale is not None:
            raise ConfigError("actions='raw' has no action_scale. Leave one of them out.")
        if render_mode is not None and render_mode not in RENDER_MODES:
            raise ConfigError(
                f"render_mode={render_mode!r} is not possible: there is {', '.join(RENDER_MODES)}."
            )
        for name, size in {"width": width, "height": height}.items():
            if not _whole(size) or not 1 <= size <= _LARGEST:
                raise ConfigError(
                    f"{name}={size!r} is not possible: give a whole number from 1 to {_LARGEST}."
                )
        if isinstance(overrides, str):
            raise ConfigError(f"overrides={overrides!r} must be a list: overrides=[{overrides!r}].")
        if not isinstance(overrides, Sequence) or not all(isinstance(o, str) for o in overrides):
            raise ConfigError(f"overrides={overrides!r} must be a list of texts: ['KEY=VALUE'].")
        if not _whole(num_worlds) or num_worlds < 1:
            raise ConfigError(
                f"num_envs={num_worlds!r} is not possible: give a whole number from 1."
            )
        num_worlds, width, height = int(num_worlds), int(width), int(height)
        _refuse_overruled(task, num_worlds, overrides)
        self._made_with = (task, num_worlds, tuple(overrides)), {
            "actions": actions, "action_scale": action_scale, "render_mode": render_mode,
            "width": width, "height": height,
        }  # fmt: skip
        experiment = load_experiment([f"task={task}", *overrides, f"num_worlds={num_worlds}"])
        built = build_environment(experiment)
        self.environment, self._scene = built.environment, built.scene
        self.num_worlds, self.device = num_worlds, built.environment.device
        #: Where the first episodes begin unless a reset says otherwise: what `overrides` have as ``seed``, else None.
        self.seed = experiment.root.seed if "seed" in _given(overrides) else None
        #: Steps after which an episode is truncated, unless a curriculum shortens it.
        self.episode_steps = round(
            experiment.root.episode.seconds / built.environment.control_dt / self._decision
        )
        self.scale = ActionScale(self.environment, action_scale) if actions == "scaled" else None
        self.space = built.environment.parts.actuation.part.action_space
        self.render_mode, self._size = render_mode, (width, height)
        self._drawn_from: tuple[int | None, str] = (None, "")  # the streams of random numbers

    def __getstate__(self) -> tuple[Any, ...]:
        """What a copy (``pickle``, ``copy.deepcopy``) is made of: the arguments, from which it is built
        anew, and, if the worlds have begun, which random numbers they draw and their state."""
        begun = bool(self.environment.observations)
        state = self.environment.state_dict() if begun else None
        return (*self._made_with, self._drawn_from, state)

    @undisturbed
    def __setstate__(self, state: tuple[Any, ...]) -> None:
        arguments, settings, drawn_from, worlds = state
        Worlds.__init__(self, *arguments, **settings)
        if worlds is not None:
            self.reset(*drawn_from)
            self.environment.load_state_dict(worlds)

    @undisturbed
    def reset(self, seed: int | None = None, draw: str = "") -> dict[str, Tensor]:
        """Begin new episodes everywhere; as :meth:`~understudy.running.environment.Environment.reset`."""
        if seed is not None:
            self._drawn_from = seed, draw
        return self.environment.reset(seed, draw)

    @property
    def columns(self) -> dict[str, tuple[str, ...]]:
        """By observation the names of its columns, in order; side by side they are those of ``flat=True``."""
        return self.environment.observation_columns

    @property
    def _decision(self) -> int:
        return self.environment.decision

    @property
    def steps_per_second(self) -> float:
        """Decisions in a second of the character's life, Hz."""
        return 1.0 / (self.environment.control_dt * self._decision)

    @undisturbed
    @torch.no_grad()
    def to_task(self, actions: Tensor) -> Tensor:
        """The task's actions (N, A) for a learner's."""
        return self.scale.to_task(actions) if self.scale else actions

    @undisturbed
    @torch.no_grad()
    def from_task(self, actions: Tensor) -> Tensor:
        """The inverse of :meth:`to_task`, at the same state."""
        return self.scale.from_task(actions) if self.scale else actions

    @undisturbed
    def step(self, actions: Tensor) -> Step:
        """One decision by a learner's `actions` (N, A); ended worlds begin anew in the same step.

        Raises
        ------
        ConfigError
            for actions of another shape.
        """
        check_shape(actions, self.num_worlds, self.space)
        return self.environment.step(self.to_task(actions))

    @undisturbed
    def advance(self, actions: Tensor) -> Step:
        """One decision, as :meth:`step`; ended worlds stay where they ended. What went wrong reads 0."""
        check_shape(actions, self.num_worlds, self.space)
        step = self.environment.advance(self.to_task(actions))
        step.observations = {
            name: torch.where(rows(step.unsound, value), 0.0, value)
            for name, value in step.observations.items()
        }
        return step

    def account(self, step: Step) -> tuple[dict[str, np.ndarray], list[list[str]]]:
        """Of the decision that gave `step`: by reward term, what it added to the reward (``reward.combine=sum``)
        or multiplied it with (``product``), (N,); and for each world, which terminations ended its episode
        (none where it goes on), ``time limit`` and ``numbers went wrong`` among them.
        """
        environment = self.environment
        names, terms = list(environment.rewarded), list(environment.rewarded.values())
        rewards = torch.nan_to_num(torch.stack(terms).float()).cpu().numpy() if terms else []
        outcomes = {term.name: term.outcome for term in environment.parts.terminations}
        reasons = {n: fired for n, fired in step.endings.items() if outcomes[n] != "report"}
        of_time = step.truncated.clone()
        for name, fired in reasons.items():
            of_time &= ~fired if outcomes[name] == "truncation" else True
        reasons |= {"time limit": of_time, "numbers went wrong": step.unsound}
        fired = (torch.stack(list(reasons.values())) & step.ended).cpu().numpy()
        ended = [
            [n for n, row in zip(reasons, fired, strict=True) if row[i]]
            for i in range(self.num_worlds)
        ]
        return dict(zip(names, rewards, strict=True)), ended

    def __repr__(self) -> str:
        seen = ", ".join(f"{k} {list(v)}" for k, v in self.environment.observation_shapes.items())
        return (
            f"{self._made_with[0][0]}: {self.num_worlds} worlds on {self.device}, {self.steps_per_second:g} steps a "
            f"second, episodes of {self.episode_steps} steps; sees {seen}; acts {self.space.size}"
        )

    @torch.no_grad()
    def one_episode(
        self, act: Callable[[dict[str, Tensor]], Tensor], seed: int = 0
    ) -> tuple[Tensor, Tensor]:
        """Lengths (N,) in steps and returns (N,) of one episode in each world.

        Parameters
        ----------
        act
            from observations by name, each (N, …), to a learner's actions (N, A).
        seed
            where they begin. Whatever went on before in these worlds ends.
        """
        observations = self.reset(seed, "trial")  # where no training began
        length = torch.zeros(self.num_worlds, device=self.device)
        returns, running = length.clone(), torch.ones_like(length, dtype=torch.bool)
        while bool(running.any()):
            step = self.step(act(observations))
            length += running
            returns += torch.where(running, step.rewards, 0.0)
            running &= ~step.ended
            observations = step.observations
        return length, returns

    def draw(self, world: int) -> np.ndarray:
        """(height, width, 3) uint8: the world of this number, now.

        Raises
        ------
        UnderstudyError
            if its scene cannot be drawn.
        """
        table, width, height = self.environment.table, *self._size
        names = [name for name in self._scene.recorded if name in table.shapes]
        tracks = {name: table[name][world : world + 1].cpu().numpy() for name in names}
        return next(iter(self._scene.draw(tracks, width, height)))

    def pictures(self) -> tuple[np.ndarray, ...] | None:
        """As :meth:`draw`, of every world; None without a ``render_mode``."""
        if self.render_mode is None:
            return None
        return tuple(self.draw(world) for world in range(self.num_worlds))

    # ---------------------------------------------------------------- spaces

    def action_space(self) -> gymnasium.Space:
        """Of one world: a box if all of an action's parts are, ``MultiDiscrete`` if all are choices,
        else both by name."""
        limit = 1.0 if self.scale else np.inf

        def of(part: Any) -> gymnasium.Space:
            if isinstance(part, Box):
                return spaces.Box(-limit, limit, (part.size,), np.float32)
            return spaces.Discrete(part.count)

        parts = self.space.parts
        if all(isinstance(part, Box) for part in parts.values()):
            return spaces.Box(-limit, limit, (self.space.size,), np.float32)
        if not any(isinstance(part, Box) for part in parts.values()):
            return spaces.MultiDiscrete([of(part).n for part in parts.values()])  # type: ignore[attr-defined]
        return spaces.Dict({name: of(part) for name, part in parts.items()})

    def observation_space(self, flat: bool) -> gymnasium.Space:
        """Of one world: its observations by name, or side by side in one row."""
        shapes = self.environment.observation_shapes
        if flat:
            size = sum(int(np.prod(shape)) for shape in shapes.values())
            return spaces.Box(-np.inf, np.inf, (size,), np.float32)
        return spaces.Dict(
            {name: spaces.Box(-np.inf, np.inf, s, np.float32) for name, s in shapes.items()}
        )


def _refuse_overruled(task: str, num_worlds: int, overrides: Sequence[str]) -> None:
    """Raise :class:`ConfigError` for `overrides` of what is said beside them: of two, one would be overruled in silence."""
    given = _given(overrides)
    if (worlds := given.get("num_worlds")) not in (None, str(num_worlds)):
        are = "this is one world" if num_worlds == 1 else f"there are {num_worlds}"
        raise ConfigError(
            f"overrides has num_worlds={worlds}, but {are}. Leave it out, and give make_vec, or an adapter, "
            f"num_envs={worlds or 'N'}."
        )
    chosen = given.get("task")
    if chosen is None and "experiment" in given:
        chosen = load_experiment(overrides).root.task
    if chosen not in (None, task):
        how = "experiment" if "task" not in given else "task"
        raise ConfigError(
            f"overrides has {how}={given[how]}, but the task is {task}. Make {chosen or 'the other one'} with these overrides."
        )


def _given(overrides: Sequence[str]) -> dict[str, str]:
    """By key, what `overrides` set it to."""
    words = [override.lstrip("+~").partition("=") for override in overrides]
    return {key: value.strip("'\" ") for key, _, value in words}


def columns(space: ActionSpace, actions: Any, worlds: int, device: torch.device) -> Tensor:
    """An action tensor (N, A) of a batch of :meth:`Worlds.action_space`: an array, or arrays by name.

    Raises
    ------
    ConfigError
        they are no numbers, of another shape than `worlds` and the space say, or lack a part.
    """
    if isinstance(actions, Mapping):
        if missing := [name for name in space.parts if name not in actions]:
            raise ConfigError(f"An action needs {', '.join(map(repr, missing))}, too.")
        parts = [_numbers(actions[name]) for name in space.parts]
        actions = np.concatenate([p.reshape(len(p), -1) for p in parts], axis=1)
    found = _numbers(actions)
    check_shape(found, worlds, space)
    return torch.as_tensor(found, device=device)


def check_shape(actions: Tensor | np.ndarray, worlds: int, space: ActionSpace) -> None:
    """Raise :class:`ConfigError` for `actions` of another shape than `worlds` and the `space` say."""
    if (shape := tuple(np.shape(actions))) != (worlds, space.size):
        raise ConfigError(
            f"Actions of shape {shape} do not fit: {(worlds, space.size)} is needed, a row for each of "
            f"{worlds} worlds."
        )


def _whole(number: Any) -> bool:
    return isinstance(number, int | np.integer) and not isinstance(number, bool)


def _numbers(actions: Any) -> np.ndarray:
    """As float32, in which what is too large is infinite. Of a tensor no gradient is kept.

    Raises
    ------
    ConfigError
        they are something else: None, texts, complex numbers, rows of several lengths.
    """
    if isinstance(actions, Tensor):
        actions = actions.detach().cpu()
        actions = actions.float() if actions.is_floating_point() else actions
    try:
        found = np.asarray(actions)
    except (ValueError, RuntimeError):  # rows of several lengths, or of tensors with gradients
        found = np.asarray(None)
    if found.dtype.kind not in "biuf":
        raise ConfigError(f"An action is made of numbers: {actions!r} is not possible.")
    with np.errstate(over="ignore"):
        return found.astype(np.float32)


def check_reset(seed: Any, options: Mapping[str, Any] | None, known: Sequence[str] = ()) -> None:
    """Refuse what :meth:`reset` would not use.

    Raises
    ------
    ConfigError
        options that are not `known`, or several seeds.
    """
    if seed is not None and isinstance(seed, Sequence | np.ndarray):
        raise ConfigError(
            "All worlds have one seed, from which each draws its own numbers: seed=3."
        )
    if unknown := [name for name in options or {} if name not in known]:
        there = f"there is {', '.join(known)}" if known else "there are none"
        raise ConfigError(
            f"The reset has no option {', '.join(map(repr, unknown))}; {there}. To change a task, give its "
            "overrides when it is made: overrides=['KEY=VALUE']."
        )


def flattened(observations: Mapping[str, Tensor]) -> Tensor:
    """(N, D): the observations side by side, in the order of the configuration. A new tensor."""
    return torch.cat([value.flatten(1) for value in observations.values()], dim=1)

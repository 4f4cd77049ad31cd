"""Policies for several papers: two MLPs, or two small convolutional networks with MLPs.

Both take any action space: one head gives the means of all boxes and the logits of all choices. The
boxes' deviation does not depend on the state; it is scheduled or learned.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal

import torch
from torch import Tensor, nn

from understudy.errors import ConfigError, suggestion
from understudy.options import check_range
from understudy.task import ActionSpace, Context
from understudy_networks.convolution import Convolution, convolutions
from understudy_networks.nn import (
    LARGEST,
    Network,
    RunningNormaliser,
    Schedule,
    action_distribution,
    box_columns,
    head_size,
    mlp,
    relu,
    scaled,
)
from understudy_reinforcement.policy import Distribution, Policy

__all__ = ["MLPPolicy", "action_space", "check_units", "observation_size"]

ACTIVATIONS: dict[str, Callable[[], nn.Module]] = {"relu": relu, "elu": nn.ELU, "tanh": nn.Tanh}


class MLPPolicy(Policy):
    """Actor and critic are MLPs of flat observations side by side, which are normalised."""

    @dataclass(frozen=True)
    class Options:
        #: name of the encoder read, or several in their order
        observation: str | tuple[str, ...] = "state"
        #: What the critic reads in its place, which the actor need not know; null is what the actor reads.
        critic: str | tuple[str, ...] | None = None
        hidden: tuple[int, ...] = (1024, 512)  #: units per layer (thesis, section 3.4.1)
        activation: Literal["relu", "elu", "tanh"] = "relu"  #: nonlinearity between the layers
        #: Standard deviation of the boxes' numbers, in their units.
        noise: Schedule = field(default_factory=lambda: Schedule(0.1, 0.05))
        learn_noise: bool = False  #: learn the deviation from ``noise.start`` instead of scheduling
        final_scale: float = 0.01  #: scale of the actor's last layer at the start

        def __post_init__(self) -> None:
            check_names(self, "observation", "critic")
            check_units("hidden", self.hidden)
            check_noise(self.noise)
            check_range(self, "final_scale", least=0)

    def __init__(self, options: Options, context: Context) -> None:
        super().__init__()
        self.options = options
        self._space = space = action_space(context, "policy 'mlp'")
        self._actor_sees, self._critic_sees = seen_by(options.observation, options.critic)
        size = joined_size(context, self._actor_sees, "policy 'mlp'")
        activation = ACTIVATIONS[options.activation]
        self.normaliser = RunningNormaliser(size)
        self.actor = mlp(
            [size, *options.hidden, head_size(space)],
            activation=activation,
            final_scale=options.final_scale,
        )
        self.critic_normaliser = None  # the actor's
        if self._critic_sees != self._actor_sees:
            size = joined_size(context, self._critic_sees, "policy 'mlp'")
            self.critic_normaliser = RunningNormaliser(size)
        self.critic = mlp([size, *options.hidden, 1], activation=activation)
        self.log_deviation = log_deviation(space, options.noise, options.learn_noise)

    def distribution(self, observations: Mapping[str, Tensor]) -> Distribution:
        outputs = self.actor(self.normaliser(joined(observations, self._actor_sees)))
        return action_distribution(self._space, outputs, self.log_deviation.exp())

    def value(self, observations: Mapping[str, Tensor]) -> Tensor:
        seen = joined(observations, self._critic_sees)
        return self.critic((self.critic_normaliser or self.normaliser)(seen)).squeeze(-1)

    def actor_parameters(self) -> Iterator[nn.Parameter]:
        yield from self.actor.parameters()
        if self.options.learn_noise:
            yield self.log_deviation

    def critic_parameters(self) -> Iterator[nn.Parameter]:
        return self.critic.parameters()

    def observe(self, observations: Mapping[str, Tensor]) -> None:
        observe_joined(self.normaliser, observations, self._actor_sees)
        observe_joined(self.critic_normaliser, observations, self._critic_sees)

    def schedule(self, samples: int) -> None:
        anneal(self.log_deviation, self.options, samples)


class CNNPolicy(Policy):
    """Actor and critic see an image (C, H, W) through convolutions and flat observations beside it.

    The network is that of Zhang et al. 2020, figure 3: convolutions with max-pooling, a fully
    connected layer of the image's features, an MLP on these and the flat observation, ReLU
    throughout. Figure 3 gives no padding; here convolutions keep the image's size. The image is
    not normalised, the flat observation is. Channels come first.
    """

    @dataclass(frozen=True)
    class Options:
        image: str = "image"  #: name of the encoder of shape (C, H, W)
        #: Name of the encoder of shape (D,), or several in their order; null for the image alone.
        flat: str | tuple[str, ...] | None = "state"
        #: Those that the critic has beside the image in place of ``flat``; null is what the actor has.
        critic: str | tuple[str, ...] | None = None
        filters: tuple[int, ...] = (2, 2)  #: per convolution, stride 1
        kernels: tuple[int, ...] = (5, 3)  #: pixels of each convolution's side, odd
        pool: int = 2  #: pixels, width and stride of the max-pooling after each convolution
        #: Let the first convolution see the pixels' coordinates (CoordConv, Liu et al. 2018).
        coordinates: bool = True
        features: int = 32  #: units of the layer that follows the convolutions
        hidden: tuple[int, ...] = (64, 64)  #: units per layer after the two are joined
        #: Standard deviation of the boxes' numbers, in their units.
        noise: Schedule = field(default_factory=lambda: Schedule(0.1, 0.05))
        learn_noise: bool = False  #: learn the deviation from ``noise.start`` instead of scheduling
        final_scale: float = 0.01  #: scale of the actor's last layer at the start

        def __post_init__(self) -> None:
            if len(self.filters) != len(self.kernels):
                raise ValueError(
                    f"kernels={self.kernels} is not possible: give one for each of filters={self.filters}."
                )
            if any(width < 1 or width % 2 == 0 for width in self.kernels):
                raise ValueError(f"kernels={self.kernels} is not possible: they must be odd.")
            check_names(self, "flat", "critic")
            check_units("filters", self.filters)
            check_units("hidden", self.hidden)
            check_range(self, "pool", "features", least=1, most=10_000)
            check_range(self, "kernels", least=1, most=99)
            check_noise(self.noise)
            check_range(self, "final_scale", least=0)

    def __init__(self, options: Options, context: Context) -> None:
        super().__init__()
        self.options = options
        self._space = space = action_space(context, "policy 'cnn'")
        shape = image_shape(context, options.image, "policy 'cnn'")
        self._actor_sees, self._critic_sees = seen_by(options.flat or (), options.critic)
        size = joined_size(context, self._actor_sees, "policy 'cnn'")
        self.normaliser = RunningNormaliser(size)
        self.actor_eye, self.critic_eye = _eye(options, shape), _eye(options, shape)
        layers = [*options.hidden, head_size(space)]
        self.actor = mlp([options.features + size, *layers], final_scale=options.final_scale)
        self.critic_normaliser = None  # the actor's
        if self._critic_sees != self._actor_sees:
            size = joined_size(context, self._critic_sees, "policy 'cnn'")
            self.critic_normaliser = RunningNormaliser(size)
        self.critic = mlp([options.features + size, *options.hidden, 1])
        self.log_deviation = log_deviation(space, options.noise, options.learn_noise)

    def distribution(self, observations: Mapping[str, Tensor]) -> Distribution:
        seen = self._see(self.actor_eye, observations, self.normaliser, self._actor_sees)
        return action_distribution(self._space, self.actor(seen), self.log_deviation.exp())

    def value(self, observations: Mapping[str, Tensor]) -> Tensor:
        normaliser = self.critic_normaliser or self.normaliser
        seen = self._see(self.critic_eye, observations, normaliser, self._critic_sees)
        return self.critic(seen).squeeze(-1)

    def _see(
        self,
        eye: nn.Module,
        observations: Mapping[str, Tensor],
        normaliser: nn.Module,
        names: tuple[str, ...],
    ) -> Tensor:
        """(…, features + D): what `eye` makes of the image, beside the flat observations `names`."""
        image = observations[self.options.image]
        features = eye(image.flatten(0, -4)).view(*image.shape[:-3], -1)
        if not names:
            return features
        return torch.cat([features, normaliser(joined(observations, names))], dim=-1)

    def actor_parameters(self) -> Iterator[nn.Parameter]:
        yield from itertools.chain(self.actor_eye.parameters(), self.actor.parameters())
        if self.options.learn_noise:
            yield self.log_deviation

    def critic_parameters(self) -> Iterator[nn.Parameter]:
        return itertools.chain(self.critic_eye.parameters(), self.critic.parameters())

    def observe(self, observations: Mapping[str, Tensor]) -> None:
        observe_joined(self.normaliser, observations, self._actor_sees)
        observe_joined(self.critic_normaliser, observations, self._critic_sees)

    def schedule(self, samples: int) -> None:
        anneal(self.log_deviation, self.options, samples)


def _eye(options: CNNPolicy.Options, shape: tuple[int, int, int]) -> Network:
    """Images (B, C, H, W) to features (B, features)."""
    layers, size = convolutions(
        shape,
        options.filters,
        options.kernels,
        pool=options.pool,
        coordinates=options.coordinates,
        activation=relu,
    )
    if size == 0:
        raise ConfigError(
            f"policy 'cnn': {len(options.filters)} poolings by {options.pool} leave nothing of an image "
            f"of {shape[1]} × {shape[2]} pixels. Give fewer filters, or policy.pool=1."
        )
    for layer in layers:
        if isinstance(layer, Convolution):
            scaled(layer)
    return Network(*layers, scaled(nn.Linear(size, options.features)), relu())


def action_space(context: Context, who: str) -> ActionSpace:
    """What the policy decides; a ConfigError says that `who` needs it."""
    if context.action_space is None:
        raise ConfigError(f"{who} needs an action space, and the task's actuation gives none.")
    return context.action_space


def observation_shape(context: Context, name: str, who: str) -> tuple[int, ...]:
    """The shape of the observation `name`; an error names what the task has instead."""
    shape = context.observation_shapes.get(name)
    if shape is None:
        raise ConfigError(
            f"{who} needs the observation '{name}', which no encoder of this task provides. "
            f"Add encoder.{name}={{name: …}}, or choose another policy."
            + suggestion(name, context.observation_shapes)
        )
    return shape


def observation_size(context: Context, name: str, who: str) -> int:
    """The size of the flat observation `name`."""
    shape = observation_shape(context, name, who)
    if len(shape) != 1:
        raise ConfigError(f"{who} needs a flat observation '{name}', and its shape is {shape}.")
    return shape[0]


Names = str | tuple[str, ...]


def seen_by(actor: Names, critic: Names | None) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The observations that the actor reads, and those that the critic does: the actor's if it names none."""
    sees = (actor,) if isinstance(actor, str) else actor
    if critic is None:
        return sees, sees
    return sees, (critic,) if isinstance(critic, str) else critic


def joined_size(context: Context, names: tuple[str, ...], who: str) -> int:
    """The size of the flat observations `names` side by side."""
    return sum(observation_size(context, name, who) for name in names)


def joined(observations: Mapping[str, Tensor], names: tuple[str, ...]) -> Tensor:
    """(…, D): the flat observations `names` side by side, in this order."""
    found = [observations[name] for name in names]
    return found[0] if len(found) == 1 else torch.cat(found, dim=-1)


def observe_joined(
    normaliser: RunningNormaliser | None,
    observations: Mapping[str, Tensor],
    names: tuple[str, ...],
) -> None:
    """Let a network's own normaliser, if it has one, observe the flat observations `names`."""
    if normaliser is not None and names:
        normaliser.observe(joined(observations, names))


def image_shape(context: Context, name: str, who: str) -> tuple[int, int, int]:
    """(C, H, W) of the image observation `name`."""
    shape = observation_shape(context, name, who)
    if len(shape) != 3:
        raise ConfigError(
            f"{who} needs an image '{name}' of shape (channels, height, width), and its shape is {shape}."
        )
    return shape[0], shape[1], shape[2]


def log_deviation(space: ActionSpace, noise: Schedule, learned: bool) -> nn.Parameter:
    """Logarithm of the standard deviation of each of the space's real numbers."""
    start = torch.full((box_columns(space),), noise.start).log()
    return nn.Parameter(start, requires_grad=learned)


@torch.no_grad()
def anneal(
    deviation: nn.Parameter, options: MLPPolicy.Options | CNNPolicy.Options, samples: int
) -> None:
    """Set a :func:`log_deviation` to the schedule's value after `samples`, unless it is learned."""
    if not options.learn_noise:
        deviation.fill_(options.noise.at(samples)).log_()


def check_names(options: object, *names: str) -> None:
    """Raise a ValueError for an option that lists no observation, or one twice."""
    for name in names:
        given = getattr(options, name)
        if isinstance(given, tuple) and (not given or len(set(given)) < len(given)):
            raise ValueError(
                f"{name}={given} is not possible: name each observation once, one at least."
            )


def check_units(name: str, units: tuple[int, ...]) -> None:
    """Raise a ValueError if hidden layers of so many `units` are missing or too large."""
    if any(count < 1 for count in units):
        raise ValueError(f"{name}={units} is not possible: every layer needs a unit.")
    sizes = [1, *units, 1]
    if sum(a * b for a, b in itertools.pairwise(sizes)) > LARGEST or len(units) > 100:
        raise ValueError(f"{name}={units} is not possible: the network would be too large.")


def check_noise(noise: Schedule) -> None:
    """A policy's noise stays above zero; other schedules may reach it."""
    for end in ("start", "end"):
        if not getattr(noise, end) > 0:
            raise ValueError(
                f"noise.{end}={getattr(noise, end)} is not possible: it must be greater than 0."
            )

"""The state fields of a task: each computed when first asked for, forgotten when the state changes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from graphlib import CycleError, TopologicalSorter

from torch import Tensor

from understudy.errors import ConfigError, suggestion
from understudy.task import Fields, Shape, Simulator
from understudy.task.terms import Wired


class FieldTable:
    """Values of state fields at the present state.

    Fields come from the simulator, from the environment (`own`), or from providers, which read other
    fields. A ConfigError if two parts provide the same field, or they need one another's.
    """

    def __init__(
        self, simulator: Simulator, providers: Sequence[Wired[Fields]], own: Mapping[str, Shape]
    ) -> None:
        self._simulator = simulator
        self._provider: dict[str, Wired[Fields]] = {}
        #: What is known of the present state; once that has changed, only the environment's own.
        self.values: dict[str, Tensor] = {}
        self.shapes: dict[str, Shape] = {}
        self.source: dict[str, str] = {}
        self.add(simulator.fields, "the simulator")
        self.add(own, "the environment")
        for provider in providers:
            shapes = provider.part.provides
            self.add({f: shapes[name] for name, f in provider.provides.items()}, provider.where)
            self._provider.update(dict.fromkeys(provider.provides.values(), provider))
        self._above = self._dependents()

    def add(self, shapes: Mapping[str, Shape], source: str) -> None:
        """Declare fields that `source` gives."""
        for name, shape in shapes.items():
            if name in self.shapes:
                raise ConfigError(
                    f"{source} provides the field '{name}', which {self.source[name]} provides "
                    "already. Remove one of them (~PART.NAME), or rename what it provides "
                    f"(PART.NAME.provides={{{name}: other_{name}}})."
                )
            self.shapes[name], self.source[name] = shape, source

    def _dependents(self) -> dict[str, set[str]]:
        """By field: the provided fields that are computed from it, directly or not."""
        reads = {name: [*p.reads.values()] for name, p in self._provider.items()}
        try:
            order = list(TopologicalSorter(reads).static_order())  # what is read comes first
        except CycleError as error:
            circle = " → ".join(reversed(error.args[1]))
            raise ConfigError(
                f"The fields {circle} need one another in a circle. Remove one of their "
                "providers (~fields.NAME), or rename what one reads (fields.NAME.reads=…)."
            ) from error
        below: dict[str, set[str]] = {}
        above: dict[str, set[str]] = {}
        for name in order:
            below[name] = {name}.union(*(below[field] for field in reads.get(name, ())))
            for field in below[name] - {name}:
                above.setdefault(field, set()).add(name)
        return above

    def need(self, who: str, names: Iterable[str], givers: Callable[[str], Sequence[str]]) -> None:
        """Raise :class:`ConfigError` if `who` reads a field that nothing provides."""
        for name in names:
            if name not in self.shapes:
                found = " or ".join(givers(name))
                hint = f" It would come from {found}." if found else suggestion(name, self.shapes)
                raise ConfigError(
                    f"{who} needs the state field '{name}', which nothing in this task "
                    f"provides.{hint}"
                )

    def put(self, fields: Mapping[str, Tensor]) -> None:
        """Set fields of the environment's own, and forget what was computed from them."""
        for name, value in fields.items():
            self.values[name] = value
            for dependent in self._above.get(name, ()):
                self.values.pop(dependent, None)

    def __getitem__(self, name: str) -> Tensor:
        if name not in self.values:
            if (provider := self._provider.get(name)) is None:
                self.values[name] = self._simulator.read(name)
            else:
                given = provider.part.compute(**self.pick(provider.reads))
                self.values |= {field: given[own] for own, field in provider.provides.items()}
        return self.values[name]

    def pick(self, names: Mapping[str, str]) -> dict[str, Tensor]:
        """The fields that `names` maps parameters to, by parameter."""
        return {parameter: self[name] for parameter, name in names.items()}

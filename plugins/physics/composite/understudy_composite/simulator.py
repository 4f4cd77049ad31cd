"""Several simulators that move on together, as one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from understudy.errors import ConfigError, suggestion
from understudy.running.environment import Environment
from understudy.task import Context, Shape, Simulator
from understudy_composite.couplings import Coupling
from understudy_composite.scene import CompositeScene
from understudy_tensors.captured import Captured


class CompositeSimulator(Simulator):
    """The members that ``simulators`` names, one for each of the scene's.

    In each step of physics they move on in the order of ``scenes``; before a member does, ``couplings``
    give it what members before it have come to. A control (N, U) is that of each member in this order,
    less the columns that a coupling drives. Fields keep their names; of members that share a parameter
    (two gravities), each one's is called ``MEMBER/NAME``.

    *Limits:* coupling is one way, from a member to those after it, once in a step of
    physics.
    """

    def __init__(self, options: None, context: Context) -> None:
        scene = context.need_scene(CompositeScene, "simulator 'composite'")
        chosen = {one.name: one for one in context.chosen.get("simulators", ())}
        if set(chosen) != set(scene.members):
            raise ConfigError(
                f"simulator 'composite' has a simulator for {_listed(chosen)}, and its scenes are "
                f"{_listed(scene.members)}: name one for each (simulators.MEMBER=…)."
            )
        self._rounds, self._n = context.substeps, context.num_worlds
        self._device = context.device
        self._members: dict[str, Simulator] = {}
        try:
            for name in scene.members:
                self._members[name] = chosen[name].build(scene.context(context, name))
            self._couplings = self._coupled(context)
            self._combine()
        except BaseException:
            self.close()
            raise
        everywhere = torch.ones(self._n, dtype=torch.bool, device=self._device)
        self.set_state(everywhere, {name: self.read(name).clone() for name in self.state_fields})

    def _coupled(self, context: Context) -> dict[str, list[Coupling]]:
        """By target."""
        found: dict[str, list[Coupling]] = {name: [] for name in self._members}
        names = list(self._members)
        for one in context.chosen.get("couplings", ()):
            for end in ("source", "target"):
                member = getattr(one.options, end)
                if member not in names:
                    raise ConfigError(
                        f"{one.where}.{end}: there is no member '{member}'.{suggestion(member, names)}"
                    )
            coupling: Coupling = one.build(context, self._members)
            if names.index(coupling.source) >= names.index(coupling.target):
                raise ConfigError(
                    f"{one.where}: member '{coupling.source}' moves on after '{coupling.target}', so it cannot "
                    "lead it. Change their order in scenes."
                )
            taken = {column for other in found[coupling.target] for column in other.columns}
            if taken & set(coupling.columns):
                raise ConfigError(
                    f"{one.where}: another coupling drives the same controls of '{coupling.target}'."
                )
            found[coupling.target].append(coupling)
        return found

    def _combine(self) -> None:
        """Whose each field, parameter and control is."""
        self._owner: dict[str, str] = {}
        fields: dict[str, Shape] = {}
        state: list[str] = []
        shared: dict[str, list[str]] = {}
        self._free: dict[str, Tensor] = {}  # columns of a member's control that nobody drives
        self._driven: dict[str, list[Tensor]] = {}
        self._control: dict[str, Tensor] = {}
        for name, member in self._members.items():
            for field, shape in member.fields.items():
                if field in self._owner:
                    raise ConfigError(
                        f"Members '{self._owner[field]}' and '{name}' both have a field '{field}': a composite "
                        "takes members whose fields have different names."
                    )
                self._owner[field], fields[field] = name, shape
            sets = {field for coupling in self._couplings[name] for field in coupling.sets}
            state += [field for field in member.state_fields if field not in sets]
            for parameter in member.parameters:
                shared.setdefault(parameter, []).append(name)
            driven = {column for coupling in self._couplings[name] for column in coupling.columns}
            free = [i for i in range(member.control_size) if i not in driven]

            def columns(of: Sequence[int]) -> Tensor:
                return torch.tensor(list(of), dtype=torch.int64, device=self._device)

            self._free[name] = columns(free)
            self._driven[name] = [columns(c.columns) for c in self._couplings[name]]
            self._control[name] = torch.zeros(self._n, member.control_size, device=self._device)
            for coupling in self._couplings[name]:
                self._take(coupling)  # what is read for the first time may cost more
        self.fields, self.state_fields = fields, tuple(state)
        self.control_size = sum(len(free) for free in self._free.values())
        #: By the name of a parameter here: the member, and its name there.
        self._parameters = {
            (parameter if len(names) == 1 else f"{name}/{parameter}"): (name, parameter)
            for parameter, names in shared.items()
            for name in names
        }
        self.parameters: Mapping[str, Shape] = {
            here: self._members[name].parameters[there]
            for here, (name, there) in self._parameters.items()
        }
        self._varied: dict[str, tuple[str, str]] = {}

    def _take(self, coupling: Coupling) -> dict[str, Tensor]:
        source = self._members[coupling.source]
        return {name: source.read(name) for name in coupling.reads}

    def _given(self, member: str, values: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The varied parameters of `member` that `values` has, by its own names."""
        return {
            there: values[here]
            for here, (owner, there) in self._varied.items()
            if owner == member and here in values
        }

    # ------------------------------------------------------------------ Simulator

    def vary(self, names: Sequence[str]) -> None:
        for name in names:
            if name not in self._parameters:
                known = suggestion(name, self._parameters)
                raise ConfigError(
                    f"simulator 'composite' has no parameter '{name}' in which worlds may differ.{known}"
                )
        self._varied = {name: self._parameters[name] for name in names}
        for member, simulator in self._members.items():
            simulator.vary([there for owner, there in self._varied.values() if owner == member])
        self.fields = {**self.fields, **{name: self.parameters[name] for name in names}}

    def read(self, name: str) -> Tensor:
        member, own = self._varied.get(name) or (self._owner[name], name)
        return self._members[member].read(own)

    def set_state(self, worlds: Tensor, state: Mapping[str, Tensor]) -> None:
        for name, member in self._members.items():
            own = {field: state[field] for field in member.state_fields if field in state}
            for coupling in self._couplings[name]:
                own |= coupling.state(**self._take(coupling))
            member.set_state(worlds, {**own, **self._given(name, state)})

    def step(self, control: Tensor, substeps: int | None = None) -> None:
        parts = control.split([len(free) for free in self._free.values()], dim=1)
        for (name, free), part in zip(self._free.items(), parts, strict=True):
            self._control[name].index_copy_(1, free, part)
        for _ in range(self._rounds if substeps is None else substeps):
            for name, member in self._members.items():
                own = self._control[name]
                couplings = zip(self._couplings[name], self._driven[name], strict=True)
                for coupling, columns in couplings:
                    own.index_copy_(1, columns, coupling.control(**self._take(coupling)))
                member.step(own)

    def replayed(self, work: Callable[[Tensor], Any], environment: Environment) -> Captured[Any]:
        return Captured(work, environment)

    def failed(self) -> Tensor:
        result = torch.zeros(self._n, dtype=torch.bool, device=self._device)
        for member in self._members.values():
            result |= member.failed()
        return result

    def snapshot(self) -> dict[str, Tensor]:
        return {
            f"{name}/{key}": value
            for name, member in self._members.items()
            for key, value in member.snapshot().items()
        }

    def restore(self, snapshot: Mapping[str, Tensor], worlds: Tensor | None = None) -> None:
        for name, member in self._members.items():
            start = f"{name}/"
            own: dict[str, Any] = {
                key.removeprefix(start): value
                for key, value in snapshot.items()
                if key.startswith(start)
            }
            member.restore(own, worlds)

    def report(self) -> dict[str, int]:
        return {
            f"{name}/{key}": count
            for name, member in self._members.items()
            for key, count in member.report().items()
        }

    def close(self) -> None:
        for member in self._members.values():
            member.close()


def _listed(names: Mapping[str, Any]) -> str:
    return ", ".join(names) or "no member"

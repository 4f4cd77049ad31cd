"""A state machine over trained policies, as a task's actuation: each acts until it is done."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import torch
from torch import Tensor

from understudy.errors import ConfigError, suggestion
from understudy.options import check_range
from understudy.task import ActionSpace, Actuation, Context, Shape, box
from understudy_skills.controller import Controller

#: s, for what has no limit: fields are finite.
_ENDLESS = 1e9
#: Fields of a decision that is judged already, which no actuation can know.
_JUDGED = ("failed", "succeeded", "violated", "reward")
#: Of this part: they change with the stage alone.
_BY_STAGE = ("stage", "stage_count", "stage_limit")
#: What a part does with a tensor of a shape that it was not made for.
_MISFITS = (RuntimeError, IndexError, ValueError, TypeError)


@dataclass(frozen=True)
class Until:
    """When a stage is done: a field (N,) is within its limits, for so long without a break."""

    field: str  #: that is judged, one number a world; of this part's own, stage_seconds ends a stage after a time
    at_least: float | None = None  #: of it; null: no limit
    at_most: float | None = None  #: of it; null: no limit
    lasting: float = 0.0  #: s, for which it must hold

    def __post_init__(self) -> None:
        check_range(self, "lasting", least=0)
        if self.at_least is None and self.at_most is None:
            raise ValueError(
                f"field={self.field} without a limit is never done: give at_least or at_most."
            )
        low, high = self.at_least, self.at_most
        if low is not None and high is not None and low > high:
            raise ValueError(
                f"at_least={low:g} is above at_most={high:g}, so that the stage is never done: exchange them."
            )
        if self.field in _JUDGED:
            raise ValueError(
                f"field={self.field} is known only once a decision is judged: name what it is judged by."
            )
        if self.field in _BY_STAGE:
            raise ValueError(
                f"field={self.field} stays as it is until a stage is done: name what that is judged by, or stage_seconds."
            )


@dataclass(frozen=True)
class Stage:
    """A policy, and for how long it acts."""

    run: str  #: run folder, or skill, whose policy acts, by its mode
    until: Until  #: the criterion at which the stage is done
    #: that it may take, which terminations of overtime judge; null: as long as it likes
    seconds: float | None = None
    #: by the name that the run's parts know: the field of this task that they read instead
    reads: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.seconds is not None:
            check_range(self, "seconds", above=0)
            until, what = self.until, f"until.lasting={self.until.lasting:g}"
            first = (until.at_least or 0.0) if until.field == "stage_seconds" else 0.0
            if first > 0.0:
                what = f"until.at_least={first:g} of stage_seconds"
            if first + until.lasting > self.seconds:
                raise ValueError(
                    f"seconds={self.seconds:g} is over before {what} can be: give the stage more seconds."
                )


class Stages(Actuation):
    """The policies of finished runs, one after another within one episode (the state machine of the dressing
    paper). A stage acts until its criterion holds; after the last one's, the last policy goes on.

    A policy decides as often as it was trained to, and anew when its stage begins. One whose control periods are several
    of this task's has its controls kept for so long. The task's own action says nothing.

    =================  ==============================================================
    field              (N,)
    =================  ==============================================================
    ``stage``          the number at work, from 0; the number of stages once all are done
    ``stage_seconds``  s since it began
    ``stage_limit``    s that it may take
    ``stage_count``    how many there are
    ``stage_lasted``   s for which its criterion has held
    ``stage_action``   (A,) what was decided last, of the largest of their actions
    ``stage_age``      control periods since that was decided
    ``stage_control``  (U,) what is kept of a policy with longer control periods, if one has
    =================  ==============================================================
    """

    every = "period"

    @dataclass(frozen=True)
    class Options:
        stages: tuple[Stage, ...]  #: the stages, in the order in which they act

        def __post_init__(self) -> None:
            if not self.stages:
                raise ValueError("stages=() is not possible: name at least one run.")

    def __init__(self, options: Options, context: Context) -> None:
        stages = self._stages = options.stages
        self._controllers = [
            Controller.load(s.run, context, any_rate=True, slower=True) for s in stages
        ]
        for number, (one, controller) in enumerate(zip(stages, self._controllers, strict=True)):
            for name in one.reads:
                if name not in controller.reads:
                    raise ConfigError(
                        f"actuation.stages[{number}].reads: {one.run} reads no field '{name}'."
                        + suggestion(name, controller.reads)
                    )
            if "action" in {one.reads.get(name, name) for name in controller.reads}:
                raise ConfigError(
                    f"actuation.stages[{number}]: {one.run} reads its own last action, and this task's says nothing. Set "
                    f"actuation.stages[{number}].reads={{action: stage_action}} if all stages have as many actions."
                )
        self._unchecked = True
        self.action_space: ActionSpace = box(1)
        self._sizes = [controller.action_size for controller in self._controllers]
        self._dt, device = context.control_dt, context.device
        self._decisions = torch.tensor([c.decision for c in self._controllers], device=device)
        limits = [_ENDLESS if s.seconds is None else s.seconds for s in stages]
        self._limits = torch.tensor([*limits, _ENDLESS], device=device)
        self.keeps: Mapping[str, Shape] = {
            **dict.fromkeys(
                ("stage", "stage_seconds", "stage_limit", "stage_count", "stage_lasted", "stage_age"), ()
            ),
            "stage_action": (max(self._sizes),),
        }  # fmt: skip
        self._held = any(controller.holds > 1 for controller in self._controllers)
        if self._held:
            assert context.simulator is not None
            self.keeps = {**self.keeps, "stage_control": (context.simulator.control_size,)}
        own = (
            "stage",
            "stage_seconds",
            "stage_lasted",
            "stage_age",
            "stage_action",
            "episode_step",
            *(["stage_control"] if self._held else ()),
        )
        taken = [
            stage.reads.get(name, name)
            for stage, controller in zip(stages, self._controllers, strict=True)
            for name in controller.reads
        ]
        self.reads = tuple(dict.fromkeys((*own, *taken, *(s.until.field for s in stages))))
        self._n, self._device = context.num_worlds, device

    def _zeros(self, *shape: int) -> Tensor:
        return torch.zeros(self._n, *shape, device=self._device)

    def begin(self, **fields: Tensor) -> dict[str, Tensor]:
        if self._unchecked:
            self._check(fields)
            self._unchecked = False
        nothing = self._zeros()
        kept = {"stage_control": self._zeros(*self.keeps["stage_control"])} if self._held else {}
        return {
            **kept,
            "stage": nothing,
            "stage_seconds": nothing,
            "stage_limit": self._limits[0].expand(self._n),
            "stage_count": nothing + len(self._stages),
            "stage_lasted": nothing,
            "stage_age": nothing,
            "stage_action": self._zeros(max(self._sizes)),
        }

    def _check(self, fields: Mapping[str, Tensor]) -> None:
        """Refuse stages that are judged by fields of several numbers, or read some of other shapes than their run's."""
        for number, stage in enumerate(self._stages):
            where, shape = f"actuation.stages[{number}]", tuple(fields[stage.until.field].shape[1:])
            if shape:
                raise ConfigError(
                    f"{where}.until.field={stage.until.field} has the shape {list(shape)}: name a field of one number, "
                    "such as a distance."
                )
            taken, controller = self._fields_of(number, fields), self._controllers[number]
            try:
                controller.control(controller.decide(taken), taken)
            except _MISFITS as error:
                shapes = ", ".join(f"{k} {list(v.shape[1:])}" for k, v in taken.items())
                raise ConfigError(
                    f"{where}: {stage.run} cannot act on fields of these shapes, {shapes}: name others of this task in "
                    f"{where}.reads."
                ) from error

    def advance(
        self,
        action: Tensor,
        stage: Tensor,
        stage_seconds: Tensor,
        stage_lasted: Tensor,
        stage_age: Tensor,
        stage_action: Tensor,
        episode_step: Tensor,
        **fields: Tensor,
    ) -> dict[str, Tensor]:
        fresh = episode_step == 0
        # nothing has been done before the first period
        passed = torch.where(fresh, 0.0, self._dt)
        fields = {
            **fields,
            "stage": stage,
            "stage_seconds": stage_seconds + passed,
            "stage_lasted": stage_lasted,
            "stage_age": stage_age,
            "stage_action": stage_action,
            "episode_step": episode_step,
        }
        at = self._number(stage)
        holds = torch.zeros_like(fresh)
        lasting = torch.zeros_like(stage)
        for number, one in enumerate(self._stages):
            value, until = fields[one.until.field], one.until
            here = torch.ones_like(fresh)
            if until.at_least is not None:
                here = here & (value >= until.at_least)
            if until.at_most is not None:
                here = here & (value <= until.at_most)
            holds = torch.where(at == number, here, holds)
            lasting = torch.where(at == number, until.lasting, lasting)
        lasted = torch.where(holds & ~fresh, stage_lasted + passed, 0.0)
        done = holds & ~fresh & (lasted >= lasting - 0.5 * self._dt)
        stage = stage + done
        seconds = torch.where(done, 0.0, stage_seconds + passed)
        now = self._number(stage)
        acting = now.clamp(max=len(self._stages) - 1)
        decides = fresh | done | (stage_age >= self._decisions[acting])
        chosen = stage_action
        for number, size in enumerate(self._sizes):
            new = self._controllers[number].decide(self._fields_of(number, fields))
            new = torch.nn.functional.pad(new, (0, chosen.shape[1] - size))
            chosen = torch.where(((acting == number) & decides).unsqueeze(1), new, chosen)
        age = torch.where(decides, 1.0, stage_age + 1.0)
        return {
            **self._kept_control(acting, age, chosen, fields),
            "stage": stage,
            "stage_seconds": seconds,
            "stage_limit": self._limits[now],
            "stage_count": self._zeros() + len(self._stages),
            "stage_lasted": torch.where(done, 0.0, lasted),
            "stage_age": age,
            "stage_action": chosen,
        }

    def _kept_control(
        self, acting: Tensor, age: Tensor, chosen: Tensor, fields: Mapping[str, Tensor]
    ) -> dict[str, Tensor]:
        """The control of policies with longer control periods, new where one of these begins."""
        if not self._held:
            return {}
        kept = fields["stage_control"]
        for number, (size, controller) in enumerate(
            zip(self._sizes, self._controllers, strict=True)
        ):
            if controller.holds > 1:
                new = controller.control(chosen[:, :size], self._fields_of(number, fields))
                begins = (acting == number) & ((age - 1.0) % controller.holds == 0)
                kept = torch.where(begins.unsqueeze(1), new, kept)
        return {"stage_control": kept}

    def control(self, action: Tensor, stage: Tensor, stage_action: Tensor, **fields: Tensor) -> Tensor:  # fmt: skip
        acting = self._number(stage).clamp(max=len(self._stages) - 1)
        fields = {**fields, "stage": stage, "stage_action": stage_action}
        found: Tensor | None = None
        for number, size in enumerate(self._sizes):
            if self._controllers[number].holds > 1:
                own = fields["stage_control"]
            else:
                own = self._controllers[number].control(
                    stage_action[:, :size], self._fields_of(number, fields)
                )
            found = own if found is None else torch.where((acting == number)[:, None], own, found)
        assert found is not None
        return found

    def _number(self, stage: Tensor) -> Tensor:
        """(N,) as an index, of a world whose numbers went wrong, too."""
        return stage.long().clamp(0, len(self._stages))

    def _fields_of(self, number: int, fields: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        """The fields, under the names that a stage's parts know."""
        other = self._stages[number].reads
        names = self._controllers[number].reads
        return {name: fields[other.get(name, name)] for name in names}

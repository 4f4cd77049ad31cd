"""Another run's actions in one of its episodes, repeated from other starts regardless of the state."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.task import ActionSpace, Actuation, Context, box
from understudy_skills import bank
from understudy_skills.controller import Controller


class Replay(Actuation):
    """Plays the actions of a finished run's episode open loop, through that run's actuation: the baseline of the dressing
    paper (Clegg et al. 2018, section 9). At the end, the last action is repeated. The task's own action has no effect.
    """

    @dataclass(frozen=True)
    class Options:
        run: str  #: the run, or skill, whose actuation turns actions into controls
        file: str  #: a bank with actions, or its run: ``job=harvest job.run=RUN job.actions=true``
        number: int = 0  #: which of the bank's episodes

        def __post_init__(self) -> None:
            check_range(self, "number", least=0)

    def __init__(self, options: Options, context: Context) -> None:
        controller = Controller.load(options.run, context, any_rate=True)
        if controller.decision != context.decision:
            raise ConfigError(
                f"{options.run} decides every {controller.decision} control periods, and this task every "
                f"{context.decision}. Set control.decision={controller.decision}."
            )
        actions = bank.fitting(options.file, context, "actuation").get("actions")
        if actions is None or actions.shape[2:] != (controller.action_size,):
            raise ConfigError(
                f"actuation.file: the bank {options.file} has no actions of {options.run}. Make one with job=harvest "
                f"job.run={options.run} job.actions=true."
            )
        if options.number >= len(actions):
            raise ConfigError(
                f"actuation.number={options.number} is not possible: the bank {options.file} has {len(actions)} "
                "episodes, counted from 0."
            )
        self._actions = actions[options.number].to(context.device)
        self._inner, self._decision = controller.actuation, controller.decision
        self.every = self._inner.part.every
        self.action_space: ActionSpace = box(1)
        self.reads = tuple(dict.fromkeys(("episode_step", *self._inner.reads.values())))

    def control(self, action: Tensor, **fields: Tensor) -> Tensor:
        at = fields["episode_step"].long() // self._decision
        taken = {own: fields[name] for own, name in self._inner.reads.items()}
        replayed = self._actions[at.clamp(max=len(self._actions) - 1)]
        control: Tensor = self._inner.part.control(replayed, **taken)
        return control

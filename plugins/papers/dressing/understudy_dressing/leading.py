"""What jobs share that lead a person without forces in simulated cloth, and keep states of the way."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from understudy.errors import ConfigError, TrainingError
from understudy.options import check_range
from understudy.records.runs import Run
from understudy.setup.building import build_scene, device_of
from understudy.setup.config import Experiment
from understudy.task import Context, State
from understudy_dressing.led import Led, Place
from understudy_dressing.moves import PERIOD
from understudy_dressing.shirt import ShirtScene
from understudy_reinforcement.origins import terms_behind
from understudy_skills import bank
from understudy_skills.gathered import Gathered, Gathering

#: The fields of a state: of the person, and of the cloth.
STATE = ("qpos", "qvel", "cloth_position", "cloth_velocity")


@dataclass
class Way:
    """The way of an arm that is led."""

    arm: Led
    every: int  #: steps in a decision
    phase: int = 0  #: in which it begins
    poses: list[np.ndarray] = field(default_factory=list)  #: (22,) rad, after each step
    #: where the arm was at each decision, and first where it began
    places: list[Place] = field(init=False)
    arrived: bool = False

    def __post_init__(self) -> None:
        self.places = [self.arm.place(self.phase)]

    def note(self, phase: int = 0) -> bool:
        """Note a step of the arm; whether it ends a decision, so that the last of the `places` is new."""
        self.poses.append(self.arm.found()[0].copy())
        decided = len(self.poses) % self.every == 0
        if decided:
            self.places.append(self.arm.place(phase))
        return decided

    @property
    def through(self) -> bool:
        """Whether the arm went through the cloth by the last decision."""
        return self.places[-1].through


@dataclass(frozen=True)
class LeadingOptions:
    """What all jobs that lead are asked."""

    bank: str  #: the bank in which the ways begin, or the folder of the run that has it
    count: int = 24  #: how many of the bank's states are led, evenly spaced
    keep: int = 3  #: of so many decisions of a way, one state is kept
    torn: float = 2.0  #: area ratio from which on states are not kept

    def __post_init__(self) -> None:
        check_range(self, "count", least=1, most=100_000)
        check_range(self, "keep", least=1, most=1000)
        check_range(self, "torn", least=1)


class Leading(Gathering):
    """Leads an arm from each of some states of a bank, and leaves banks of states of the way, each in a folder of its own name.

    With each state it keeps the poses that follow, ``way`` (T, 22) rad, one per decision; once the way has ended, its last pose is
    repeated. All states are at rest except those at the beginning. States that a bank holds out for evaluations are not led.
    """

    options: Any  #: LeadingOptions, with what a job adds
    portions: ClassVar[tuple[str, ...]]  #: the names of the banks that it may leave
    _from: ClassVar[str]  #: the experiment from whose last states it leads
    _went: ClassVar[str]  #: what no arm did, for the error when all of them failed

    def __init__(self, options: Any, experiment: Experiment) -> None:
        """``options.count`` states of the bank ``options.bank``."""
        self.options, self._experiment = options, experiment
        self.device = device_of(experiment.root.device)
        self._gathered = Gathered(options.count)  # one number for each arm: whether it arrived
        self._kept: dict[str, list[dict[str, Tensor]]] = {name: [] for name in self.portions}

    @abstractmethod
    def _lead(self, pose: np.ndarray, cloth: np.ndarray) -> Way:
        """The way of the arm from the pose (22,) rad and the vertices (V, 3) m."""

    @abstractmethod
    def _keep(self, places: list[Place], at: Callable[..., dict[str, Tensor]]) -> None:
        """Add states of a way to :attr:`_kept`. ``at(k)`` is the state at decision k; in ``at(k, until)`` the poses that follow end
        with that of the decision `until`."""

    def _keep_halves(
        self, places: list[Place], at: Callable[..., dict[str, Tensor]], end: str
    ) -> None:
        """Keep the first state as ``ends`` and the last as `end`; those between them that the options ask for as ``far`` in the
        first half of the way, and as ``near`` in the second."""
        every, torn, last = self.options.keep, self.options.torn, len(places) - 1
        self._kept["ends"].append(at(0))
        self._kept[end].append(at(last))
        for k in range(every, last, every):
            if places[k].ratio < torn:
                self._kept["far" if 2 * k < last else "near"].append(at(k))

    def _refuse_other_arm(self, context: Context) -> None:
        """Refuse a task of another arm than the one that is led."""

    @property
    @abstractmethod
    def _longest(self) -> float:
        """The longest that a way can last, s."""

    def prepare(self) -> None:
        experiment = self._experiment
        root = experiment.root
        context = build_scene(experiment)
        self._scene = context.scene
        self._shirt = context.need_scene(ShirtScene, "a job that leads arms")
        self._refuse_other_arm(context)
        self._every = max(1, round(root.control.decision / root.control.frequency / PERIOD))
        states = bank.starts(self.options.bank, context, "job.bank")
        missing = [name for name in STATE if name not in states]
        if missing:
            raise ConfigError(
                f"job.bank={self.options.bank} has no '{missing[0]}': give one that job=harvest leaves of {self._from}."
            )
        rows = np.linspace(0, len(states["qpos"]) - 1, self.options.count).round().astype(int)
        self._states = {name: states[name][np.unique(rows)] for name in STATE}
        self._gathered = Gathered(len(self._states["qpos"]))

    def iterate(self, samples: int) -> dict[str, Any]:
        row = self._gathered.count
        state = {name: values[row] for name, values in self._states.items()}
        way = self._lead(
            state["qpos"][:22].double().numpy(), state["cloth_position"].double().numpy()
        )
        places, arrived = way.places, float(way.arrived)
        if way.arrived:
            self._keep(places, self._states_of(state, way))
        self._gathered.add({"arrived": torch.tensor([arrived])})
        return {
            "consumed": len(places) - 1,
            "states": self._gathered.count,
            "progress": max(place.progress for place in places),
            "area_ratio": max(place.ratio for place in places),
            "arrived": arrived,
        }

    def _states_of(self, state: Mapping[str, Tensor], way: Way) -> Callable[..., dict[str, Tensor]]:
        every, places, poses = self._every, way.places, np.stack(way.poses)
        longest = round(self._longest / PERIOD) // every + 1
        decisions = torch.from_numpy(
            np.concatenate([poses[every - 1 :: every], poses[-1:]])
        ).float()

        def at(k: int, until: int | None = None) -> dict[str, Tensor]:
            follow = decisions[k:until]
            follow = torch.cat(
                [follow, decisions[: until or len(decisions)][-1:].expand(longest, -1)]
            )
            if k == 0:
                return {**state, "way": follow[:longest]}
            qpos = torch.cat([torch.from_numpy(places[k].pose).float(), state["qpos"][22:]])
            cloth = torch.from_numpy(places[k].cloth).float()
            return {
                "qpos": qpos, "qvel": torch.zeros_like(qpos), "cloth_position": cloth,
                "cloth_velocity": torch.zeros_like(cloth), "way": follow[:longest],
            }  # fmt: skip

        return at

    def stage(self) -> str:
        return self._gathered.stage("arms led")

    def products(self, run: Run) -> None:
        if not self._kept["ends"]:
            raise TrainingError(
                f"No arm {self._went} from job.bank={self.options.bank}. Lead more of its states (job.count), or harvest "
                "others, with job.lasting=16."
            )
        behind = terms_behind(run.info, run.path)
        for name, kept in self._kept.items():
            if kept:
                about = {"led": name, "clips": behind}
                states = {field: torch.stack([one[field] for one in kept]) for field in kept[0]}
                (run.path / name).mkdir(exist_ok=True)
                bank.save(run.path / name / bank.NAME, states, about, self._scene)

    def state_dict(self) -> State:
        kept = {
            name: {field: torch.stack([one[field] for one in ones]) for field in ones[0]}
            for name, ones in self._kept.items()
            if ones
        }
        return {**self._gathered.state_dict(), "kept": kept}

    def load_state_dict(self, state: State) -> None:
        self.load_learned(state, 0)
        for name, fields in state["kept"].items():
            rows = range(len(fields["qpos"]))
            self._kept[name] = [{field: value[k] for field, value in fields.items()} for k in rows]

    def report(self) -> Mapping[str, int]:
        return {}

    def forget_worlds(self) -> None:
        pass

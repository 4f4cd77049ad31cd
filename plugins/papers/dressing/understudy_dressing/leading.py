"""Jobs that lead arms without forces in cloth that is simulated, and keep states of the way: into a sleeve, and to the hem.

At the tuck's end the front is gathered above the elbow, the hand is before the chin and the sleeve behind the shoulder, so an
arm that makes straight for its sleeve goes through the front. Led the other way round, it goes in: the holding hand lowers the
hem, the elbow goes up before the chest while the fingertip goes through the sleeve's entrance, and the arm out to its side.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from understudy.errors import ConfigError, TrainingError
from understudy.options import check_range
from understudy.records.runs import Run
from understudy.setup.building import build_sections, device_of
from understudy.setup.config import Experiment
from understudy.task import Context, State
from understudy_dressing.led import Led, Place
from understudy_dressing.person import Side
from understudy_dressing.shirt import (
    _BACK_AT,
    _BEYOND_AT,
    _HELD_AT,
    _LOWERED_AT,
    _TUCKED_AT,
    PERIOD,
    ShirtScene,
)
from understudy_skills import bank
from understudy_skills.gathered import Gathered, Gathering

#: What a state is, of the person and the cloth.
STATE = ("qpos", "qvel", "cloth_position", "cloth_velocity")
#: Which hand, that which goes in or that which holds, goes where, m: under the hem, and back to the shoulder.
_UNDER = tuple(("in", place) for place in (*_TUCKED_AT, *_BEYOND_AT))
_BACK = (("holds", _LOWERED_AT), *(("in", place) for place in _BACK_AT))


class _Leading(Gathering):
    """Leads an arm from each of some states of a bank, and leaves banks of states of the way, each in a folder of its name.

    Each state has the poses that follow as ``way`` (T, 22) rad, one a decision, the last one again from the end of the way on.
    All are at rest but those of the beginning. States that a bank holds out for evaluations are not led.
    """

    portions: ClassVar[tuple[str, ...]]  #: the names of the banks that it may leave
    _from: ClassVar[str]  #: the experiment whose ends it wants
    _went: ClassVar[str]  #: what no arm did

    def __init__(self, options: Any, experiment: Experiment) -> None:
        """Of the bank ``options.bank``, ``options.count`` states."""
        self.options, self._experiment = options, experiment
        self.device = device_of(experiment.root.device)
        self._gathered = Gathered(options.count)  # of one number: what became of each arm
        self._kept: dict[str, list[dict[str, Tensor]]] = {name: [] for name in self.portions}

    @abstractmethod
    def _lead(
        self, pose: np.ndarray, cloth: np.ndarray
    ) -> tuple[list[Place], list[np.ndarray], bool]:
        """From the pose (22,) rad and vertices (V, 3) m: where the arm was at each decision, the first of them the beginning; the
        pose (22,) rad of each step; and whether it arrived."""

    @abstractmethod
    def _keep(self, places: list[Place], at: Callable[..., dict[str, Tensor]]) -> None:
        """Adds to :attr:`_kept` states of such a way, that of decision k being ``at(k)``, or ``at(k, until)`` with the poses
        that follow until that decision and then its own."""

    def _keep_halves(
        self, places: list[Place], at: Callable[..., dict[str, Tensor]], end: str, every: int, torn: float
    ) -> None:  # fmt: skip
        """Keeps the first state as ``ends`` and the last as `end`; between them one of `every` so many decisions, where the area
        ratio is below `torn`, as ``far`` in the first half of the way and as ``near`` in the second."""
        last = len(places) - 1
        self._kept["ends"].append(at(0))
        self._kept[end].append(at(last))
        for k in range(every, last, every):
            if places[k].ratio < torn:
                self._kept["far" if 2 * k < last else "near"].append(at(k))

    @property
    @abstractmethod
    def _longest(self) -> float:
        """s, of a way."""

    def prepare(self) -> None:
        experiment = self._experiment
        root, registry = experiment.root, experiment.registry
        context = Context(
            seed=root.seed, device=torch.device("cpu"), num_worlds=1, control_dt=1.0 / root.control.frequency,
            substeps=root.control.substeps, decision=root.control.decision, registry=registry,
            sections=build_sections(experiment), chosen=experiment.choices, inputs=experiment.inputs,
        )  # fmt: skip
        self._scene = context.scene = experiment.need("scene").build(context)
        self._shirt = context.need_scene(ShirtScene, "a job that leads arms")
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
        places, way, arrived = self._lead(state["qpos"][:22].double().numpy(), state["cloth_position"].double().numpy())  # fmt: skip
        if arrived:
            self._keep(places, self._states_of(state, places, np.stack(way)))
        self._gathered.add({"arrived": torch.tensor([float(arrived)])})
        return {
            "consumed": len(places) - 1,
            "states": self._gathered.count,
            "progress": max(place.progress for place in places),
            "area_ratio": max(place.ratio for place in places),
            "arrived": float(arrived),
        }

    def _states_of(
        self, state: Mapping[str, Tensor], places: list[Place], way: np.ndarray
    ) -> Callable[..., dict[str, Tensor]]:
        every = self._every
        longest = round(self._longest / PERIOD) // every + 1
        decisions = torch.from_numpy(np.concatenate([way[every - 1 :: every], way[-1:]])).float()

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
        for name, kept in self._kept.items():
            if kept:
                states = {field: torch.stack([one[field] for one in kept]) for field in kept[0]}
                (run.path / name).mkdir(exist_ok=True)
                bank.save(run.path / name / bank.NAME, states, {"led": name}, self._scene)

    def sources(self) -> Mapping[str, Any]:
        return {"bank": {"run": self.options.bank}}

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


class Lead(_Leading):
    """Leads arms in a task of ``dressing/shirt_sleeve`` from states of a bank, as ``job=harvest`` leaves of ``dressing/shirt_tuck``;
    or of the second sleeve, where the other arm is in its own.

    If `held`, its states are of a held hem, and the arm goes under it first: ``tucks`` are states until there, whose way ends there.
    From there, and if `back` from where a policy had brought the arm, the hand goes back along the chest to its shoulder.
    It leaves banks in the folders ``ends`` (where the arms began), ``low`` (the hem on its way down), ``half`` and ``near`` (the
    hand on its way, and nearer or in), ``out`` (the arm on its way out) and ``dressed`` (where it ended), of those arms that went
    all the way through no cloth, as :class:`_Leading` says.
    """

    portions = ("tucks", "ends", "low", "half", "near", "out", "dressed")
    _from, _went = "dressing/shirt_tuck", "came into the sleeve"

    @dataclass(frozen=True)
    class Options:
        bank: str  #: the bank in which the arms begin, or the folder of the run that has it
        count: int = 24  #: how many of its states are led, evenly of all
        lowers: float = (
            0.6  #: s, in which the hem comes down; if `held` or `back` each step of that
        )
        speed: float = 0.8  #: m/s, of fingertip and elbow, which go their own ways
        most: float = 2.2  #: s, within which the hand has to be in
        out: float = 1.6  #: s, in which the arm goes out to its side
        keep: int = 3  #: of every so many decisions of a way one state
        torn: float = 2.6  #: area ratio of states that are not kept
        enough: float = 0.08  #: progress from which on the arm goes out to its side
        elbow: tuple[float, float, float] = (0.28, 0.09, -0.08)  #: m, where the left elbow goes
        #: whether arms are led under the hem first, from a bank of the held hem (`initial_states.worn=held`), and the hem
        #: is lowered as the hand goes back to its shoulder; the bank `tucks` has the way until there
        held: bool = False
        #: if `held`, whether the other hand has only just taken the hem: it brings it to the front first, the trunk upright
        taken: bool = False
        goes: float = 0.6  #: s, from each place to the next on the way under the hem
        #: whether the hand goes back to its shoulder as the hem is lowered, as it does if `held`: for arms of which a policy
        #: has held the hem and brought the hand no further than under it
        back: bool = False
        side: Side = "left"  #: the arm that goes in: the paper's first, or `right`, the second

        def __post_init__(self) -> None:
            check_range(self, "count", least=1, most=100_000)
            check_range(self, "keep", least=1, most=1000)
            check_range(self, "lowers", "most", "out", least=0.1, most=10)
            check_range(self, "speed", least=0.05, most=5)
            check_range(self, "torn", least=1)
            check_range(self, "enough", least=0.01, most=0.6)
            check_range(self, "goes", least=0.1, most=10)
            check_range(self, "elbow", least=-1e3, most=1e3)
            if self.taken and not self.held:
                raise ValueError("taken=true is not possible with held=false: give held=true, too.")

    options: Options

    @property
    def _longest(self) -> float:
        options = self.options
        lowers = options.lowers * (len(_BACK) if options.held or options.back else 1)
        return lowers + options.most + options.out

    def _lead(
        self, pose: np.ndarray, cloth: np.ndarray
    ) -> tuple[list[Place], list[np.ndarray], bool]:
        """Until the arm goes through cloth, is not in in time, or is out at its side."""
        options, way = self.options, list[np.ndarray]()
        arm = Led(self._shirt, options.side, pose, cloth)
        places = [arm.place(-1 if options.held else 0)]

        def steps(seconds: float) -> range:
            return range(1, round(seconds / PERIOD) + 1)

        def through(phase: int) -> bool:
            way.append(arm.found()[0].copy())
            if len(way) % self._every == 0:
                places.append(arm.place(phase))
            return places[-1].through

        def gone(place: tuple[float, float, float], hand: str, phase: int) -> bool:
            """Whether that hand came to the place, with the trunk upright where it brings the hem."""
            mine: Side = options.side
            other: Side = "left" if mine == "right" else "right"
            who = mine if hand == "in" else other
            seconds = options.goes if phase < 0 else options.lowers
            begin = arm.found()[0].copy()
            end = arm.reached(who, arm.mirrored * np.array(place), upright=place == _HELD_AT)
            for k in steps(seconds):
                arm.go(end, k / len(steps(seconds)), begin)
                if through(phase):
                    return False
            return True

        def near() -> bool:
            """Whether the hand is where it makes for its sleeve from, as the options ask."""
            if not options.held and not options.back:
                side = options.side
                lowered = self._shirt.settled("in_sleeve", side, other_dressed=side == "right")[0]
                for k in steps(options.lowers):
                    arm.lower(k / len(steps(options.lowers)), pose, lowered)
                    if through(0):
                        return False
                return True
            under = (*((("holds", _HELD_AT),) if options.taken else ()), *_UNDER)
            return all(
                gone(place, hand, -1) for hand, place in (under if options.held else ())
            ) and all(gone(place, hand, 0) for hand, place in _BACK)

        if not near():
            return places, way, False
        for _ in steps(options.most):
            arm.approach(PERIOD * options.speed, np.array(options.elbow))
            if through(1) or places[-1].progress > options.enough:
                break
        if places[-1].progress <= options.enough or places[-1].through:
            return places, way, False
        begin = arm.found()[0].copy()
        for k in steps(options.out):
            arm.spread(k / len(steps(options.out)), begin)
            if through(2):
                return places, way, False
        return places, way, places[-1].phase == 2

    def _keep(self, places: list[Place], at: Callable[..., dict[str, Tensor]]) -> None:
        options, kept = self.options, self._kept
        under = sum(place.phase < 0 for place in places)
        end = max(0, under - 1)  # the decision at which the arm is under the hem
        kept["ends"].append(at(end))
        kept["dressed"].append(at(len(places) - 1))
        if under:
            kept["tucks"].append(at(0, end))
        hand = sum(place.phase == 1 for place in places)
        first = sum(place.phase <= 0 for place in places)
        for k in range(options.keep, len(places), options.keep):
            phase = places[k].phase
            if places[k].ratio >= options.torn or k == end:
                continue
            if phase < 0:
                kept["tucks"].append(at(k, end))
            else:
                kept[("low", "half" if k < first + hand // 2 else "near", "out")[phase]].append(
                    at(k)
                )


class LeadGrip(_Leading):
    """Leads a hand whose arm is in its sleeve to the hem that the other one holds, in a task of ``dressing/shirt_regrip``, from
    states of a bank, as ``job=harvest`` leaves of ``dressing/shirt_sleeve``; ours.

    It leaves banks in the folders ``ends`` (where the hands began), ``far`` and ``near`` (in the first and the second half of their
    way) and ``taken`` (where they ended), of those hands that came to it, while their arm went through no cloth, as
    :class:`_Leading` says.
    """

    portions = ("ends", "far", "near", "taken")
    _from, _went = "dressing/shirt_sleeve", "came to the hem"

    @dataclass(frozen=True)
    class Options:
        bank: str  #: the bank in which the hands begin, or the folder of the run that has it
        count: int = 24  #: how many of its states are led, evenly of all
        speed: float = 0.8  #: m/s, of the fingertip
        most: float = 3.0  #: s, within which the hand has to be there
        near: float = 0.03  #: m, of the grip's target, where it is there
        keep: int = 3  #: of every so many decisions of a way one state
        torn: float = 2.0  #: area ratio of states that are not kept
        side: Side = "left"  #: the hand that is to grip

        def __post_init__(self) -> None:
            check_range(self, "count", least=1, most=100_000)
            check_range(self, "keep", least=1, most=1000)
            check_range(self, "most", least=0.1, most=10)
            check_range(self, "speed", least=0.05, most=5)
            check_range(self, "near", least=0.005, most=0.2)
            check_range(self, "torn", least=1)

    options: Options

    @property
    def _longest(self) -> float:
        return self.options.most

    def _lead(
        self, pose: np.ndarray, cloth: np.ndarray
    ) -> tuple[list[Place], list[np.ndarray], bool]:
        """Until the hand is there, the arm goes through cloth, or it takes too long."""
        options, way = self.options, list[np.ndarray]()
        arm = Led(self._shirt, options.side, pose, cloth)
        places = [arm.place(0)]
        for _ in range(round(options.most / PERIOD)):
            away = arm.grip(PERIOD * options.speed)
            way.append(arm.found()[0].copy())
            if len(way) % self._every == 0:
                places.append(arm.place(0))
                if places[-1].through or away < options.near:
                    return places, way, not places[-1].through
        return places, way, False

    def _keep(self, places: list[Place], at: Callable[..., dict[str, Tensor]]) -> None:
        self._keep_halves(places, at, "taken", self.options.keep, self.options.torn)


class LeadRest(_Leading):
    """Leads a person whose arms are both in their sleeves back to the neutral pose, in a task of ``dressing/shirt_finish``, from
    states of a bank, as ``job=harvest`` leaves of ``dressing/shirt_sleeve_second``; ours.

    It leaves banks in the folders ``ends`` (where they began), ``far`` and ``near`` (in the first and the second half of their way)
    and ``rested`` (where they ended), of those of whom no arm went through cloth, as :class:`_Leading` says.
    """

    portions = ("ends", "far", "near", "rested")
    _from, _went = "dressing/shirt_sleeve_second", "came to rest"

    @dataclass(frozen=True)
    class Options:
        bank: str  #: the bank in which they begin, or the folder of the run that has it
        count: int = 24  #: how many of its states are led, evenly of all
        seconds: float = 1.6  #: s, that the way back takes
        keep: int = 3  #: of every so many decisions of a way one state
        torn: float = 2.0  #: area ratio of states that are not kept

        def __post_init__(self) -> None:
            check_range(self, "count", least=1, most=100_000)
            check_range(self, "keep", least=1, most=1000)
            check_range(self, "seconds", least=0.1, most=10)
            check_range(self, "torn", least=1)

    options: Options

    @property
    def _longest(self) -> float:
        return self.options.seconds

    def _lead(
        self, pose: np.ndarray, cloth: np.ndarray
    ) -> tuple[list[Place], list[np.ndarray], bool]:
        """Until the person is neutral, or an arm goes through cloth."""
        way, arm = list[np.ndarray](), Led(self._shirt, "right", pose, cloth, holds=False)
        places = [arm.place(0)]
        steps = round(self.options.seconds / PERIOD)
        for k in range(1, steps + 1):
            arm.rest(k / steps, pose)
            way.append(arm.found()[0].copy())
            if len(way) % self._every == 0:
                places.append(arm.place(0))
                if places[-1].through or arm.through("left"):
                    return places, way, False
        return places, way, True

    def _keep(self, places: list[Place], at: Callable[..., dict[str, Tensor]]) -> None:
        self._keep_halves(places, at, "rested", self.options.keep, self.options.torn)

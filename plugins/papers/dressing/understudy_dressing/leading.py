"""A job that leads arms from where one of the shirt's tucks ended into the sleeve, and keeps states of the way.

At the tuck's end the front is gathered above the elbow, the hand is before the chin and the sleeve behind the shoulder, so an
arm that makes straight for its sleeve goes through the front. Led the other way round, it goes in: the holding hand lowers the
hem, the elbow goes up before the chest while the fingertip goes through the sleeve's entrance, and the arm out to its side. The
cloth is simulated, and nothing limits torques.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import torch
from scipy.optimize import least_squares
from torch import Tensor

from understudy.errors import ConfigError, TrainingError
from understudy.options import check_range
from understudy.records.runs import Run
from understudy.setup.building import build_sections, device_of
from understudy.setup.config import Experiment
from understudy.task import Context, State
from understudy_cloth.mesh import face_areas
from understudy_dressing.person import Side
from understudy_dressing.shirt import (
    _BACK_AT,
    _BEYOND_AT,
    _LOWERED_AT,
    _TUCKED_AT,
    DRESSED,
    HOLDERS,
    PERIOD,
    Moves,
    ShirtScene,
)
from understudy_dressing.state import centre_and_normal, progress
from understudy_skills import bank
from understudy_skills.gathered import Gathered, Gathering

#: The banks that it leaves, by where on the way their states are.
PORTIONS = ("tucks", "ends", "low", "half", "near", "out")
#: What a state is, of the person and the cloth.
STATE = ("qpos", "qvel", "cloth_position", "cloth_velocity")
#: What the elbow weighs beside the fingertip; m beyond the entrance, where that goes.
_WEIGHT, _BEYOND = 0.7, 0.12
#: Which hand, that which goes in or that which holds, goes where, m: under the hem, and back to the shoulder.
_UNDER = tuple(("in", place) for place in (*_TUCKED_AT, *_BEYOND_AT))
_BACK = (("holds", _LOWERED_AT), *(("in", place) for place in _BACK_AT))
#: m: so far links stay apart.
_APART = 0.003


@dataclass(frozen=True)
class Place:
    """Where an arm was on its way."""

    phase: int  #: 0 while the hem comes down, 1 while the hand goes in, 2 while the arm goes out; −1 before, under the hem
    pose: np.ndarray  #: (22,) rad
    cloth: np.ndarray  #: (V, 3) m
    progress: float  #: equation 11
    ratio: float  #: equation 12, the largest of any triangle
    through: bool  #: whether the arm goes through the cloth


class Led(Moves):
    """A shirt on a person whose arm of `side` is led into its sleeve, while the other hand holds the hem."""

    def __init__(self, shirt: ShirtScene, side: Side, pose: np.ndarray, cloth: np.ndarray) -> None:
        super().__init__(shirt, pose, cloth)
        self._shirt = shirt
        self._side: Side = side
        self._closed = tuple(holder != side for holder in HOLDERS)
        self._entrance = torch.tensor(shirt.sleeve(side)["entrance"].copy())
        self.mirrored = np.array([1.0, 1.0 if side == "left" else -1.0, 1.0])
        self._mine = self._arm(side)
        self._free = [*range(3), *self._mine]
        limited = self._body.jnt_limited[self._free].astype(bool)
        ranges = self._body.jnt_range[self._free]
        self._low, self._high = (np.where(limited, ranges[:, k], s * 2.2) for k, s in enumerate((-1, 1)))  # fmt: skip

    def place(self, phase: int) -> Place:
        pose, x = self.found()
        through = self.through(self._side)
        bones, cloth = torch.tensor(self.bones(self._side))[None], torch.tensor(x)[None]
        ratio = (face_areas(x[self._shirt.faces]) / face_areas(self._shirt.corners)).max()
        inside = progress(bones, cloth[:, self._entrance])[1]
        return Place(phase, pose.copy(), x, float(inside), float(ratio), through)

    def lower(self, share: float, begin: np.ndarray, end: np.ndarray) -> None:
        """Trunk and the arm that holds go by a `share` of the way from those of the pose `begin` to those of `end`, (22,) rad."""
        others = [i for i in range(len(begin)) if i not in self._mine]
        self._mix(others, share, begin, end)

    def go(self, end: np.ndarray, share: float, begin: np.ndarray) -> None:
        """By a `share` of the way from the pose `begin` to `end`, (22,) rad."""
        self._mix(list(range(len(begin))), share, begin, end)

    def spread(self, share: float, begin: np.ndarray) -> None:
        """The arm that goes in goes by a `share` of the way from that of the pose `begin` (22,) rad out to its side."""
        self._mix(self._mine, share, begin, self.bent({self._side: DRESSED}))

    def approach(self, speed: float, to: np.ndarray) -> None:
        """Fingertip and elbow go on by a step of `speed`, m, the elbow of the left arm, or its mirror image, to the place `to`, m."""
        pose, x = self.found()
        self._place(pose)
        bones = self.bones(self._side)
        cloth = torch.tensor(x[self._entrance])[None]
        centre, normal = (one[0].numpy() for one in centre_and_normal(cloth))
        inside = float(progress(torch.tensor(bones)[None], cloth)[1]) > 0
        tip = _towards(bones[0], bones[0] + normal if inside else centre + _BEYOND * normal, speed)
        elbow = _towards(bones[3], self.mirrored * to, speed)
        pose, begin = pose.copy(), pose[self._free].copy()

        def off(hinges: np.ndarray) -> np.ndarray:
            pose[self._free] = hinges
            self._place(pose)
            at = self.bones(self._side)
            mujoco.mj_collision(self._body, self._data)
            near = sum(np.maximum(0.0, _APART - self._data.contact.dist).tolist())
            return np.concatenate([at[0] - tip, _WEIGHT * (at[3] - elbow), 0.03 * (hinges - begin), [3.0 * near]])  # fmt: skip

        inner = np.clip(begin, self._low + 1e-3, self._high - 1e-3)
        pose[self._free] = least_squares(
            off, inner, bounds=(self._low, self._high), diff_step=1e-4, max_nfev=6
        ).x
        self._go(pose)

    def _mix(self, which: list[int], share: float, begin: np.ndarray, end: np.ndarray) -> None:
        pose = self._pose.copy()
        pose[which] = begin[which] + share * share * (3 - 2 * share) * (end - begin)[which]
        self._go(pose)

    def _go(self, pose: np.ndarray) -> None:
        self._pose = pose
        self._step(pose, self._closed)


def _towards(begin: np.ndarray, end: np.ndarray, speed: float) -> np.ndarray:
    way = end - begin
    return begin + way * min(1.0, speed / float(np.linalg.norm(way)))


class Lead(Gathering):
    """Leads arms in a task of ``dressing/shirt_sleeve`` from states of a bank, as ``job=harvest`` leaves of ``dressing/shirt_tuck``;
    or of the second sleeve, where the other arm is in its own.

    If `held`, its states are of a held hem, and the arm goes under it first: ``tucks`` are states until there, whose way ends there.
    From there, and if `back` from where a policy had brought the arm, the hand goes back along the chest to its shoulder.
    It leaves banks in the folders ``ends`` (where the arms began), ``low`` (the hem on its way down), ``half`` and ``near`` (the
    hand on its way, and nearer or in) and ``out`` (the arm on its way out), at rest but for the first, of those arms that
    went all the way through no cloth. Each state has the poses that follow as ``way`` (T, 22) rad, one a decision, the last
    one again from the end of the way on. States that a bank holds out for evaluations are not led.
    """

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

    def __init__(self, options: Options, experiment: Experiment) -> None:
        self.options, self._experiment = options, experiment
        self.device = device_of(experiment.root.device)
        self._gathered = Gathered(options.count)  # of one number: what became of each arm
        self._kept: dict[str, list[dict[str, Tensor]]] = {name: [] for name in PORTIONS}

    def prepare(self) -> None:
        experiment = self._experiment
        root, registry = experiment.root, experiment.registry
        context = Context(
            seed=root.seed, device=torch.device("cpu"), num_worlds=1, control_dt=1.0 / root.control.frequency,
            substeps=root.control.substeps, decision=root.control.decision, registry=registry,
            sections=build_sections(experiment), chosen=experiment.choices, inputs=experiment.inputs,
        )  # fmt: skip
        self._scene = context.scene = experiment.need("scene").build(context)
        self._shirt = context.need_scene(ShirtScene, "job 'dressing/lead'")
        self._every = max(1, round(root.control.decision / root.control.frequency / PERIOD))
        states = bank.starts(self.options.bank, context, "job.bank")
        missing = [name for name in STATE if name not in states]
        if missing:
            raise ConfigError(
                f"job.bank={self.options.bank} has no '{missing[0]}': give one that job=harvest leaves of dressing/shirt_tuck."
            )
        rows = np.linspace(0, len(states["qpos"]) - 1, self.options.count).round().astype(int)
        self._states = {name: states[name][np.unique(rows)] for name in STATE}
        self._gathered = Gathered(len(self._states["qpos"]))

    def iterate(self, samples: int) -> dict[str, Any]:
        row = self._gathered.count
        state = {name: values[row] for name, values in self._states.items()}
        places, way = self._lead(state["qpos"][:22].double().numpy(), state["cloth_position"].double().numpy())  # fmt: skip
        arrived = places[-1].phase == 2 and not places[-1].through
        if arrived:
            self._keep(state, places, np.stack(way))
        self._gathered.add({"arrived": torch.tensor([float(arrived)])})
        return {
            "consumed": len(places) - 1,
            "states": self._gathered.count,
            "progress": max(place.progress for place in places),
            "area_ratio": max(place.ratio for place in places),
            "arrived": float(arrived),
        }

    def _lead(self, pose: np.ndarray, cloth: np.ndarray) -> tuple[list[Place], list[np.ndarray]]:
        """Where the arm was at each decision, until it goes through cloth, is not in in time, or is out at its side; and the
        pose (22,) rad of each step."""
        options, arm, way = (
            self.options,
            Led(self._shirt, self.options.side, pose, cloth),
            list[np.ndarray](),
        )
        places = [arm.place(-1 if options.held else 0)]

        def steps(seconds: float) -> range:
            return range(1, round(seconds / PERIOD) + 1)

        def through(phase: int) -> bool:
            way.append(arm.found()[0].copy())
            if len(way) % self._every == 0:
                places.append(arm.place(phase))
            return places[-1].through

        def gone(who: Side, place: tuple[float, float, float], phase: int) -> bool:
            seconds = options.goes if phase < 0 else options.lowers
            begin, end = arm.found()[0].copy(), arm.reached(who, arm.mirrored * np.array(place))
            for k in steps(seconds):
                arm.go(end, k / len(steps(seconds)), begin)
                if through(phase):
                    return False
            return True

        if options.held or options.back:
            mine = options.side
            other: Side = "left" if mine == "right" else "right"
            under = _UNDER if options.held else ()
            for hand, place in (*under, *_BACK):
                who = mine if hand == "in" else other
                if not gone(who, place, -1 if (hand, place) in under else 0):
                    return places, way
        else:
            mine = options.side
            lowered = self._shirt.settled("in_sleeve", mine, other_dressed=mine == "right")[0]
            for k in steps(options.lowers):
                arm.lower(k / len(steps(options.lowers)), pose, lowered)
                if through(0):
                    return places, way
        for _ in steps(options.most):
            arm.approach(PERIOD * options.speed, np.array(options.elbow))
            if through(1) or places[-1].progress > options.enough:
                break
        if places[-1].progress > options.enough and not places[-1].through:
            begin = arm.found()[0].copy()
            for k in steps(options.out):
                arm.spread(k / len(steps(options.out)), begin)
                if through(2):
                    break
        return places, way

    def _keep(self, state: Mapping[str, Tensor], places: list[Place], way: np.ndarray) -> None:
        options, every = self.options, self._every
        first = options.lowers * (len(_BACK) if options.held or options.back else 1)
        longest = round((first + options.most + options.out) / PERIOD) // every + 1
        decisions = torch.from_numpy(np.concatenate([way[every - 1 :: every], way[-1:]])).float()

        def kept(k: int, until: int | None = None) -> dict[str, Tensor]:
            """The state at decision `k`, and the poses that follow, until that decision and then its own."""
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

        under = sum(place.phase < 0 for place in places)
        end = max(0, under - 1)  # the decision at which the arm is under the hem
        self._kept["ends"].append(kept(end))
        if under:
            self._kept["tucks"].append(kept(0, end))
        hand = sum(place.phase == 1 for place in places)
        first = sum(place.phase <= 0 for place in places)
        for k in range(options.keep, len(places), options.keep):
            phase = places[k].phase
            if places[k].ratio >= options.torn or k == end:
                continue
            if phase < 0:
                self._kept["tucks"].append(kept(k, end))
            else:
                name = ("low", "half" if k < first + hand // 2 else "near", "out")[phase]
                self._kept[name].append(kept(k))

    def stage(self) -> str:
        return self._gathered.stage("arms led")

    def products(self, run: Run) -> None:
        if not self._kept["ends"]:
            raise TrainingError(
                f"No arm came into the sleeve from job.bank={self.options.bank}. Lead more of its states (job.count), or harvest "
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

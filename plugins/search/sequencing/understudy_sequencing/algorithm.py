"""Algorithm 1 of the dressing paper (section 5) over any list of experiments, as an outer loop."""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from understudy.errors import suggestion
from understudy.options import check_range
from understudy_sweeps.chain import Chain
from understudy_sweeps.loops import OuterLoop, Report, Trial

#: What may name a subtask: a folder's and an override's `{NAME}` both take it.
_NAME = re.compile(r"[A-Za-z0-9_]+")


class Algorithm1(OuterLoop):
    """Subtasks, each trained to end where the next one begins, in two passes.

    ========================  =====================================================================
    stage                     what
    ========================  =====================================================================
    ``NAME_starts``           a bank of the subtask's own, narrow starts, and so their mean
    ``NAME_first``            the first pass (lines 1 to 4): with a term towards the mean of the next
                              subtask's starts, all but the last
    ``NAME``                  the second pass (lines 5 to 11), from ``NAME_first`` if `warm`: the first
                              subtask from its starts, widened; each later one from where the one
                              before it ended
    ``NAME_ends``             a bank of where the episodes of ``NAME`` ended
    ========================  =====================================================================

    Each is a run that resumes by itself; a sweep that was stopped goes on at the stage where it was.
    """

    extendable = ("subtasks",)

    @dataclass(frozen=True)
    class Options:
        #: in order, by name, the overrides of each, its narrow starts among them
        subtasks: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
        #: by subtask, what its harvest is given in place of `ending`: [job.moment=change, job.field=gripped, job.value=1]
        ends: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
        #: by subtask, what its second pass is given in place of `starts`, where a task begins in a bank by a part of its
        #: own: [initial_states.file='{grip_ends}'] names the bank of the subtask before, grip
        begins: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
        passes: Literal["both", "first"] = "both"  #: ``first``: the paper's ablation
        #: α of line 5, by which the covariance of the first subtask's starts is multiplied (not
        #: published); 1 leaves its starts as they are
        widening: float = 2.0
        #: where second-pass episodes begin: ``gaussian`` as fits the ends of the subtask before (the
        #: paper), or ``bank``, those ends themselves (its code)
        starts: Literal["gaussian", "bank"] = "gaussian"
        warm: bool = True  #: whether the second pass goes on from the first one's policy
        field: str = "qpos"  #: of the state: what is to come near the mean of the next one's starts
        weight: float = 1.0  #: w of line 2, of minus the distance; 0 leaves the term out
        ending: str = "success"  #: which endings are the next one's starts, as of ``job=harvest``
        count: int = 256  #: states of each bank (2018 code: 20)
        seconds: float = 0.1  #: s, for which starts are simulated before they are kept
        fields: tuple[str, ...] = ()  #: that banks keep beside the simulator's state
        #: overrides of every training and bank of starts, before the subtask's own
        each: tuple[str, ...] = ()

        def __post_init__(self) -> None:
            check_range(self, "widening", "seconds", above=0)
            check_range(self, "weight", least=0)
            check_range(self, "count", least=2)
            if not self.subtasks:
                raise ValueError("subtasks={} is not possible: give at least one.")
            for option, given in (("ends", self.ends), ("begins", self.begins)):
                for name in given:
                    if name not in self.subtasks:
                        raise ValueError(
                            f"{option}.{name} is of no subtask.{suggestion(name, self.subtasks)}"
                        )
            first = next(iter(self.subtasks))
            if first in self.begins:
                raise ValueError(
                    f"begins.{first} is not possible: the first subtask begins where it does by itself."
                )
            taken: set[str] = set()
            for name in self.subtasks:
                if not _NAME.fullmatch(name):
                    raise ValueError(
                        f"subtasks.{name} is not possible: name it by letters, digits and _."
                    )
                stages = {name, *(f"{name}_{end}" for end in ("starts", "first", "ends"))}
                if stages & taken:
                    raise ValueError(
                        f"subtasks.{name} is not possible: '{min(stages & taken)}' would be the name of "
                        "two stages. Name it otherwise."
                    )
                taken |= stages

    alike = Chain.alike

    def __init__(self, options: Options, seed: int = 0) -> None:
        self._chain = Chain(Chain.Options(stages_of(options), options.each), seed)
        self.share, self.missing = 0.0, self._chain.missing

    def ask(self, number: int) -> Trial | None:
        return self._chain.ask(number)

    def recall(self, trial: Trial) -> bool:
        return self._chain.recall(trial)

    def tell(self, report: Report) -> None:
        self._chain.tell(report)
        self.share, self.missing = self._chain.share, self._chain.missing

    def summary(self) -> list[dict[str, Any]]:
        """A row for each stage: what came of it, and its samples."""
        return self._chain.summary()


def stages_of(options: Algorithm1.Options) -> dict[str, tuple[str, ...]]:
    """The stages of a :class:`Chain`, by name the overrides of each."""
    names = list(options.subtasks)
    stages: dict[str, tuple[str, ...]] = {}
    kept = f"job.fields=[{','.join(options.fields)}]"
    both = options.passes == "both"
    widened = both and options.widening != 1.0
    for number, name in enumerate(names):
        wanted = (number > 0 and options.weight > 0) or (number == 0 and widened)
        if wanted:
            stages[f"{name}_starts"] = (
                *options.subtasks[name], "job=settle", f"job.count={options.count}",
                f"job.seconds={options.seconds}", kept,
            )  # fmt: skip
    towards = {
        name: f"+reward.terms.next_start={{name: sequencing/next_start, weight: {options.weight}, "
        f"field: {options.field}, reads: {{value: {options.field}}}, file: '{{{later}_starts}}'}}"
        for name, later in itertools.pairwise(names)
        if options.weight > 0
    }
    for name in names:
        ends = (towards[name],) if name in towards else ()
        stages[f"{name}_first"] = (*options.subtasks[name], *ends)
    if not both:
        return stages
    for number, name in enumerate(names):
        begins: tuple[str, ...] = ()
        if number > 0:
            given = options.begins.get(name)
            file = f"'{{{names[number - 1]}_ends}}'"
            begins = _starts(options.starts, file, 1.0) if given is None else given
        elif widened:
            begins = _starts("gaussian", f"'{{{name}_starts}}'", options.widening)
        warm = (f"start.run='{{{name}_first}}'",) if options.warm else ()
        ends = (towards[name],) if name in towards else ()
        stages[name] = (*options.subtasks[name], *ends, *begins, *warm)
        if number + 1 < len(names):
            stages[f"{name}_ends"] = (
                "job=harvest", f"job.run='{{{name}}}'",
                *options.ends.get(name, (f"job.ending={options.ending}",)), f"job.count={options.count}", kept,
            )  # fmt: skip
    return stages


def _starts(kind: str, file: str, widening: float) -> tuple[str, ...]:
    if kind == "bank":
        return ("initial_states=bank", f"initial_states.file={file}")
    return (
        "initial_states=sequencing/gaussian", f"initial_states.file={file}",
        f"initial_states.widening={widening}",
    )  # fmt: skip

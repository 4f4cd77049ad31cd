"""What a run shows of itself: a report page, the motion as video, and metrics for TensorBoard."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from understudy import hookimpl
from understudy.setup.registry import Registrar

if TYPE_CHECKING:
    from understudy.records.observer import RunObserver

#: Plugins that this one builds on.
REQUIRES = ("motion",)

_HERE = "understudy_report"


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.kind("report_section", "a part of a run's report page")
    register.component(
        "command",
        "runs",
        f"{_HERE}.listing:ListRuns",
        "list runs, newest first, with their results",
    )

    def add(name: str, target: str, summary: str) -> None:
        register.component("report_section", name, f"{_HERE}.{target}", summary)

    add("headline", "headline:Headline", "the result in a sentence, and the figures to remember")
    add("motion", "motion:Motion", "the video or a stick figure player, and a filmstrip")
    add("evaluation", "evaluation:EvaluationSection", "what the last evaluation found")
    add("learning", "learning:LearningCurves", "metrics against samples")
    add("model_error", "model_error:ModelError", "where a learned model goes wrong")
    add("provenance", "provenance:Provenance", "what is needed to repeat the run, whom to credit")
    add("configuration", "configuration:Configuration", "the composed configuration")


@hookimpl
def understudy_run_observers() -> Iterable[RunObserver]:
    from understudy_report.maker import ReportMaker
    from understudy_report.progress import ProgressLine
    from understudy_report.tensorboard import TensorBoard

    return [ProgressLine(), TensorBoard(), ReportMaker()]

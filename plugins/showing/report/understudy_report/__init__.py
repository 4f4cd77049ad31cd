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

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "command": {
        "runs": ("listing:ListRuns", "list runs, newest first, with their results"),
    },
    "report_section": {
        "headline": ("headline:Headline", "the result in a sentence, and the figures to remember"),
        "motion": ("motion:Motion", "the video or a stick figure player, and a filmstrip"),
        "evaluation": ("evaluation:EvaluationSection", "what the last evaluation found"),
        "learning": ("learning:LearningCurves", "metrics against samples"),
        "model_error": ("model_error:ModelError", "where a learned model goes wrong"),
        "provenance": ("provenance:Provenance", "what is needed to repeat the run, whom to credit"),
        "configuration": ("configuration:Configuration", "the composed configuration"),
    },
}


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.kind("report_section", "a part of a run's report page")
    register.parts(__name__, PARTS)


@hookimpl
def understudy_run_observers() -> Iterable[RunObserver]:
    from understudy_report.maker import ReportMaker
    from understudy_report.progress import ProgressLine
    from understudy_report.tensorboard import TensorBoard

    return [ProgressLine(), TensorBoard(), ReportMaker()]

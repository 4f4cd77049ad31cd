"""What the report says about standing."""

from understudy.records.runs import Run
from understudy_report.section import ReportSection
from understudy_report.values import mapping, number, read_evaluation


class StandingSection(ReportSection):
    """How long the trunk was upright at the end of an episode."""

    title = "Standing"
    order = 30

    def html(self, run: Run) -> str | None:
        measures = mapping(read_evaluation(run).get("measures"))
        seconds = number(mapping(measures.get("upright")).get("mean"))
        if seconds is None:
            return None
        return f"<p>The trunk was upright for the last {seconds:.1f} s of an episode.</p>"

"""The errors of a learned model of the simulator, if the learner has one and reports them."""

from __future__ import annotations

from understudy.records.runs import Run
from understudy_report.charts import Chart, draw_chart
from understudy_report.markup import grid
from understudy_report.section import ReportSection
from understudy_report.values import number

#: Metrics ``model_error/BODY/DECISIONS``: m off after so many decisions on its own.
PREFIX = "model_error/"


class ModelError(ReportSection):
    """A table of the errors when they were last measured, by body and by decisions ahead, and a curve of the mean
    over the bodies."""

    title = "The learned model's error"
    order = 65

    def html(self, run: Run) -> str | None:
        rows, means, last = [], {}, {}
        for row in run.metrics():
            found = {}
            for key, value in row.items():
                body, _, horizon = key.removeprefix(PREFIX).rpartition("/")
                off = number(value)
                if key.startswith(PREFIX) and horizon.isdecimal() and off is not None:
                    found[body, int(horizon)] = off
            if found:
                last = found
                horizons = sorted({horizon for _, horizon in found})
                for horizon in horizons:
                    every = [off for (_, h), off in found.items() if h == horizon]
                    means[f"{PREFIX}{horizon}"] = horizon
                    row = {**row, f"{PREFIX}{horizon}": 100.0 * sum(every) / len(every)}
                rows.append(row)
        if not last:
            return None
        horizons = sorted({horizon for _, horizon in last})
        bodies = sorted({body for body, _ in last}, key=lambda b: -last.get((b, horizons[-1]), 0.0))
        table = grid(
            ("Body", *(f"{h} ahead" for h in horizons)),
            ((body, *(_centimetres(last.get((body, h))) for h in horizons)) for body in bodies),
        )
        end = max((x for row in rows if (x := number(row.get("samples"))) is not None), default=0.0)
        charts = "".join(
            draw_chart(
                Chart(f"{h} decision{'s' * (h != 1)} ahead", key, "cm", low=0.0), rows, (), end
            )
            for key, h in sorted(means.items(), key=lambda item: item[1])
        )
        return (
            "<p>How far each body is from where the simulator has it, when the model goes on by itself "
            "with the same actions; the mean over episodes that last so long, on decisions that it has "
            f'not been trained on. The last look, in cm:</p><div class="card">{table}</div>'
            f'<h3>Mean over the bodies</h3><div class="charts">{charts}</div>'
        )


def _centimetres(off: float | None) -> str:
    return "" if off is None else f"{100.0 * off:.1f}"

"""The auto-encoder's poses on the report page: drawn, rebuilt, and along each number of the code."""

from __future__ import annotations

from html import escape

from understudy.records.runs import Run
from understudy_motion.readers.npz import Archive
from understudy_pose_vae import pictures
from understudy_report.markup import grid
from understudy_report.section import ReportSection
from understudy_report.values import mapping, number, read_evaluation

_CELL = (128, 150)


class PosesSection(ReportSection):
    """Samples as a grid, held-out poses beside what is made of them, and figures beside PCA's."""

    title = "Poses"
    order = 20

    def html(self, run: Run) -> str | None:
        file = run.path / pictures.FILE
        if not file.is_file():
            return None
        archive = Archive(file)
        bones = archive.integers("bones", None, 2).tolist()

        def drawn(name: str, colour: str = "var(--learned)") -> list[str]:
            places = archive.floats(f"places/{name}", None, None, 3)
            return [pictures.figure(p, bones, colour) for p in places]

        pairs = [
            before + after
            for before, after in zip(drawn("given", "var(--reference)"), drawn("rebuilt"), strict=True)
        ]  # fmt: skip
        steps, latent = pictures.STEPS, int(archive.number("latent"))
        along = drawn("along")
        return "".join([
            '<div class="card"><h3>Poses drawn from the codes of the clips</h3>',
            pictures.sheet(drawn("samples"), 10, "poses drawn at random", _CELL),
            '</div><div class="card"><h3>Poses of clips that were held out (grey), rebuilt (blue)</h3>',
            pictures.sheet(pairs, 10, "poses and their reconstructions", _CELL),
            f"</div>{_figures(run, archive, latent)}",
            '<div class="card"><h3>One number of the code changed from −2 to 2 deviations</h3>',
            f'<div class="charts">{"".join(_strip(along[i * steps : (i + 1) * steps], i) for i in range(latent))}',
            "</div></div>",
        ])  # fmt: skip


def _strip(figures: list[str], number: int) -> str:
    sheet = pictures.sheet(figures, len(figures), f"code {number + 1}", (100, 150))
    return f"<div><h4>{number + 1}</h4>{sheet}</div>"


def _figures(run: Run, archive: Archive, latent: int) -> str:
    measures = mapping(read_evaluation(run).get("measures"))

    def own(name: str) -> float | None:
        return number(mapping(measures.get(name)).get("mean"))

    learned, held_out = archive.integers("poses", 2).tolist()
    share = archive.floats("explained", None)
    names = ("rotation_error", "position_error", "explained_variance")
    words = ("Error of a joint's rotation", "Error of a joint's place", "Explained variance")
    units = ("°", " cm", " %")
    rows = [
        [word, *(_shown(value, unit) for value in (own(name), float(other)))]
        for word, unit, name, other in zip(
            words, units, names, archive.floats("principal", 3), strict=True
        )
    ]
    components = int((share < 0.85).sum()) + 1
    text = (
        f"Learned from {learned} poses, judged on {held_out} of other clips. {latent} principal components "
        f"cover {100 * share[latent - 1]:.1f} % of the variance learned from; {components} would cover 85 %."
    )
    heads = ["", "auto-encoder", f"{latent} principal components"]
    return f'<div class="card">{grid(heads, rows)}<p>{escape(text)}</p></div>'


def _shown(value: float | None, unit: str) -> str:
    if value is None:
        return "–"
    return f"{100 * value:.1f}{unit}" if unit == " %" else f"{value:.2f}{unit}"

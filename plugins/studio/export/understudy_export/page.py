"""A recorded motion as one page that plays in any browser, without a network."""

from __future__ import annotations

from html import escape
from pathlib import Path

from understudy.errors import FileError
from understudy.folders import write_atomically
from understudy.records import runs
from understudy_credits.walk import in_a_line, open_made
from understudy_report import words
from understudy_report.motion import FIGURES, Figures
from understudy_report.page import html_page, name_of
from understudy_report.stick_figures import stick_figure_animation


def write_page(source: str, path: Path, made: str | None = None) -> str:
    """Write what was recorded of the run folder `source` as the page `path`; returns a line on it. `made` is the skill
    that was recorded there, which knows on what terms it may be shown.

    Raises
    ------
    FileError
        nothing was recorded that can be drawn.
    RunError
        there is no such run, or the page cannot be written.
    """
    run = runs.open_run(source)
    figures = Figures.load(run.path / FIGURES)
    player = figures and stick_figure_animation(figures.learned, figures.reference, figures.dt)
    if figures is None or not player:
        raise FileError(
            f"{run.path} has no recording to play: `understudy render {run.path}` makes one, if its task has a figure of "
            "links; for cloth, grains and points, report.html shows the video, and for cloth an export to .glb each frame."
        )
    licence, attribution = in_a_line(open_made(made or source))
    said = f"Licence: {licence}. " if licence else ""  # of a motion of nobody's clip and no model
    names = ["learned"] if figures.reference is None else ["learned", "reference"]
    key = "".join(f'<span class="key {name}">{name}</span>' for name in names)
    content = (
        f'<section><div class="card">{player}</div><p>{key}</p>'
        f"<p>{escape(f'{said}{attribution}')}</p></section>"
    )
    created = words.text(run.info.get("created", ""))[:16].replace("T", " ")
    write_atomically(path, html_page(name_of(run), "understudy export", created, content))
    seconds = len(figures.learned) * figures.dt
    line = f"{path}: {len(figures.learned)} frames, {seconds:.2f} s"
    return f"{line} · licence: {licence}" if licence else line

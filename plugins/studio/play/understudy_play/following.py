"""What a page shows of a run beside its newest policy: the policies of its checkpoints, and its curves."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from html import escape
from typing import Any

import numpy as np
import viser
from torch import Tensor

from understudy.errors import RunError, shown
from understudy.records import checkpoint, runs
from understudy_play.player import Player
from understudy_skills.skill import Skill

#: s between two looks into the folder.
_EVERY = 2.0
#: Points of a curve at most.
_POINTS = 400
#: By chart: its title, and how the metrics that it has begin.
_CHARTS = {
    "reward": ("Reward per step, by term", ("reward",)),
    "bounds": ("Episodes ended by", ("episode/ended_by/",)),
}
#: Of curves, in turn; legible on light and dark.
_COLOURS = ("#3b82f6", "#ef4444", "#10b981", "#f59e0b", "#8b5cf6", "#ec4899", "#14b8a6", "#84cc16")
_SMALL = "<div style='margin:0 .75em;font-size:.85em;color:#667080'>"


class Following:
    """For the run in the folder `path`, whose policy `player` plays: a slider over its checkpoints, which
    stays at the newest until it is moved, and curves by reward term and by what ended episodes. With `growing`, the folder
    is read again and again, since its training still runs.
    """

    def __init__(self, player: Player, path: str, *, growing: bool) -> None:
        self._player, self._run, self._growing = player, runs.open_run(path), growing
        self._kept: list[int] = []
        self._wanted: int | None = None  #: the iteration that the visitor chose; None: the newest
        self._played = -1
        self._size, self._due = -1, 0.0
        self._charts: dict[str, tuple[tuple[str, ...], Any]] = {}

    def add_to(self, gui: viser.GuiApi) -> None:
        """Put it where `gui` has come to."""
        self._gui = gui
        self._slider = gui.add_slider("Checkpoint", 0, 1, 1, 1, hint="the last is the newest")
        self._told = gui.add_html("")
        self._folder = gui.add_folder("Curves")

        @self._slider.on_update
        def _(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:  # and not from here
                self.choose(int(self._slider.value))

        self.look()

    def choose(self, place: int) -> None:
        """Play the checkpoint at this `place` of the slider from the next look on."""
        kept = self._kept
        self._wanted = None if place >= len(kept) - 1 else kept[max(place, 0)]
        self._due = 0.0

    def advance(self) -> None:
        """Look again if it is time, or the visitor chose another policy."""
        if time.monotonic() >= self._due:
            self.look()

    def look(self) -> None:
        """Take up what the run keeps now."""
        self._due = time.monotonic() + _EVERY if self._growing else np.inf
        found = checkpoint.newest(self._run.checkpoints)
        kept = sorted(int(path.name) for path in found if path.name.isdigit())
        if kept != self._kept:
            self._kept = kept
            self._slider.max = max(1, len(kept) - 1)
        if kept and self._wanted not in kept:  # its file is gone, or none was chosen
            self._wanted = None
        if kept:
            self._take(kept[-1] if self._wanted is None else self._wanted)
        self._draw()

    def _take(self, iteration: int) -> None:
        place = self._kept.index(iteration)
        if self._slider.value != place:
            self._slider.value = place
        if iteration == self._played:
            return
        try:
            state, _ = checkpoint.load(self._run.checkpoints / f"{iteration:08d}")
            skill = _with(self._player.skill, state)
            self._player.take(skill)
        except RunError as error:  # replaced meanwhile, or damaged: what plays goes on
            self._told.content = f"{_SMALL}{escape(shown(str(error)))}</div>"
            return
        self._played = iteration
        newest = ", the newest" if iteration == self._kept[-1] else ""
        self._told.content = (
            f"{_SMALL}after iteration {iteration}{newest}: {skill.samples:,} samples</div>"
        )

    def _draw(self) -> None:
        try:
            size = self._run.metrics_file.stat().st_size
        except OSError:
            return
        if size == self._size:
            return
        self._size = size
        rows = self._run.metrics()
        for key, (title, begins) in _CHARTS.items():
            names, data = curves(rows, begins)
            before, handle = self._charts.get(key, ((), None))
            if names and names == before:
                handle.data = data
            elif names:
                if handle is not None:
                    handle.remove()
                with self._folder:
                    handle = self._gui.add_uplot(
                        data,
                        _series(names, begins),
                        title=title,
                        aspect=1.3,
                        scales={"x": {"time": False}},
                    )
                self._charts[key] = names, handle


def curves(
    rows: Sequence[Mapping[str, Any]], begins: tuple[str, ...]
) -> tuple[tuple[str, ...], tuple[np.ndarray, ...]]:
    """Of the metrics whose names begin so: the names, and the samples (T,) with each one's values (T,),
    NaN where a row has none. At most 400 of the rows, evenly, the last among them."""
    rows = [row for row in rows if isinstance(row.get("samples"), (int, float))]
    names = tuple(dict.fromkeys(n for row in rows for n in row if n.startswith(begins)))
    if len(rows) > _POINTS:
        rows = [rows[i] for i in np.linspace(0, len(rows) - 1, _POINTS).round().astype(int)]
    columns = [[row["samples"] for row in rows]]
    columns += [
        [v if isinstance(v := row.get(n), (int, float)) else np.nan for row in rows] for n in names
    ]
    return names if len(rows) > 1 else (), tuple(np.asarray(c, float) for c in columns)


def _series(names: Sequence[str], begins: tuple[str, ...]) -> tuple[Any, ...]:
    labels = [name.removeprefix(begins[0]).lstrip("/") or "all" for name in names]
    return (
        {"label": "samples"},
        *(
            {"label": label, "stroke": _COLOURS[i % len(_COLOURS)], "width": 1.5, "spanGaps": True}
            for i, label in enumerate(labels)
        ),
    )


def _with(skill: Skill, state: Mapping[str, Any]) -> Skill:
    policy = state.get("policy")
    if not isinstance(policy, dict) or not all(isinstance(t, Tensor) for t in policy.values()):
        raise RunError(f"{skill.name} keeps no policy there.")
    return replace(skill, policy=policy, samples=int(state["progress"]["samples"]))

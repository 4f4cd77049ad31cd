"""Runs as the tests of the report need them, and pages taken apart."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np

from understudy.records.runs import Run
from understudy.setup.plugins import load
from understudy.setup.registry import Registry
from understudy_report.motion import FIGURES, Figures
from understudy_report.page import write_report

EVIL = "<script>alert(1)</script>\"'&"
VOID = {"meta", "input", "link", "br", "img"}
#: Stick figures that do not move, (T, S, 2, 3).
STILL = np.zeros((5, 3, 2, 3))


class Page(HTMLParser):
    """Checks that elements nest, and collects scripts, links, texts and headings."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[str] = []
        self.scripts: list[dict[str, str | None]] = []
        self.addresses: list[str] = []
        self.headings: list[str] = []
        self.text = ""
        self.feed(html)
        self.close()
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        if tag not in VOID:
            self.open.append(tag)
        if tag == "script":
            self.scripts.append(dict(attrs))
        self.addresses += [v or "" for k, v in attrs if k in ("src", "href", "action")]
        assert not any(k.startswith("on") for k, _ in attrs)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open[-1:] not in (["script"], ["style"]):
            self.text += data
        if self.open[-1:] == ["h2"]:
            self.headings.append(data)


def make_run(folder: Path, **info: Any) -> Run:
    complete = {
        "config": {"task": "spacetime/walk", "seed": 3, "device": "cpu", "reward": {"terms": {}}},
        "created": "2025-06-02T10:11:12+0200",
        "versions": {"understudy": "0.1.0"},
        "machine": {"system": "Linux", "processor": "", "cores": 2},
        "command": ["understudy", "train", "seed=3"],
        "overrides": ["seed=3"],
        "components": [
            {
                "kind": "learner",
                "name": "ppo",
                "plugin": "ppo",
                "distribution": "d",
                "version": "1.2",
            }
        ],
        "sources": {"motion": {"file": "walk.txt", "licence": "MIT"}},
        "citations": ["Schulman 2017"],
    }
    return Run(folder, {**complete, **info})


def add_metrics(run: Run, count: int) -> None:
    for i in range(1, count + 1):
        run.append_metrics(
            {
                "iteration": i,
                "samples": 1000 * i,
                "seconds": 3.0 * i,
                "samples_per_second": 333.3,
                "reward": i / count,
                "kl": 0.01,
                "explained_variance": 1 - 1 / i,
                "episode/episode_seconds": 0.1 * i,
                "episode/truncated": 0.25,
                "episode/ended_by/fall": 0.75,
            }
        )


def evaluation(rate: float = 62 / 64, **other: Any) -> dict[str, Any]:
    """What an evaluation writes."""
    return {
        "episodes": 64,
        "seconds": 20.0,
        "samples": 96_000,
        "policy": "deterministic",
        "success_rate": rate,
        "success_rate_95": [0.89, 0.99],
        "success": "survived: 20 s without fall",
        "mean_episode_seconds": 19.43,
        "violated": {"com": 0.4, "fall": 0.03125},
        "measures": {
            "within_all_bounds": {
                "reduce": "min", "mean": 0.6, "spread": 0.49, "mean_95": [0.54, 0.66],
            },
            "height": {"reduce": "max", "mean": 1.234, "spread": 0.1, "mean_95": [1.2, 1.27]},
        },
        "objective": {"name": "success_rate", "value": rate},
        "starts": "never used in training",
        **other,
    }  # fmt: skip


def add_evaluation(run: Run, rate: float = 62 / 64, **other: Any) -> None:
    run.write_json("evaluation.json", evaluation(rate, **other))


def report(
    run: Run,
    outlines: np.ndarray | None = None,
    reference: np.ndarray | None = None,
    registry: Registry | None = None,
) -> tuple[Page, str]:
    """The page of `run` with the stick figures, of the bundled sections or those of `registry`."""
    if outlines is not None:
        Figures(outlines, reference, 1 / 30).save(run.path / FIGURES)
    path = write_report(run, registry or load(only=["report"]).registry)
    assert path == run.path / "report.html"
    html = path.read_text(encoding="utf-8")
    return Page(html), html

"""Reports of complete, incomplete and hostile runs."""

from __future__ import annotations

import base64
import json
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from understudy.errors import RunError
from understudy.records.runs import Run
from understudy.report import write_report
from understudy.running.evaluation import Evaluation

EVIL = "<script>alert(1)</script>\"'&"
VOID = {"meta", "input", "link", "br"}


class Page(HTMLParser):
    """Checks that elements nest, and collects scripts, links and text."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[str] = []
        self.scripts: list[dict[str, str | None]] = []
        self.addresses: list[str] = []
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


def add_evaluation(run: Run, rate: float = 62 / 64, samples: int = 96_000) -> None:
    evaluation = Evaluation(64, rate, 19.43, {"fall": 0.03125}, 0.953, 20.0, True)
    run.write_json("evaluation.json", evaluation.as_json(samples))


def report(
    run: Run, outlines: np.ndarray | None = None, reference: np.ndarray | None = None
) -> tuple[Page, str]:
    path = write_report(run, outlines, reference)
    assert path == run.path / "report.html"
    html = path.read_text(encoding="utf-8")
    return Page(html), html


def test_complete_run(tmp_path: Path) -> None:
    run = make_run(tmp_path)
    add_metrics(run, 100)
    add_evaluation(run)
    page, _ = report(run, np.zeros((5, 3, 2, 3)), None)
    # 96 of the 100 rows are behind the evaluated policy, 3 s each.
    assert (
        "97 % of 64 episodes of 20 s succeeded (95 % interval 89–99 %), after 96,000 samples and "
        "4.8 min of training on 2 cores." in page.text
    )
    for text in (
        "spacetime/walk", "Episode length", "Reward per step", "Explained variance", "KL divergence",
        "Samples per second", "Ended by fall", "learner/ppo", "MIT", "Schulman 2017", "0.1.0",
        "understudy train seed=3", "seed: 3",
    ):  # fmt: skip
        assert text in page.text
    assert page.addresses == []


def test_nothing_comes_from_the_network(tmp_path: Path) -> None:
    run = make_run(tmp_path)
    add_metrics(run, 3)
    _, html = report(run, np.zeros((5, 3, 2, 3)), np.zeros((5, 3, 2, 3)))
    for address in re.findall(r"https?://[^\s\"']+", html):
        assert address == "http://www.w3.org/2000/svg"  # a name, which is never fetched
    assert "@import" not in html
    assert "url(" not in html


def test_video_takes_the_place_of_the_player(tmp_path: Path) -> None:
    run, figure = make_run(tmp_path), np.zeros((5, 3, 2, 3))
    assert "Play" in report(run, figure)[0].text
    video = b"\0video"
    (tmp_path / "video.mp4").write_bytes(video)
    page, html = report(run, figure)
    assert page.scripts == []
    assert f"data:video/mp4;base64,{base64.b64encode(video).decode()}" in html
    assert "0.0 s" in page.text  # the filmstrip stays


def test_text_of_strangers_is_escaped(tmp_path: Path) -> None:
    run = make_run(
        tmp_path,
        config={"task": EVIL, EVIL: [EVIL], "device": EVIL, "seed": EVIL},
        created=EVIL,
        versions={EVIL: EVIL},
        machine={EVIL: EVIL},
        command=[EVIL],
        overrides=[EVIL],
        components=[{k: EVIL for k in ("kind", "name", "plugin", "distribution", "version")}],
        sources={EVIL: {EVIL: {"licence": EVIL}, "list": [EVIL]}},
        citations=[EVIL],
    )
    run.append_metrics(
        {"samples": 1, "seconds": 1, f"episode/ended_by/{EVIL}": 0.5, "reward": EVIL}
    )
    add_evaluation(run)
    evaluation = json.loads((tmp_path / "evaluation.json").read_text())
    evaluation |= {"violated": {EVIL: 0.5}, "policy": EVIL, "episodes": EVIL}
    run.write_json("evaluation.json", evaluation)
    page, html = report(run)
    assert page.scripts == []
    assert EVIL not in html
    assert page.text.count("<script>alert(1)</script>") > 10


def test_only_the_player_may_run(tmp_path: Path) -> None:
    page, html = report(make_run(tmp_path), np.zeros((5, 3, 2, 3)))
    assert page.scripts == [{"type": "application/json"}, {}]
    assert "default-src 'none'" in html
    assert "script-src 'sha256-" in html


def test_empty_run(tmp_path: Path) -> None:
    page, _ = report(Run(tmp_path, {}))
    assert "Nothing has been learned yet." in page.text
    assert tmp_path.name in page.text
    assert "h2" not in page.tags


@pytest.mark.parametrize("rows", [1, 2, 150, 1000])
def test_any_number_of_rows(tmp_path: Path, rows: int) -> None:
    run = make_run(tmp_path)
    add_metrics(run, rows)
    page, html = report(run)
    assert f"Not evaluated yet, after {rows * 1000:,} samples and" in page.text
    assert ("circle" in page.tags) == (rows == 1)
    assert ('class="band"' in html) == (rows == 1000)
    assert len(html) < 200_000


@pytest.mark.parametrize(
    "value", [float("nan"), float("inf"), -1e300, 10**400, "x", None, [], True]
)
def test_values_that_are_no_numbers(tmp_path: Path, value: Any) -> None:
    run = make_run(tmp_path)
    add_metrics(run, 3)
    run.append_metrics({"samples": 4000, "seconds": value, "reward": value, "kl": value})
    run.append_metrics({"samples": value, "reward": 1.0, "entropy": 0.0})
    run.append_metrics({"episode/ended_by/never": value, "samples": 5000})
    page, html = report(run)
    assert "2 not finite" in page.text
    assert not re.search(r'(cx|cy|x|y|d)="[^"]*(nan|inf)', html)


@pytest.mark.parametrize("value", [0.0, 5.0, -5.0, 1e-12, 1e20])
def test_constant_curve(tmp_path: Path, value: float) -> None:
    run = make_run(tmp_path)
    for i in range(3):
        run.append_metrics(
            {"samples": i, "reward": value, "kl": value, "explained_variance": value}
        )
    _, html = report(run)
    assert html.count('class="line"') == 3


@pytest.mark.parametrize("content", ["", "{", "[1]", '"x"', '{"success_rate": "x"}', "\xff"])
def test_damaged_evaluation(tmp_path: Path, content: str) -> None:
    (tmp_path / "evaluation.json").write_text(content, encoding="latin-1")
    page, _ = report(make_run(tmp_path))
    assert "Nothing has been learned yet." in page.text


@pytest.mark.parametrize("value", [None, 3, "x", ["x"], {"x": 1}])
def test_info_of_other_types(tmp_path: Path, value: Any) -> None:
    keys = ("config", "created", "versions", "machine", "command", "overrides", "components",
            "sources", "citations")  # fmt: skip
    report(make_run(tmp_path, **{key: value for key in keys}))


def test_lone_surrogates(tmp_path: Path) -> None:
    page, _ = report(make_run(tmp_path, config={"task": "walk\ud800"}))
    assert "walk?" in page.text


@pytest.mark.parametrize(
    ("rate", "text"),
    [(1.0, "100 %"), (0.999, "99.9 %"), (0.001, "0.1 %"), (0.0, "0 %"), (0.5, "50 %")],
)
def test_only_all_episodes_are_100_percent(tmp_path: Path, rate: float, text: str) -> None:
    run = make_run(tmp_path)
    add_evaluation(run, rate)
    assert f"{text} of 64 episodes" in report(run)[0].text


def test_unwritable_folder(tmp_path: Path) -> None:
    with pytest.raises(RunError, match="could not be written"):
        write_report(make_run(tmp_path / "missing"))

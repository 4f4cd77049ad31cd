"""Reports of complete, incomplete and hostile runs."""

from __future__ import annotations

import base64
import json
import re
from pathlib import Path
from typing import Any

import pytest
from report_runs import EVIL, STILL, add_evaluation, add_metrics, evaluation, make_run, report

from understudy.errors import RunError
from understudy.records.runs import Run
from understudy_report.page import write_report


def test_complete_run(tmp_path: Path) -> None:
    run = make_run(tmp_path)
    add_metrics(run, 100)
    add_evaluation(run)
    page, _ = report(run, STILL)
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
    assert page.headings == ["Motion", "Evaluation", "Learning", "Provenance", "Configuration"]
    assert "left out" not in page.text


def test_nothing_comes_from_the_network(tmp_path: Path) -> None:
    run = make_run(tmp_path)
    add_metrics(run, 3)
    add_evaluation(run)
    _, html = report(run, STILL, STILL)
    for address in re.findall(r"https?://[^\s\"']+", html):
        assert address == "http://www.w3.org/2000/svg"  # a name, which is never fetched
    assert "@import" not in html
    assert "url(" not in html


def test_video_takes_the_place_of_the_player(tmp_path: Path) -> None:
    run = make_run(tmp_path)
    assert "Play" in report(run, STILL)[0].text
    video = b"\0video"
    (tmp_path / "video.mp4").write_bytes(video)
    page, html = report(run, STILL)
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
    run.append_metrics({"samples": 2, f"mark/{EVIL}": 1.0, f"evaluation/{EVIL}": 0.5})
    add_evaluation(
        run, violated={EVIL: 0.5}, policy=EVIL, episodes=EVIL, success=EVIL, starts=EVIL,
        measures={EVIL: {"reduce": EVIL, "mean": 0.5}}, objective={"name": EVIL, "value": 1.0},
    )  # fmt: skip
    page, html = report(run)
    assert "left out" not in page.text
    assert page.scripts == []
    assert EVIL not in html
    assert page.text.count("<script>alert(1)</script>") > 10


def test_only_the_player_may_run(tmp_path: Path) -> None:
    page, html = report(make_run(tmp_path), STILL)
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
def test_damaged_evaluation(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], content: str
) -> None:
    """What cannot be read counted as absent without a word; it is said once, however many read it."""
    run = make_run(tmp_path)
    page, _ = report(run)
    assert "cannot be read" not in capsys.readouterr().err, "there is none"
    (tmp_path / "evaluation.json").write_text(content, encoding="latin-1")
    page, _ = report(run)
    assert "Nothing has been learned yet." in page.text
    said = capsys.readouterr().err.count(
        "evaluation.json cannot be read, so the run counts as not judged"
    )
    assert said == (0 if content.startswith("{") and content != "{" else 1)


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


def test_says_what_success_means(tmp_path: Path) -> None:
    run = make_run(tmp_path)
    add_evaluation(run)
    page, _ = report(run)
    assert "An episode succeeds by this: survived: 20 s without fall." in page.text
    assert "Startsnever used in training" in page.text


def test_says_what_a_measure_means_that_decides_success(tmp_path: Path) -> None:
    run = make_run(tmp_path)
    measure = {"name": "spacetime/within_all_bounds", "reduce": "min"}
    run.info["config"]["measure"] = {"within_all_bounds": measure}
    add_evaluation(run)
    evaluation = json.loads((run.path / "evaluation.json").read_text())
    evaluation |= {"success": "within_all_bounds at least 1"}
    run.write_json("evaluation.json", evaluation)
    page, _ = report(run)
    assert (
        "An episode succeeds if the least within_all_bounds of the episode (1 in all bounds, no fall) is at least 1."
        in page.text
    )
    run.info["config"]["measure"] = {
        "seated": {"name": "value", "reads": {"value": "seated_seconds"}, "reduce": "max"}
    }
    run.write_json("evaluation.json", evaluation | {"success": "seated at least 3"})
    assert (
        "An episode succeeds if the greatest seated of the episode (the field seated_seconds) is at least 3."
        in report(run)[0].text
    )


def test_says_what_a_success_leaves_out(tmp_path: Path) -> None:
    run = make_run(tmp_path)
    add_evaluation(run)
    evaluation = json.loads((run.path / "evaluation.json").read_text())
    run.write_json("evaluation.json", {**evaluation, "violated": {"com": 1.0, "fall": 0.03}})
    page, _ = report(run)
    assert (
        "What else was violated meanwhile does not count: com in 100 % of the episodes."
        in page.text
    )


def test_says_that_episodes_were_over_early(tmp_path: Path) -> None:
    run = make_run(tmp_path)
    add_evaluation(run, cut={"motion_end": 0.6, "pause": 0.0}, mean_episode_seconds=1.71)
    page, _ = report(run)
    assert "97 % of 64 episodes of at most 20 s (1.71 s on average) succeeded" in page.text
    ended = "judged by what there was of them: 60 % of them by motion_end."
    assert ended in page.text


@pytest.mark.parametrize("share", [0.0, 0.25])
def test_says_in_how_many_episodes_numbers_went_wrong(tmp_path: Path, share: float) -> None:
    run = make_run(tmp_path)
    add_evaluation(run, unsound=share)
    page, _ = report(run)
    sentence = "In 25 % of the episodes numbers went wrong, which is never a success."
    assert (sentence in page.text) is bool(share)
    assert ("Numbers went wrong in25 %" in page.text) is bool(share)


def test_measures_of_the_task(tmp_path: Path) -> None:
    run = make_run(tmp_path)
    add_evaluation(run, objective={"name": "height", "value": 1.234})
    page, html = report(run)
    assert "within_all_boundsmin0.60.54 to 0.660.49" in page.text
    assert "heightmax1.231.2 to 1.270.1" in page.text
    assert "Objectiveheight 1.234" in page.text
    assert '<div class="tile"><b>1.23</b><span>height</span></div>' in html
    for name, shares in (("com", "40 %"), ("fall", "3 %")):
        assert f"{name} {shares}" in page.text


@pytest.mark.parametrize(
    ("verdict", "said"),
    [("depends", "the motion depends on"), ("independent", "the motion does not depend on"), ("", "")],
)  # fmt: skip
def test_half_the_time_step(tmp_path: Path, verdict: str, said: str) -> None:
    run = make_run(tmp_path)
    found = {"physics_hz": 1200.0, "success_rate": 0.5, "difference_95": [-0.53, -0.4]}
    add_evaluation(run, half_step={**found, "verdict": verdict})
    text = report(run)[0].text
    assert "50 % succeeded (1,200 Hz), by -53 to -40 points (95 %)" in text
    assert said in text


def test_success_at_coarse_physics_is_a_curve_of_its_own(tmp_path: Path) -> None:
    run = make_run(tmp_path)
    for samples, key in ((1, "rehearsal/success_rate_at_most"), (2, "rehearsal/success_rate"), (3, "evaluation/success_rate")):  # fmt: skip
        run.append_metrics({"samples": samples, key: 0.5})
    text = report(run)[0].text
    assert "Of them at coarse physics" in text
    assert "Episodes that succeeded" in text


@pytest.mark.parametrize("missing", list(evaluation()))
def test_evaluation_without_a_key(tmp_path: Path, missing: str) -> None:
    run = make_run(tmp_path)
    run.write_json("evaluation.json", {k: v for k, v in evaluation().items() if k != missing})
    page, _ = report(run)
    assert "left out" not in page.text
    assert "Evaluation" in page.headings


@pytest.mark.parametrize("value", [None, 3, "x", ["x"], {"x": 1}, True, float("nan")])
def test_evaluation_of_other_types(tmp_path: Path, value: Any) -> None:
    run = make_run(tmp_path)
    run.write_json("evaluation.json", {key: value for key in evaluation()})
    page, html = report(run)
    assert "left out" not in page.text
    assert not re.search(r'(x|y|d|style)="[^"]*(nan|inf)', html)


def test_missing_evaluation(tmp_path: Path) -> None:
    run = make_run(tmp_path)
    add_metrics(run, 5)
    page, _ = report(run)
    assert "Not evaluated yet, after 5,000 samples and 15.0 s of training" in page.text
    assert "Evaluation" not in page.headings
    assert "counts as a success" not in page.text


def test_damaged_stick_figures_are_named(tmp_path: Path) -> None:
    run = make_run(tmp_path)
    (tmp_path / "stick_figures.npz").write_bytes(b"PK\x03\x04 and nothing more")
    page, _ = report(run)
    assert "The section 'motion' of plugin 'report' is left out" in page.text
    assert "Provenance" in page.headings


def test_unwritable_folder(tmp_path: Path) -> None:
    with pytest.raises(RunError, match="could not be written"):
        write_report(make_run(tmp_path / "missing"))

"""The command line: what it prints, and that bad input is one clear line and exit status 2."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import imageio_ffmpeg
import pytest
from commands import begin_on, forked
from motion_files import walker

from understudy.command.cli import main
from understudy_motion.writers.bvh import BvhWriter

QUICK = (
    "experiment=spacetime/walk",
    "num_worlds=8",
    "learner.rollout_steps=4",
    "learner.minibatches=2",
    "policy.feedback.hidden=[16]",
    "budget.samples=64",
    "evaluation.episodes=2",
    "evaluation.final_episodes=2",
    "evaluation.seconds=0.5",
    "run.video_seconds=0.2",
)


def complaint(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """The one line that a refused command prints."""
    assert main(arguments) == 2
    captured = capsys.readouterr()
    lines = [line for line in captured.err.splitlines() if line.startswith("understudy: ")]
    assert len(lines) == 1, captured.err
    assert "Traceback" not in captured.err
    assert captured.out == ""
    return lines[0]


def test_unknown_names_are_answered_with_suggestions(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    run = f"run.dir={tmp_path / 'run'}"
    line = complaint(capsys, "train", *QUICK, run, "reward.terms.survival.name=spacetime/survial")
    assert "There is no reward 'spacetime/survial'" in line
    assert "Did you mean 'spacetime/survival'?" in line
    line = complaint(capsys, "train", *QUICK, run, "learner.epoch=3")
    assert "learner has no option 'epoch'. Did you mean 'epochs'?" in line
    line = complaint(capsys, "train", *QUICK, run, "termination.terms.com.sice=0.3")
    assert "termination.terms.com has no option 'sice'. Did you mean 'size'?" in line
    line = complaint(capsys, "train", "experiment=spacetime/wlk")
    assert "There is no experiment=spacetime/wlk. Did you mean 'spacetime/walk'?" in line
    assert not (tmp_path / "run").exists()


def test_combinations_that_make_no_sense_say_what_is_missing(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    run = f"run.dir={tmp_path / 'run'}"
    line = complaint(capsys, "train", *QUICK, run, "~encoder.feedforward")
    assert "needs the observation 'feedforward', which no encoder of this task provides" in line
    line = complaint(capsys, "train", *QUICK, run, "~fields.reference")
    assert "needs the state field" in line
    assert "It would come from fields 'characters/reference'" in line
    line = complaint(capsys, "train", *QUICK, run, "~reward.terms.survival")
    assert "reward.terms is empty" in line
    assert not (tmp_path / "run").exists()


def clip(rows: list[list[float]]) -> str:
    return json.dumps({"Loop": "wrap", "Frames": rows})


GOOD = [0.1, 0.0, 0.9, 0.0, *([1.0, 0.0, 0.0, 0.0] * 4), 0.0, *([1.0, 0.0, 0.0, 0.0] * 2), 0.0]
GOOD += [*[1.0, 0.0, 0.0, 0.0], 0.0, *([1.0, 0.0, 0.0, 0.0] * 2), 0.0]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (clip([GOOD, [*GOOD[:3], float("nan"), *GOOD[4:]]]), "NaN is not a number"),
        (clip([GOOD, GOOD[:-1]]), "frame 1"),
        ("not json", "clip.txt"),
    ],
)
def test_a_bad_clip_is_named(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, text: str, reason: str
) -> None:
    assert len(GOOD) == 44
    file = tmp_path / "clip.txt"
    file.write_text(text)
    line = complaint(capsys, "train", *QUICK, f"motion.file={file}", f"run.dir={tmp_path / 'run'}")
    assert str(file) in line
    assert reason in line
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("<mujoco><worldbody><body></mujoco>", "does not load"),
        ("<mujoco><include file='/etc/passwd'/></mujoco>", "refers to other files"),
        (None, "cannot be read"),
    ],
)
def test_a_model_that_does_not_load(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, text: str | None, reason: str
) -> None:
    file = tmp_path / "model.xml"
    if text is not None:
        file.write_text(text)
    line = complaint(capsys, "train", "scene=mjcf", f"scene.file={file}", "simulator=mujoco")
    assert reason in line
    assert str(file) in line


def test_a_run_of_a_newer_version_and_no_run(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert "is no run folder" in complaint(capsys, "resume", str(tmp_path))
    newer = {"layout": 99, "config": {}, "overrides": [], "sources": {}}
    (tmp_path / "run.json").write_text(json.dumps(newer))
    assert "newer understudy (layout 99" in complaint(capsys, "evaluate", str(tmp_path))


def test_a_run_from_beginning_to_end(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    run = tmp_path / "run"
    assert main(["train", *QUICK, f"run.dir={run}"]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == f"run: {run}"
    for name in ("run.json", "metrics.jsonl", "evaluation.json", "report.html"):
        assert (run / name).stat().st_size > 0, name
    assert json.loads((run / "run.json").read_text())["sources"]["motion"]["licence"]
    evaluation = json.loads((run / "evaluation.json").read_text())
    assert {"episodes", "success_rate", "mean_episode_seconds", "samples"} <= evaluation.keys()
    assert evaluation["samples"] == 64
    info = json.loads((run / "run.json").read_text())
    assert info["origins"]["learner.gamma"] == "default of learner ppo [ppo]"
    assert info["origins"]["motion.name"] == "task/spacetime/walk.yaml [spacetime]"
    assert "default of learner ppo [ppo]" in (run / "report.html").read_text()
    line = complaint(capsys, "train", *QUICK, f"run.dir={run}")
    assert "already holds a run" in line

    before = (run / "evaluation.json").stat().st_mtime_ns
    assert main(["resume", str(run)]) == 0
    captured = capsys.readouterr()
    assert f"{run} is finished (budget). With a larger budget.samples=… it goes on." in captured.err
    assert captured.out == f"run: {run}\n"
    assert (run / "evaluation.json").stat().st_mtime_ns == before, "nothing was judged again"

    other = ["evaluation.success={measure: return, at_least: 1000}", "run.video_seconds=0.1"]
    assert main(["resume", str(run), *other]) == 0
    found = json.loads((run / "evaluation.json").read_text())
    assert found["success"] == "return at least 1000", "judged anew by what was asked"
    info = json.loads((run / "run.json").read_text())
    config = info["config"]
    assert (config["run"]["video_seconds"], config["run"]["dir"]) == (0.1, str(run))
    capsys.readouterr()
    words = ["episodes=1", "seconds=0.1"]
    own = {f: f.read_bytes() for f in run.iterdir() if f.is_file() and f.name != ".lock"}
    assert main(["evaluate", str(run), *words, "checkpoint=0"]) == 0
    captured = capsys.readouterr()
    found = json.loads(captured.out)
    assert (found["samples"], found["episodes"], found["seconds"]) == (0, 1, 0.1)
    file = run / "evaluation-checkpoint-0-episodes-1-seconds-0.1.json"
    assert json.loads(file.read_text()) == found
    assert f"Written to {file}. The run's own result is as it was." in captured.err
    assert main(["evaluate", str(run), *words]) == 0
    assert json.loads((run / "evaluation-episodes-1-seconds-0.1.json").read_text())["episodes"] == 1
    capsys.readouterr()
    line = complaint(capsys, "evaluate", str(run), "checkpoint=7")
    kept = sorted(int(p.stem) for p in (run / "checkpoints").glob("*.json"))
    assert f"keeps no checkpoint=7: there is {', '.join(map(str, kept))}; or write last" in line
    for word in ("last", "best", "0.9", "100%"):
        assert main(["evaluate", str(run), *words, f"checkpoint={word}", "half_step=false"]) == 0
        assert json.loads(capsys.readouterr().out)["samples"] == 64
    for word in ("1.5", "worst", "200%"):
        assert f"checkpoint={word}" in complaint(capsys, "evaluate", str(run), f"checkpoint={word}")
    assert "WIDTHxHEIGHT" in complaint(capsys, "render", str(run), "size=big")
    slower = "episode.seconds=0.4"
    assert main(["evaluate", str(run), "episodes=1", slower, "num_worlds=2"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["changed"] == [slower]
    file = run / "evaluation-episode.seconds-0.4-episodes-1-num_worlds-2.json"
    assert json.loads(file.read_text()) == found
    assert main(["render", str(run), *words, slower, "run.video_seconds=0"]) == 0
    drawn = Path(capsys.readouterr().out.removeprefix("run: ").strip())
    assert drawn.parent == run / "renders"
    assert json.loads((drawn / "evaluation.json").read_text())["changed"] == [slower]
    report = (drawn / "report.html").read_text(encoding="utf-8")
    assert f"Judged otherwise than it was trained: {slower}." in report
    assert main(["render", str(run), *words, "checkpoint=0", "run.video_seconds=0"]) == 0
    drawn = Path(capsys.readouterr().out.removeprefix("run: ").strip())
    assert json.loads((drawn / "evaluation.json").read_text())["changed"] == ["checkpoint=0"]
    assert main(["render", str(run), *words, "size=160x90", "camera=90"]) == 0
    drawn = Path(capsys.readouterr().out.removeprefix("run: ").strip())
    assert "changed" not in json.loads((drawn / "evaluation.json").read_text())
    assert json.loads((drawn / "evaluation.json").read_text())["episodes"] == 1
    assert json.loads((run / "run.json").read_text())["config"] == info["config"], "as trained"
    video = drawn / "video.mp4"
    if video.exists():  # there is OpenGL
        shown = next(imageio_ffmpeg.read_frames(str(video)))
        assert tuple(shown["source_size"]) == (160, 90)
    assert main(["evaluate", str(drawn), "episodes=1"]) == 0, "it serves as a run"
    assert main(["export", str(drawn), str(tmp_path / "walk.bvh")]) == 0
    capsys.readouterr()
    assert "--overwrite" in complaint(capsys, "export", str(drawn), str(tmp_path / "walk.bvh"))
    assert main(["export", str(drawn), str(tmp_path / "walk.bvh"), "--overwrite"]) == 0
    assert {f: f.read_bytes() for f in own} == own, "the run's own result stays"
    assert main(["resume", str(run), "budget.samples=128"]) == 0
    assert main(["evaluate", str(run)]) == 0
    found = json.loads((run / "evaluation.json").read_text())
    assert found["samples"] == 128
    finer = found["half_step"]
    assert finer["physics_hz"] == 2 * config["control"]["frequency"] * config["control"]["substeps"]
    assert "At half the time step" in (run / "report.html").read_text(encoding="utf-8")
    assert main(["evaluate", str(run), "half_step=false"]) == 0
    assert "half_step" not in json.loads((run / "evaluation.json").read_text())
    capsys.readouterr()
    assert "half_step=false" in complaint(capsys, "evaluate", str(run), "half_step=maybe")
    rows = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    assert [row["iteration"] for row in rows] == [1, 2, 3, 4]


def test_lists(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plugins", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert {"name", "distribution", "version", "status", "components"} <= rows[0].keys()
    assert all(row["status"] == "ok" for row in rows)
    assert main(["tasks"]) == 0
    assert "spacetime/walk" in capsys.readouterr().out
    assert main(["config", "experiment=spacetime/walk", "seed=7"]) == 0
    shown = capsys.readouterr().out.splitlines()
    line = next(x for x in shown if x.startswith("termination.terms.com.size: 0.2"))
    assert line.endswith("# termination/spacetime.yaml [spacetime]")
    line = next(x for x in shown if x.startswith("learner.gamma: 0.95"))
    assert line.endswith("# default of learner ppo [ppo]")
    assert next(x for x in shown if x.startswith("seed: 7")).endswith("command line: seed=7")


@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
@pytest.mark.parametrize(
    "command", ["--help", "experiments", "train", "describe learner/ppo", "motion check walk"]
)
def test_terminals_without_utf_8(command: str, encoding: str, tmp_path: Path) -> None:
    """What they cannot show is replaced; the rest is printed."""
    process = begin_on(tmp_path / "terminal", encoding, *command.split())
    process.join(100)
    shown = (tmp_path / "terminal").read_bytes()
    assert process.exitcode == 0, shown
    assert len(shown.decode(encoding)) > 100


def test_a_process_that_is_told_to_print_ascii() -> None:
    code = "import sys; from understudy.command.cli import main; sys.exit(main())"
    command, environment = [sys.executable, "-c", code], {**os.environ, "PYTHONIOENCODING": "ascii"}
    done = subprocess.run([*command, "experiments"], capture_output=True, env=environment)
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.decode("ascii")) > 100


@pytest.mark.parametrize("lines_of_code", [False, True])
def test_a_warning_is_a_sentence_told_once(lines_of_code: bool, tmp_path: Path) -> None:
    """It had the line of code below it, and came again whenever a library had looked at the filters since."""
    code = """
import sys, warnings
from understudy.command import cli
def run(words):
    for _ in range(3):
        with warnings.catch_warnings():
            warnings.simplefilter("always")
            warnings.warn("It may shake.\\n  Make it heavier.", stacklevel=1)
    warnings.warn("Another.", stacklevel=1)
    return 0
cli._run = run
cli.main()
"""
    wanted = "1" if lines_of_code else ""
    said = forked(code, cwd=tmp_path, UNDERSTUDY_TRACEBACK=wanted).stderr
    if lines_of_code:
        assert said.count("UserWarning: It may shake.") == 3
    else:
        assert said == "It may shake. Make it heavier.\nAnother.\n"


def test_a_servo_too_strong_for_its_time_step_is_told_of_in_a_line(tmp_path: Path) -> None:
    words = ("--observations", "experiment/spacetime/walk", "control.substeps=2")
    process = begin_on(tmp_path / "terminal", "utf-8", "describe", *words)
    process.join(100)
    told, *_ = (tmp_path / "terminal").read_text().splitlines()
    assert told.startswith("The time step of 16.7 ms is too long for the servo of humanoid's joint")
    assert told.endswith("scene.servos.step_speed=10.")
    assert "warn_of_shaking" not in (tmp_path / "terminal").read_text()


@pytest.mark.parametrize("name", ["-walk.bvh", "--walk.bvh", "-h.bvh"])
def test_a_file_named_like_an_option(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    BvhWriter().write(walker(), Path(name))
    assert main(["motion", "check", name]) in (0, 1)
    assert "6 frames at 30 frames/s" in capsys.readouterr().out


def test_names_that_are_no_text_are_shown(tmp_path: Path) -> None:
    name = os.fsdecode(os.fsencode(tmp_path) + b"/\xff.bvh")
    process = begin_on(tmp_path / "terminal", "utf-8", "motion", "check", name)
    process.join(100)
    shown = (tmp_path / "terminal").read_bytes()
    assert (process.exitcode, shown.count(b"there is no such file")) == (2, 1), shown


@pytest.mark.parametrize(
    "words",
    [
        ("train", "experiment=spacetime/walk", "scene.character=<model file>"),
        ("evaluate", "<run folder>"),
        ("motion", "retarget", "walk", "<model file>", "out.npz"),
        ("evaluate", "runs/walk", "checkpoint=<N>"),
    ],
)
def test_what_stands_for_ones_own_is_to_be_written(
    words: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    """As pages and messages have it; a file of such a name is taken."""
    line = complaint(capsys, *words)
    assert re.search(r"<[^>]+> in '.*' stands for your own: write that in its place\.$", line)


@pytest.mark.parametrize(
    "chosen", ["spacetime/walk.yaml", "spacetime/walk.yml", "./spacetime/walk", "spacetime//walk"]
)
def test_an_option_named_as_its_file_is_told_its_name(
    chosen: str, capsys: pytest.CaptureFixture[str]
) -> None:
    said = f"There is no experiment={chosen}. Write experiment=spacetime/walk."
    assert said in complaint(capsys, "config", f"experiment={chosen}")


@pytest.mark.parametrize("choice", ["learner=ppo.yaml", "learner=./ppo"])
def test_other_choices_too(choice: str, capsys: pytest.CaptureFixture[str]) -> None:
    line = complaint(capsys, "config", "experiment=spacetime/walk", choice)
    assert line.endswith("Write learner=ppo.")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("play --push strong", "Argument --push: 'strong' is no number."),
        ("play --bits x", "Argument --bits: 'x' is no whole number."),
        ("export a b.bvh --cycles 1.5", "Argument --cycles: '1.5' is no whole number."),
        ("export a b.bvh --rate fast", "Argument --rate: 'fast' is no number."),
        ("motion retarget a b c.npz --start now", "Argument --start: 'now' is no number."),
    ],
)
def test_what_is_no_number_is_named_as_people_would(
    words: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Not as the name of a function that reads it: "invalid _count value"."""
    assert main(words.split()) == 2
    assert capsys.readouterr().err.startswith(f"understudy: {said} See `understudy ")


@pytest.mark.parametrize(
    "word", ["run.dir=~/mine", "motion.file='~/walk.npz'", "+initial_states.file=~/a", "--video=~/v.mp4", "run.dir=~"]
)  # fmt: skip
def test_a_home_that_no_shell_fills_in_is_no_folder_of_that_name(
    word: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A training made the folder ``~`` in the working folder, which is then asked to be removed."""
    monkeypatch.chdir(tmp_path)
    command = (
        ["play", "spacetime/walk"]
        if word.startswith("--")
        else ["train", "experiment=miniature/go"]
    )
    assert main([*command, word]) == 2
    said = f"understudy: A shell leaves ~ behind = as it is: write {word.replace('~', '$HOME')}.\n"
    assert capsys.readouterr().err == said
    assert not any(tmp_path.iterdir())


DEEP = "d/" * 1500


@pytest.mark.parametrize(
    "words",
    [
        ("train", "experiment=miniature/go", f"run.dir={DEEP}"),
        ("train", "experiment=miniature/go", f"run={{dir: '{DEEP}'}}"),
        ("sweep", "experiment=miniature/go", "seeds=2", f"run.dir={DEEP}"),
        ("play", "spacetime/walk", f"--video={DEEP}film.mp4"),
        ("play", "spacetime/walk", "--video", f"{DEEP}film.mp4"),
    ],
    ids=lambda words: f"{words[0]} {words[-1][:9]}",
)
def test_thousands_of_folders_in_one_another_are_refused(
    words: tuple[str, ...],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Making them recursed until Python gave up, in a traceback."""
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    said = capsys.readouterr().err
    assert "leads through more than 200 folders. Name another." in said
    assert len(said.splitlines()) == 1
    assert not any(tmp_path.iterdir())


def test_lists_of_many_files_are_not_deep(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["train", "experiment=miniature/go", f"nothing=[{'a/b, ' * 300}]"]) == 2
    assert "folders" not in capsys.readouterr().err

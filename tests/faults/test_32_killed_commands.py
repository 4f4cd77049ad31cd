"""Fault 32: a command that shows or writes something dies at any of its writes. What was there is untouched,
what it makes is whole or not there, and the same command afterwards makes it."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from commands import forked
from robots import robot_file

from understudy.command.cli import main
from understudy.records import runs
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import installed
from understudy_characters.reference import ReferenceMotion
from understudy_characters.scene import CharacterScene
from understudy_motion.library import find
from understudy_report.motion import FIGURES, Figures

#: Carries a command out in processes that die at one of its writes each, in a new copy of the folder, until one
#: lives to the end. Prints each one's status, and what is there then, by digest. It is carried out once before,
#: so that they need not import. The clock stands, so that a page's date is the same in all of them.
_KILLER = """
import hashlib, json, os, shutil, sys, time
from pathlib import Path
import torch
torch.set_num_threads(1)
from understudy.command.cli import main
import understudy.running.training
from understudy_reproduce import command, tables
for module in (command, tables):
    module.table_files = lambda plugins: {"mine/one": made / "one.yaml"}
made, work = Path(sys.argv[1]), Path(sys.argv[2])
time.strftime = lambda *_: "2026-01-01 00:00"
stands = time.gmtime(10**9)
time.localtime = lambda *_: stands  # archives have it

def found():
    return {str(p.relative_to(work)): hashlib.sha256(p.read_bytes()).hexdigest()
            for p in sorted(work.rglob("*")) if p.is_file()}

def dying(after):
    left = [after]
    def hook(event, arguments):
        writes = event in ("os.rename", "os.mkdir", "os.remove", "os.link") or (
            event == "open" and isinstance(arguments[2], int) and arguments[2] & (os.O_WRONLY | os.O_RDWR))
        if writes and os.path.realpath(str(arguments[0])).startswith(str(work)):
            if left[0] == 0:
                os._exit(9)
            left[0] -= 1
    return hook

answers = os.dup(1)
nowhere = os.open("/dev/null", os.O_WRONLY)
for words in json.loads(sys.argv[3]):
    rows = []
    shutil.rmtree(work, ignore_errors=True)
    shutil.copytree(made, work)
    os.chdir(work)
    os.dup2(nowhere, 1)
    main(words)
    while not rows or rows[-1][0] == 9 and len(rows) < 100:
        shutil.rmtree(work, ignore_errors=True)
        shutil.copytree(made, work)
        os.chdir(work)
        process = os.fork()
        if process == 0:
            os.dup2(nowhere, 2)
            sys.addaudithook(dying(len(rows)))
            status = 1
            try:
                status = main(words)
            finally:
                os._exit(status)
        status, left = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]), found()
        again = os.fork() if status == 9 else None
        if again == 0:  # the same command, in what it left
            os.dup2(nowhere, 2)
            os._exit(main(words))
        if again is not None:
            again = os.waitstatus_to_exitcode(os.waitpid(again, 0)[1])
        rows.append([status, left, again, found()])
    sys.stdout.flush()
    os.write(answers, json.dumps(rows).encode() + b"\\n")
"""

#: Carries out commands one after another, with the table ``mine/one``.
_ALL = """
import json, sys
from pathlib import Path
from understudy.command.cli import main
from understudy_reproduce import command, tables
for module in (command, tables):
    module.table_files = lambda plugins: {"mine/one": Path(sys.argv[1]) / "one.yaml"}
sys.exit(max(main(words) for words in json.loads(sys.argv[2])))
"""

#: By command, the files that it makes.
QUICK = {
    "export runs/a page.html": ("page.html",),
    "export runs/a old.html --overwrite": ("old.html",),
}
THOROUGH = {
    "runs runs": (),
    "cite runs/a": (),
    "licence runs/a --for research": (),
    "compare runs/a runs/b --no-film": ("comparison.html",),
    "compare runs/a runs/b --no-film --overwrite --page old.html": ("old.html",),
    "new plugin glide": tuple(
        f"understudy-glide/{file}"
        for file in (
            "README.md",
            "pyproject.toml",
            "src/understudy_glide/__init__.py",
            "src/understudy_glide/terms.py",
            "tests/test_glide.py",
        )
    ),
    "new paper glide": tuple(
        f"understudy-glide/{file}"
        for file in (
            "README.md",
            "docs/glide.md",
            "pyproject.toml",
            "src/understudy_glide/__init__.py",
            "src/understudy_glide/conf/experiment/glide/first.yaml",
            "src/understudy_glide/conf/reproduction/glide/table.yaml",
            "src/understudy_glide/terms.py",
            "tests/test_experiment.py",
            "tests/test_glide.py",
        )
    ),
    "play runs/a --unpack new/run": tuple(
        f"new/run/{file}"
        for file in (
            ".lock",
            "run.json",
            "evaluation.json",
            "checkpoints/00000001.json",
            "checkpoints/00000001.safetensors",
        )
    ),
    "play runs/a --pack small": ("small.json", "small.safetensors"),
    "export walk walk.glb --seconds 0.5": ("walk.glb",),
    "export walk old.glb --seconds 0.5 --overwrite": ("old.glb",),
    "export walk walk.bvh --seconds 0.5": ("walk.bvh",),
    "export walk walk.npz --seconds 0.5": ("walk.npz",),
    "motion check walk": (),
    "motion check walk --fix walk.npz": ("walk.npz",),
    "motion check walk --fix old.npz --overwrite": ("old.npz",),
    "motion retarget walk humanoid walk.npz": ("walk.npz",),
    "motion retarget walk humanoid old.npz --overwrite": ("old.npz",),
    "motion export robot.npz robot.xml walk.csv --for mjlab": ("walk.csv",),
    "motion export robot.npz robot.xml old.csv --for mjlab --overwrite": ("old.csv",),
    "motion learned walking walk.npz": ("walk.npz",),
    "motion learned walking old.npz --overwrite": ("old.npz",),
    "evaluate runs/a episodes=1": ("runs/a/evaluation-episodes-1.json",),
    "reproduce mine/one --card run.dir=table": (
        "table/card.csv",
        "table/card.html",
        "table/card.md",
    ),
}
#: A paper's table of one training.
TABLE = """
title: How near a point gets
source: A paper, table 1
overrides: [budget.samples=256, run.video_seconds=0, evaluation.criterion=null]
rows: {calm: [experiment=miniature/go]}
columns: {small: []}
figures: [{of: return}]
seeds: [0]
"""


def digests(folder: Path) -> dict[str, str]:
    return {
        str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest()
        for p in folder.rglob("*")
        if p.is_file()
    }


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run with something to show, nothing of it learned, and files of another day."""
    folder = tmp_path_factory.mktemp("killed")
    words = ["experiment=miniature/go", f"run.dir={folder}/runs/a"]
    runs.create(load_experiment(words), words, {}).unlock()
    lines = np.zeros((5, 3, 2, 3), np.float32)
    lines[:, :, 1, 2] = 1.0
    Figures(lines, None, 1 / 30).save(folder / "runs/a" / FIGURES)
    for name in ("old.html", "old.glb", "old.npz", "old.csv"):
        (folder / name).write_text("of another day")
    return folder


@pytest.fixture(scope="module")
def trained(made: Path) -> Path:
    """The same with two short trainings."""
    shutil.rmtree(made / "runs")
    (made / "one.yaml").write_text(TABLE)
    words = ["experiment=miniature/go", "budget.samples=256", "run.video_seconds=0"]
    both = [["train", *words, f"run.dir={made}/runs/a"], ["reproduce", "mine/one", "run.dir=table"]]
    ended = forked(_ALL, str(made), json.dumps(both), cwd=made)
    assert ended.returncode == 0, ended.stderr
    shutil.copytree(made / "runs/a", made / "runs/b")
    for card in (made / "table").glob("card.*"):
        card.unlink()
    walking(made / "walking")
    robot = robot_file(made)
    words = ["motion", "retarget", "walk", str(robot), str(made / "robot.npz")]
    assert main(words) == 0
    return made


def walking(folder: Path) -> None:
    """A run whose recording is its reference, over two cycles and more."""
    words = ["experiment=spacetime/walk", f"run.dir={folder}"]
    runs.create(load_experiment(words), words, {"motion": {"licence": "CC0-1.0"}}).unlock()
    scene = CharacterScene(CharacterScene.Options("humanoid"))
    clip = find("walk", installed().registry)
    times = torch.arange(105) / 30
    found = ReferenceMotion(clip, scene.character, scene.layout, control_dt=1 / 30).sample(times)
    qpos = found["reference_qpos"].numpy()
    np.savez(
        folder / "recording.npz", qpos=qpos, reference_qpos=qpos, phase=found["phase"].numpy(),
        control_dt=1 / 30, first_episode=105,
    )  # fmt: skip


def check_killed(made: Path, work: Path, commands: dict[str, tuple[str, ...]]) -> None:
    before = digests(made)
    words = json.dumps([command.split() for command in commands])
    ended = forked(_KILLER, str(made), str(work.resolve()), words, cwd=made)
    assert ended.returncode == 0, ended.stderr
    for (command, files), line in zip(commands.items(), ended.stdout.splitlines(), strict=True):
        *killed, (status, after, *_) = json.loads(line)
        assert status == 0, command
        assert {n for n in after if after[n] != before.get(n)} == set(files), command
        assert len(killed) >= 2 * len(files), f"{command} writes, so it can die of it"
        for status, found, again, made_then in killed:
            assert status == 9, command
            done = all(found.get(name) == after[name] for name in files)  # and died tidying up
            assert again == 0 or (again == 2 and done and files), command
            assert {n: made_then.get(n) for n in after} == after, command
            for name, digest in before.items():
                allowed = (digest, after[name]) if name in files else (digest,)
                assert found.get(name) in allowed, f"{command}: {name} was there"
            for name in found.keys() - before.keys():  # or begun, under a name that nothing reads
                begun = any(part.startswith(".") for part in Path(name).parts)
                assert begun or found[name] == after.get(name), f"{command}: {name} is half made"


def test_what_was_there_is_untouched(made: Path, tmp_path: Path) -> None:
    check_killed(made, tmp_path / "work", QUICK)


@pytest.mark.slow
@pytest.mark.parametrize("command", THOROUGH)
def test_every_other_command(trained: Path, tmp_path: Path, command: str) -> None:
    check_killed(trained, tmp_path / "work", {command: THOROUGH[command]})

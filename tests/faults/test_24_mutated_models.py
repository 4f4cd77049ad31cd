"""Fault 24: a damaged or hostile MJCF ends in a model or one FileError, soon, and crashes nothing.

A model is first compiled in a process of its own (``trial.py``). What that process does, done here for many mutants
of a valid model in one, may take 1 GB of address space more than it had, and 5 s for each, and crashes nothing.
"""

from __future__ import annotations

import json
import os
import random
import re
import sys
from pathlib import Path
from typing import Any

import mujoco
import pytest
from commands import forked

from understudy.errors import FileError
from understudy_mujoco import apart, trial
from understudy_mujoco.scene import MjcfFile

#: Attributes and elements of every kind that models of characters have.
MODEL = """<mujoco model="m">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="0.002" gravity="0 0 -9.81" integrator="implicitfast"><flag contact="enable"/></option>
  <size memory="1M"/>
  <default><default class="leg"><geom type="capsule" size=".05" rgba="1 0 0 1"/><joint damping="1"/></default></default>
  <asset><texture name="t" type="2d" builtin="checker" width="8" height="8" rgb1="0 0 0" rgb2="1 1 1"/>
    <material name="mat" texture="t" texrepeat="2 2"/>
    <mesh name="box" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/><hfield name="h" nrow="4" ncol="4" size="1 1 .1 .1"/></asset>
  <worldbody><light pos="0 0 3"/><camera name="c" pos="0 -3 1"/><geom name="floor" type="plane" size="5 5 1"/>
    <body name="trunk" pos="0 0 1"><freejoint/><inertial pos="0 0 0" mass="1" diaginertia=".1 .1 .1"/>
      <geom name="g" type="box" size=".1 .1 .2" material="mat"/><site name="s" pos="0 0 .2"/>
      <body name="leg" pos="0 0 -.2" childclass="leg"><joint name="knee" axis="0 1 0" range="-1 1"/>
        <geom name="shin" fromto="0 0 0 0 0 -.4"/></body>
      <body name="head" pos="0 0 .3" quat="1 0 0 0"><joint type="ball"/><geom type="mesh" mesh="box"/></body>
    </body></worldbody>
  <contact><pair geom1="g" geom2="floor"/><exclude body1="trunk" body2="leg"/></contact>
  <equality><connect body1="trunk" body2="leg" anchor="0 0 0" active="false"/></equality>
  <tendon><fixed name="f"><joint joint="knee" coef="1"/></fixed></tendon>
  <actuator><position name="a" joint="knee" kp="10" forcerange="-5 5"/><motor joint="knee" gear="2"/></actuator>
  <sensor><jointpos joint="knee"/><accelerometer site="s"/></sensor>
  <keyframe><key qpos="0 0 1 1 0 0 0 0 1 0 0 0"/></keyframe>
</mujoco>
"""
#: What stands in the place of a word.
WORDS = (
    "nan", "-inf", "inf", "1e308", "-1e308", "1e-308", "0", "-1", "999999999", "99999999999999999999",
    "9" * 2000, "", " ", "x" * 5000, "true", "floor", "trunk", "knee", "capsule", "mesh", "ball", "free",
    "../../etc/passwd", "/etc/passwd", "é", "&amp;", "1 " * 3000, "-0 0 0 0", "1 2 3 4 5 6 7 8 9",
)  # fmt: skip

READ = """
import json, resource, sys, time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
sys.path.insert(0, {folder!r})
from test_24_mutated_models import mutant
from understudy.errors import FileError
from understudy_mujoco.trial import attempt
first, count, file = int(sys.argv[1]), int(sys.argv[2]), Path("model.xml")
def read():
    with ThreadPoolExecutor(1) as thread:  # what an exception leaves behind in MuJoCo is the thread's
        thread.submit(attempt, file).result()
file.write_text(mutant(None)); read()
used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + 2**30, used + 2**30))
loaded, refused, slowest = 0, 0, 0.0
for seed in [*range(first, first + count), *map(int, sys.argv[3:])]:
    Path("seed").write_text(str(seed))  # which one it was, should it crash
    file.write_text(mutant(seed))
    began = time.monotonic()
    try:
        read(); loaded += 1
    except FileError as error:
        assert str(file) in str(error), (seed, str(error))
        assert "\\n" not in str(error), (seed, str(error))
        refused += 1
    slowest = max(slowest, time.monotonic() - began)
print(json.dumps(dict(loaded=loaded, refused=refused, slowest=slowest)))
"""


def mutant(seed: int | None) -> str:
    """Words and elements replaced, deleted, doubled and swapped; None is the model itself."""
    if seed is None:
        return MODEL
    rng, text = random.Random(seed), MODEL
    for _ in range(rng.choice((1, 1, 2, 4))):
        pattern = rng.choice((r"<[^>]*>|[^<]+", r'"[^"]*"|[^"]+', r"[\w.-]+|[^\w.-]+", r"\S+|\s+"))
        pieces = re.findall(pattern, text)
        at, other = rng.randrange(len(pieces)), rng.randrange(len(pieces))
        match rng.randrange(6):
            case 0:
                pieces[at], pieces[other] = pieces[other], pieces[at]
            case 1:
                pieces[at:at] = pieces[at : other + 1][:200]
            case 2:
                del pieces[at : at + rng.choice((1, 1, 3))]
            case 3 if pattern.startswith('"') and pieces[at].startswith('"'):
                pieces[at] = f'"{rng.choice(WORDS)}"'
            case 4 if rng.random() < 0.1:
                pieces[at:at] = ["<body>"] * 3000
            case _:
                pieces[at] = rng.choice(WORDS)
        text = "".join(pieces)
    return text


@pytest.mark.parametrize(
    ("first", "count"),
    [(0, 400), *(pytest.param(n, 250, marks=pytest.mark.slow) for n in range(500, 10500, 250))],
)
def test_mutants(first: int, count: int, tmp_path: Path) -> None:
    code = READ.format(folder=str(Path(__file__).parent))
    # of these MuJoCo says "Caught an unknown exception!", which is none of its errors
    unknown = ("4728", "7065", "8865")
    done = forked(code, str(first), str(count), *unknown, cwd=tmp_path)
    at = (tmp_path / "seed").read_text()
    assert done.returncode == 0, f"seed {at}, status {done.returncode}: {done.stderr[-2000:]}"
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["slowest"] < 5, found
    assert min(found["loaded"], found["refused"]) > count / 20, found
    assert {p.name for p in tmp_path.iterdir()} == {"model.xml", "seed"}
    sys.stdout.write(f"{count} mutants from {first}: {found}\n")


SLIDER = (
    '<worldbody><body name="b"><joint type="slide" name="j"/><geom size="1"/></body></worldbody>'
)


def load(folder: Path, text: str) -> MjcfFile:
    (folder / "model.xml").write_text(text)
    return MjcfFile(MjcfFile.Options(str(folder / "model.xml")))


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ('<worldbody><replicate count="2000000000"><geom size="1"/></replicate></worldbody>', "within 1 s"),
        ("<worldbody>" + '<replicate count="100">' * 5 + '<geom size="1"/>' + "</replicate>" * 5 + "</worldbody>",
         "(within 1 s|more memory)"),  # whichever comes first
        ('<size nkey="2000000000"/>' + SLIDER, "within 1 s"),
        ('<compiler><lengthrange inttotal="1e9" mode="all"/></compiler>' + SLIDER
         + '<actuator><muscle joint="j"/></actuator>', "within 1 s"),
        ('<size memory="3G"/>' + SLIDER, "Could not allocate"),
        ('<asset><hfield name="h" nrow="30000" ncol="30000" size="1 1 1 1"/></asset>', "more memory"),
    ],
    ids=["replicate", "nested", "keys", "length range", "arena", "height field"],
)  # fmt: skip
def test_what_computes_or_allocates_without_end(
    content: str, reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(trial, "LIMITS", apart.Limits(cpu=1, wall=60, memory=2**30))
    with pytest.raises(FileError, match=rf"model\.xml does not (load|compile).*{reason}"):
        load(tmp_path, f"<mujoco>{content}</mujoco>")


@pytest.mark.usefixtures("fresh_readers")
def test_what_ends_or_stops_mujoco(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for command, reason in (("kill -SEGV $$", r"status -11"), ("exec sleep 60", "within 1 s")):
        (tmp_path / "python").write_text(f"#!/bin/sh\n{command}\n")
        (tmp_path / "python").chmod(0o700)
        monkeypatch.setattr(apart.sys, "executable", str(tmp_path / "python"))
        monkeypatch.setattr(trial, "LIMITS", apart.Limits(wall=1))
        with pytest.raises(FileError, match=reason):
            load(tmp_path, f"<mujoco model='{command}'>{SLIDER}</mujoco>")


def test_one_that_fails_leaves_nothing_behind(tmp_path: Path) -> None:
    """After an exception within MuJoCo the next warning in the same thread would never return."""
    for seed in (4728, 7065, 8865):
        with pytest.raises(FileError, match=r"model\.xml does not load: MuJoCo gives no reason"):
            load(tmp_path, mutant(seed))
    assert 'anchor="0 nan 0"' in mutant(8980)
    with pytest.raises(FileError, match="its eq_data is no finite number"):
        load(tmp_path, mutant(8980))
    assert mujoco.MjModel.from_xml_string(mutant(8980)).nbody == 4  # which warns, here


def test_a_model_is_tried_once_and_again_when_it_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(trial, "_passed", set())
    tried, run = [], apart.subprocess.run

    def counted(*arguments: Any, **options: Any) -> Any:
        tried.append(arguments)
        return run(*arguments, **options)

    monkeypatch.setattr(apart.subprocess, "run", counted)
    for _ in range(2):
        load(tmp_path, MODEL)
    assert len(tried) == 1
    with pytest.raises(FileError, match=r"model\.xml does not load: .*'size'"):
        load(tmp_path, MODEL.replace('size=".05"', 'size="x"'))
    assert len(tried) == 2


@pytest.mark.usefixtures("fresh_readers")
def test_nothing_of_the_working_folder_is_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "mujoco.py").write_text("import os; os.mkdir('executed')")
    monkeypatch.chdir(tmp_path)
    load(tmp_path, f"<mujoco model='elsewhere'>{SLIDER}</mujoco>")
    assert not os.path.exists(tmp_path / "executed")

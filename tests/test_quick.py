"""``make quick``: what it chooses, and that it ends in time."""

from __future__ import annotations

import re
import subprocess
import sys
import time
from pathlib import Path

import pytest
from quick import ROOT, SMOKES, TESTS, nearest


def test_every_wing_has_a_smoke() -> None:
    page = (ROOT / "plugins" / "README.md").read_text(encoding="utf-8")
    assert list(SMOKES) == re.findall(r"^\d+\. \[`(\w+)`\]", page, re.MULTILINE)
    for wing, test in SMOKES.items():
        file, _, name = test.partition("::")
        assert f"def {name}" in (TESTS / file).read_text(encoding="utf-8")
        assert any((ROOT / "plugins" / wing).glob(f"{Path(file).parts[1]}/understudy_*"))


@pytest.mark.parametrize(
    ("changed", "first"),
    [
        ("plugins/learning/ppo/understudy_ppo/learner.py", "plugins/ppo/test_learner.py"),
        ("kernel/understudy/records/checkpoint.py", "kernel/records/test_checkpoint.py"),
        ("plugins/physics/mujoco_warp/understudy_mujoco_warp/simulator.py",
         "plugins/mujoco_on_warp/test_warp_simulator.py"),
        ("tests/kernel/test_random.py", "kernel/test_random.py"),
        ("docs/tour.md", "test_docs.py"),
    ],
)  # fmt: skip
def test_the_nearest_come_first(changed: str, first: str) -> None:
    chosen = nearest([ROOT / changed])
    assert chosen[0] == TESTS / first
    assert len(set(chosen)) == len(chosen) < 60


def test_what_imports_a_module_is_near_it() -> None:
    chosen = nearest([ROOT / "kernel/understudy/random.py"])
    for module in TESTS.rglob("test_*.py"):
        if "from understudy.random import" in module.read_text(encoding="utf-8"):
            assert module in chosen


@pytest.mark.parametrize(("seconds", "said"), [(20, "1 skipped"), (0, "no tests ran")])
def test_it_ends_in_time_and_says_what_it_left_out(
    tmp_path: Path, seconds: float, said: str
) -> None:
    file = tmp_path / "test_long.py"
    file.write_text(
        "import time, pytest\n"
        "@pytest.mark.timeout(140)\n"
        "def test_long(): time.sleep(150)\n"
        "@pytest.mark.parametrize('i', range(3))\n"
        "def test_later(i): raise AssertionError\n"
    )
    done = subprocess.run(
        [sys.executable, str(TESTS / "quick.py"), "--until", str(time.time() + seconds), str(file)],
        cwd=tmp_path, capture_output=True, text=True, timeout=150,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout
    assert said in done.stdout
    assert f"{3 if seconds else 4} further tests were not reached" in done.stdout

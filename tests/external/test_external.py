"""A stranger's distribution: built, installed with plain pip, listed, trained, swapped in, checked."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from commands import forked

pytest.importorskip("hatchling", reason="building the distribution needs hatchling (dev extra)")

SOURCE = Path(__file__).parent / "understudy-balance"


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder into which pip built and installed the distribution."""
    folder = tmp_path_factory.mktemp("site")
    command = [
        sys.executable, "-m", "pip", "install", "--quiet", "--no-index", "--no-deps",
        "--no-build-isolation", "--target", str(folder), str(SOURCE),
    ]  # fmt: skip
    subprocess.run(command, check=True, timeout=120)
    return folder


#: The command line where the distribution is found first.
COMMAND = """
import sys
site, *arguments = sys.argv[1:]
sys.path.insert(0, site)
from understudy.command.cli import main
sys.exit(main(arguments))
"""


def understudy(site: Path, *arguments: str) -> str:
    done = forked(COMMAND, str(site), *arguments, cwd=site, MUJOCO_GL="disable")
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_is_listed_with_its_distribution(site: Path) -> None:
    """In an interpreter of its own; the other tests' are forks of one that has imported all."""
    listed = subprocess.run(
        [sys.executable, "-m", "understudy.command.cli", "plugins", "--json"],
        env=os.environ | {"PYTHONPATH": str(site)}, capture_output=True, timeout=200, check=True,
    )  # fmt: skip
    rows = {row["name"]: row for row in json.loads(listed.stdout)}
    balance = rows["balance"]
    assert balance["distribution"] == "understudy-balance"
    assert (balance["version"], balance["status"]) == ("0.3.0", "ok")
    assert "reward/balance/upright" in balance["components"]
    assert "balance/stand" in understudy(site, "tasks")


def test_trains_for_a_few_iterations(site: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    out = understudy(
        site, "train", "task=balance/stand", "policy=mlp", "learner=ppo", "num_worlds=8",
        "learner.rollout_steps=8", "learner.minibatches=2", "policy.hidden=[32]",
        "budget.samples=192", "evaluation.episodes=4", "evaluation.final_episodes=4",
        "evaluation.seconds=0.5", f"run.dir={run}",
    )  # fmt: skip
    assert out.splitlines()[-1] == f"run: {run}"
    info = json.loads((run / "run.json").read_text())
    assert {"name": "balance/upright", "plugin": "balance"}.items() <= {
        k: v for c in info["components"] if c["kind"] == "reward" for k, v in c.items()
    }.items()
    assert len((run / "metrics.jsonl").read_text().splitlines()) == 3
    evaluation = json.loads((run / "evaluation.json").read_text())
    assert evaluation["success"] == "upright at least 3"
    assert 0.0 < evaluation["measures"]["upright"]["mean"] <= 0.5 + 1e-6
    assert "The trunk was upright for the last" in (run / "report.html").read_text()


def test_its_option_and_term_swap_into_another_task(site: Path) -> None:
    config = json.loads(
        understudy(site, "config", "--json", "experiment=spacetime/walk", "reward=upright_gentle")
    )
    upright = {"name": "balance/upright", "scale": 1.0, "weight": 1.0}
    assert config["reward"]["terms"] == {"upright": upright}
    shown = understudy(
        site, "config", "experiment=spacetime/walk", "+reward.terms.upright={name: balance/upright}"
    )
    assert "balance/upright" in shown


def test_its_term_counts_in_another_plugins_task(site: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    understudy(
        site, "train", "experiment=spacetime/walk", "reward.terms.upright={name: balance/upright}",
        "num_worlds=8", "learner.rollout_steps=4", "learner.minibatches=2",
        "policy.feedback.hidden=[16]", "budget.samples=32", "evaluation.episodes=2",
        "evaluation.final_episodes=2", "evaluation.seconds=0.2", "run.video_seconds=0.2", f"run.dir={run}",
    )  # fmt: skip
    (row,) = (json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines())
    share = 32 * row["reward"]  # of 32 samples; survival alone is 0 or 1 in each
    assert 0.0 < share < 32.0
    assert abs(share - round(share)) > 1e-4


def test_passes_the_checks_that_the_tutorial_shows(site: Path) -> None:
    page = (Path(__file__).parents[2] / "docs" / "plugin-tutorial.md").read_text(encoding="utf-8")
    (tests,) = re.findall(r"^## 12.*?```python\n(.*?)```", page, re.M | re.S)
    names = re.findall(r"^def (test_\w+)", tests, re.M)
    assert len(names) == 3
    code = (
        "import sys; sys.path.insert(0, sys.argv[1])\n" + tests + "\n".join(f"{n}()" for n in names)
    )
    done = forked(code, str(site), cwd=site)
    assert done.returncode == 0, done.stderr

"""What a shell offers where the cursor is."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from understudy.setup.plugins import installed
from understudy_inspect.completion import words


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("understudy tra", ["train"]),
        ("understudy motion ", ["check", "export", "fetch", "learned", "retarget", "view"]),
        ("understudy train exp", ["experiment="]),
        ("understudy train experiment=spacetime/w", [f"experiment=spacetime/{walk}" for walk in ("walk", "walk_imagined", "walk_imagined_gpu")]),
        ("understudy config learner=tr", ["learner=trpo"]),
        ("understudy describe simulator/m", ["simulator/mujoco", "simulator/mujoco_warp"]),
        ("understudy completion z", ["zsh"]),
        ("understudy evaluate runs/x ep", ["episode.", "episodes="]),
        ("understudy train experiment=miniature/go learner.ga", ["learner.gae_lambda=", "learner.gamma="]),
        ("understudy train experiment=miniature/go resolution.", [f"resolution.{name}=" for name in ("budget", "difficulty", "substeps")]),
        ("understudy train experiment=nothing learner.ga", []),
        ("understudy train 'open", []),
    ],
)  # fmt: skip
def test_words(line: str, expected: list[str]) -> None:
    found = [w for w in words(line, installed()) if not w.startswith("simulator/miniature")]
    assert found == expected


def test_what_is_offered_can_be_composed() -> None:
    offered = words("understudy train experiment=miniature/go ", installed())
    assert {"experiment=", "seed=", "learner=", "learner.", "budget."} <= set(offered)


@pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash")
@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("understudy tra", "train"),
        ("understudy train experiment=spacetime/jo", "spacetime/jog"),
        ("understudy train exp", "experiment="),
    ],
)
def test_bash(line: str, expected: str) -> None:
    """bash replaces what stands behind the last = alone."""
    script = f"""
        source <(understudy completion bash)
        COMP_LINE={line!r} COMP_POINT={len(line)}
        compopt() {{ :; }}
        _understudy
        printf '%s\\n' "${{COMPREPLY[@]}}"
    """
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    ended = subprocess.run(
        ["bash", "-c", script], capture_output=True, text=True, check=False,
        env={**os.environ, "PATH": path},
    )  # fmt: skip
    assert ended.stdout.splitlines() == [expected], ended.stderr

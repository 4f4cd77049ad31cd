"""Lists of what there is are there at once."""

from __future__ import annotations

import subprocess
import sys

import pytest
from worlds import child_environment

LATE = ("torch", "mujoco", "scipy", "hydra", "numpy")


@pytest.mark.parametrize(
    "words", [["tasks"], ["tasks", "--json"], ["plugins"], ["experiments"], ["completion", "bash"]]
)
def test_a_list_imports_nothing_that_takes_seconds(words: list[str]) -> None:
    """Torch alone is two of the three seconds that a list took."""
    code = (
        "import sys; from understudy.command.cli import main; ended = main(sys.argv[1:]); "
        f"print([m for m in {LATE} if m in sys.modules], file=sys.stderr); sys.exit(ended)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, *words], capture_output=True, text=True, env=child_environment(), check=False
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stderr.splitlines()[-1] == "[]"
    assert len(done.stdout) > 100

"""Where the person would begin inside the cloth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from understudy.command.cli import main
from understudy_dressing.initial_states import depth_in_person
from understudy_dressing.person import PersonScene


def test_depth_in_the_neutral_person() -> None:
    """The upper arm hangs from the shoulder; its radius falls from 65 to 50 mm over 30 cm."""
    depth = depth_in_person(PersonScene(PersonScene.Options()))
    points = np.array([[0, -0.21, -0.15], [0.1, -0.21, -0.15], [1.0, 0, 0], [0, 0, 0.325]])
    found = depth(points)
    assert found[0] == pytest.approx(0.0575, abs=1e-3)
    assert found[1] == pytest.approx(0.0575 - 0.1, abs=1e-3)
    assert found[2] < -0.8
    assert found[3] == pytest.approx(0.10), "the middle of the head's upper sphere"


@pytest.mark.parametrize(
    ("low", "high"),
    [
        ("[-0.3,-0.21,0.1]", "[-0.3,-0.21,0.1]"),
        ("[-0.4,-0.4,-0.2]", "[0.8,0.2,0.2]"),
    ],
    ids=["all", "some"],
)
def test_cloth_that_begins_in_the_person_is_refused(
    low: str, high: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("potpourri3d", reason="potpourri3d is not installed")
    run = tmp_path / "run"
    words = (f"initial_states.low={low}", f"initial_states.high={high}", "num_worlds=2")
    assert main(["train", "experiment=dressing/sleeve_small", *words, f"run.dir={run}"]) == 2
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert "the cloth begins" in error
    assert "cm inside the person: move low and high away from it." in error
    assert not run.exists(), "before anything is written"

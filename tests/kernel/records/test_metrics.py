"""The rows of a run's metrics, as other programs read them."""

from __future__ import annotations

import json
import math
from pathlib import Path

from understudy.records.runs import Run


def test_a_row_is_json_whatever_became_of_its_numbers(tmp_path: Path) -> None:
    """NaN and infinity are none of JSON's words: readers in other languages would refuse the row, or the file."""
    run = Run(tmp_path, {})
    row = {"samples": 1, "loss": math.nan, "kl": math.inf, "reward": -math.inf, "note": "x"}
    run.append_metrics(row)

    def refuse(word: str) -> None:
        raise AssertionError(f"{word} is no JSON")

    found = json.loads(run.metrics_file.read_text(), parse_constant=refuse)
    assert found == {"samples": 1, "loss": None, "kl": None, "reward": None, "note": "x"}
    assert run.metrics() == [found]

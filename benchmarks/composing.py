"""What composing an experiment costs with files of options kept and with Hydra's own repository, in one process::

python benchmarks/composing.py
"""

from __future__ import annotations

import json
import statistics
import time
from collections.abc import Sequence
from datetime import date
from typing import Any

from hydra._internal.config_repository import ConfigRepository

from understudy.errors import ConfigError
from understudy.setup import composition
from understudy.setup.kept import KeptOptions
from understudy.setup.plugins import installed


def seconds(overrides: Sequence[str], repository: type) -> tuple[float, dict[str, Any]]:
    """Processor time of composing again what was composed just before, and the result."""
    composition.KeptOptions = repository  # type: ignore[misc]
    composition.compose_raw(overrides)
    began = time.process_time()
    result = composition.compose_raw(overrides)
    return time.process_time() - began, result


def main() -> None:
    for more in ([], ["learner=ppo"]):
        before, after = [], []
        for name in sorted(composition.options(installed(), "experiment"))[::9]:
            overrides = [f"experiment={name}", *more]
            try:
                own, expected = seconds(overrides, ConfigRepository)
                kept, found = seconds(overrides, KeptOptions)
            except ConfigError:  # it needs runs of others
                continue
            assert found == expected
            before.append(own)
            after.append(kept)
        row = {
            "when": date.today().isoformat(), "swapped_in": more, "experiments": len(after),
            "hydras_seconds": round(statistics.mean(before), 3),
            "kept_seconds": round(statistics.mean(after), 3),
        }  # fmt: skip
        print(json.dumps(row))


if __name__ == "__main__":
    main()

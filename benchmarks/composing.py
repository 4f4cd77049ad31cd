"""What composing an experiment again costs with and without Hydra's own settings, in one process::

python benchmarks/composing.py
"""

from __future__ import annotations

import gc
import json
import statistics
import time
from collections.abc import Callable, Collection, Iterable, Sequence
from datetime import date
from pathlib import Path
from typing import Any

import hydra
from omegaconf import DictConfig, open_dict

from understudy.errors import ConfigError
from understudy.setup import composition, option_files
from understudy.setup.plugins import installed


def hydras(
    folders: Iterable[Path], overrides: Sequence[str], own: Collection[str] = ()
) -> DictConfig:
    """What Hydra's public interface composes; of the groups `own` what it composes of them alone."""
    first, *others = folders = list(folders)
    path = ",".join(f"'file://{folder}'" for folder in others)
    with hydra.initialize_config_dir(str(first), version_base="1.3", job_name="understudy"):
        found = hydra.compose("config", overrides=[f"hydra.searchpath=[{path}]", *overrides])
    if own:
        theirs = [o for o in overrides if o.lstrip("+").partition("=")[0].split(".")[0] in own]
        alone = hydras(folders, theirs)
        with open_dict(found):
            found.update({key: alone[key] for key in own})
    return found


def seconds(
    overrides: Sequence[str], compose: Callable[..., DictConfig]
) -> tuple[float, dict[str, Any]]:
    """Processor time of composing again what was composed just before, and the result."""
    composition.compose = compose  # type: ignore[attr-defined]
    composition.compose_raw(overrides)
    began = time.process_time()
    result = composition.compose_raw(overrides)
    return time.process_time() - began, result


def main() -> None:
    gc.disable()  # as timeit does: one collection takes as long as twenty compositions
    for more in ([], ["learner=ppo"]):
        before, after = [], []
        for name in sorted(composition.options(installed(), "experiment"))[::9]:
            overrides = [f"experiment={name}", *more]
            try:
                own, expected = seconds(overrides, hydras)
                kept, found = seconds(overrides, option_files.compose)
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

"""Hydra's reading of files, less what no run needs: its own settings, and the same file twice.

A composition reads some seven files of ours. Hydra adds thirteen for its launchers, sweepers and logging,
which its compose API throws away, and looks for each in every plugin's folder.
"""

from __future__ import annotations

import copy
import functools
import os
from stat import S_ISREG

from hydra._internal.config_repository import ConfigRepository
from hydra.conf import HydraConf
from hydra.plugins.config_source import ConfigResult
from omegaconf import DictConfig, OmegaConf

__all__ = ["KeptOptions"]

#: What was read, by the file's path, time of change, size and number.
_read: dict[tuple[str | int, ...], ConfigResult | None] = {}


@functools.cache
def _settings() -> DictConfig:
    """Hydra's own settings with nothing chosen."""
    settings = OmegaConf.structured(HydraConf(defaults=[]))
    settings.job.name = "understudy"
    return settings


class KeptOptions(ConfigRepository):
    """Hydra's repository of nothing but files; one that has not changed is not parsed anew."""

    def load_config(self, config_path: str) -> ConfigResult | None:
        if config_path == "hydra/config":
            header: dict[str, str | None] = {"package": "hydra"}
            content = copy.deepcopy(_settings())
            return ConfigResult("hydra", "", content, header, [], is_schema_source=True)
        state = self._state(config_path)
        if state is None:
            return None
        if state not in _read:
            _read[state] = super().load_config(config_path)
        return copy.deepcopy(_read[state])  # Hydra changes what it is given

    def _state(self, config_path: str) -> tuple[str | int, ...] | None:
        """The first file of that name, and what changes when its content does."""
        name = f"{config_path.removesuffix('.yaml')}.yaml"
        for source in self.sources:
            if source.scheme() == "file":
                file = os.path.join(source.path, name)
                try:
                    state = os.stat(file)
                except (OSError, ValueError):
                    continue
                if S_ISREG(state.st_mode):
                    return (file, state.st_mtime_ns, state.st_size, state.st_ino)
        return None

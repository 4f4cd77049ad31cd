"""Where the values of a configuration come from."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from understudy.errors import UnderstudyError
from understudy.records.observer import RunObserver
from understudy.records.runs import Run
from understudy.setup.composition import for_hydra, hydra_session, split_overrides
from understudy.setup.config import Experiment
from understudy.setup.option_files import OptionFiles, choices, parsed
from understudy.setup.plugins import Plugins, installed
from understudy.setup.validation import validate


class RecordOrigins(RunObserver):
    """Keeps in ``run.json``, as ``origins``, what set each value of the configuration."""

    def started(self, run: Run) -> None:
        plugins = installed()
        try:
            experiment = validate(run.config, plugins.registry)
            run.info["origins"] = all_origins(experiment, run.info["overrides"], plugins)
        except UnderstudyError:  # it was put together by a program, or in another environment
            return
        run.write_json("run.json", run.info)


def all_origins(
    experiment: Experiment, overrides: Sequence[str], plugins: Plugins | None = None
) -> dict[str, str]:
    """For each key path of the effective configuration, what set it: a word of the command line, a
    plugin's file, or the default of a component and its plugin."""
    given = origins(overrides, plugins)
    owners = {
        chosen.where: f"{chosen.component.kind} {chosen.component.name} [{chosen.component.plugin}]"
        for choice in experiment.choices.values()
        for chosen in choice
    }
    for name in experiment.sections:
        owners[name] = f"section {name} [{experiment.registry.sections[name].plugin}]"
    found = {}
    for key in paths(experiment.effective(), ""):
        above = [key[:i] for i in range(len(key), 0, -1) if i == len(key) or key[i] == "."]
        owner = next((owners[path] for path in above if path in owners), "understudy")
        by_name = above[1] if key.endswith(".name") and len(above) > 1 else key
        found[key] = given.get(key) or given.get(by_name) or f"default of {owner}"
    return found


def origins(overrides: Sequence[str], plugins: Plugins | None = None) -> dict[str, str]:
    """For each key path of the composed configuration, the file (or override) that set it."""
    plugins = plugins or installed()
    origin: dict[str, str] = {}
    overrides, emptied, chosen = split_overrides(overrides, plugins)
    with hydra_session(plugins, overrides):
        sources = [(name or "understudy", folder) for name, folder in plugins.folders()]
        files = OptionFiles([folder for _, folder in sources])
        for item in choices(files, for_hydra(overrides, plugins)).defaults:
            path = item.config_path or ""
            owners = (owner for owner, folder in sources if (folder / f"{path}.yaml").is_file())
            if owner := next(owners, ""):
                for key in paths(files.content(item), ""):
                    group = key.partition(".")[0]
                    if group not in chosen or path.startswith(f"{group}/"):
                        origin[key] = f"{path}.yaml [{owner}]"
        for override in map(parsed, overrides):
            value = None if override.is_delete() else override.value()
            for key in paths(value, override.key_or_group):
                if not any(k.startswith(f"{key}.") for k in origin):  # else it chose a file
                    origin[key] = f"command line: {override.input_line}"
    for name, override in emptied.items():
        origin = {k: v for k, v in origin.items() if k != name and not k.startswith(f"{name}.")}
        origin[name] = f"command line: {override}"
    return origin


def paths(value: Any, prefix: str) -> Iterator[str]:
    """The key paths of everything in a nested configuration; an empty mapping has one."""
    if isinstance(value, Mapping) and (value or not prefix):
        for key, item in value.items():
            yield from paths(item, f"{prefix}.{key}" if prefix else str(key))
    else:
        yield prefix

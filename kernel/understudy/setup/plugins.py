"""Plugin loading: entry points, pluggy hooks, and the config directories plugins contribute.

A plugin is a module named in the entry-point group ``understudy``. It implements any of the hooks
below with ``@understudy.hookimpl``. The bundled plugins are loaded exactly like a stranger's.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pluggy

from understudy.errors import PluginError, suggestion
from understudy.setup.registry import Registrar, Registry

if TYPE_CHECKING:
    from understudy.records.observer import RunObserver

GROUP = "understudy"
hookspec = pluggy.HookspecMarker(GROUP)
hookimpl = pluggy.HookimplMarker(GROUP)


class Hooks:
    """The hooks a plugin may implement."""

    @hookspec
    def understudy_register(self, register: Registrar) -> None:
        """Register components, tasks, sections, kinds and citations."""

    @hookspec
    def understudy_config_directory(self) -> str | Path | None:
        """A directory of config options (``task/…``, ``policy/…``) added to the search path."""
        raise NotImplementedError

    @hookspec
    def understudy_run_observers(self) -> Iterable[RunObserver]:
        """Observers of every training run (loggers, live views)."""
        raise NotImplementedError


@dataclass(frozen=True)
class LoadedPlugin:
    """One plugin found on this machine. ``status`` is ``ok`` or the reason it did not load."""

    name: str
    distribution: str
    version: str
    status: str
    config_directory: Path | None = None


@dataclass
class Plugins:
    """The loaded plugins and the registry they filled."""

    manager: pluggy.PluginManager
    registry: Registry
    loaded: list[LoadedPlugin] = field(default_factory=list)

    def config_directories(self) -> list[tuple[str, Path]]:
        return [(p.name, p.config_directory) for p in self.loaded if p.config_directory]

    def observers(self) -> list[RunObserver]:
        """Fresh observers from every plugin."""
        return [o for group in self.manager.hook.understudy_run_observers() for o in group]


def load(*, only: Iterable[str] | None = None, extra: Iterable[tuple[str, Any]] = ()) -> Plugins:
    """Load all installed plugins, or just those named in `only`, plus `extra` (name, module) pairs.

    ``UNDERSTUDY_PLUGINS=a,b`` allows only the named plugins and ``UNDERSTUDY_DISABLE_PLUGINS=c``
    leaves some out. A plugin that fails to import, misspells a hook, or provides what an earlier
    one provides already is recorded in ``registry.broken``, with nothing of it kept; the others
    still load. The bundled plugins come first, then the others by name.

    Raises
    ------
    PluginError
        if two distributions provide a plugin of the same name, or a variable names none.
    """
    manager = pluggy.PluginManager(GROUP)
    manager.add_hookspecs(Hooks)
    result = Plugins(manager, Registry())
    found = sorted(
        metadata.entry_points(group=GROUP),
        key=lambda e: (e.dist is None or e.dist.name != "understudy", e.name),
    )
    there = {entry.name for entry in found}
    allowed = (_names("UNDERSTUDY_PLUGINS", there) or None) if only is None else set(only)
    disabled = _names("UNDERSTUDY_DISABLE_PLUGINS", there)
    seen: dict[str, str] = {}
    for entry in found:
        if (allowed is not None and entry.name not in allowed) or entry.name in disabled:
            continue
        distribution = entry.dist.name if entry.dist else ""
        version = entry.dist.version if entry.dist else ""
        if seen.setdefault(entry.name, entry.value) != entry.value:
            raise PluginError(
                f"Two distributions provide a plugin named '{entry.name}'. Uninstall one of them, "
                f"or set UNDERSTUDY_DISABLE_PLUGINS={entry.name}."
            )
        if manager.has_plugin(entry.name):
            continue  # the same distribution seen twice on the path
        try:
            module = entry.load()
        except (Exception, SystemExit) as error:  # a stranger's import may raise anything
            _isolate(result, LoadedPlugin(entry.name, distribution, version, ""), error)
            continue
        _add(result, entry.name, module, distribution, version)
    for name, module in extra:
        _add(result, name, module, "", "")
    faults = _shadowed_options(result) | result.registry.unknown_kinds()
    for plugin in [p for p in result.loaded if p.name in faults]:
        result.loaded.remove(plugin)
        _isolate(result, plugin, faults[plugin.name])
    return result


def _names(variable: str, there: set[str]) -> set[str]:
    names = {name.strip() for name in os.environ.get(variable, "").split(",") if name.strip()}
    for name in sorted(names - there):
        advice = suggestion(name, there)
        raise PluginError(f"{variable} names '{name}', which is no installed plugin.{advice}")
    return names


def _isolate(plugins: Plugins, plugin: LoadedPlugin, error: BaseException) -> None:
    """Keep nothing of `plugin` but its name and why it did not load."""
    reason = f"{type(error).__name__}: {error}".splitlines()[0]
    if plugins.manager.has_plugin(plugin.name):
        plugins.manager.unregister(name=plugin.name)
    plugins.registry.remove(plugin.name)
    plugins.registry.broken[plugin.name] = reason
    plugins.loaded.append(replace(plugin, status=reason, config_directory=None))


def _add(plugins: Plugins, name: str, module: Any, distribution: str, version: str) -> None:
    manager = plugins.manager
    plugin = LoadedPlugin(name, distribution, version, "ok")
    try:
        for item in dir(module):
            if (
                item.startswith("understudy_")
                and not hasattr(Hooks, item)
                and callable(getattr(module, item))
            ):
                hooks = ", ".join(h for h in vars(Hooks) if h.startswith("understudy_"))
                raise PluginError(f"it defines '{item}', which is no hook. The hooks are: {hooks}.")
        manager.register(module, name)
        manager.check_pending()
        others = [p for p in manager.get_plugins() if p is not module]
        register = Registrar(plugins.registry, name, distribution, version)
        manager.subset_hook_caller("understudy_register", others)(register=register)
        given = manager.subset_hook_caller("understudy_config_directory", others)()
        if given:
            plugin = replace(plugin, config_directory=Path(given[0]))
            if not Path(given[0]).is_dir():
                raise PluginError(f"its config directory {given[0]} does not exist.")
    except (Exception, SystemExit) as error:  # as at import: named, isolated
        _isolate(plugins, plugin, error)
        return
    plugins.loaded.append(plugin)


def kernel_conf() -> Path:
    """The kernel's own config directory (``conf/`` at the top of the source tree)."""
    here = Path(__file__).resolve()
    packaged = here.parents[1] / "conf"
    return packaged if packaged.is_dir() else here.parents[3] / "conf"


def _shadowed_options(plugins: Plugins) -> dict[str, PluginError]:
    """By plugin: a config option that the kernel or an earlier plugin provides already."""
    own = {file.relative_to(kernel_conf()) for file in kernel_conf().rglob("*.yaml")}
    owner = dict.fromkeys(own, "")  # the kernel's come first
    faults: dict[str, PluginError] = {}
    for name, directory in plugins.config_directories():
        for file in sorted(directory.rglob("*.yaml")):
            option = file.relative_to(directory)
            if owner.setdefault(option, name) != name:
                other = f"plugin '{owner[option]}'" if owner[option] else "understudy itself"
                faults[name] = PluginError(
                    f"it provides the config option '{option.with_suffix('')}', which {other} "
                    "provides already. Rename one of them."
                )
    return faults


@functools.cache
def installed() -> Plugins:
    """The plugins of this environment, loaded once."""
    return load()

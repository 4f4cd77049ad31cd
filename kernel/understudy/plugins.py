"""Plugin loading: entry points, pluggy hooks, and the config directories plugins contribute.

A plugin is a module named in the entry-point group ``understudy``. It implements any of the hooks
below with ``@understudy.hookimpl``. The bundled plugins are loaded exactly like a stranger's.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Iterable
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pluggy

from understudy.errors import PluginError
from understudy.registry import Registrar, Registry

if TYPE_CHECKING:
    from understudy.interfaces import RunObserver

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


def load(
    *, only: Iterable[str] | None = None, extra: Iterable[tuple[str, Any]] = ()
) -> Plugins:
    """Load all installed plugins, or just those named in `only`, plus `extra` (name, module) pairs.

    ``UNDERSTUDY_PLUGINS=a,b`` allows only the named plugins and ``UNDERSTUDY_DISABLE_PLUGINS=c``
    leaves some out. A plugin that fails to import is recorded in ``registry.broken`` and the
    others still load.

    Raises
    ------
    PluginError
        if two plugins provide the same name or config option, or a hook is misspelled.
    """
    allowed = _names("UNDERSTUDY_PLUGINS") if only is None else set(only)
    disabled = _names("UNDERSTUDY_DISABLE_PLUGINS") or set()
    manager = pluggy.PluginManager(GROUP)
    manager.add_hookspecs(Hooks)
    result = Plugins(manager, Registry())
    found = sorted(metadata.entry_points(group=GROUP), key=lambda e: (e.dist is None or e.dist.name != "understudy", e.name))
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
        except Exception as error:  # a stranger's import may raise anything; the others must work
            _broken(result, entry.name, distribution, version, error)
            continue
        _add(result, entry.name, module, distribution, version)
    for name, module in extra:
        _add(result, name, module, "", "")
    result.registry.check_kinds()
    _refuse_shadowed_options(result)
    return result


def _names(variable: str) -> set[str] | None:
    text = os.environ.get(variable)
    return None if not text else {name.strip() for name in text.split(",") if name.strip()}


def _broken(plugins: Plugins, name: str, distribution: str, version: str, error: Exception) -> None:
    reason = f"{type(error).__name__}: {error}".splitlines()[0]
    plugins.registry.broken[name] = reason
    plugins.loaded.append(LoadedPlugin(name, distribution, version, reason))


def _add(plugins: Plugins, name: str, module: Any, distribution: str, version: str) -> None:
    manager = plugins.manager
    manager.register(module, name)
    try:
        manager.check_pending()
    except pluggy.PluginValidationError as error:
        manager.unregister(name=name)
        raise PluginError(f"Plugin '{name}' implements a hook that does not exist: {error}") from error
    unknown = [
        item
        for item in dir(module)
        if item.startswith("understudy_") and not hasattr(Hooks, item) and callable(getattr(module, item))
    ]
    if unknown:
        raise PluginError(
            f"Plugin '{name}' defines '{unknown[0]}', which is no hook. The hooks are: "
            + ", ".join(item for item in vars(Hooks) if item.startswith("understudy_"))
        )
    others = [p for p in manager.get_plugins() if p is not module]
    directory: Path | None = None
    register = Registrar(plugins.registry, name, distribution, version)
    try:
        manager.subset_hook_caller("understudy_register", others)(register=register)
        given = manager.subset_hook_caller("understudy_config_directory", others)()
        directory = Path(given[0]) if given else None
    except PluginError:
        raise
    except Exception as error:  # as at import: named, isolated
        manager.unregister(name=name)
        registry = plugins.registry
        for key in [k for k, c in registry.components.items() if c.plugin == name]:
            del registry.components[key]
        for key in [k for k, t in registry.tasks.items() if t.plugin == name]:
            del registry.tasks[key]
        _broken(plugins, name, distribution, version, error)
        return
    plugins.loaded.append(LoadedPlugin(name, distribution, version, "ok", directory))


def _refuse_shadowed_options(plugins: Plugins) -> None:
    owner: dict[Path, str] = {}
    for name, directory in plugins.config_directories():
        for file in sorted(directory.rglob("*.yaml")):
            option = file.relative_to(directory)
            if option in owner:
                raise PluginError(
                    f"Plugins '{owner[option]}' and '{name}' both provide the config option "
                    f"'{option.with_suffix('')}'. Rename one of them."
                )
            owner[option] = name


@functools.cache
def installed() -> Plugins:
    """The plugins of this environment, loaded once."""
    return load()

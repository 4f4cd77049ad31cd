"""Loading plugins: entry points, tables, pluggy's hook, and folders of options.

A plugin is a module named in the entry-point group ``understudy``. It declares what it provides in
tables (:data:`understudy.setup.registry.TABLES`), and config options in a folder ``conf`` beside
it. The hook below, marked with ``@understudy.hookimpl``, registers what is only known at run time;
the tables of a module with a hook are read if it also has ``REQUIRES``. The bundled plugins are
loaded exactly like a stranger's.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from importlib import metadata
from pathlib import Path
from types import FunctionType, MethodType, ModuleType
from typing import Any

import pluggy

from understudy.errors import PluginError, RunError, said, suggestion
from understudy.folders import read
from understudy.setup.registry import Registrar, Registry
from understudy.signals import is_stop

__all__ = ["Plugins", "installed", "kernel_conf"]

GROUP = "understudy"
hookspec = pluggy.HookspecMarker(GROUP)
hookimpl = pluggy.HookimplMarker(GROUP)
_HOOKS = (FunctionType, MethodType, staticmethod, classmethod)  #: what may be a hook


class Hooks:
    """The hook that a plugin may implement."""

    @hookspec
    def understudy_register(self, register: Registrar) -> None:
        """Register what is only known at run time, such as the files in a folder."""


@dataclass(frozen=True)
class LoadedPlugin:
    """One plugin found on this machine. ``status`` is ``ok`` or the reason it did not load."""

    name: str
    distribution: str = ""
    version: str = ""
    status: str = "ok"
    config_directory: Path | None = None


@dataclass
class Plugins:
    """The loaded plugins and the registry they filled."""

    registry: Registry = field(default_factory=Registry)
    loaded: list[LoadedPlugin] = field(default_factory=list)

    def folders(self) -> list[tuple[str, Path]]:
        """The folders of options by owner: the kernel, whose name is empty, then the plugins."""
        found = [(p.name, p.config_directory) for p in self.loaded if p.config_directory]
        return [("", kernel_conf()), *found]


def load(*, only: Iterable[str] | None = None, extra: Iterable[tuple[str, Any]] = ()) -> Plugins:
    """Load all installed plugins, or just those named in `only`, plus `extra` (name, module) pairs.

    ``UNDERSTUDY_PLUGINS=a,b`` allows only the named plugins and ``UNDERSTUDY_DISABLE_PLUGINS=c``
    leaves some out; a PluginError if they name a plugin that is not installed. A plugin that fails
    to import, misspells the hook, has unreadable options, or provides what an earlier one provides
    is left out as a whole and recorded in ``registry.broken``; the others still load. Bundled
    plugins come first, then the others by name.
    """
    result = Plugins()
    of = functools.cache(_of)  # many plugins are of one distribution
    found = sorted(_entries(), key=lambda e: (of(e.dist)[0] != "understudy", e.name, of(e.dist)))
    there = {entry.name for entry in found}
    allowed = (_names("UNDERSTUDY_PLUGINS", there) or None) if only is None else set(only)
    disabled = _names("UNDERSTUDY_DISABLE_PLUGINS", there)
    seen: dict[str, Any] = {}
    for entry in found:
        if (allowed is not None and entry.name not in allowed) or entry.name in disabled:
            continue
        distribution, version = of(entry.dist)
        first = seen.setdefault(entry.name, entry)
        if first.value != entry.value:
            other, by = of(first.dist)[0] or "another distribution", distribution or entry.value
            why = f"{other} provides a plugin named '{entry.name}' already"
            error = PluginError(f"{why}. Uninstall {by}, or rename its plugin.")
            _isolate(result, LoadedPlugin(f"{entry.name} of {by}", distribution, version), error)
        elif first is entry:  # else the same distribution, seen twice on the path
            plugin = LoadedPlugin(entry.name, distribution, version)
            _add(result, plugin, lambda entry=entry: _module(entry))
    for name, module in extra:
        _add(result, LoadedPlugin(name), lambda module=module: module)
    faults = _broken_options(result) | result.registry.unknown_kinds()
    for plugin in [p for p in result.loaded if p.name in faults]:
        result.loaded.remove(plugin)
        _isolate(result, plugin, faults[plugin.name])
    return result


def _entries(one: metadata.Distribution | None = None) -> Iterable[metadata.EntryPoint]:
    """The entry points of plugins; a PluginError names the package whose own cannot be read, by
    anyone: torch would fail on it, too."""
    try:
        return one.entry_points if one else metadata.entry_points(group=GROUP)
    except Exception as error:
        whose = f"{one.name} in {one.locate_file('')}" if one else ""
        whose = whose or f"one of {len([*map(_entries, metadata.distributions())])} packages"
        why = f"The entry points of {whose} cannot be read ({said(error)}), so that nothing with plugins"
        raise PluginError(f"{why} works beside it. Install it anew, or remove it.") from error


def _module(entry: metadata.EntryPoint) -> Any:
    if not metadata.EntryPoint.pattern.match(entry.value):
        where = f"its entry point is {entry.value!r}, which names no module"
        raise PluginError(f"{where}. Write {entry.name} = MODULE there.")
    return entry.load()


def _of(distribution: metadata.Distribution | None) -> tuple[str, str]:
    """Name and version; empty if the metadata are damaged."""
    with suppress(Exception):  # such as a name that is no text
        return (distribution.name or "", distribution.version or "") if distribution else ("", "")
    return "", ""


def _names(variable: str, there: set[str]) -> set[str]:
    names = {name.strip() for name in os.environ.get(variable, "").split(",") if name.strip()}
    for name in sorted(names - there):
        advice = suggestion(name, there)
        raise PluginError(f"{variable} names '{name}', which is no installed plugin.{advice}")
    return names


def _isolate(plugins: Plugins, plugin: LoadedPlugin, error: BaseException) -> None:
    """Forget all of `plugin` but its name and why it did not load."""
    reason = said(error)
    plugins.registry.remove(plugin.name)
    plugins.registry.broken[plugin.name] = reason
    plugins.loaded.append(replace(plugin, status=reason, config_directory=None))


def _add(plugins: Plugins, plugin: LoadedPlugin, find: Callable[[], Any]) -> None:
    """Register what the plugin's module, which `find` imports, declares."""
    manager = pluggy.PluginManager(GROUP)  # one each, so that no other's hook is called again
    try:
        module = find()
        hooked = [item for item in dir(module) if item.startswith("understudy_")]
        for item in hooked:
            if item not in vars(Hooks) and callable(getattr(module, item)):
                why = f"it defines '{item}', which is no hook"
                raise PluginError(f"{why}. The hook is understudy_register.")
            if item in vars(Hooks) and not manager.parse_hookimpl_opts(module, item):
                raise PluginError(f"its '{item}' is no function marked with @understudy.hookimpl.")
        register = Registrar(plugins.registry, plugin.name, plugin.distribution, plugin.version)
        if not hooked or "REQUIRES" in dir(module):  # else its constants may mean something else
            register.tables(module)
        there = vars(module) if isinstance(module, ModuleType) else {}
        more = {*dir(module)} - there.keys() or any(isinstance(v, _HOOKS) for v in there.values())
        if hooked or more:  # else it is data, in which pluggy would look for hooks, and take longer
            manager.add_hookspecs(Hooks)
            manager.register(module)
            manager.check_pending()
            manager.hook.understudy_register(register=register)
        plugins.loaded.append(replace(plugin, config_directory=_conf(module)))
    except BaseException as error:  # a stranger's code may raise anything
        if is_stop(error):
            raise
        _isolate(plugins, plugin, error)


def _conf(module: Any) -> Path | None:
    """The folder ``conf`` beside a module of a package, if there is one."""
    file = getattr(module, "__file__", None)
    beside = Path(file).parent / "conf" if file and getattr(module, "__package__", "") else None
    return beside if beside and beside.is_dir() else None


def kernel_conf() -> Path:
    """The kernel's own config directory (``conf/`` at the top of the source tree)."""
    here = Path(__file__).resolve()
    packaged = here.parents[1] / "conf"
    return packaged if packaged.is_dir() else here.parents[3] / "conf"


def _broken_options(plugins: Plugins) -> dict[str, BaseException]:
    """By plugin: the error for a config option that cannot be read, or that is provided already."""
    owner, faults = dict[str, str](), dict[str, BaseException]()
    bundled = {"", *(p.name for p in plugins.loaded if p.distribution == "understudy")}
    for name, directory in plugins.folders():
        for option in sorted(
            f"{folder.removeprefix(str(directory))}/{file}"[1:-5]
            for folder, folders, files in os.walk(directory)
            for file in (*folders, *files)
            if file.endswith(".yaml")
        ):
            if owner.setdefault(option, name) != name:
                other = f"plugin '{owner[option]}'" if owner[option] else "understudy itself"
                why = f"it provides the config option '{option}', which {other} provides already"
                faults[name] = PluginError(f"{why}. Rename one of them.")
            elif name not in bundled and (why := _unreadable(directory / f"{option}.yaml")):
                faults[name] = PluginError(f"its config option '{option}' {why}.")
    return faults


#: The most bytes of a stranger's file of options, and the most values with its anchors expanded.
_BYTES, _VALUES = 2**20, 10**5


def _unreadable(file: Path) -> str:
    """Why a file of options cannot be read; "" if it can. Anchors are not expanded."""
    import yaml

    values: dict[int, int] = {}

    def count(node: Any) -> int:
        """Values in the node; a RecursionError if it contains itself."""
        if id(node) not in values:
            inside = node.value if isinstance(node, yaml.CollectionNode) else ()
            flat = (n for item in inside for n in (item if isinstance(item, tuple) else (item,)))
            values[id(node)] = 1 + sum(map(count, flat))
        return values[id(node)]

    try:
        root = yaml.compose(read(file, _BYTES).decode(), Loader=yaml.SafeLoader)
        return "has too many values" if root is not None and count(root) > _VALUES else ""
    except (OSError, RunError) as error:
        return f"cannot be read: {getattr(error, 'strerror', None) or error}"
    except UnicodeDecodeError:
        return "is not UTF-8"
    except (yaml.YAMLError, ValueError) as error:
        return f"is not YAML: {' '.join(str(error).split())[:200]}"
    except RecursionError:
        return "is nested too deep, or in itself"


@functools.cache
def installed() -> Plugins:
    """The plugins of this environment, loaded once."""
    return load()

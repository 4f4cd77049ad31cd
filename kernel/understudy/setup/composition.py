"""Configurations composed by Hydra from the options of the kernel and of all plugins."""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import functools
import re
from collections.abc import Callable, Iterator, Sequence
from os.path import exists
from pathlib import Path
from typing import Any

from hydra.core.override_parser.types import Quote, QuotedString
from hydra.errors import HydraException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from understudy.errors import ConfigError, UnderstudyError, suggestion
from understudy.options import as_yaml, each, items, plain
from understudy.setup.config import Experiment
from understudy.setup.option_files import MARK, compose, parsed
from understudy.setup.plugins import Plugins, installed, kernel_conf
from understudy.setup.root import KEYS, Root
from understudy.setup.validation import GROUPS, refuse_code, unknown_key, validate

__all__ = [
    "compose_raw",
    "for_hydra",
    "hydra_session",
    "load_experiment",
    "options",
    "refuse_resolvers",
    "replaced",
    "split_overrides",
]


@contextlib.contextmanager
def hydra_session(plugins: Plugins, overrides: Sequence[str]) -> Iterator[None]:
    """Checks `overrides`; inside, Hydra's errors about them become ours."""
    _check_length("".join(overrides), 10)
    for override in overrides:
        _check(override, plugins)
    try:
        yield
    except (HydraException, OmegaConfBaseException, ValueError, TypeError, RecursionError) as error:
        raise ConfigError(_plain(error, plugins, overrides) + plugins.registry.absent()) from error


#: A list, a mapping or a quotation with something after it: ``[1] walk.bvh``.
_MORE = r"""(\[[^\[\]]*\]|\{[^{}]*\}|'[^']*'|"[^"]*")[^\s,'"\]}][^,]*|(\[[^\[\]]*\]|\{[^{}]*\})\s[^,:]*"""
#: A name in a mapping with a sign that Hydra's grammar has for none: ``{läufer: 1}``.
_NAMED = re.compile(r"[{,][^{}\[\],:]*[^\w\s$%()*+./=?@\\|{}\[\],:-][^{}\[\],:]*:", re.ASCII)
_LONGEST = 10_000  #: characters of an override
_LONGEST_KEY = 255  #: bytes, as of a file's name
_PLAIN = re.compile(r"[+~]{0,2}[\w@./-]+=[\w./-]*", re.ASCII)


def _check_length(text: str, overrides: int = 1) -> None:
    """A ConfigError if `text` is longer than so many `overrides` may be, as Hydra takes its square."""
    if len(text) > overrides * _LONGEST:
        raise ConfigError(
            f"{text[:60]} … has {len(text)} characters, and at most {overrides * _LONGEST} are "
            "read. Shorten it."
        )


def readable(override: str) -> str:
    """`override`, its value quoted if Hydra's grammar lacks it, as it lacks many names of files."""
    key, equals, value = override.partition("=")
    if not equals or _PLAIN.fullmatch(override) or key != key.strip():
        return override
    _check_length(override)

    def reads(text: str, several: bool = False) -> bool:
        try:
            return parsed(f"{key}={text}").is_sweep_override() == several
        except (HydraException, RecursionError):
            return False

    def quoted(text: str) -> str:
        return QuotedString(text, Quote.single).with_quotes()

    if value != value.strip():
        if not value.lstrip().startswith(("[", "{", "'", '"')):
            return f"{key}={quoted(value)}"  # which Hydra would strip
        override = f"{key}={(value := value.strip())}"
    structured = value.startswith(("[", "{")) and not exists(value)
    if not reads(value) and re.fullmatch(_MORE, value):
        return f"{key}={quoted(value)}"
    if reads(value) or ("," in value and reads(value, True) and not (exists(value) or structured)):
        return override
    if structured:
        words = _each_word(value, lambda word: word if reads(word) else quoted(word))
        return f"{key}={words}" if reads(words) else override
    return override if value[0] in "{'\"" and not exists(value) else f"{key}={quoted(value)}"


def _each_word(value: str, mend: Callable[[str], str]) -> str:
    """A list or mapping as people write it, ``{a: [learner=ppo, x=[1]]}``, with `mend` applied to
    each word that is not quoted. Brackets after an equals sign belong to the word."""
    result, word, depth, quote, within, keys = "", "", 0, "", [""], [set[str]()]

    def ended() -> str:
        plain = word.strip()
        return word.replace(plain, mend(plain)) if plain and plain[0] not in "'\"" else word

    for sign in value:
        if quote or (sign in "'\"" and not word.strip()):
            quote = "" if sign == quote else quote or sign
        elif "=" in word and (sign in "[{" or depth):
            depth += (sign in "[{") - (sign in "]}")
        elif sign in "[]{}," or (sign == ":" and within[-1] == "{"):
            key = word.strip().strip("'\"") if sign == ":" and result[-1] in "{," else ""
            if key in keys[-1]:
                raise ConfigError(f"'{key}' stands twice in {value[:200]}. Write it once.")
            keys[-1] |= {key} - {""}
            word = re.sub(r"(?<!\\)[=()]", r"\\\g<0>", word) if sign == ":" else ended()
            result, word = result + word + sign, ""
            if sign in "[{":
                within, keys = [*within, sign], [*keys, set()]
            elif sign in "]}" and len(within) > 1:
                within, keys = within[:-1], keys[:-1]
            continue
        word += sign
    return result + ended()


def _check(override: str, plugins: Plugins) -> None:
    """Raise :class:`ConfigError` unless `override` is a single assignment."""
    if override.lstrip("+~'\" ").startswith("hydra"):  # hydra.searchpath=[pkg://x] imports x
        raise ConfigError(f"{override}: Hydra itself cannot be configured. Remove it.")
    key, equals, value = override.partition("=")
    if not key.strip("+~ '\""):
        raise ConfigError(f"'{override}' sets nothing. Write KEY=VALUE, without spaces.")
    if len(key.encode()) > _LONGEST_KEY:  # Hydra looks for a file of that name
        raise ConfigError(f"'{key[:40]}…' is no configuration key: it has {len(key)} characters.")
    if not equals and not override.startswith("~"):
        known = options(plugins, "experiment")
        form = f"experiment={key}" if key in known else "KEY=VALUE, without spaces"
        raise ConfigError(f"'{override}' sets nothing. Write {form}.")
    if key != key.strip():
        raise ConfigError(f"'{override}' has blanks around its key. Write {key.strip()}={value}.")
    try:
        read = parsed(override)
        several = read.is_sweep_override()
        chosen = read.value() if equals and not several and not read.is_delete() else None
    except (HydraException, RecursionError) as why:
        of = "; names in {} are of a-z, digits and _-./, unquoted" * bool(_NAMED.search(value))
        raise ConfigError(f"{override:.99} cannot be read. Check brackets and quotes{of}.") from why
    group = read.key_or_group
    if not _is_value(group, plugins) and ("/" in group or "." not in group):  # it names a file
        names = chosen if isinstance(chosen, list) else [chosen]
        slot = plugins.registry.slots.get(group)
        one = slot is not None and not slot.many and len(names) != 1
        if names is chosen and (one or not all(isinstance(n, (str, QuotedString)) for n in names)):
            raise ConfigError(f"{override} names no option of {group}. Write {key}=NAME.")
        if any(map(_leads_out, (group, *names))):
            raise ConfigError(f"{override} names no option: those are files in folders of options.")
        if isinstance(chosen, str):  # as one types it: without a suffix, ``./`` and doubled slashes
            name = Path(re.sub(r"\.ya?ml$", "", chosen)).as_posix()
            if name != chosen and name in options(plugins, group):
                raise ConfigError(f"There is no {group}={chosen}. Write {group}={name}.")
    if several:
        raise ConfigError(
            f"{override} has several values and a run takes one. A list is written [{value}], a text with "
            f"commas {key}=\"'{value}'\"; runs and seeds are compared by `understudy sweep`."
        )


def _leads_out(name: Any) -> bool:
    """Whether the `name` of a group or an option leads out of the folders, or is to be resolved."""
    text = str(name) if isinstance(name, (str, QuotedString)) else ""
    return Path(text).is_absolute() or ".." in Path(text).parts or "${" in text


_RESOLVER = re.compile(r"\$\{[^}]*(:|\$\{)")


def refuse_resolvers(overrides: Sequence[str], of: str) -> None:
    """A ConfigError for a stranger's overrides, found in `of`, that read this machine (``${a:b}``)."""
    for override in overrides:
        if _RESOLVER.search(override):
            raise ConfigError(
                f"{of} sets {override}, which would be read from this machine. Give it a value anew."
            )


def _plain(error: Exception, plugins: Plugins, overrides: Sequence[str]) -> str:
    """Hydra's error in one line; with a suggestion if an option was not found."""
    if isinstance(error, RecursionError):
        return f"{' '.join(overrides):.200}: a file builds on itself, or is nested too deep."
    text = next(iter(str(error).replace(MARK, "").strip().splitlines()), "").rstrip()
    unset = re.search(r"Missing mandatory value: ([\w.]+)|Interpolation key '([\w.]+)' not", text)
    if unset and (unset[1] or unset[2] in dict(items(plain(dataclasses.asdict(Root()))))):
        return _not_set(unset[1] or unset[2], overrides, plugins)
    if missing := re.search(r"Could not find '([^/']+)/([^']*)'", text):
        group, name = missing.groups()
        return f"There is no {group}={name}.{suggestion(name, options(plugins, group))}"
    if slashed := re.search(r"Could not override '(\w+/[\w/]+)'", text):
        dotted = slashed[1].replace("/", ".")
        return f"There is no configuration key '{slashed[1]}'. A part's option has dots: {dotted}=VALUE."
    if stray := re.search(r"Could not override '([^']+)'", text):
        if slot := plugins.registry.slots.get(stray[1]):
            one = "{name: COMPONENT, …}"
            form = f"{{NAME: {one}}}" if slot.many else one
            return f"There is no such choice of {stray[1]}. Give one: '{stray[1]}={form}'."
        return unknown_key(stray[1], plugins.registry)
    for line in (kernel_conf() / "hydra_errors.txt").read_text(encoding="utf-8").splitlines():
        theirs, _, ours = line.partition(" -> ")
        if found := re.search(theirs, text):
            return found.expand(ours)
    return text or type(error).__name__


def _not_set(path: str, overrides: Sequence[str], plugins: Plugins) -> str:
    """The error for a `path` without a value. The files that `overrides` choose, or files that
    these build on, may say what it takes, in a comment ``# needs PATH: …``."""
    choices = [tuple(o.lstrip("+").partition("=")[::2]) for o in overrides]
    for group, name in choices:  # to which files are added that they build on
        file = options(plugins, group).get(name) if group.isidentifier() else None
        text = file.read_text(encoding="utf-8") if file else ""
        said = re.search(rf"^# needs {re.escape(path)}: (.*(?:\n#   .*)*)", text, re.MULTILINE)
        if said:
            return f"{path} is not set. It takes {' '.join(said[1].replace('#', '').split())}."
        choices += re.findall(r"^ +- (?:override )?/(\w+)(?:/|: )([\w/]+)", text, re.MULTILINE)
    return f"{path} is not set. Give it a value."


def options(plugins: Plugins, group: str) -> dict[str, Path]:
    """By name as one types it: the files of options for `group`, less those to build on (``_x``)."""
    return {
        file.relative_to(folder / group).with_suffix("").as_posix(): file
        for _, folder in plugins.folders()
        for file in sorted((folder / group).rglob("[!_]*.yaml"))
    }


#: Root keys that are values, not groups of options.
_VALUES = KEYS - {"task", "reward", "termination"}


def _is_value(key: str, plugins: Plugins) -> bool:
    """Whether `key` is set to a value, rather than to the name of a file."""
    return key in _VALUES or (key in plugins.registry.sections and not options(plugins, key))


def for_hydra(overrides: Sequence[str], plugins: Plugins) -> list[str]:
    """`overrides` as Hydra takes them. It may set options that no file mentions (``a.b=value``):
    validation knows which ones exist."""
    result = []
    for override in overrides:
        key, equals, value = override.partition("=")
        sets = "." in key or value.startswith("{") or _is_value(key.lstrip("+"), plugins)
        if not key.startswith("~"):
            mend = functools.partial(_as_typed, sets=sets)
            override = f"{key}{equals}{_each_word(value, mend)}"
        signed = key.startswith(("+", "~"))
        result.append(f"++{override}" if sets and equals and not signed else override)
    return result


_NUMERAL = re.compile(r"[+-]?([\d.][\d_.]*(e[+-]?\d[\d_]*)?|inf|nan|true|false)", re.IGNORECASE)


def _as_typed(word: str, sets: bool) -> str:
    """`word`; quoted if it is a number whose text is kept, or, unless it `sets`, a file's name."""
    if not _NUMERAL.fullmatch(word):
        return word
    if not sets:
        return f"'{word}'"
    return word if as_yaml(parsed(f"x={word}").value()) == word else f"'{MARK}{word}'"


def split_overrides(
    overrides: Sequence[str], plugins: Plugins
) -> tuple[list[str], dict[str, str], set[str]]:
    """Three kinds of overrides: those that Hydra applies; by key, those that empty a slot or a
    section (``policy=null``), for which Hydra has no word; and, of the first, the groups for which
    a file is chosen (``policy=mlp``)."""
    groups = {*GROUPS, *(name for name in plugins.registry.slots if "." not in name)}
    kept, emptied = list[str](), dict[str, str]()
    for override in overrides:
        key, _, value = override.partition("=")
        if value == "null" and key in groups.union(plugins.registry.sections):
            emptied[key] = override
        else:
            kept.append(override)
            emptied.pop(key.lstrip("+"), None)  # chosen again
    pairs = [o.lstrip("+").split("=", 1) for o in kept if "=" in o]
    chosen = {key for key, value in pairs if key in groups and not value.lstrip().startswith("{")}
    return kept, emptied, chosen


def replaced(overrides: Sequence[str], by: Sequence[str]) -> list[str]:
    """`overrides` without those that `by` sets, then `by`."""
    new = {*map(_key, by)}
    return [*(o for o in overrides if _key(o) not in new), *by]


def _key(override: str) -> str:
    return override.lstrip("+~").partition("=")[0]


def compose_raw(overrides: Sequence[str], plugins: Plugins | None = None) -> dict[str, Any]:
    """The composed configuration as plain data.

    A part that an override chooses (``policy=mlp``) has what its file and other overrides set; what
    the task or experiment sets for its own choice is not mixed in. A ConfigError if it cannot be.
    """
    plugins = plugins or installed()
    overrides = [readable(o) for o in ([overrides] if isinstance(overrides, str) else overrides)]
    kept, emptied, chosen = split_overrides(overrides, plugins)
    with hydra_session(plugins, overrides):
        folders = [folder for _, folder in plugins.folders()]
        config = compose(folders, for_hydra(kept, plugins), own=chosen)
        raw = OmegaConf.to_container(config, resolve=True, throw_on_missing=False)
    refuse_code(raw)
    # Leaves are copied, since two keys that share one (``${…}``) may have different types.
    given = each(raw, copy.copy) | dict.fromkeys(emptied)
    for path in sorted(path for path, value in items(given) if value == "???"):
        raise ConfigError(_not_set(path, overrides, plugins))
    with contextlib.suppress(UnderstudyError):  # which notes what is taken as text
        if given != plain(given):
            validate(given, plugins.registry)
    return plain(given)


def load_experiment(overrides: Sequence[str], plugins: Plugins | None = None) -> Experiment:
    """Compose `overrides` and validate the result."""
    plugins = plugins or installed()
    return validate(compose_raw(overrides, plugins), plugins.registry)

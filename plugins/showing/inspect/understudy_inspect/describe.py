"""What a component is, and what it can be given."""

from __future__ import annotations

import dataclasses
import functools
import inspect
import json
import re
import textwrap
import typing
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import yaml

from understudy.errors import ConfigError, suggestion
from understudy.options import REQUIRED, Option, in_words, options_of, schema_of
from understudy.setup.plugins import Plugins
from understudy.setup.registry import Component
from understudy.setup.root import Root
from understudy.setup.validation import EXTRAS
from understudy.testing.sentences import sentences
from understudy_inspect.catalogue import Offer, offers
from understudy_inspect.tests_of import tests_of

if TYPE_CHECKING:
    from understudy.setup.building import Built
    from understudy.setup.config import Experiment

#: Of the files that test a part: those that name it most.
_SHOWN = 4

#: What components of a kind take besides their own options.
_OF_KIND = {
    "reads": "renames fields that it reads: {ITS NAME: FIELD}",
    "provides": "renames fields that it gives: {ITS NAME: FIELD}",
    "weight": "its factor where reward.combine is sum, its exponent where it is product",
    "outcome": "what the end is: failure, success, truncation, or report (no end)",
    "reduce": "how an episode's values become one: last, min, max, mean, sum, any",
}


def describe(name: str, plugins: Plugins) -> str:
    """The text about ``KIND/NAME``, a part or a file of options; NAME alone does where it is clear. Of a kind, or
    of a plugin, alone: its parts, a line each.

    Raises
    ------
    ConfigError
        if there is no such part, or several.
    """
    registry = plugins.registry
    chosen, _, value = name.partition("=")  # as it is typed to choose it: learner=ppo
    name = f"{chosen}/{value}" if value and "/" not in chosen else name
    kind, _, rest = name.partition("/")
    if (group := _group(name, plugins)) is not None:
        options = _table(name, options_of(group), sentences(group))
        return f"{options}\n\n{_kind(name, plugins)}" if name in registry.kinds else options
    if (kind, rest) in registry.components:
        return _component(registry.components[kind, rest], plugins)
    for offer in offers(plugins, kind):
        if offer.name == rest:
            return _offer(kind, offer, plugins)
    found = [(k, n) for k, n in registry.components if n == name]
    if len(found) == 1:
        return _component(registry.components[found[0]], plugins)
    typed = [*registry.kinds, *(f"{k}/{n}" for k, n in registry.components)]
    if found:
        raise ConfigError(
            f"There are several '{name}': " + ", ".join(f"{k}/{n}" for k, n in found) + "."
        )
    owner, _, option = name.rpartition(".")  # as it is typed to set it: budget.samples
    if option and (owner in typed or _group(owner, plugins) is not None):
        raise ConfigError(
            f"'{name}' is no part. An option is described with what it belongs to: `understudy describe {owner}`."
        )
    if kind in registry.kinds:
        if not rest:
            return _kind(kind, plugins)
        registry.find(kind, rest)  # says that there is none, and why
    if of_plugin := [c for c in registry.components.values() if c.plugin == name]:
        return _lines(f"plugin {name}", of_plugin)
    raise ConfigError(
        f"There is nothing called '{name}'. Write KIND/NAME, as in learner/ppo."
        + (suggestion(name, typed) if "Did you" in suggestion(name, typed) else "")
        + registry.absent()
    )


def observed(
    name: str, plugins: Plugins, overrides: Sequence[str] = (), *, columns: bool = True
) -> str:
    """The observations of a task, experiment or run: the shape of each, what reads it where there is a policy, and
    what each of its columns is, in order. Builds one world on the CPU.

    Parameters
    ----------
    name : ``task/NAME``, ``experiment/NAME`` (or with ``=``), or a run folder
    overrides : as a training takes them
    columns : whether they are wanted, a line each

    Raises
    ------
    ConfigError
        if `name` is none of these, or cannot be built.
    RunError
        if the run folder is damaged.
    """
    lines = []
    asked = "--columns" if columns else "--observations"
    with _built(name, plugins, overrides, asked) as (experiment, built):
        readers = _readers(experiment, built)
        for observation, names in built.environment.observation_columns.items():
            shape = list(built.environment.observation_shapes[observation])
            lines.append(f"{observation} {shape}{readers.get(observation, '')}")
            lines += [f"  {n:>4}  {name}" for n, name in enumerate(names) if columns]
    return "\n".join(lines)


def read_by_parts(name: str, plugins: Plugins, overrides: Sequence[str] = ()) -> str:
    """The state fields that terms, encoders and other parts of a task, experiment or run can read: shape without the
    worlds, and what gives each; parameters and errors as :func:`observed`."""
    with _built(name, plugins, overrides, "--fields") as (_, built):
        table = built.environment.table
        width = max(map(len, table.shapes))
        lines = [
            f"{field:<{width}}  {list(table.shapes[field])!s:<8}  {table.source[field]}"
            for field in sorted(table.shapes)
        ]
        named = {k: v for k, v in built.scene.describe().items() if isinstance(v, list)}
    lines.append(
        "Before each shape comes N, the worlds. previous_FIELD is the one of before the decision. Units and frames: "
        "docs/conventions.md, State fields. Names of links and joints, in their order: --columns."
    )
    lines += [
        f"Rows of {what}, in their order: {', '.join(map(str, v))}." for what, v in named.items()
    ]
    return "\n".join(lines)


@contextmanager
def _built(
    name: str, plugins: Plugins, overrides: Sequence[str], option: str
) -> Iterator[tuple[Experiment, Built]]:
    """One world on the CPU of a task, experiment or run, which `option` is asked of."""
    from understudy.records.runs import open_run
    from understudy.setup.building import build_environment
    from understudy.setup.composition import compose_raw, load_experiment

    group, _, rest = name.replace("=", "/", 1).partition("/")
    if (Path(name) / "run.json").is_file():
        run = open_run(name)
        config = compose_raw(run.words(overrides), plugins) if overrides else run.config
        experiment = run.experiment(plugins.registry, {**config, "device": "cpu"})
    elif group in ("task", "experiment"):
        experiment = load_experiment([f"{group}={rest}", *overrides, "device=cpu"], plugins)
    else:
        raise ConfigError(
            f"{option} takes a task, an experiment or a run folder, and {name} is none: write task/spacetime/walk, say."
        )
    built = build_environment(experiment, num_worlds=1)
    try:
        yield experiment, built
    finally:
        built.environment.close()


def _readers(experiment: Experiment, built: Built) -> dict[str, str]:
    """By observation what of the policy reads it, in words; empty where no policy is chosen."""
    chosen = experiment.one("policy") if "policy" in experiment.registry.slots else None
    if chosen is None:
        return {}
    read = chosen.build(built.context).readers(built.environment.reset(0))
    return {name: f", read by {' and '.join(who) or 'no network'}" for name, who in read.items()}


def names(plugins: Plugins) -> list[str]:
    """All that :func:`describe` knows, as it is typed."""
    kinds = {kind for kind, _ in plugins.registry.components} | {"experiment", "task"}
    files = {f"{kind}/{offer.name}" for kind in kinds for offer in offers(plugins, kind)}
    parts = {f"{kind}/{name}" for kind, name in plugins.registry.components if kind != "command"}
    groups = {name for name in options_of(Root) if _group(name, plugins)}
    return sorted(files | parts | groups | plugins.registry.sections.keys())


def _group(name: str, plugins: Plugins) -> type | None:
    """The options of the group or section of a configuration that has that name, if one has."""
    if (section := plugins.registry.sections.get(name)) is not None:
        return cast("type", section.options.factory)
    option = options_of(Root).get(name)
    found = option.annotation if option else None
    return found if dataclasses.is_dataclass(found) and isinstance(found, type) else None


def _kind(kind: str, plugins: Plugins) -> str:
    """What a kind is, and each of its parts in a line."""
    registry = plugins.registry
    parts = [c for c in registry.components.values() if c.kind == kind]
    return _lines(f"{kind}: {registry.kinds[kind].summary}", parts)


def _lines(head: str, parts: Sequence[Component]) -> str:
    """A head, then each of the parts as one types it and what it is."""
    rows = sorted((f"{part.kind}/{part.name}", part.summary) for part in parts)
    width = max((len(name) for name, _ in rows), default=0)
    return "\n".join([head, *(f"  {name:<{width}}  {what}".rstrip() for name, what in rows)])


def _component(component: Component, plugins: Plugins) -> str:
    with component.guarded("cannot be described"):
        return _described(component, plugins)


def _described(component: Component, plugins: Plugins) -> str:
    factory = component.factory
    schema = schema_of(factory)
    comments = sentences(factory)
    parts = [
        f"{component.kind}/{component.name}: {component.summary}".rstrip(": "),
        f"plugin {component.plugin} ({component.distribution} {component.version})".replace(" )", ")")
        + _place(factory)
        + _tested(component),
        *_paragraphs(factory),
        *(_paragraphs(schema) if schema is not None and "(" not in (schema.__doc__ or "(") else []),
    ]  # fmt: skip
    if schema is None and not inspect.isclass(factory):
        reads = [
            parameter.name
            for parameter in inspect.signature(factory).parameters.values()
            if parameter.kind is not inspect.Parameter.KEYWORD_ONLY
        ]
        parts.append(f"Reads: {', '.join(reads)}." if reads else "")
    extra = {n: o for n, o in EXTRAS.get(component.kind, {}).items() if n not in component.options}
    table = _table("Options", {**component.options, **extra}, {**_OF_KIND, **comments})
    parts.append(table if component.options or extra else "It has no options.")
    files = [
        f"  {component.kind}={offer.name}  [{offer.plugin}] {offer.summary}".rstrip()
        for offer in offers(plugins, component.kind)
        if _chooses(offer, component.name)
    ]
    if files:
        parts.append("\n".join(["Chosen by", *files]))
    citations = plugins.registry.citations.values()
    cited = [c.summary for c in citations if c.plugin == component.plugin]
    if cited:
        parts.append("\n".join(["Please cite", *(f"  {text}" for text in cited)]))
    return "\n\n".join(part for part in parts if part)


def _place(factory: Any) -> str:
    """A line that says in which file `factory` is, from the working folder where it is below that."""
    thing = inspect.unwrap(factory)
    try:
        file, (lines, line) = Path(inspect.getfile(thing)), inspect.getsourcelines(thing)
        # after its decorators
        line += [bool(re.match(r"\s*(def|class) ", text)) for text in lines].index(True)
    except (OSError, TypeError, ValueError):  # there is no source
        return ""
    return f"\nin {_from_here(file)}, line {line}"


def _tested(component: Component) -> str:
    """A line that says which files test it; nothing where there are none."""
    files = [_from_here(file) for file in tests_of(component)]
    more = [f"{len(files) - _SHOWN} more"] if len(files) > _SHOWN else []
    return f"\ntests: {', '.join([*files[:_SHOWN], *more])}" if files else ""


def _from_here(file: Path) -> str:
    """As one types it: from the working folder where it is below that."""
    here = Path.cwd()
    return str(file.relative_to(here) if file.is_relative_to(here) else file)


def _offer(group: str, offer: Offer, plugins: Plugins) -> str:
    """A file of options as it stands, and what the component that it names can be given."""
    head = (
        f"{group}={offer.name}  (plugin {offer.plugin or 'understudy'}: {group}/{offer.name}.yaml)"
    )
    parts = [head, textwrap.indent(offer.text.strip(), "  ")]
    for (kind, name), component in plugins.registry.components.items():
        if kind == group and _chooses(offer, name):
            parts.append(_component(component, plugins))
    return "\n\n".join(parts)


def _chooses(offer: Offer, component: str) -> bool:
    return _named_in(offer.text) == component


@functools.lru_cache(1024)  # asked for each component of a kind
def _named_in(text: str) -> Any:
    """The component that a file of options names, if it names one."""
    content = yaml.safe_load(text)
    return content.get("name") if isinstance(content, Mapping) else None


def _paragraphs(thing: Any) -> Iterator[str]:
    text = inspect.getdoc(thing) if inspect.isclass(thing) or inspect.isfunction(thing) else None
    if text:
        yield re.sub(r":\w+:`~?([^`]*)`|``([^`]*)``", lambda m: m[1] or m[2], text)


def _table(title: str, options: Mapping[str, Option], comments: Mapping[str, str]) -> str:
    rows = list(_rows(options, comments, ""))
    first = min(40, max((len(f"{name}={default}") for name, default, _ in rows), default=0))
    lines = []
    for name, default, text in rows:
        wrapped = textwrap.wrap(text, max(40, 96 - first)) or [""]
        lines.append(f"  {f'{name}={default}':<{first}}  {wrapped[0]}".rstrip())
        lines += [f"  {'':<{first}}  {more}" for more in wrapped[1:]]
    return "\n".join([title, *lines])


def _rows(
    options: Mapping[str, Option], comments: Mapping[str, str], prefix: str
) -> Iterator[tuple[str, str, str]]:
    """(key, default as one types it, type and comment) of each option, and of those within it."""
    for name, option in options.items():
        inner = _dataclass_in(option.annotation)
        kind = "" if option.annotation is Any else in_words(option.annotation).removeprefix("a ")
        about = comments.get(name, "").replace("``", "")
        text = f"{kind}; {about}" if kind and about else kind or about
        default = "…" if option.default is REQUIRED else _typed(option.default)
        if inner is not None and dataclasses.is_dataclass(option.default):
            yield from _rows(options_of(inner), sentences(inner), f"{prefix}{name}.")
            continue
        yield f"{prefix}{name}", default, text
        if inner is not None:
            yield from _rows(options_of(inner), sentences(inner), f"{prefix}{name}.")


def _typed(value: Any) -> str:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        value = dataclasses.asdict(value)
    return json.dumps(value, ensure_ascii=False, default=str) if value != {} else "{}"


def _dataclass_in(annotation: Any) -> type | None:
    """The dataclass that an option is, or may be."""
    for item in (annotation, *typing.get_args(annotation)):
        if dataclasses.is_dataclass(item) and isinstance(item, type):
            return item
    return None

"""Options of components: declared by a dataclass or by keyword-only parameters, checked at the
border.

One declaration serves the command line, the checks and the error messages.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import re
import sys
import types
import typing
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from understudy.errors import ConfigError, suggestion

__all__ = [
    "REQUIRED",
    "Option",
    "as_yaml",
    "at",
    "check_range",
    "checked_options",
    "in_words",
    "make_options",
    "options_of",
    "schema_of",
]


@dataclass(frozen=True)
class Option:
    """One option of a component: its type, and its default (``REQUIRED`` if there is none)."""

    name: str
    annotation: Any
    default: Any


REQUIRED: Any = inspect.Parameter.empty
_hints = functools.lru_cache(1024)(typing.get_type_hints)  # every experiment asks again


class Typed:
    """A number or truth value together with the text it was typed as, where the value alone does
    not show that: ``1e3``, ``0012``, ``on``. An option that takes text takes the text."""

    def __init__(self, value: Any, text: str) -> None:
        self.value, self.text = value, text

    def __repr__(self) -> str:
        return self.text


def options_of(factory: Any) -> dict[str, Option]:
    """The options of a factory.

    A class's are the fields of its ``Options``; a function's (a term's) its keyword-only parameters.
    """
    if (schema := schema_of(factory)) is not None:
        hints = _hints(schema)
        result = {}
        for item in dataclasses.fields(schema):
            none, make = dataclasses.MISSING, item.default_factory
            default: Any = item.default if make is none else make()
            default = REQUIRED if default is none else default
            result[item.name] = Option(item.name, hints[item.name], default)
        return result
    if inspect.isclass(factory):
        return {}
    hints = _hints(getattr(factory, "func", factory))  # of a functools.partial
    return {
        name: Option(name, hints.get(name, Any), parameter.default)
        for name, parameter in inspect.signature(factory).parameters.items()
        if parameter.kind is inspect.Parameter.KEYWORD_ONLY
    }


def schema_of(factory: Any) -> Any:
    """The dataclass that declares a factory's options; None of a function."""
    return factory if dataclasses.is_dataclass(factory) else getattr(factory, "Options", None)


def coerce(value: Any, annotation: Any, where: str) -> Any:
    """`value` as the annotated type, or a :class:`ConfigError` that names the key path `where`.

    Knows the types that options use: bool, int, float, str, ``X | None``, ``Literal``, tuples and
    lists, mappings, nested dataclasses, and Any. A float takes whole numbers, an int only floats
    without a fraction; NaN and infinity are never accepted. Text takes a number as it was typed.
    """
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if annotation is Any:
        return plain(value)
    if origin in (typing.Union, types.UnionType):
        if value is None and type(None) in arguments:
            return None
        attempts = [item for item in arguments if item is not type(None)]
        attempts.sort(key=lambda item: item is str and isinstance(value, (int, float, Typed)))
        for item in attempts:
            try:
                return coerce(value, item, where)
            except ConfigError:
                if item is attempts[-1]:  # an error inside a list or mapping names its own place
                    if len(attempts) == 1 or isinstance(value, (list, tuple, Mapping)):
                        raise
                    raise _not_of(attempts, value, where) from None
    if isinstance(value, (int, float, Typed)):
        number = value if isinstance(value, Typed) else Typed(value, as_yaml(value))
        if annotation is str or (origin is typing.Literal and number.text in arguments):
            number.value = number.text
        value = number.value
    if origin is typing.Literal:
        if value in arguments:
            return value
        raise ConfigError(
            f"{where}={as_yaml(value)} is not possible.{suggestion(str(value), map(str, arguments))}"
        )
    if annotation in (bool, int, str) and type(value) is annotation:
        return value
    if annotation is int and isinstance(value, float) and value.is_integer():
        return int(value)  # 1e6 is how people write a million samples
    if annotation is float and isinstance(value, (int, float)) and not isinstance(value, bool):
        if not abs(value) <= sys.float_info.max:  # nor is a whole number that no float holds
            raise ConfigError(f"{where}={value} is not possible; give a finite number.")
        return float(value)
    if origin in (tuple, list) and isinstance(value, (list, tuple)):
        if origin is tuple and arguments and arguments[-1] is not Ellipsis:
            if len(value) != len(arguments):
                raise ConfigError(f"{where} takes {len(arguments)} values, got {len(value)}.")
            kinds = list(arguments)
        else:
            kinds = [arguments[0] if arguments else Any] * len(value)
        return origin(
            coerce(v, kind, f"{where}[{i}]")
            for i, (v, kind) in enumerate(zip(value, kinds, strict=True))
        )
    if (origin or annotation) in (dict, Mapping) and isinstance(value, Mapping):
        kind = arguments[1] if arguments else Any
        return {str(k): coerce(v, kind, f"{where}.{k}") for k, v in value.items()}
    if dataclasses.is_dataclass(annotation) and isinstance(annotation, type):
        return make_options(annotation, value, where)
    raise _not_of([annotation], value, where)


def _not_of(kinds: Sequence[Any], value: Any, where: str) -> ConfigError:
    expected = " or ".join(dict.fromkeys(in_words(kind) for kind in kinds))
    return ConfigError(f"{where}={as_yaml(value)} is not possible: it takes {expected}.")


def items(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Every key path in nested plain data, and its value."""
    yield path, value
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from items(item, f"{path}.{key}".lstrip("."))
    elif isinstance(value, (list, tuple)):
        for i, item in enumerate(value):
            yield from items(item, f"{path}[{i}]")


def at(value: Any, path: str) -> Any:
    """The value at the key path `path` in nested plain data, or None."""
    for key in path.split("."):
        value = value.get(key) if isinstance(value, Mapping) else None
    return value


def each(value: Any, change: Callable[[Any], Any]) -> Any:
    """The nested `value` with `change` applied to every leaf, what is neither mapping nor list."""
    if isinstance(value, Mapping):
        return {str(key): each(item, change) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [each(item, change) for item in value]
    return change(value)


def plain(value: Any) -> Any:
    """The nested `value`, with the number of each :class:`Typed`, or its text if that was taken."""
    return each(value, lambda item: item.value if isinstance(item, Typed) else item)


def as_typed(value: Any, text: str) -> Any:
    """`value`, or a :class:`Typed` if it is a number or truth value whose `text` is lost in it.
    What YAML reads as a number nobody meant (``010`` as 8, ``1:30`` as 90) stays text."""
    if type(value) in (int, float) and re.match(r"[+-]?0[0-9_]|[^:]*:", text):
        return text
    says = type(value) not in (bool, int, float) or as_yaml(value) == text
    return value if says else Typed(value, text)


def as_yaml(value: Any) -> str:
    """`value` as it is written in a configuration: ``null``, ``true``, ``[1, 2]``, ``{a: 'b'}``."""
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key}: {as_yaml(item)}" for key, item in value.items()) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(as_yaml, value)) + "]"
    return repr(value)


_WORDS = {
    int: "a whole number",
    float: "a number",
    str: "text",
    bool: "true or false",
    Any: "anything",
}


def in_words(annotation: Any) -> str:
    """A type as users know it, such as ``a list of whole numbers``."""
    origin, inner = typing.get_origin(annotation), typing.get_args(annotation)
    if annotation in _WORDS:
        return _WORDS[annotation]
    if origin is typing.Literal:
        return " or ".join(map(str, inner))
    if origin in (tuple, list):
        kinds = dict.fromkeys(in_words(kind) for kind in inner if kind is not Ellipsis)
        of = " or ".join(kinds).removeprefix("a ")
        count = f"{len(inner)} " if origin is tuple and Ellipsis not in inner else ""
        plural = "s" if of.endswith("number") or of.endswith("mapping") else ""
        if of.startswith("list"):
            of = of.replace("list", "lists", 1)
        return f"a list of {count}{of}{plural}" if of else "a list"
    if origin in (typing.Union, types.UnionType):
        choices = [in_words(kind) for kind in inner if kind is not type(None)]
        return " or ".join([*dict.fromkeys(choices), *(["null"] if type(None) in inner else [])])
    if (origin or annotation) in (dict, Mapping) or dataclasses.is_dataclass(annotation):
        return "a mapping"
    return getattr(annotation, "__name__", str(annotation))


def make_options(schema: Any, values: Any, where: str) -> Any:
    """The dataclass `schema` filled from the mapping `values`; errors name the key path `where`."""
    if isinstance(values, schema):
        return values
    if not isinstance(values, Mapping):
        keys = ", ".join(options_of(schema))
        given = as_yaml(values)
        raise ConfigError(f"{where}={given} is not possible: it takes a mapping of {keys}.")
    return filled(schema, checked_options(options_of(schema), values, where), where)


def filled(schema: type, checked: Mapping[str, Any], where: str) -> Any:
    """The dataclass `schema` made of `checked` options; its own range checks may refuse them."""
    try:
        return schema(**checked)
    except ValueError as error:  # which begins with the option's name
        raise ConfigError(f"{_below(where)}{error}") from error


def check_range(
    options: Any,
    *names: str,
    above: float | None = None,
    least: float | None = None,
    most: float | None = None,
) -> None:
    """For the ``__post_init__`` of a dataclass of options: a ValueError unless each of the options
    `names` is None, or is greater than `above`, at least `least` and at most `most`; so is each
    value of a tuple or a mapping. Without a `most`, a whole number with a `least`, which is a size
    or a count, is at most :data:`MANY`, and all else at most 1e12."""
    for name in names:
        given = getattr(options, name)
        several = given.values() if isinstance(given, Mapping) else given
        for value in several if isinstance(given, (tuple, Mapping)) else (given,):
            if value is None:
                continue
            few = MANY if type(value) is int and least is not None else 1e12
            end = few if most is None else most
            for limit, holds, how in (
                (above, above is None or value > above, "greater than"),
                (least, least is None or value >= least, "at least"),
                (end, value <= end, "at most"),
            ):
                if not holds:
                    raise ValueError(
                        f"{name}={as_yaml(given)} is not possible: it must be {how} {limit:g}."
                    )


#: The largest size or count that an option can be, unless it says otherwise.
MANY = 10**6


def _below(where: str) -> str:
    return f"{where}." if where else ""


def checked_options(
    options: Mapping[str, Option], values: Mapping[str, Any], where: str
) -> dict[str, Any]:
    """`values` coerced to the types of `options`, and defaults for those not given; an unknown
    option is an error, and so is a missing one without a default."""
    for key in values:
        if key not in options:
            owner = where or "The configuration"
            raise ConfigError(f"{owner} has no option '{key}'.{suggestion(str(key), options)}")
    result = {}
    for name, option in options.items():
        if name in values:
            result[name] = coerce(values[name], option.annotation, f"{_below(where)}{name}")
        elif option.default is REQUIRED:
            raise ConfigError(f"{_below(where)}{name} is not set. Give it a value.")
        else:
            result[name] = option.default
    return result

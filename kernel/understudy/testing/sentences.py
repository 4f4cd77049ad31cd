"""What the source says of options, for what describes them and what checks that each is described."""

from __future__ import annotations

import ast
import functools
import inspect
import io
import textwrap
import tokenize
from typing import Any

from understudy.options import schema_of

__all__ = ["sentences"]


@functools.cache
def sentences(factory: Any) -> dict[str, str]:
    """By option of `factory`: its sentence, the comments ``#:`` above it and behind it in the source.

    Those of a dataclass that another one extends count; where there is no source, nothing is found.
    """
    found: dict[str, str] = {}
    schema = schema_of(factory)
    for thing in reversed(schema.__mro__[:-1]) if schema is not None else [factory]:
        try:
            source = textwrap.dedent(inspect.getsource(inspect.unwrap(thing)))
        except (OSError, TypeError):
            continue
        tokens = tokenize.generate_tokens(io.StringIO(source).readline)
        said = {t.start[0]: t.string[2:].strip() for t in tokens if t.string.startswith("#:")}
        node, after = ast.parse(source).body[0], 0
        for name, end in _declared(node):
            lines = [said[line] for line in range(after + 1, end + 1) if line in said]
            if lines:
                found[name] = " ".join(lines)
            after = end
    return found


def _declared(node: ast.AST) -> list[tuple[str, int]]:
    """By order: the name, and the last line, of each thing that a class or a signature declares."""
    if isinstance(node, ast.ClassDef):
        return [(getattr(getattr(s, "target", s), "id", ""), s.end_lineno or 0) for s in node.body]
    if not isinstance(node, ast.FunctionDef):
        return []
    arguments = node.args
    found = [(a.arg, a.end_lineno or 0) for a in (*arguments.posonlyargs, *arguments.args)]
    for argument, default in zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True):
        found.append((argument.arg, (default or argument).end_lineno or 0))
    return found

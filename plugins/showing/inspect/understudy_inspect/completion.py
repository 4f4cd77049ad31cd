"""Completion of the command line in shells: commands, experiments, options of groups, keys."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Iterator, Sequence
from typing import Any

from understudy.command.command import Command
from understudy.errors import UnderstudyError
from understudy.setup.plugins import Plugins, installed
from understudy_inspect.catalogue import offers

#: Each asks `understudy completion words` for whole words that may stand where the cursor is.
_SCRIPTS = {
    "bash": """\
# source <(understudy completion bash)
_understudy() {
    local line="${COMP_LINE:0:COMP_POINT}" word prefix
    word="${line##*[[:space:]]}"
    # bash replaces what stands behind the last = or : only
    prefix="${word%"${word##*[=:]}"}"
    local IFS=$'\\n'
    COMPREPLY=($(understudy completion words -- "$line" 2>/dev/null))
    COMPREPLY=("${COMPREPLY[@]#"$prefix"}")
    case "${COMPREPLY[0]}${prefix}" in *=* | *. | */) compopt -o nospace ;; esac
    case "${COMPREPLY[0]}" in *= | *. | */) compopt -o nospace ;; *) compopt +o nospace ;; esac
}
complete -o default -F _understudy understudy
""",
    "zsh": """\
#compdef understudy
# source <(understudy completion zsh)
_understudy() {
    local -a found
    found=(${(f)"$(understudy completion words -- "${(j: :)words[1,CURRENT]}" 2>/dev/null)"})
    if (( ${#found} )); then
        compadd -Q -S '' -- ${(M)found:#*[=./]}
        compadd -Q -- ${found:#*[=./]}
    else
        _files
    fi
}
(( $+functions[compdef] )) || { autoload -Uz compinit && compinit }
compdef _understudy understudy
""",
    "fish": """\
# understudy completion fish | source
complete -c understudy -f -a '(understudy completion words -- (commandline -cp | string collect) 2>/dev/null)'
complete -c understudy -n 'not understudy completion words -- (commandline -cp | string collect) 2>/dev/null | string length -q' -F
""",
}


class Completion(Command):
    """Prints what a shell needs to complete understudy's command line."""

    example = "source <(understudy completion bash)"

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument(
            "shell",
            choices=[*_SCRIPTS, "words"],
            help="the shell whose script is printed; `words` is what such scripts call",
        )
        parser.add_argument(
            "line", nargs="?", default="", help="for `words`: the line up to the cursor"
        )

    def run(self, options: argparse.Namespace) -> int:
        if options.shell == "words":
            for word in words(options.line, installed()):
                print(word)
        else:
            print(_SCRIPTS[options.shell], end="")
        return 0


#: Commands that take overrides; those of runs take other words first.
_COMPOSING = ("train", "config", "sweep")
_OF_RUNS = {
    "resume": (),
    "evaluate": ("episodes=", "seconds=", "checkpoint=", "half_step="),
    "render": ("episodes=", "seconds=", "size=", "camera=", "checkpoint="),
}
_SHELLS = ("bash", "zsh", "fish")


def words(line: str, plugins: Plugins) -> list[str]:
    """What the last word of `line`, a command line up to the cursor, may become; whole words."""
    try:
        before = shlex.split(line)[1:]
    except ValueError:  # an open quote
        return []
    last = "" if not line or line[-1].isspace() else before.pop() if before else ""
    return sorted({word for word in _words(before, last, plugins) if word.startswith(last)})


def _words(before: Sequence[str], last: str, plugins: Plugins) -> Iterator[str]:
    commands = plugins.registry.names("command")
    typed = " ".join(before)
    if typed not in commands:
        start = f"{typed} " if typed else ""
        yield from (c[len(start) :].partition(" ")[0] for c in commands if c.startswith(start))
    command, *rest = before or [""]
    if command == "describe" and not rest:
        from understudy_inspect import describe

        yield from describe.names(plugins)
    elif command == "completion" and not rest:
        yield from _SHELLS
    elif command in _COMPOSING or (command in _OF_RUNS and rest):
        yield from _OF_RUNS.get(command, ())
        key, equals, _ = last.partition("=")
        if equals:
            yield from (f"{key}={offer.name}" for offer in offers(plugins, key))
        else:
            yield from _keys(rest[command in _OF_RUNS :], last, plugins)


def _keys(given: Sequence[str], last: str, plugins: Plugins) -> Iterator[str]:
    """Keys of the configuration that `given` composes; those with a dot once one is typed."""
    # Imported where they are needed: they import torch, and somebody is waiting.
    from understudy.setup.composition import compose_raw
    from understudy.setup.validation import root_keys, validate
    from understudy_inspect.origins import paths

    groups = ["experiment", "task", "ablation", "search", *plugins.registry.slots]
    if "." in last:
        try:
            raw = compose_raw(list(given), plugins)
            effective: dict[str, Any] = validate(raw, plugins.registry).effective()
            section = plugins.registry.sections.get(last.partition(".")[0])
            if section and section.name not in effective:
                yield from (f"{section.name}.{name}=" for name in section.options.options)
        except UnderstudyError:
            return
        yield from (f"{path}=" for path in paths(effective, "") if not path.endswith(".name"))
    else:
        roots = root_keys(plugins.registry)
        chosen = {g for g in groups if any(True for _ in offers(plugins, g))}
        nested = {"motion", "control", "episode", "budget", "evaluation", "checkpoint", "run", "start",
                  "resolution", "reward", "termination"}  # fmt: skip
        yield from (f"{name}=" for name in chosen | (roots - nested))
        yield from (
            f"{name}." for name in nested | {s for s in roots if s in plugins.registry.slots}
        )

"""The physics that a policy was trained in, beside that in which it acts: contacts, self-collision, and the step."""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping
from typing import Any

from understudy.setup.config import Experiment
from understudy.task import Context

#: The options of scenes that say how things touch, and how often that is solved.
_PHYSICS = ("contact", "self_collision", "steps")


def _contacts(choices: Mapping[str, Any]) -> dict[str, Any]:
    """By key of the configuration: what scenes say of contacts and of their members' steps."""
    found = dict[str, Any]()
    for slot in ("scene", "scenes"):
        for chosen in choices.get(slot, ()):
            options = {k: v for k, v in chosen.effective().items() if k in _PHYSICS}
            found |= {f"{chosen.where}.{key}": value for key, value in _leaves(options).items()}
    return found


def _leaves(options: Mapping[str, Any], above: str = "") -> dict[str, Any]:
    """By key path: the values of `options`, whose mappings are gone through and whose lists are values."""
    found = dict[str, Any]()
    for key, value in options.items():
        path = f"{above}{key}"
        if isinstance(value, Mapping):
            found |= _leaves(value, f"{path}.")
        else:
            found[path] = list(value) if isinstance(value, tuple) else value
    return found


def tell_of_other_physics(source: str, own: Experiment, context: Context) -> None:
    """Warn, in a sentence, that the run or skill `source` acts in other physics than its `own`, with both values of each
    option that both tasks have, and what would make them equal."""
    here, there = _contacts(context.chosen), _contacts(own.choices)
    differ = {k: (there[k], here[k]) for k in there if k in here and there[k] != here[k]}
    said = [
        f"{key} is {_text(now)} here and {_text(then)} there" for key, (then, now) in differ.items()
    ]
    cures = [f"{key}={_text(then)}" for key, (then, _) in differ.items()]
    control = own.root.control
    then = 1.0 / (control.frequency * control.substeps)
    now = context.control_dt / (context.own_substeps or context.substeps)
    if abs(now / then - 1.0) > 1e-6:
        said.append(
            f"a step of physics lasts {1e3 * now:.4g} ms here and {1e3 * then:.4g} ms there"
        )
        equal = context.control_dt / then
        if round(equal) >= 1 and abs(equal - round(equal)) < 1e-6:
            cures.append(f"control.substeps={round(equal)}")
    if not said:
        return
    cure = f" {' '.join(cures)} would make them equal." if cures else ""
    warnings.warn(
        f"{source} acts in other physics than that of its own task: {'; '.join(said)}.{cure}",
        stacklevel=3,
    )


def _text(value: Any) -> str:
    """`value` as it is written in a configuration."""
    return json.dumps(value, separators=(",", ":"))

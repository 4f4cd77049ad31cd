"""Gripping styles: which finger touches which stick (thesis, section 5.5.2).

A style has an entry for each finger, from the thumb on: 0 touches nothing, 1 the upper stick, 2 the lower
one. Of all tuples those are left whose thumb is on the upper stick, in which no fingers cross, and in which
each stick has a finger besides the thumb. Tongs and a brush are held in one way each: of tongs the thumb is on the
lower bar, index and middle finger on the upper one (section 5.7.4); a brush is one part, which all three are on.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from understudy.errors import ConfigError
from understudy_hand.table import FINGERS
from understudy_hand.tools import Tool

__all__ = ["NAMED", "Style", "read_style", "styles", "written"]

Style = tuple[int, ...]
UPPER, LOWER = 1, 2

#: Those that the thesis has names for (figures 5.10 and 5.12).
NAMED: dict[str, Style] = {
    "standard": (1, 1, 1, 2, 0),
    "forsaken_pinky": (1, 1, 1, 1, 2),
    "right_hand_rule": (1, 1, 2, 0, 0),
    "dino_claw": (1, 0, 1, 2, 0),
}


#: The only ones of other tools.
_ONLY: dict[Tool, Style] = {
    "tongs": (LOWER, UPPER, UPPER, 0, 0),
    "brush": (UPPER, UPPER, UPPER, 0, 0),
}


def styles(fingers: int, tool: Tool = "sticks") -> tuple[Style, ...]:
    """All of a hand with so many fingers; seventeen of two sticks for five."""
    if tool in _ONLY:
        return (_ONLY[tool][:fingers],)
    every = itertools.product((0, UPPER, LOWER), repeat=fingers)
    return tuple(style for style in every if not _against(style))


def written(style: Style) -> str:
    """As digits, thumb first."""
    return "".join(map(str, style))


def read_style(text: str, fingers: int, tool: Tool = "sticks") -> Style:
    """The style `text`, a name or digits from the thumb on, of a hand with so many `fingers`.

    Raises
    ------
    ConfigError
        it is none; the sentence says why, and which there are.
    """
    style = NAMED.get(text)
    if style is None:
        if not text or set(text) - set("012"):
            named = ", ".join(NAMED)
            raise ConfigError(
                f"'{text}' is no gripping style: give {fingers} digits from the thumb on (0 no contact, "
                f"1 upper stick, 2 lower stick), or a name: {named}.{_list(fingers, tool)}"
            )
        style = tuple(int(digit) for digit in text)
    check_style(style, fingers, tool)
    return style


def check_style(style: Sequence[int], fingers: int, tool: Tool = "sticks") -> None:
    """Raises:
    ConfigError: a hand with so many `fingers` has no such style; the sentence says why, and which it has.
    """
    shown = written(tuple(style))
    if len(style) != fingers:
        reason = f"it has {len(style)} entries and the hand {fingers} fingers"
    elif tool in _ONLY:
        if tuple(style) in styles(fingers, tool):
            return
        reason = f"{'a brush is' if tool == 'brush' else 'tongs are'} held otherwise"
    elif not (reason := _against(style)):
        return
    raise ConfigError(
        f"The gripping style {shown} is not possible: {reason}.{_list(fingers, tool)}"
    )


def _against(style: Sequence[int]) -> str:
    """Why `style` is none, or nothing."""
    if set(style) - {0, UPPER, LOWER}:
        return "entries are 0, 1 or 2"
    if style[0] != UPPER:
        return "the thumb is on the upper stick, so the first entry is 1"
    touching = [(finger, stick) for finger, stick in enumerate(style) if stick]
    for (one, above), (other, below) in itertools.pairwise(touching):
        if above > below:
            names = f"the {FINGERS[one]} and the {FINGERS[other]} finger"
            return f"{names} cross, as the sticks they touch are {above} and {below}"
    for stick, name in ((UPPER, "upper"), (LOWER, "lower")):
        if stick not in style[1:]:
            who = "only the thumb touches" if stick == UPPER else "no finger touches"
            return f"{who} the {name} stick"
    return ""


def _list(fingers: int, tool: Tool = "sticks") -> str:
    known = " ".join(written(style) for style in styles(fingers, tool))
    return f" A hand of {fingers} fingers has: {known}."

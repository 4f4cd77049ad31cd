"""How each tool is held: what of it carries contacts, which links bear it beside the tips, at which angles.

m, rad; in the palm's frame. Parts are numbered from 1 on, the upper one first; a brush has one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from understudy.errors import ConfigError
from understudy_gripping.styles import LOWER, UPPER, Style
from understudy_hand.tools import BAR, RADIUS, Tool

__all__ = ["Holding", "holding"]

#: Where the lower stick lies in a human palm, about which it is searched (the release's grip), and how far it
#: may go from there.
_PLACE, _TURN = (0.0355, -0.0611, 0.0910), (0.558891, 0.529425, 0.499098, 0.397808)
_FAR, _TURNED = 0.04, 0.6


@dataclass(frozen=True)
class Holding:
    """How one kind of tool is held."""

    #: Links that bear it beside the tips: the part, and where along it (m from the middle).
    supports: Mapping[str, tuple[int, float]]
    angles: tuple[float, ...]  #: at which a grip is solved, rising; more is more closed
    place: tuple[float, float, float] = _PLACE  #: of the lower part, of which a search begins
    turn: tuple[float, float, float, float] = _TURN
    far: float = _FAR  #: m, and
    turned: float = _TURNED  #: rad: how far it may go from there
    #: Half sizes where parts are bars; else they are round.
    bar: tuple[float, float, float] | None = None
    most: float = 0.6  #: rad: how far a target may be from the pose

    @property
    def thickness(self) -> float:
        """m from a part's axis to where a finger touches it."""
        return RADIUS if self.bar is None else self.bar[1]

    def sides(self, style: Style) -> tuple[tuple[float, float, float], ...]:
        """By finger: towards which side of its part it lies. The thesis searches no sides; those of sticks are the
        release's: thumb +z, index +y above other fingers, all others -z. A bar is touched from without."""
        if self.bar is not None:
            return tuple((0.0, 1.0 if part == UPPER else -1.0, 0.0) for part in style)
        above = style[1] == UPPER and UPPER in style[2:]
        index = (0.0, 1.0, 0.0) if above else (0.0, 0.0, -1.0)
        return ((0.0, 0.0, 1.0), index, *[(0.0, 0.0, -1.0)] * (len(style) - 2))

    def first_guess(self, style: Style) -> tuple[float, ...]:
        """m: places 13 mm from one another towards the tips, the thumb's behind the others (measured)."""
        ahead = {UPPER: 0.0, LOWER: -0.012}
        places = [0.035 if self.bar is None else 0.0]
        for part in style[1:]:
            if part:
                places.append(ahead[part])
                ahead[part] -= 0.013
        return tuple(places)


_HOLDINGS: dict[str, Holding] = {
    "sticks": Holding(
        supports={
            "index_metacarpal": (LOWER, 0.085),  # the valley
            "thumb_middle": (LOWER, 0.045),
            "index_proximal": (UPPER, 0.065),
        },
        angles=(0.0, 0.04, 0.08, 0.12, 0.15),  # the sticks touch at 0.154
    ),
    # The thumb on one bar, index and middle finger on the other, no others (section 5.7.4).
    "tongs": Holding(
        supports={},
        angles=(0.02, 0.03, 0.04, 0.05, 0.06),
        far=0.06,
        turned=1.0,
        bar=BAR,
        most=1.5,
    ),
    # As the upper one of two sticks. It has no angle; two rows make it a table like others.
    "brush": Holding(
        supports={"index_proximal": (UPPER, 0.065)},
        angles=(0.0, 1.0),
        place=(0.0355, -0.0611, 0.1260),
    ),
}


def holding(tool: Tool) -> Holding:
    """How the `tool` is held.

    Raises
    ------
    ConfigError
        there is no such tool, or nothing to hold.
    """
    found = _HOLDINGS.get(tool)
    if found is None:
        raise ConfigError(f"No hand holds '{tool}'. There are: {', '.join(_HOLDINGS)}.")
    return found

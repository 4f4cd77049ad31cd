"""A figure's table of links, and what is none."""

from __future__ import annotations

from dataclasses import replace

import pytest

from understudy.errors import ConfigError
from understudy_characters.table import Link, build_figure

TRUNK = Link("trunk", None, (0.0, 0.0, 0.0), "box", (0.1, 0.1, 0.2), (0.0, 0.0, 0.0), 10.0)
HEAD = Link("head", "trunk", (0.0, 0.0, 0.3), "sphere", (0.1,), (0.0, 0.0, 0.0), 4.0)


def built(*links: Link) -> int:
    """How many bodies it has."""
    spec = build_figure(
        links, name="figure", standing_height=1.0, timestep=0.001, colour=(1.0, 0.0, 0.0, 1.0)
    )
    return int(spec.compile().nbody)


@pytest.mark.parametrize(
    ("links", "said"),
    [
        ((TRUNK, HEAD, HEAD), "'figure' has two links 'head'"),
        ((HEAD, TRUNK), "'figure' has no link 'trunk' before 'head', which hangs on it"),
        ((TRUNK, replace(HEAD, parent="head")), "has no link 'head' before 'head'"),
        ((TRUNK, replace(HEAD, parent=None)), "two links without a parent: 'head' is one"),
        ((), "'figure' has no links"),
    ],
)
def test_what_is_no_figure_is_refused(links: tuple[Link, ...], said: str) -> None:
    assert built(TRUNK, HEAD) == 3
    with pytest.raises(ConfigError, match=said):
        built(*links)

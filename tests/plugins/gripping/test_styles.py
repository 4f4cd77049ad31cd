"""Gripping styles: those that there are, and what is said of others."""

from __future__ import annotations

import pytest

from understudy.errors import ConfigError
from understudy_gripping.styles import NAMED, read_style, styles, written

#: Section 5.5.2: "there are seventeen gripping styles left".
SEVENTEEN = "10012 10102 10112 10120 10122 11002 11012 11020 11022 11102 11112 11120 11122 11200 11202 11220 11222"


def test_five_fingers_have_seventeen() -> None:
    assert " ".join(map(written, styles(5))) == SEVENTEEN


def test_other_hands_have_theirs() -> None:
    assert [written(style) for style in styles(3)] == ["112"]
    assert [written(s) for s in styles(4)] == ["1012", "1102", "1112", "1120", "1122"]


def test_those_with_a_name_are_among_them() -> None:
    assert set(NAMED.values()) <= set(styles(5))
    assert read_style("standard", 5) == (1, 1, 1, 2, 0) == read_style("11120", 5)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("1112", "it has 4 entries and the hand 5 fingers"),
        ("111200", "it has 6 entries and the hand 5 fingers"),
        ("01120", "the thumb is on the upper stick"),
        ("21120", "the thumb is on the upper stick"),
        ("12112", "the index and the middle finger cross"),
        ("10201", "the middle and the little finger cross"),
        ("12220", "only the thumb touches the upper stick"),
        ("11110", "no finger touches the lower stick"),
        ("10000", "only the thumb touches the upper stick"),
        ("1112x", "is no gripping style"),
        ("", "is no gripping style"),
        ("standart", "is no gripping style"),
    ],
)
def test_what_is_none_is_refused_with_reason_and_list(text: str, reason: str) -> None:
    with pytest.raises(ConfigError) as error:
        read_style(text, 5)
    assert reason in str(error.value)
    assert SEVENTEEN in str(error.value)


def test_a_name_of_the_human_hands_is_none_of_another() -> None:
    with pytest.raises(ConfigError, match=r"5 entries and the hand 3 fingers.*has: 112\."):
        read_style("standard", 3)

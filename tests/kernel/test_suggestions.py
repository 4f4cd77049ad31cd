"""What is offered for a name that is not known."""

from understudy.errors import suggestion


def test_a_near_miss_is_named():
    assert suggestion("wlak", ["walk", "run"]) == " Did you mean 'walk'?"


def test_the_end_of_a_name_is_a_near_miss():
    assert "'spacetime/walk'" in suggestion("walk", ["spacetime/walk", "run"])


def test_a_few_are_listed_whole():
    names = [f"clip_{n:02d}" for n in range(48)]
    assert all(name in suggestion("x", names) for name in names)


def test_of_many_as_much_is_listed_as_is_read_and_how_many_there_are_beside():
    said = suggestion("x", [f"clip_{n:03d}" for n in range(126)])
    assert "clip_047, … and 78 more" in said
    assert "clip_048" not in said

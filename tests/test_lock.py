"""`constraints.txt` locks everything that is installed to develop with, down to what others bring."""

from __future__ import annotations

import tomllib
from importlib import metadata
from pathlib import Path

from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[1]


def brought(extras: tuple[str, ...]) -> dict[str, str]:
    """By name: the version of each distribution that these extras bring and that is installed."""
    found: dict[str, str] = {}
    seen: set[tuple[str, str]] = set()
    wanted = [("understudy", extra) for extra in ("", *extras)]
    while wanted:
        name, extra = wanted.pop()
        if (name, extra) in seen:
            continue
        seen.add((name, extra))
        try:
            distribution = metadata.distribution(name)
        except metadata.PackageNotFoundError:
            continue
        found[name] = distribution.version.partition("+")[0]
        for line in distribution.requires or []:
            needed = Requirement(line)
            if needed.marker is None or needed.marker.evaluate({"extra": extra}):
                own = canonicalize_name(needed.name)
                wanted += [(own, ""), *((own, more) for more in needed.extras)]
    del found["understudy"]
    return found


def locked() -> dict[str, str]:
    """By name, the version of what this Python is to have."""
    here = [line for line in lines() if line.marker is None or line.marker.evaluate()]
    return {canonicalize_name(line.name): str(line.specifier).removeprefix("==") for line in here}


def lines() -> list[Requirement]:
    text = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    return [Requirement(line) for line in text if line and not line.startswith("#")]


def test_everything_that_is_brought_is_locked() -> None:
    pinned = locked()
    assert {name for name in brought(("dev", "docs")) if name not in pinned} == set()


def test_a_lower_bound_is_not_above_the_lock() -> None:
    pinned = locked()
    for line in metadata.requires("understudy") or []:
        needed = Requirement(line)
        version = pinned.get(canonicalize_name(needed.name))
        assert version is not None, f"{needed.name} is not locked"
        assert needed.specifier.contains(version, prereleases=True), f"{line}: {version} is locked"


def test_the_oldest_python_can_have_what_is_locked() -> None:
    """That of a distribution that is kept for years, such as 3.11.2, for which a line of its own may say another version."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    oldest = settings["project"]["requires-python"].removeprefix(">=") + ".0"
    refused = set()
    for line in lines():
        if line.marker is not None and not line.marker.evaluate({"python_full_version": oldest}):
            continue
        try:
            needed = metadata.metadata(line.name)["Requires-Python"]
        except metadata.PackageNotFoundError:  # of another platform, or extra
            continue
        other = metadata.version(line.name).partition("+")[0] not in str(line.specifier)
        if not other and needed and not SpecifierSet(needed).contains(oldest):
            refused.add(f"{line.name} needs {needed}")
    assert refused == set()

"""`constraints.txt` locks everything that is installed to develop with, down to what others bring."""

from __future__ import annotations

from importlib import metadata
from pathlib import Path

from packaging.requirements import Requirement
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
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pairs = [line.split("==") for line in lines if line and not line.startswith("#")]
    return {canonicalize_name(name): version for name, version in pairs}


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

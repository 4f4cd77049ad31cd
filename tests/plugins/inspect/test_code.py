"""A run records the digest of the code that it was made with."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from understudy_inspect.code import digest_of


def test_an_edit_of_any_source_changes_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "some_package_to_edit"
    (package / "conf").mkdir(parents=True)
    for name in ("__init__.py", "conf/a.yaml", "notes.txt"):
        (package / name).write_text("")
    monkeypatch.syspath_prepend(tmp_path)
    __import__(package.name)
    seen = {digest_of(package.name)}
    (package / "notes.txt").write_text("nothing of it")
    assert {digest_of(package.name)} == seen
    for change in ("__init__.py", "conf/a.yaml"):
        (package / change).write_text("# edited")
        seen.add(digest_of(package.name))
    (package / "__init__.py").rename(package / "other.py")
    seen.add(digest_of(package.name))
    assert len(seen) == 4
    del sys.modules[package.name]
    assert digest_of(package.name) == ""

"""The documentation builds as a site, strictly: every link leads somewhere, every module is there."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def test_every_guide_can_be_come_to() -> None:
    """A page that no menu has is found by its address alone."""
    menu = (ROOT / "docs" / "site" / "pages.py").read_text(encoding="utf-8")
    for page in (ROOT / "docs").glob("*.md"):
        assert f'"{page.name}"' in menu, page.name


@pytest.mark.slow
def test_the_site_builds_strictly_and_loads_nothing_from_the_network(tmp_path: Path) -> None:
    pytest.importorskip("mkdocs", reason="the site needs the extra docs")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    index = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert 'src="http' not in index
    assert "fonts.googleapis" not in index
    assert "understudy.task.parts.Curriculum" in (tmp_path / "api" / "task.html").read_text("utf-8")
    shown = "".join(p.read_text("utf-8") for p in (tmp_path / "api").glob("plugins-*.html"))
    for package in (ROOT / "plugins").glob("*/*/understudy_*"):
        modules = [p for p in package.rglob("*.py") if p.stem != "__init__"]
        assert not modules or f'id="{package.name}.' in shown, package.name
    assert (tmp_path / "media" / "walk.mp4").is_file()


def test_the_notebook_is_python_and_names_no_result() -> None:
    notebook = json.loads((ROOT / "docs" / "notebook" / "walk.ipynb").read_text(encoding="utf-8"))
    for number, cell in enumerate(notebook["cells"]):
        if cell["cell_type"] == "code":
            compile("".join(cell["source"]), f"cell {number}", "exec")
            assert cell["outputs"] == []


@pytest.mark.slow
def test_the_notebook_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With 20 000 samples in the place of a whole training."""
    monkeypatch.chdir(tmp_path)
    notebook = json.loads((ROOT / "docs" / "notebook" / "walk.ipynb").read_text(encoding="utf-8"))
    names: dict[str, object] = {}
    for cell in notebook["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] != "code" or "IPython" in source:
            continue
        source = source.replace('"seed=0"', '"seed=0", "budget.samples=20000"')
        exec(compile(source, "cell", "exec"), names)
    assert (tmp_path / "runs" / "notebook" / "video.mp4").is_file()

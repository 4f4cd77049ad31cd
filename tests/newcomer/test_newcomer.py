"""A newcomer's path: the wheel in an empty environment, the demo (short), its page, an export.

The environment has the libraries of this one by their path, so nothing is fetched; understudy itself comes
from the wheel.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import zipfile
from pathlib import Path

import pytest

pytest.importorskip("hatchling", reason="building the wheel needs hatchling (dev extra)")
pytest.importorskip("build", reason="building the wheel needs build (dev extra)")

ROOT = Path(__file__).resolve().parents[2]


def run(command: list[str], cwd: Path, timeout: float = 280) -> str:
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    done = subprocess.run(
        command, cwd=cwd, env=environment, capture_output=True, text=True, timeout=timeout
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return done.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the wheel and the source distribution."""
    folder = tmp_path_factory.mktemp("dist")
    run([sys.executable, "-m", "build", "-n", "-o", str(folder), str(ROOT)], folder)
    return folder


@pytest.fixture(scope="module")
def understudy(built: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The command, in an environment with the wheel."""
    folder = tmp_path_factory.mktemp("newcomer")
    run([sys.executable, "-m", "venv", "--without-pip", "env"], folder)
    python = folder / "env" / "bin" / "python"
    (wheel,) = built.glob("*.whl")
    pip = [sys.executable, "-m", "pip", "--python", str(python), "install", "--quiet", "--no-index"]
    run([*pip, "--no-deps", str(wheel)], folder)
    base = {"base": str(folder / "env"), "platbase": str(folder / "env")}
    own = Path(sysconfig.get_path("purelib", "venv", base))
    libraries = [p for p in sys.path if Path(p).name in ("site-packages", "dist-packages")]
    (own / "zz_libraries.pth").write_text("\n".join(libraries))
    return folder / "env" / "bin" / "understudy"


@pytest.fixture(scope="module")
def demo(understudy: Path) -> Path:
    """The run folder of the demo, cut short."""
    cwd = understudy.parents[2]
    out = run(
        [
            str(understudy), "train", "experiment=spacetime/walk_imagined", "num_worlds=16",
            "learner.rollout_steps=16", "learner.model.first_samples=256", "learner.model.first_updates=9",
            "learner.updates=2", "policy.feedback.hidden=[32]", "budget.samples=512",
            "evaluation.episodes=4", "evaluation.final_episodes=4", "evaluation.seconds=1",
            "run.video_seconds=0.2",
        ],
        cwd,
    )  # fmt: skip
    last = out.splitlines()[-1]
    assert last.startswith("run: ")
    return cwd / last.removeprefix("run: ")


def test_the_wheel_is_what_answers(understudy: Path) -> None:
    assert run([str(understudy), "--version"], understudy.parents[2]).startswith("understudy ")
    where = (
        "import understudy, understudy_play; print(understudy.__file__, understudy_play.__file__)"
    )
    python = str(understudy.with_name("python"))
    for file in run([python, "-c", where], understudy.parents[2]).split():
        assert file.startswith(str(understudy.parents[1]))


def test_the_wheel_has_what_is_not_python(built: Path) -> None:
    (wheel,) = built.glob("*.whl")
    names = set(zipfile.ZipFile(wheel).namelist())
    assert {
        "understudy/conf/config.yaml",
        "understudy_report/page.css",
        "understudy_spacetime/skills/walk.safetensors",
        "understudy_spacetime/conf/experiment/spacetime/walk.yaml",
    } <= names


def test_the_source_distribution_can_be_worked_with(built: Path) -> None:
    (archive,) = built.glob("*.tar.gz")
    with tarfile.open(archive) as opened:
        names = {name.partition("/")[2] for name in opened.getnames()}
    assert {
        "Makefile", "constraints.txt", "Dockerfile", "mkdocs.yml", "pyproject.toml", "hatch_build.py", "LICENSE",
        "benchmarks/cpu.py", "docs/media/walk.mp4", "tests/conftest.py", "conf/config.yaml",
    } <= names  # fmt: skip


def test_a_skill_can_be_watched_before_anything_is_trained(understudy: Path) -> None:
    assert "spacetime/walk: " in run([str(understudy), "play"], understudy.parents[2])


def test_the_demo_leaves_a_page_that_says_what_a_success_is(demo: Path) -> None:
    page = (demo / "report.html").read_text(encoding="utf-8")
    assert "succeeds if the least within_all_bounds of the episode (1 in all bounds" in page
    evaluation = json.loads((demo / "evaluation.json").read_text())
    assert evaluation["success"] == "within_all_bounds at least 1"


def test_what_was_learned_is_read_by_another_program(understudy: Path, demo: Path) -> None:
    gltf = pytest.importorskip("pygltflib", reason="the independent reader (dev extra)")
    out = demo / "walk.glb"
    run([str(understudy), "export", str(demo), str(out)], demo)
    scene = gltf.GLTF2().load(str(out))
    assert scene.animations
    named = {node.name for node in scene.nodes}
    assert {"root", "left_knee", "right_elbow"} <= named


@pytest.mark.slow
def test_stable_baselines3_learns_the_walk(understudy: Path) -> None:
    """The page's 20 480 samples, from the wheel; some minutes on two idle cores."""
    pytest.importorskip("stable_baselines3", reason="it is not installed (extra learners)")
    text = (ROOT / "docs" / "other-learners.md").read_text(encoding="utf-8")
    snippets = re.findall(r"^```python\n(.*?)^```", text, re.M | re.S)
    (code,) = (s for s in snippets if "understudy_gym.stable_baselines3" in s)
    said = run([str(understudy.with_name("python")), "-c", code], understudy.parents[2], 1800)
    before, after = re.findall(r"before (\S+), after (\S+) steps", said)[0]
    assert float(after) > 1.3 * float(before)


@pytest.mark.slow
@pytest.mark.parametrize("width", [1280, 390])
def test_the_page_fits_the_screen(demo: Path, width: int, tmp_path: Path) -> None:
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("there is no Chromium")
    playwright = pytest.importorskip("playwright.sync_api", reason="drives Chromium (dev extra)")
    with playwright.sync_playwright() as p:
        browser = p.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": width, "height": 900})
        problems: list[str] = []
        page.on("pageerror", lambda error: problems.append(str(error)))
        page.goto(f"file://{demo / 'report.html'}")
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        assert page.locator("video, figure.player").count() == 1
        page.screenshot(path=tmp_path / f"{width}.png", full_page=True)
        browser.close()
    assert not problems


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_demo_keeps_its_promise(understudy: Path, seed: int) -> None:
    """Some two minutes each on two idle cores."""
    cwd = understudy.parents[2]
    command = [str(understudy), "train", "experiment=spacetime/walk_imagined", f"seed={seed}"]
    run([*command, f"run.dir=seed{seed}"], cwd, timeout=3000)
    evaluation = json.loads((cwd / f"seed{seed}" / "evaluation.json").read_text())
    assert evaluation["success_rate"] >= 0.9
    assert evaluation["violated"]["fall"] <= 0.1
    assert evaluation["violated"]["com"] <= 0.1

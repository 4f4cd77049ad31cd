"""What ``understudy new`` writes passes at once, as a stranger would try it."""

from __future__ import annotations

import argparse
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

import pytest
from commands import forked

from understudy.command.cli import main
from understudy.setup.plugins import installed
from understudy_scaffold import new
from understudy_scaffold.new import next_steps

pytest.importorskip("hatchling", reason="building the distribution needs hatchling (dev extra)")


#: pytest, where the package is found first.
PYTEST = """
import sys
site, folder = sys.argv[1:]
sys.path.insert(0, site)
import pytest
sys.exit(pytest.main(["-q", "-p", "no:cacheprovider", folder]))
"""


def install(folder: Path, site: Path) -> None:
    """Build the package in `folder` and install it in `site`."""
    command = [
        sys.executable, "-m", "pip", "install", "--quiet", "--no-index", "--no-deps",
        "--no-build-isolation", "--target", str(site), str(folder),
    ]  # fmt: skip
    subprocess.run(command, check=True, timeout=200)


#: Builds the wheel of the package in this folder by the backend that it names, which is all that pip calls of it.
BUILD = "import sys, hatchling.build; print(hatchling.build.build_wheel(sys.argv[1]))"


def unpack(folder: Path, site: Path) -> None:
    """As :func:`install`, without pip, which takes five times as long: a wheel is unpacked where it is installed."""
    with tempfile.TemporaryDirectory() as place:
        command = [sys.executable, "-c", BUILD, place]
        built = subprocess.run(command, cwd=folder, check=True, timeout=200, capture_output=True)
        with zipfile.ZipFile(Path(place) / built.stdout.decode().split()[-1]) as wheel:
            wheel.extractall(site)


def test_a_new_plugin_passes_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Installed by pip, and in an interpreter of its own; the others are unpacked, and forks of one that has imported all."""
    monkeypatch.chdir(tmp_path)
    assert main(["new", "plugin", "my_juggling"]) == 0
    said = capsys.readouterr().out
    assert "-e understudy-my-juggling && " in said
    assert "my_juggling/high" in said
    written, site = tmp_path / "understudy-my-juggling", tmp_path / "site"
    install(written, site)
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(written)],
        env=os.environ | {"PYTHONPATH": str(site)}, cwd=written, capture_output=True, text=True,
        timeout=250, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout
    assert "8 passed" in done.stdout


def test_what_comes_next_is_of_this_environment(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Where it is not on the path, its programs are named with their folder: another pip would install elsewhere."""
    here, folder = Path(sys.executable).parent, Path("a folder")
    monkeypatch.setenv("PATH", str(here))
    assert " pip install " in next_steps(folder, "tall")
    assert "pytest 'a folder'" in next_steps(folder, "tall")
    monkeypatch.setenv("PATH", str(tmp_path))
    steps = next_steps(folder, "tall")
    for program in ("pip", "pytest", "understudy"):
        assert f" {here}/{program} " in steps
        assert f" {program} " not in steps


def test_what_cannot_be_built_here_is_fetched(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "--no-build-isolation --no-deps -e tall" in next_steps(Path("tall"), "tall")
    monkeypatch.setattr(new, "find_spec", lambda name: None)
    steps = next_steps(Path("tall"), "tall")
    assert "pip install -e tall && " in steps
    assert "pip install pytest && " in steps


def test_a_new_paper_passes_at_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What is printed has its experiment and its table, too, which its tests compose."""
    assert main(["new", "paper", "thrown", "--folder", str(tmp_path / "a" / "b")]) == 0
    written = tmp_path / "a" / "b"
    said = capsys.readouterr().out
    assert re.search(r"^Train the experiment: .*understudy train experiment=thrown/first ", said, re.M)  # fmt: skip
    assert re.search(r"^Train all of its table: .*understudy reproduce thrown/table$", said, re.M)
    (printed,) = re.findall(r"(pip install .*-e )", said)
    assert f"\n{printed}.\n" in (written / "README.md").read_text()
    unpack(written, tmp_path / "site")
    done = forked(PYTEST, str(tmp_path / "site"), str(written), cwd=written)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "10 passed" in done.stdout
    assert (written / "docs" / "thrown.md").is_file()
    texts = [
        f.read_text() for f in written.rglob("*") if f.suffix in (".py", ".md", ".yaml", ".toml")
    ]
    assert not [text for text in texts if "$name" in text or "NAME" in text or ">>>" in text]
    commands = re.findall(r"understudy (train|reproduce|new|describe) ([^`\n]+)", "\n".join(texts))
    assert ("reproduce", "thrown/table") in commands
    for name, words in commands:  # those of the pages as well as those that are printed
        parser = argparse.ArgumentParser()
        installed().registry.find("command", name).factory().arguments(parser)
        _, left = parser.parse_known_args(shlex.split(words))
        assert [word for word in left if "=" not in word] == [], words


@pytest.mark.parametrize(
    ("only", "there", "away", "passed"),
    [("reward", "terms.py", "encoder", 7), ("observation", "encoders.py", "reward", 3)],
)
def test_one_of_both_alone(
    only: str,
    there: str,
    away: str,
    passed: int,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Nothing in what is written or printed speaks of the other, and its tests pass."""
    written = tmp_path / "tall"
    assert main(["new", "plugin", "tall", "--only", only, "--folder", str(written)]) == 0
    said = capsys.readouterr().out
    sources = written / "src" / "understudy_tall"
    assert {f.name for f in sources.iterdir()} == {"__init__.py", there}
    texts = [f.read_text() for f in (*sources.iterdir(), *written.glob("tests/*.py"))]
    assert not [text for text in [said, *texts] if away in text or ">>>" in text]
    (printed,) = re.findall(r"(pip install .*-e )", said)
    assert f"\n{printed}.\n" in (written / "README.md").read_text()
    unpack(written, tmp_path / "site")
    done = forked(PYTEST, str(tmp_path / "site"), str(written), cwd=written)
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"{passed} passed" in done.stdout


@pytest.fixture(scope="module")
def observation(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which ``tall`` was written and in whose ``site`` it was installed."""
    folder = tmp_path_factory.mktemp("observation")
    words = ["new", "plugin", "tall", "--only", "observation", "--folder", str(folder / "tall")]
    assert main(words) == 0
    unpack(folder / "tall", folder / "site")
    return folder


@pytest.mark.parametrize("wrong", ["com_position[:, :1]", "com_position[:1, 2:].expand(4, 1)"])
def test_the_test_of_the_observation_can_fail(
    wrong: str, observation: Path, tmp_path: Path
) -> None:
    """One that gives another coordinate, or all worlds the same."""
    compiled = shutil.ignore_patterns("__pycache__")  # of a text as old and as long
    shutil.copytree(observation, tmp_path, dirs_exist_ok=True, ignore=compiled)
    written, encoders = tmp_path / "tall", tmp_path / "site" / "understudy_tall" / "encoders.py"
    text = encoders.read_text()
    assert "com_position[:, 2:]" in text
    encoders.write_text(text.replace("com_position[:, 2:]", wrong))
    done = forked(PYTEST, str(tmp_path / "site"), str(written), cwd=written)
    assert done.returncode == 1
    assert "test_what_is_observed" in done.stdout


def test_only_what_there_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    where = ["--folder", str(tmp_path / "tall")]
    assert main(["new", "plugin", "tall", "--only", "memory", *where]) == 2
    assert "choose from" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "name", ["Juggling", "../up", "with-dash", "1st", "class", "", "spacetime"]
)
def test_names_that_cannot_be_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["new", "plugin", name]) == 2
    assert f"'{name}'" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_what_is_there_stays(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "mine").mkdir()
    assert main(["new", "paper", "thrown", "--folder", str(tmp_path / "mine")]) == 2
    assert "is there already" in capsys.readouterr().err
    assert list((tmp_path / "mine").iterdir()) == []

"""What a stranger has who installs the package: ``make wheel``.

Builds a wheel, installs it into a fresh environment by what pip finds, and in an empty folder trains, evaluates,
lists, compares, cites, asks for licences, exports, plays on loopback and carries out the notebook. Ends with
status 1 at the first that fails. It takes some minutes, most of them to fetch PyTorch; ``--python`` names another
interpreter, ``--requirement`` something to be installed before (``torch==2.13.0``), and ``--pypi-alone`` reads
none of pip's settings: no mirror, no folder of wheels, PyPI's index alone.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
#: A run of seconds.
TINY = ("experiment=spacetime/walk", "num_worlds=16", "budget.samples=2000", "run.dir=run",
        "evaluation.episodes=8", "evaluation.final_episodes=8", "evaluation.seconds=2")  # fmt: skip
#: s: for a page to answer.
PATIENCE = 120.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--python", default=sys.executable, help="the interpreter to install for")
    parser.add_argument("--requirement", action="append", default=[], help="installed before")
    parser.add_argument("--without-notebook", action="store_true", help="leave Jupyter out")
    parser.add_argument("--pypi-alone", action="store_true", help="read none of pip's settings")
    options = parser.parse_args()
    if options.pypi_alone:
        kept = {"PIP_CERT", "PIP_DEFAULT_TIMEOUT"}
        for name in [n for n in os.environ if n.startswith("PIP_") and n not in kept]:
            del os.environ[name]
        os.environ["PIP_CONFIG_FILE"] = os.devnull
    with tempfile.TemporaryDirectory(prefix="wheel-") as folder:
        place = Path(folder)
        build = [sys.executable, "-m", "build", "--wheel", "--outdir", str(place), str(ROOT)]
        run("a wheel", build, place)
        (wheel,) = place.glob("*.whl")
        run("an environment", [options.python, "-m", "venv", str(place / "env")], place)
        extras = "view" if options.without_notebook else "view,notebook"
        pip = [str(place / "env/bin/pip"), "install", "--quiet"]
        if options.requirement:
            run("what is asked for", [*pip, *options.requirement], place)
        run("the wheel and what it needs", [*pip, f"{wheel}[{extras}]"], place)
        work = place / "work"
        work.mkdir()
        try_out(place / "env/bin", work, notebook=not options.without_notebook)


def try_out(programs: Path, work: Path, *, notebook: bool) -> None:
    """Use what is installed, in the empty folder `work`."""
    understudy = str(programs / "understudy")
    run("version", [understudy, "--version"], work)
    run("train", [understudy, "train", *TINY], work)
    run("evaluate", [understudy, "evaluate", "run", "episodes=8", "seconds=2"], work)
    run("runs", [understudy, "runs", "."], work, says="run")
    run("compare", [understudy, "compare", "run", "spacetime/walk"], work)
    a_page(work / "comparison.html")
    run("cite", [understudy, "cite", "run"], work, says="@software{understudy")
    licence = [understudy, "licence", "run", "--for", "commercial"]
    run("licence", licence, work, says="Nothing stands in the way")
    run("export", [understudy, "export", "run", "page.html"], work)
    a_page(work / "page.html")
    play([understudy, "play", "spacetime/walk", "--no-browser", "--port", "8765"], work)
    if notebook:
        shutil.copy(ROOT / "docs/notebook/walk.ipynb", work)
        run("notebook", [str(programs / "jupyter"), "execute", "walk.ipynb"], work)


def a_page(file: Path) -> None:
    """See that `file` is a page which asks nothing of a network."""
    text = file.read_text(encoding="utf-8")
    asked = re.findall(r"""(?:src|href)=["']?(https?:[^"' >]+)""", text)
    asked = [a for a in asked if f'<a href="{a}' not in text]
    if "<html" not in text.lower() or asked:
        sys.exit(f"{file.name} is no page for itself: {asked}")


def run(what: str, command: list[str], folder: Path, says: str = "") -> None:
    """Carry out `command`; say how long it took, or what it said where it fails or does not say `says`."""
    began = time.monotonic()
    # Nothing of the tree, nor of another environment, is to be found.
    own = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "UNDERSTUDY"))}
    own["PATH"] = f"{Path(command[0]).parent}:{own['PATH']}"
    done = subprocess.run(command, cwd=folder, env=own, capture_output=True, text=True, check=False)
    if done.returncode:
        print(done.stdout[-4000:], done.stderr[-4000:], sep="\n")
        sys.exit(f"{what}: status {done.returncode}")
    if says not in done.stdout:
        sys.exit(f"{what}: {says!r} is not in {done.stdout[-4000:]}")
    print(f"{what}: {time.monotonic() - began:.0f} s", flush=True)


def play(command: list[str], folder: Path) -> None:
    """Start a page; see that it answers at the address that it prints, and end it."""
    began = time.monotonic()
    log = folder / "play.log"
    with log.open("w") as said:
        page = subprocess.Popen(command, cwd=folder, stdout=said, stderr=subprocess.STDOUT)
    try:
        address = None
        while address is None and page.poll() is None and time.monotonic() - began < PATIENCE:
            time.sleep(0.5)
            address = re.search(r"http://[\w.:\[\]]+", log.read_text())
        if address is None:
            sys.exit(f"play: no page\n{log.read_text()[-4000:]}")
        with urllib.request.urlopen(address[0], timeout=30) as answer:
            if answer.status != 200 or b"<html" not in answer.read().lower():
                sys.exit(f"play: {address[0]} is no page")
    finally:
        page.send_signal(signal.SIGINT)
        page.wait(30)
    print(f"play: {time.monotonic() - began:.0f} s", flush=True)


if __name__ == "__main__":
    main()

"""Where `make demo` fetches torch from, with an index that answers, one that does not, and one that hangs.

pip and venv are recorded in place of run, so nothing is fetched.
"""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

pytestmark = pytest.mark.skipif(shutil.which("make") is None, reason="needs make")


class _Index(BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        self.send_response(200)
        self.end_headers()

    def log_message(self, format: str, *args: object) -> None:
        pass


@pytest.fixture
def index() -> Iterator[str]:
    """An index on loopback that answers."""
    server = HTTPServer(("127.0.0.1", 0), _Index)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()


def install(folder: Path, index: str, *settings: str) -> tuple[list[str], str]:
    """The arguments of pip's call that installs torch, and what was printed; pip is a stub."""
    stub = folder / "python"
    stub.write_text(
        f"""#!/bin/sh
if [ "$1" = -m ]; then
  mkdir -p "$3/bin"
  printf '#!/bin/sh\\nexec {sys.executable} "$@"\\n' > "$3/bin/python"
  printf '#!/bin/sh\\necho "$@" >> {folder}/pip.log\\n' > "$3/bin/pip"
  chmod +x "$3/bin/python" "$3/bin/pip"
fi
"""
    )
    stub.chmod(0o755)
    command = ["make", f"{folder}/venv/.small", f"VENV={folder}/venv", f"PYTHON={stub}"]
    environment = {k: v for k, v in os.environ.items() if k not in ("TORCH", "MAKEFLAGS")}
    environment |= {"no_proxy": "127.0.0.1"}
    done = subprocess.run(
        [*command, f"CPU_INDEX={index}", *settings],
        cwd=ROOT, env=environment, capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    calls = (folder / "pip.log").read_text().splitlines()
    (torch,) = [call for call in calls if " torch" in call]
    return torch.split()[torch.split().index("torch") + 1 :], done.stdout


def test_the_build_for_cpus_where_its_index_answers(tmp_path: Path, index: str) -> None:
    arguments, said = install(tmp_path, index)
    assert arguments == ["--index-url", index]
    assert f"Fetching PyTorch's build for CPUs, about 0.2 GB, from {index}." in said


def test_what_pip_finds_where_nothing_answers(tmp_path: Path) -> None:
    with socket.socket() as closed:
        closed.bind(("127.0.0.1", 0))
        address = f"http://127.0.0.1:{closed.getsockname()[1]}"
    arguments, said = install(tmp_path, address)
    assert arguments == []
    assert "about 3 GB" in said
    assert f"{address} does not answer" in said


def test_an_index_that_accepts_and_says_nothing_is_left_within_seconds(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = f"http://127.0.0.1:{silent.getsockname()[1]}"
        began = time.monotonic()
        arguments, _ = install(tmp_path, address)
    assert arguments == []
    assert time.monotonic() - began < 15


@pytest.mark.parametrize("given", ["", "--index-url https://mirror.example/simple"])
def test_what_the_user_says_of_torch_is_taken(tmp_path: Path, index: str, given: str) -> None:
    arguments, _ = install(tmp_path, index, f"TORCH={given}")
    assert arguments == given.split()

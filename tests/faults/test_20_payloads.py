"""Fault 20: files from strangers are data; what would execute is refused unexecuted."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import pickle
import re
from pathlib import Path
from typing import Any

import pytest
import torch

from understudy.errors import UnderstudyError
from understudy.records import checkpoint, runs
from understudy_inspect.replay import replay_step

ROOT = Path(__file__).parents[2]
NOW = checkpoint.FORMAT


class Payload:
    """Unpickling this makes a folder named ``executed``."""

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, ("executed",)


def payloads() -> dict[str, bytes]:
    torch.save({"w": Payload()}, "payload.pt")
    return {"pickle": pickle.dumps(Payload()), "torch": Path("payload.pt").read_bytes()}


@pytest.fixture
def path(tmp_path: Path) -> Path:
    checkpoint.save(tmp_path / "00000001", {"w": torch.ones(3)}, {})
    return tmp_path / "00000001"


def test_the_payload_works() -> None:
    pickle.loads(payloads()["pickle"])
    assert Path("executed").exists()


@pytest.mark.parametrize("kind", ["pickle", "torch"])
@pytest.mark.parametrize("ending", [".json", ".safetensors"])
@pytest.mark.parametrize("sealed", [False, True])
def test_pickle_in_a_checkpoint(path: Path, kind: str, ending: str, sealed: bool) -> None:
    data = payloads()[kind]
    path.with_suffix(ending).write_bytes(data)
    if sealed:  # an attacker computes the digests, too
        document = {
            "format": NOW,
            "state": {"map": {}},
            "meta": {},
            "sha256": hashlib.sha256(data).hexdigest(),
        }
        if ending == ".safetensors":
            path.with_suffix(".json").write_bytes(checkpoint._sealed(document))
    for read in (checkpoint.load, replay_step):
        with pytest.raises(UnderstudyError, match="damaged"):
            read(path)
    assert not Path("executed").exists()


@pytest.mark.parametrize(
    "document",
    [
        [], 3, None, "text", {}, {"format": NOW},
        {"format": NOW, "state": [], "meta": {}},
        {"format": NOW, "state": {"tensor": "nowhere"}, "meta": {}},
        {"format": NOW, "state": {"tensor": ["w"]}, "meta": {}},
        {"format": NOW, "state": {"map": 3}, "meta": {}},
        {"format": NOW, "state": {"map": {"a": None}}, "meta": {}},
        {"format": NOW, "state": {"map": {"a": {}}}, "meta": {}},
        {"format": NOW, "state": {"float": "__import__('os')"}, "meta": {}},
        {"format": NOW, "state": {"float": {}}, "meta": {}},
        {"format": NOW, "state": {"list": 3.5}, "meta": {}},
        {"format": NOW, "state": {"map": {}}, "meta": 3},
        {"format": -3, "state": {"map": {}}, "meta": {}},
        {"format": "1", "state": {"map": {}}, "meta": {}},
        {"format": None, "state": {"map": {}}, "meta": {}},
        {"format": 10**30, "state": {"map": {}}, "meta": {}},
    ],
    ids=str,
)  # fmt: skip
def test_odd_content_with_a_right_seal(path: Path, document: Any) -> None:
    if isinstance(document, dict):
        digest = hashlib.sha256(path.with_suffix(".safetensors").read_bytes()).hexdigest()
        document = {"sha256": digest, **document}
    path.with_suffix(".json").write_bytes(checkpoint._sealed(document))
    with pytest.raises(UnderstudyError):
        checkpoint.load(path)


def test_nested_without_end(path: Path) -> None:
    deep: Any = {"value": 1}
    body = '{"list": [' * 200_000 + "]}" * 200_000
    for text in (
        body,
        json.dumps({"content": body, "digest": hashlib.sha256(body.encode()).hexdigest()}),
    ):
        path.with_suffix(".json").write_text(text)
        with pytest.raises(UnderstudyError):
            checkpoint.load(path)
    for _ in range(150):
        deep = {"list": [deep]}
    digest = hashlib.sha256(path.with_suffix(".safetensors").read_bytes()).hexdigest()
    document = {"format": NOW, "state": deep, "meta": {}, "sha256": digest}
    path.with_suffix(".json").write_bytes(checkpoint._sealed(document))
    checkpoint.load(path)


@pytest.mark.parametrize(
    "text",
    ["", "[]", "3", "null", "{}", '{"layout": 2}', '{"layout": 2, "config": []}', "\0\0", "[" * 100_000,
     '{"layout": "2", "config": {}}', '{"layout": 2, "config": {}}'],
    ids=lambda t: t[:40],
)  # fmt: skip
def test_odd_run_files(tmp_path: Path, text: str) -> None:
    (tmp_path / "run.json").write_text(text)
    with pytest.raises(UnderstudyError):
        runs.open_run(tmp_path)


def test_run_file_nested_to_the_limit(tmp_path: Path) -> None:
    for depth in range(900, 1000, 3):  # wherever the interpreter's limit strikes
        config = '{"a":' * depth + "1" + "}" * depth
        (tmp_path / "run.json").write_text(
            f'{{"layout":2,"overrides":[],"sources":{{}},"config":{config}}}'
        )
        with contextlib.suppress(UnderstudyError):
            runs.open_run(tmp_path)


def test_state_that_is_no_data_is_not_written(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match=r"state 'a/b' is a Payload, which is not data"):
        checkpoint.save(tmp_path / "x", {"a": {"b": Payload()}}, {})
    assert not list(tmp_path.glob("x*"))


def test_no_source_reads_code_as_data() -> None:
    """The calls by which files are executed occur nowhere in the product."""
    forbidden = re.compile(
        r"allow_pickle\s*=\s*True|yaml\.(unsafe_|full_)?load\(|weights_only\s*=\s*False|\bpickle\.loads?\b"
        r"|\btorch\.load\(|\bimport pickle\b|\bjoblib\b|\bdill\b|\bmarshal\b|(?<![\w.])(eval|exec)\(|hydra\.utils"
    )
    found = [
        f"{file.relative_to(ROOT)}:{number}: {line.strip()}"
        for folder in ("kernel", "plugins")
        for file in (ROOT / folder).rglob("*.py")
        for number, line in enumerate(file.read_text(encoding="utf-8").splitlines(), 1)
        if forbidden.search(line)
    ]
    assert not found

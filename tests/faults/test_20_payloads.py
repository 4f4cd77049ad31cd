"""Fault 20: files from strangers are data; what would execute is refused unexecuted."""

from __future__ import annotations

import ast
import builtins
import contextlib
import hashlib
import itertools
import json
import os
import pickle
from pathlib import Path
from typing import Any

import pytest
import torch

from understudy.errors import PluginError, UnderstudyError
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
        {"format": NOW, "state": {"deflated": "w"}, "meta": {}},
        {"format": NOW, "state": {"deflated": ["w", "torch.float32", [0]]}, "meta": {}},
        {"format": NOW, "state": {"deflated": ["w", "torch.float32", [2**18]]}, "meta": {}},
        {"format": NOW, "state": {"deflated": ["w", "torch.float32", [2**40]]}, "meta": {}},
        {"format": NOW, "state": {"deflated": ["w", "os.system", [2**18]]}, "meta": {}},
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


@pytest.mark.parametrize("shape", [[2**18 + 1], [-1, -(2**18)], [-(2**18)], ["a"], [0.5, 2**20], 5])
def test_deflated_tensors_of_another_size(path: Path, shape: Any) -> None:
    checkpoint.save(path, {"w": torch.zeros(2**18)}, {})
    document = checkpoint.read_sealed(path.with_suffix(".json"))
    assert document["state"]["map"]["w"] == {"deflated": ["w", "torch.float32", [2**18]]}
    document["state"]["map"]["w"]["deflated"][2] = shape
    path.with_suffix(".json").write_bytes(checkpoint._sealed(document))
    with pytest.raises(UnderstudyError, match="damaged"):
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
    with pytest.raises(PluginError, match=r"state 'a/b' is a Payload, which is not data"):
        checkpoint.save(tmp_path / "x", {"a": {"b": Payload()}}, {})
    assert not list(tmp_path.glob("x*"))


#: Whatever executes what it reads; of a module all of it.
FORBIDDEN = {
    "pickle", "cPickle", "_pickle", "dill", "cloudpickle", "joblib", "marshal", "shelve", "runpy", "code",
    "codeop", "hydra.utils", "torch.load", "torch.jit.load", "torch.package", "torch.export.load",
    "torch.hub.load", "yaml.load", "yaml.load_all", "yaml.full_load", "yaml.full_load_all",
    "yaml.unsafe_load", "yaml.unsafe_load_all", "eval", "exec", "__import__", "builtins.eval",
    "builtins.exec", "builtins.__import__", "pandas.read_pickle", "numpy.load", "numpy.lib.npyio",
}  # fmt: skip


def executes(source: str) -> list[int]:
    """The lines of `source` in which a file's content could be executed, under whatever name."""
    names: dict[str, str] = {}
    found: set[int] = set()

    def path_of(node: ast.AST) -> str:
        if isinstance(node, ast.Name):
            return names.get(node.id, node.id if hasattr(builtins, node.id) else "")
        if isinstance(node, ast.Attribute) and (before := path_of(node.value)):
            return f"{before}.{node.attr}"
        return ""

    def bad(path: str) -> bool:
        above = itertools.accumulate(path.split("."), "{}.{}".format)
        return any(name in FORBIDDEN for name in above)

    def without_pickle(call: ast.Call) -> bool:
        """``np.load(file, allow_pickle=False)``, which is also what it does unasked."""
        said = [k.value for k in call.keywords if k.arg == "allow_pickle"] + call.args[2:3]
        return not any(k.arg is None for k in call.keywords) and all(
            isinstance(value, ast.Constant) and value.value is False for value in said
        )

    nodes = list(ast.walk(ast.parse(source)))
    for node in nodes:
        if isinstance(node, ast.Import):
            for alias in node.names:
                names[alias.asname or alias.name.partition(".")[0]] = (
                    alias.name if alias.asname else alias.name.partition(".")[0]
                )
                found |= {node.lineno} if bad(alias.name) else set()
        elif isinstance(node, ast.ImportFrom):
            for alias in node.names:
                names[alias.asname or alias.name] = path = f"{node.module}.{alias.name}"
                # NumPy's reader itself may be imported; how it is called is seen below
                found |= {node.lineno} if bad(path) and path != "numpy.load" else set()
    plain = {
        id(node.func)
        for node in nodes
        if isinstance(node, ast.Call)
        and path_of(node.func) == "numpy.load"
        and without_pickle(node)
    }
    for node in nodes:
        if isinstance(node, (ast.Name, ast.Attribute)) and bad(path_of(node)):
            found |= set() if id(node) in plain else {node.lineno}
        elif (
            isinstance(node, ast.keyword)
            and isinstance(node.value, ast.Constant)
            and (node.arg, node.value.value) in (("allow_pickle", True), ("weights_only", False))
        ):
            found.add(node.value.lineno)
    return sorted(found)


@pytest.mark.parametrize(
    "source",
    [
        "import pickle", "import pickle as p", "from pickle import loads", "from pickle import loads as f",
        "import numpy as np\nnp.load(f, None, True)", "import numpy\nnumpy.load(f, allow_pickle=True)",
        "from numpy import load\nload(f, None, True)", "import numpy as np\nread = np.load",
        "import numpy as np\nnp.load(f, **options)", "import numpy as np\nnp.load(f, allow_pickle=yes)",
        "import torch\ntorch.load(f)", "from torch import load", "import torch as t\nt.jit.load(f)",
        "from torch.jit import load", "from torch import jit\njit.load(f)", "import torch.package",
        "from torch.package import PackageImporter", "from torch import package", "__import__('os')",
        "eval(text)", "run = exec", "import yaml\nyaml.load(f)", "from yaml import unsafe_load",
        "from hydra.utils import instantiate", "import hydra\nhydra.utils.instantiate(c)",
        "reader(f, weights_only=False)", "import builtins\nbuiltins.eval(x)",
    ],
)  # fmt: skip
def test_the_lint_sees(source: str) -> None:
    assert executes(source)


@pytest.mark.parametrize(
    "source",
    [
        "import numpy as np\nnp.load(f)", "import numpy as np\nnp.load(f, allow_pickle=False)",
        "import torch\nmodel.eval()", "import yaml\nyaml.safe_load(f)", "from torch.jit import script",
        "from safetensors.torch import load",
    ],
)  # fmt: skip
def test_the_lint_lets_pass(source: str) -> None:
    assert not executes(source)


def test_no_source_reads_code_as_data() -> None:
    """What executes what it reads occurs nowhere in the product."""
    files = [file for folder in ("kernel", "plugins") for file in (ROOT / folder).rglob("*.py")]
    assert len(files) > 200
    found = {
        str(file.relative_to(ROOT)): lines
        for file in files
        if (lines := executes(file.read_text(encoding="utf-8")))
    }
    assert not found

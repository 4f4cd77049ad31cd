"""Warp's C++ headers, compiled once a machine.

To compile a kernel for a processor, Warp first compiles its headers: 1.5 s, for a module of a tenth of that, anew in
each thread of each process, and removes them at its end. Here they are kept beside the kernels.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
import tempfile
import threading
from functools import cache, wraps
from pathlib import Path
from typing import Any

import warp as wp

__all__ = ["keep_headers"]

_FOLDER = "understudy_headers"


@cache
def keep_headers() -> None:
    """From now on this process takes compiled headers from Warp's kernel cache, and leaves those that it compiles.

    Each thread still has a folder of its own: what is shared are copies, each put there whole. A Warp that keeps
    no headers, or elsewhere, is left as it is.
    """
    build: Any = getattr(getattr(wp, "_src", None), "build", None)
    if not hasattr(build, "build_cpu"):
        return
    compile_one = build.build_cpu
    tried: set[Path] = set()

    @wraps(compile_one)
    def compile_with_kept(*arguments: Any, **named: Any) -> Any:
        if not named.get("use_precompiled_headers") or not named.get("pch_dir"):
            return compile_one(*arguments, **named)
        own, kept = Path(named["pch_dir"]), _kept()
        with _lock(os.getpid()):  # where there are none, one thread makes what the others wait for
            _copy_new(kept, own)
            if not any(own.glob("*.pch")) and kept not in tried:
                tried.add(kept)
                result = compile_one(*arguments, **named)
                _copy_new(own, kept)
                return result
        result = compile_one(*arguments, **named)
        _copy_new(own, kept)  # other options have other headers
        return result

    build.build_cpu = compile_with_kept


@cache
def _lock(process: int) -> threading.Lock:
    """Of this `process`: a fork's is not held by a thread that it does not have."""
    return threading.Lock()


def _kept() -> Path:
    """Where the headers of this installation of Warp are: they name its files, and when these were written."""
    headers = Path(wp.__file__).parent / "native"
    written = max((path.stat().st_mtime_ns for path in headers.glob("*.h")), default=0)
    of = f"{wp.config.version} {headers} {written}"
    folder = wp.config.kernel_cache_dir or tempfile.gettempdir()
    return Path(folder) / _FOLDER / hashlib.sha256(of.encode()).hexdigest()[:16]


def _copy_new(source: Path, target: Path) -> None:
    """Copy what `target` lacks, each file whole or not at all. What cannot be copied is only slower."""
    with contextlib.suppress(OSError):
        target.mkdir(parents=True, exist_ok=True)
        for path in source.glob("*.pch"):
            if (target / path.name).exists():
                continue
            handle, partial = tempfile.mkstemp(dir=target, suffix=".partial")
            os.close(handle)
            try:
                shutil.copyfile(path, partial)
                os.replace(partial, target / path.name)
            except BaseException:
                os.unlink(partial)
                raise

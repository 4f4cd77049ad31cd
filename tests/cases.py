"""The failing inputs of public reports, where the folder with the data has them beside it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

_SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"
CASES = Path(os.environ.get("UNDERSTUDY_DATA") or _SHARED).parent / "cases"
needs_cases = pytest.mark.skipif(not CASES.is_dir(), reason=f"there is no folder {CASES}")

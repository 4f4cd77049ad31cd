"""USD's names are made by compiled modules: the type checker takes any."""

from typing import Any

def __getattr__(name: str) -> Any: ...

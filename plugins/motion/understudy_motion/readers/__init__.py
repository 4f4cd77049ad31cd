"""Readers of clip file formats, each a module with ``read(path) -> Clip``."""

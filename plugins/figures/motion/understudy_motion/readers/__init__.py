"""Readers of clip file formats: components of kind ``clip_reader``."""

"""Fetching clips from where they are published, with their licence."""

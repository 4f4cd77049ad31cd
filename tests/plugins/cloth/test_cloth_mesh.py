"""Constraints in colours."""

from __future__ import annotations

import numpy as np
from sheets import sheet, tube

from understudy_cloth.mesh import colours_of, even_out, hinges_of


def test_hinges_of_a_colour_share_no_vertex_and_are_as_many_as_of_another() -> None:
    for x, faces in (sheet(20, 30), tube(16, 40, 0.0573)):
        hinges = hinges_of(faces, x[faces])
        counts = np.diff(hinges.first)
        assert counts.sum() == len(hinges.quads)
        for first, last in zip(hinges.first, hinges.first[1:], strict=False):
            vertices = hinges.quads[first:last].ravel()
            assert len(np.unique(vertices)) == len(vertices)
        greedy = np.bincount(colours_of(hinges.quads))
        assert len(counts) == len(greedy)
        assert greedy.max() > 1.2 * greedy.mean(), "there was nothing to even out"
        assert counts.max() < 1.1 * counts.mean()


def test_what_cannot_be_evened_out_stays() -> None:
    """Three hinges at one vertex, and a fourth elsewhere."""
    groups = np.array([[0, 1, 2, 3], [0, 4, 5, 6], [0, 7, 8, 9], [10, 11, 12, 13]])
    colours = colours_of(groups)
    assert colours.tolist() == [0, 1, 2, 0]
    assert even_out(colours, groups).tolist() == [0, 1, 2, 0]

"""Constraints in colours."""

from __future__ import annotations

import itertools

import numpy as np
from sheets import sheet, tube

from understudy_cloth.mesh import colours_of, distances_of, even_out, hinges_of, spread
from understudy_cloth.patterns import t_shirt


def test_hinges_of_a_colour_share_no_vertex_and_are_as_many_as_of_another() -> None:
    for x, faces in (sheet(20, 30), tube(16, 40, 0.0573)):
        hinges = hinges_of(faces, x[faces], True)
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


def reads(first: np.ndarray, groups: np.ndarray) -> float:
    """How often a GPU reads for 8 threads side by side, 16 bytes for each from one of 8 banks: 1 at best."""
    found = [
        np.bincount(column % 8).max()
        for begin, end in itertools.pairwise(first)
        for k in range(begin, end, 8)
        for column in groups[k : min(k + 8, end)].T
    ]
    return float(np.mean(found))


def test_threads_side_by_side_read_from_banks_of_their_own() -> None:
    shirt = t_shirt()
    assert shirt.rest is not None
    hinges = hinges_of(shirt.faces, shirt.rest, True)
    edges = distances_of(shirt.faces, shirt.rest, True)
    sorted_quads = hinges.quads.copy()
    for begin, end in zip(hinges.first, hinges.first[1:], strict=False):
        part = hinges.quads[begin:end]
        sorted_quads[begin:end] = part[np.argsort(part[:, 0], kind="stable")]
    assert reads(hinges.first, sorted_quads) > 2.3, "there was nothing to spread"
    assert reads(hinges.first, hinges.quads) < 1.7
    assert reads(edges.first, edges.pairs) < 1.4


def test_spreading_keeps_colours_together_and_all_of_them() -> None:
    colours = np.array([0, 0, 0, 1, 1])
    groups = np.array([[0, 8], [8, 1], [1, 2], [3, 4], [5, 12]])
    order = spread(np.arange(5), colours, groups)
    assert sorted(order[:3]) == [0, 1, 2]
    assert sorted(order[3:]) == [3, 4]
    assert order[:2].tolist() != [0, 1], "0 and 8 are in one bank"

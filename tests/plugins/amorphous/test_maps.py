"""Density and height maps against eq. 2 and 3 of Zhang et al. 2020, by hand and as laws."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from understudy.task import Context
from understudy_amorphous.maps import (
    Grid,
    MaterialMaps,
    TableMap,
    density,
    density_and_height,
    draw_maps,
    in_tool_frame,
)
from understudy_amorphous.tool import orientation

GRID = Grid(cells=32, width=0.2)


def by_hand(points: torch.Tensor, grid: Grid) -> tuple[torch.Tensor, torch.Tensor]:
    """Eq. 2 and 3 as they are printed, cell by cell, of one world's points (P, 3)."""
    n, h = grid.cells, grid.width
    material, height = torch.zeros(n, n), torch.zeros(n, n)
    for i in range(n):
        for j in range(n):
            centre = torch.tensor([(i + 0.5 - n / 2) * h, (j + 0.5 - n / 2) * h])
            for x in points:
                v = (x[:2] - centre).abs()
                if (v < 2.5 * h).all():
                    w = math.hypot(2.5 * h - float(v[0]), 2.5 * h - float(v[1]))
                    material[i, j] += w
                    height[i, j] += w * float(x[2])
    return material, height / material.clamp(min=1e-12)


def cloud(seed: int, worlds: int = 2, count: int = 12, within: float = 3.4) -> torch.Tensor:
    points = torch.rand(worlds, count, 3, generator=torch.Generator().manual_seed(seed))
    return points * torch.tensor([2 * within, 2 * within, 1.0]) - torch.tensor([within, within, 0])


def test_maps_are_those_of_the_printed_equations() -> None:
    points = cloud(0)
    material, height = density_and_height(points, GRID)
    for world in range(2):
        expected, expected_height = by_hand(points[world], GRID)
        torch.testing.assert_close(material[world], expected, atol=1e-5, rtol=1e-5)
        torch.testing.assert_close(height[world], expected_height, atol=1e-5, rtol=1e-4)


def test_a_particle_in_the_middle_of_a_cell_weighs_the_root_of_two_times_half_a_metre() -> None:
    found = density(torch.tensor([[[0.1, 0.1, 0.3]]]), GRID)[0]
    assert found[16, 16] == pytest.approx(math.sqrt(2) * 0.5)
    assert found[17, 16] == pytest.approx(math.hypot(0.5, 0.3))
    assert int((found > 0).sum()) == 25, "its own cell and two rings"


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**31), i=st.integers(-6, 6), j=st.integers(-6, 6))
def test_no_material_is_lost_where_it_moves_by_whole_cells(seed: int, i: int, j: int) -> None:
    points = cloud(seed, within=1.2)
    moved = points + torch.tensor([i * 0.2, j * 0.2, 0.0])
    here, there = density(points, GRID), density(moved, GRID)
    torch.testing.assert_close(there, here.roll((i, j), (1, 2)), atol=1e-4, rtol=1e-4)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_maps_add_up_and_heights_lie_between_the_particles(seed: int) -> None:
    points = cloud(seed)
    both = density(points, GRID)
    torch.testing.assert_close(both, density(points[:, :5], GRID) + density(points[:, 5:], GRID))
    _, height = density_and_height(points, GRID)
    assert bool((height <= points[..., 2].amax(1).view(-1, 1, 1) + 1e-5).all())
    assert bool((height >= 0).all())


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**31), yaw=st.floats(-3, 3), x=st.floats(-9, 9), y=st.floats(-9, 9))
def test_a_map_in_the_tools_frame_sees_no_motion_of_both(
    seed: int, yaw: float, x: float, y: float
) -> None:
    """Tool and material, moved and turned together, make the same map."""
    points = cloud(seed, worlds=1)
    pose = torch.tensor([[0.3, -0.2, 0.1]]), orientation(torch.tensor([[0.0, 0.2, 0.5]]))
    cosine, sine = math.cos(yaw), math.sin(yaw)
    turn = torch.tensor([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1.0]])
    shift = torch.tensor([x, y, 0.0])
    together = pose[0] @ turn.T + shift, orientation(torch.tensor([[0.0, 0.2, 0.5 + yaw]]))
    seen = in_tool_frame(points, *pose)
    torch.testing.assert_close(
        in_tool_frame(points @ turn.T + shift, *together), seen, atol=1e-4, rtol=1e-4
    )
    still = density_and_height(seen, GRID)
    assert float(still[0].sum()) > 0


def test_what_is_ahead_of_the_tool_is_on_the_side_of_rising_rows() -> None:
    ahead = torch.tensor([[[0.0, 2.0, 0.1]]])  # the tool at the origin faces y
    pose = torch.zeros(1, 3), orientation(torch.tensor([[0.0, 0.0, math.pi / 2]]))
    found = density(in_tool_frame(ahead, *pose), GRID)[0]
    row, column = divmod(int(found.argmax()), 32)
    assert row in (25, 26)
    assert column in (15, 16)


def test_worlds_do_not_see_each_other() -> None:
    points = cloud(3)
    alone = torch.cat([density(points[:1], GRID), density(points[1:], GRID)])
    torch.testing.assert_close(density(points, GRID), alone)


def test_the_pile_of_the_spreading_task_covers_a_hundred_cells() -> None:
    """6 × 6 columns of particles 0.2 m apart and two rings: what Table 4 reports where nothing was
    spread (94)."""
    line = 0.2 * (torch.arange(6) - 2.5)
    x, y = torch.meshgrid(line, line, indexing="ij")
    pile = torch.stack([x.flatten(), y.flatten(), torch.zeros(36)], dim=1).unsqueeze(0)
    assert int((density(pile, GRID) > 0).sum()) == 100


def occupied(frame: str, points: torch.Tensor, x: float, yaw: float) -> float:
    """Cells of the map in `frame` with `points` (1, P, 3), the tool at (x, 0) and leaning."""
    context = Context(seed=0, device=torch.device("cpu"), num_worlds=1, control_dt=0.1, substeps=1)
    part = TableMap(TableMap.Options(GRID, frame), context)  # type: ignore[arg-type]
    fields = {
        "particle_position": points,
        "tool_position": torch.tensor([[x, 0.0, 0.3]]),
        "tool_orientation": orientation(torch.tensor([[0.0, 0.4, yaw]])),
    }
    return float(part.compute(**{name: fields[name] for name in part.reads})["occupied_cells"])


def test_the_tools_motion_changes_no_cell_of_the_map_that_covers_the_table() -> None:
    points = cloud(1, worlds=1, within=2.0)
    expected = float((density(points, GRID) > 0).sum())
    assert occupied("world", points, 0.0, 0.0) == occupied("world", points, 4.0, 1.0) == expected


def test_the_observed_map_has_the_cells_that_the_policy_sees() -> None:
    points = cloud(1, worlds=1, within=2.0)
    pose = torch.tensor([[1.0, 0.0, 0.3]]), orientation(torch.tensor([[0.0, 0.4, 0.7]]))
    seen = density(in_tool_frame(points, *pose), GRID)
    assert occupied("tool", points, 1.0, 0.7) == float((seen > 0).sum())
    assert 0 < occupied("tool", points, 4.5, 0.0) < occupied("tool", points, 0.0, 0.0)
    assert occupied("tool", points, 9.0, 0.0) == 0.0, "what is off the map counts no more"


def drawn(frame: str, yaw: float, **more: Any) -> torch.Tensor:
    """(3, 32, 32): density, height and goal, one particle at (1.5, 0.1, 0.5), the goal at (0.1, -1.9), the
    tool at (0.2, 0.2, 0.2)."""
    options = MaterialMaps.Options(("density", "height", "goal"), frame, GRID, **more)  # type: ignore[arg-type]
    return draw_maps(
        options,
        particle_position=torch.tensor([[[1.5, 0.1, 0.5]]]),
        tool_position=torch.tensor([[0.2, 0.2, 0.2]]),
        tool_orientation=orientation(torch.tensor([[0.0, 0.0, yaw]])),
        goal=torch.tensor([[0.1, -1.9]]),
    )[0]


def test_each_channel_shows_its_own_in_the_frame_that_is_chosen() -> None:
    """Cells are counted from the corner at (-3.2, -3.2) m of the frame."""
    places = {
        ("world", 0.0): ((23, 16), (16, 6)),
        ("world", 1.0): ((23, 16), (16, 6)),
        ("tool", 0.0): ((22, 15), (15, 5)),
        ("tool", math.pi / 2): ((15, 9), (5, 16)),  # it faces y
    }
    for (frame, yaw), (material, goal) in places.items():
        maps = drawn(frame, yaw)
        for channel, (row, column) in ((maps[0], material), (maps[2], goal)):
            assert middle(channel) == pytest.approx((row, column), abs=1e-3), (frame, yaw)
        assert float(maps[1].max()) == pytest.approx(0.5 if frame == "world" else 0.3)
        assert bool(((maps[1] > 0) == (maps[0] > 0)).all()), "a height where there is material"
    assert float(drawn("world", 0.0)[2].max()) == pytest.approx(1.0), (
        "the goal is in a cell's middle"
    )
    assert float(drawn("world", 0.0)[0].max()) == pytest.approx(0.1 * math.sqrt(2) * 0.5)


def test_maps_of_the_table_can_be_around_another_place_and_heights_in_another_unit() -> None:
    here, there = drawn("world", 0.0), drawn("world", 0.0, centre=(0.4, -0.2), height_scale=3.0)
    moved = here.roll((-2, 1), (1, 2)) * torch.tensor([1.0, 3.0, 1.0])[:, None, None]
    torch.testing.assert_close(there, moved, atol=1e-4, rtol=1e-4)


def middle(image: torch.Tensor) -> tuple[float, float]:
    """Row and column of an image's middle, weighted by its values."""
    index = torch.arange(len(image), dtype=torch.float32)
    total = float(image.sum())
    return float(image.sum(1) @ index) / total, float(image.sum(0) @ index) / total

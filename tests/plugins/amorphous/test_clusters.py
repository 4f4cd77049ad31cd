"""The clusters curriculum (section 4.1) and episodes of different lengths."""

from __future__ import annotations

from typing import Any

import pytest
import torch

from understudy.errors import ConfigError
from understudy.random import WorldStreams
from understudy.task import Context, Rollout
from understudy_amorphous.curricula import Between, Clusters
from understudy_amorphous.scene import AmorphousScene

CPU = torch.device("cpu")


def curriculum(*, evaluating: bool = False, blocks: int = 4, **options: Any) -> Clusters:
    context = Context(
        seed=0, device=CPU, num_worlds=4, control_dt=0.1, substeps=1, evaluating=evaluating
    )
    context.scene = AmorphousScene(AmorphousScene.Options(blocks=blocks), context)
    return Clusters(
        Clusters.Options(
            **{
                "seconds": Between(10.0, 20.0),
                "episodes": 4,
                "threshold": 0.6,
                "within": 1.3,
                **options,
            }
        ),
        context,
    )


def rollout(
    distances: list[float], returns: float = 0.0, ended: bool = True, clusters: float = 1.0
) -> Rollout:
    """One step of four worlds whose episodes end with the farthest particle so far away."""
    row = torch.zeros(1, 4)
    false = torch.zeros(1, 4, dtype=torch.bool)
    return Rollout(
        {}, {}, row.unsqueeze(2), row, row, false, false | ended, false, row, row + returns,
        {"farthest_distance": torch.tensor([distances]), "clusters": row + clusters},
    )  # fmt: skip


def test_a_cluster_more_whenever_enough_episodes_gather_them() -> None:
    part = curriculum()
    assert part.update(rollout([1.0, 1.2, 1.5, 2.0])) == {"clusters": 1, "distance": 0.5}
    found = part.update(rollout([1.0, 1.2, 1.3, 2.0]))
    assert found == {"clusters": 2, "distance": 0.75, "mark/2 clusters": 1.0}
    assert part.begin(WorldStreams(0, "x", 4, CPU))["clusters"].tolist() == [2.0] * 4
    part.update(rollout([0.5] * 4))
    assert part.clusters == 2, "episodes that began with one cluster say nothing of two"
    for _ in range(5):
        part.update(rollout([0.5] * 4, clusters=part.clusters))
    assert part.clusters == 4, "and no more than four"


def test_running_episodes_do_not_count() -> None:
    part = curriculum()
    assert part.update(rollout([0.1] * 4, ended=False)) == {"clusters": 1}


def test_it_can_go_by_the_total_reward() -> None:
    part = curriculum(by="return", threshold=30.0)
    assert part.update(rollout([9.0] * 4, returns=29.0))["clusters"] == 1
    assert part.update(rollout([9.0] * 4, returns=31.0))["clusters"] == 2


def test_it_is_saved_with_the_training() -> None:
    part, other = curriculum(), curriculum()
    part.update(rollout([0.1] * 4))
    part.update(rollout([0.1] * 4, ended=False))
    other.load_state_dict(part.state_dict())
    assert other.clusters == 2
    assert other.begin(WorldStreams(0, "x", 4, CPU))["clusters"].tolist() == [2.0] * 4


def test_evaluations_have_all_of_them() -> None:
    assert curriculum(evaluating=True, most=3).clusters == 3


def test_episodes_have_different_lengths() -> None:
    limits = curriculum().begin(WorldStreams(0, "x", 4, CPU))["episode_limit"]
    assert bool(((limits >= 10.0) & (limits < 20.0)).all())
    assert len(set(limits.tolist())) == 4


def test_fewer_at_the_end_than_at_the_start_is_refused() -> None:
    with pytest.raises(ValueError, match="most=1 is not possible"):
        Clusters.Options(seconds=Between(1.0, 1.0), start=2, most=1)


def test_there_are_no_more_than_the_scene_has() -> None:
    with pytest.raises(
        ConfigError, match=r"curriculum\.most=4 is not possible: there are 2 clusters"
    ):
        curriculum(blocks=2)
    fewer = curriculum(most=2)
    fewer.load_state_dict({"clusters": 4, "ended": 0, "total": 0.0})
    for clusters, ended in ((0, 0), (-3, 0), (2, -1)):
        with pytest.raises(ValueError, match="and not between"):
            fewer.load_state_dict({"clusters": clusters, "ended": ended, "total": 0.0})
    assert fewer.clusters == 2, "those of a run that had more"

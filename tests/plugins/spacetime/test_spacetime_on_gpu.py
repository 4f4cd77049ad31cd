"""What learns within bounds on a GPU: steps and evaluations are captured, learning where to begin waits
for nothing."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import pytest
import torch
from on_gpu import no_waiting
from torch import Tensor

pytest.importorskip(
    "mujoco_warp", reason="MuJoCo Warp is not installed (pip install 'understudy[gpu]')"
)

from understudy.inputs import Inputs
from understudy.running.training import Training
from understudy.setup.composition import load_experiment
from understudy.task import Context, Rollout
from understudy_characters.scene import CharacterScene, reference_motion
from understudy_motion.section import Motion, MotionOptions
from understudy_reinforcement.job import Reinforcement
from understudy_spacetime.evolution import Evolution

pytestmark = pytest.mark.gpu

SMALL = (
    "experiment=spacetime/walk", "simulator=mujoco_warp", "num_worlds=256", "learner.minibatches=4",
    "evaluation.episodes=16", "evaluation.final_episodes=16", "evaluation.seconds=1",
    "evaluation.starts={clip_start: {name: spacetime/clip_start}, any_phase: "
    "{name: characters/reference_states}}",
)  # fmt: skip


@pytest.mark.parametrize(
    "more",
    [
        (),
        ("initial_states=spacetime/importance_by_starts",),
        ("initial_states=spacetime/evolution",),
        ("curriculum=spacetime/adaptive_bounds",),
        ("+baseline=deepmimic",),
        ("reward.terms.imitation.name=deepmimic/imitation", "termination=spacetime/reported"),
        ("+style=high_energy",),
        ("+style=large_volume",),
        ("policy.feedforward=null",),
        ("scene.character=revolute",),
    ],
)
def test_trains_and_evaluates_recorded(more: tuple[str, ...]) -> None:
    with warnings.catch_warnings():
        warnings.filterwarnings("error", message="Steps cannot be captured")
        training = Training(load_experiment([*SMALL, *more])).prepare()
        for _ in range(6):
            row = training.iterate()
            assert row["skipped_steps"] == 0
        assert isinstance(training.job, Reinforcement)
        assert training.job.environment.captured_step.on
        first, again = (training.job.evaluate("test", 16) for _ in range(2))
    training.close()
    for name in ("success_from_clip_start", "success_from_any_phase"):
        assert 0.0 <= first.measures[name].mean <= 1.0
        assert abs(first.measures[name].mean - again.measures[name].mean) <= 0.25


def test_evolution_waits_for_nothing(
    make_rollout: Callable[[dict[str, Tensor], Tensor], Rollout], plugins: object
) -> None:
    from understudy.setup.plugins import installed

    context = Context(
        0, torch.device("cuda"), 64, control_dt=1 / 30, substeps=20,
        sections={"motion": Motion(MotionOptions(), installed().registry, Inputs())},
        scene=CharacterScene(CharacterScene.Options("humanoid")),
    )  # fmt: skip
    states = Evolution(Evolution.Options(by="starts"), context)
    time = torch.rand(16 * 4096, device="cuda")
    found = reference_motion(context).sample(time)
    fields = {
        "phase": found["phase"],
        "episode_step": torch.zeros(len(time), dtype=torch.int64, device="cuda"),
        "motion_time": time,
        "qpos": found["reference_qpos"],
        "qvel": found["reference_qvel"],
    }
    rollout = make_rollout(
        {name: value.unflatten(0, (16, 4096)) for name, value in fields.items()},
        time.view(16, 4096),
    )
    states.update(rollout)  # kernels are loaded
    with no_waiting():
        states.update(rollout)

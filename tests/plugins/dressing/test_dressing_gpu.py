"""On a GPU nothing leaves the device within a rollout, and the sleeve is the CPU's."""

from __future__ import annotations

import warnings

import pytest
import torch
from on_gpu import no_waiting
from torch import Tensor

from understudy.running.environment import Environment
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.testing import check_simulator

pytestmark = pytest.mark.gpu
pytest.importorskip("potpourri3d", reason="potpourri3d is not installed")
pytest.importorskip("mujoco_warp", reason="MuJoCo Warp is not installed")
#: The small sleeve with the large one's simulators.
SMALL = [
    "experiment=dressing/sleeve_small",
    "device=cuda",
    "simulators.person={name: mujoco_warp}",
    "simulators.cloth={name: cloth, self_contact: true}",
]


def built(worlds: int, *given: str) -> Environment:
    experiment = load_experiment([*(given or SMALL), f"num_worlds={worlds}"])
    return build_environment(experiment).environment


def test_the_composite_conforms() -> None:
    check_simulator(built(4).parts.simulator, 4, ["cloth/gravity"])


def test_a_decision_does_not_wait_for_the_device() -> None:
    environment = built(8)
    environment.reset(seed=1)
    action = torch.full((8, environment.action_size), 0.2, device="cuda")
    for _ in range(2):
        environment._step(action)
    with no_waiting():
        environment._step(action)


@pytest.mark.parametrize(
    ("given", "decisions"),
    [
        (SMALL, 8),
        (["experiment=dressing/sleeve"], 8),
        (["experiment=dressing/shirt_tuck", "scenes.person.damping=3.0"], 1),
    ],
)
def test_a_decision_is_captured_and_replayed(given: list[str], decisions: int) -> None:
    """And gives what it gives uncaptured. A shirt's contacts are summed in another order each time: two uncaptured runs are 0.15 mm apart
    after two decisions and 4 cm after eight, so that of a shirt one is compared."""
    found: list[dict[str, Tensor]] = []
    for captured in (False, True):
        environment = built(4, *given)
        environment.reset(seed=1)
        step = environment.captured_step if captured else environment._step
        generator = torch.Generator("cuda").manual_seed(0)
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # what cannot be captured says so
            size = (4, environment.action_size)
            for _ in range(4):  # captured by then
                step(torch.randn(size, generator=generator, device="cuda"))
            environment.reset(seed=1)
            for _ in range(decisions):
                step(torch.randn(size, generator=generator, device="cuda"))
        assert environment.captured_step.on == captured
        found.append({name: environment.table[name].clone() for name in ("qpos", "cloth_position")})
        environment.close()
    for name, value in found[0].items():
        torch.testing.assert_close(found[1][name], value, atol=1e-4, rtol=1e-3, msg=name)


def test_a_second_is_the_cpus() -> None:
    """MuJoCo and cloth on a core, and both on the GPU, under the same torques."""
    ends = []
    here = ["experiment=dressing/sleeve_small", "simulators.cloth.self_contact=true"]
    for environment in (built(2), built(2, *here)):
        environment.reset(seed=1)
        for k in range(20):
            pull = torch.tensor([0.0, -0.3 if k < 6 else 0.0, 0.0, 0.1])
            environment.advance(pull.to(environment.device).expand(2, -1))
        ends.append(environment.table["cloth_position"].cpu().clone())
        ends.append(environment.table["qpos"].cpu().clone())
        environment.close()
    torch.testing.assert_close(ends[1], ends[3], atol=2e-3, rtol=0.0)
    torch.testing.assert_close(ends[0], ends[2], atol=5e-3, rtol=0.0)

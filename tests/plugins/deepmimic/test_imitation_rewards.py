"""The imitation reward: numbers worked out by hand, and what must not matter to it."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from understudy.errors import ConfigError
from understudy.options import make_options
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.task import Context
from understudy_characters.scene import CharacterScene
from understudy_deepmimic import rewards
from understudy_deepmimic.rewards import Velocity
from understudy_tensors import rotations

CONTEXT = Context(
    0,
    torch.device("cpu"),
    1,
    control_dt=1 / 30,
    substeps=20,
    scene=CharacterScene(CharacterScene.Options("humanoid")),
)
JOINTS, EFFECTORS, SPEEDS = 12, 4, 34
VELOCITY = Velocity(Velocity.Options(), CONTEXT)


def noise(seed: int, *shape: int) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def state(seed: int) -> dict[str, Tensor]:
    """Any state of a character, as the fields have it."""
    root = rotations.normalize(noise(seed, 1, 4))
    return {
        "root_rotation": root,
        "root_heading": rotations.heading(root),
        "root_position": noise(seed + 1, 1, 3),
        "joint_rotations": rotations.normalize(noise(seed + 2, 1, JOINTS, 4)),
        "end_effector_positions": noise(seed + 3, 1, EFFECTORS, 3),
        "com_position": noise(seed + 4, 1, 3),
        "qvel": noise(seed + 5, 1, SPEEDS),
    }


def terms(own: dict[str, Tensor], reference: dict[str, Tensor]) -> dict[str, float]:
    """The four terms of a character in state `own`."""

    def taken(*names: str) -> list[Tensor]:
        return [side[name] for side in (own, reference) for name in names]

    found = {
        "pose": rewards.pose(*taken("root_rotation", "joint_rotations")),
        "velocity": VELOCITY(*taken("qvel")),
        "end_effectors": rewards.end_effectors(
            *taken("root_position", "root_heading", "end_effector_positions")
        ),
        "com": rewards.com(*taken("com_position")),
    }
    return {name: value.item() for name, value in found.items()}


def turned(q: Tensor, angle: float, axis: tuple[float, float, float] = (0.6, 0.0, 0.8)) -> Tensor:
    return rotations.multiply(
        q, rotations.from_axis_angle(torch.tensor(axis), torch.tensor(float(angle)))
    )


def test_perfect_tracking_is_one() -> None:
    for seed in range(5):
        assert set(terms(state(seed), state(seed)).values()) == {1.0}


def test_pose() -> None:
    """0.3 rad in a joint, 0.4 rad in another: exp(-2 · 0.25)."""
    own, reference = state(0), state(0)
    joints = own["joint_rotations"].clone()
    joints[:, 2] = turned(joints[:, 2], 0.3)
    joints[:, 7] = -turned(joints[:, 7], -0.4, (0.0, 1.0, 0.0))  # the same rotation as without -
    own["joint_rotations"] = joints
    found = terms(own, reference)
    assert found.pop("pose") == pytest.approx(math.exp(-0.5), rel=1e-4)
    assert set(found.values()) == {1.0}


def test_the_root_is_a_joint() -> None:
    own, reference = state(0), state(0)
    own["root_rotation"] = turned(own["root_rotation"], 0.2)
    assert terms(own, reference)["pose"] == pytest.approx(math.exp(-2 * 0.04), rel=1e-4)


def test_velocity() -> None:
    """The root's turning, a ball's, a hinge's count; the root's translation does not."""
    assert CONTEXT.scene is not None
    layout = CONTEXT.scene.layout  # type: ignore[attr-defined]
    dofs = [layout.root_dof + 4, int(layout.ball_dofs[0, 1]), int(layout.hinge_dofs[0, 0])]
    for dof, by, expected in zip(dofs, (1.0, -2.0, 3.0), (0.1, 0.4, 0.9), strict=True):
        own, reference = state(0), state(0)
        own["qvel"] = own["qvel"].clone()
        own["qvel"][:, dof] += by
        assert terms(own, reference)["velocity"] == pytest.approx(math.exp(-expected), rel=1e-4)
    own, reference = state(0), state(0)
    own["qvel"] = own["qvel"].clone()
    own["qvel"][:, layout.root_dof : layout.root_dof + 3] += 5.0
    assert terms(own, reference)["velocity"] == 1.0


def test_end_effectors() -> None:
    """10 cm of one hand: exp(-40 · 0.01); all 10 cm higher: exp(-40 · 4 · 0.01)."""
    own, reference = state(0), state(0)
    own["end_effector_positions"] = own["end_effector_positions"].clone()
    own["end_effector_positions"][:, 1, 0] += 0.1
    assert terms(own, reference)["end_effectors"] == pytest.approx(math.exp(-0.4), rel=1e-4)
    own = state(0)
    own["root_position"] = own["root_position"] + torch.tensor([3.0, -2.0, 0.1])
    assert terms(own, reference)["end_effectors"] == pytest.approx(math.exp(-1.6), rel=1e-4)


def test_end_effectors_when_the_heading_jumps() -> None:
    """The root's x axis points up: a hair's breadth on either side of it are opposite headings, and
    the same pose."""
    up = rotations.from_axis_angle(torch.tensor([0.0, 1.0, 0.0]), torch.tensor([-math.pi / 2]))
    hands = noise(3, 1, EFFECTORS, 3)
    sides = []
    for lean in (1e-3, -1e-3):
        root = turned(up, lean, (0.0, 1.0, 0.0))
        yaw = rotations.heading(root)
        inside = torch.bmm(hands, rotations.turn_matrix(yaw))  # of the heading frame
        sides.append((torch.zeros(1, 3), yaw, inside))
    assert abs(abs(float(sides[0][1] - sides[1][1])) - math.pi) < 1e-2
    assert rewards.end_effectors(*sides[0], *sides[1]).item() == pytest.approx(1.0, abs=1e-4)


def test_com() -> None:
    own, reference = state(0), state(0)
    own["com_position"] = own["com_position"] + torch.tensor([0.1, 0.2, -0.2])
    assert terms(own, reference)["com"] == pytest.approx(math.exp(-0.9), rel=1e-4)


def moved(state: dict[str, Tensor], angle: float, shift: Tensor) -> dict[str, Tensor]:
    """The same state elsewhere, facing another way; what is in the heading frame stays."""
    turn = rotations.from_heading(torch.tensor(angle))
    root = rotations.multiply(turn, state["root_rotation"])
    places = {
        name: rotations.rotate(turn, state[name]) + shift
        for name in ("root_position", "com_position")
    }
    return {**state, **places, "root_rotation": root, "root_heading": rotations.heading(root)}


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    near=st.floats(0.0, 0.3),
    angle=st.floats(-3.0, 3.0),
    x=st.floats(-9.0, 9.0),
    y=st.floats(-9.0, 9.0),
)
def test_within_limits_and_wherever_both_are(
    seed: int, near: float, angle: float, x: float, y: float
) -> None:
    own, other = state(seed), state(seed + 100)
    reference = {
        name: torch.lerp(value, other[name], near)
        for name, value in own.items()
        if name != "root_heading"
    }
    for name in ("root_rotation", "joint_rotations"):
        reference[name] = rotations.normalize(reference[name])
    reference["root_heading"] = rotations.heading(reference["root_rotation"])
    here = terms(own, reference)
    assert all(0 <= value <= 1 for value in here.values())
    assert all(value > 0 for value in terms(own, own).values())
    shift = torch.tensor([x, y, 0.0])
    there = terms(moved(own, angle, shift), moved(reference, angle, shift))
    assert there == pytest.approx(here, abs=2e-3)


def test_an_episode_begins_as_the_reference() -> None:
    """The fields agree with one another: what the simulator has is what the clip has."""
    environment = build_environment(
        load_experiment(["task=deepmimic/walk", "num_worlds=32"])
    ).environment
    environment.reset(seed=1)
    for term in environment.parts.rewards:
        given = environment.table.pick(term.reads)
        assert term.function(**given, **term.options).min() > 0.999, term.name
    assert [term.weight for term in environment.parts.rewards] == [0.65, 0.1, 0.15, 0.1]
    assert environment.parts.combine == "sum"


def test_a_term_can_be_left_out() -> None:
    left_out = load_experiment(["task=deepmimic/walk", "num_worlds=2", "~reward.terms.velocity"])
    environment = build_environment(left_out).environment
    environment.reset()
    assert [term.name for term in environment.parts.rewards] == ["pose", "end_effectors", "com"]


def test_all_four_as_one_term() -> None:
    """Weighted as in the paper, and by other weights."""
    own, reference = state(0), state(40)
    mixed = {name: 0.97 * reference[name] + 0.03 * own[name] for name in own}
    for name in ("root_rotation", "joint_rotations"):
        mixed[name] = rotations.normalize(mixed[name])
    mixed["root_heading"] = reference["root_heading"]
    fields = {**mixed, **{f"reference_{k}": v for k, v in reference.items()}}
    found = terms(mixed, reference)
    weights = {"pose": 0.65, "velocity": 0.1, "end_effectors": 0.15, "com": 0.1}
    expected = sum(weights[name] * found[name] for name in weights)
    imitation = rewards.Imitation(rewards.Imitation.Options(), CONTEXT)
    assert imitation(**fields).item() == pytest.approx(expected, rel=1e-5)
    alone = rewards.Imitation.Options(pose=0.0, velocity=0.0, end_effectors=0.0, com=2.0)
    given = rewards.Imitation(alone, CONTEXT)(**fields).item()
    assert given == pytest.approx(2.0 * found["com"], rel=1e-5)


def test_one_term_of_no_weights_is_refused() -> None:
    none = {"pose": 0, "velocity": 0, "end_effectors": 0, "com": 0}
    with pytest.raises(
        ConfigError, match=r"reward\.terms\.i\.pose=0 is not possible with velocity=0"
    ):
        make_options(rewards.Imitation.Options, none, "reward.terms.i")

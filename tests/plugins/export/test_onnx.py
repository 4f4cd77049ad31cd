"""Policies as ONNX models: run by ONNX Runtime they act as they do in torch."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from line_task import SIDE_AND_STEP, line_context, make_policy

import understudy_export
from understudy.command.cli import main
from understudy.setup.building import Built, build_environment
from understudy.setup.composition import load_experiment
from understudy_export.policy import Acting, write_model, write_policy
from understudy_networks.policies import MLPPolicy
from understudy_reinforcement.policy import Policy, build_policy
from understudy_skills.skill import Skill, open_skill

for needed in ("onnx", "onnxscript", "onnxruntime"):
    pytest.importorskip(needed, reason=f"{needed} is not installed (the extras onnx and dev)")

WORLDS = 4


def session(path: Path) -> Any:
    import onnxruntime

    return onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])


def facts(model: Any) -> dict[str, Any]:
    found = model.get_modelmeta().custom_metadata_map
    return {key: json.loads(value) for key, value in found.items()}


def acting(skill: Skill) -> tuple[Built, Policy]:
    built = build_environment(skill.experiment, num_worlds=WORLDS, evaluating=True)
    policy = build_policy(skill.experiment, built.context)
    skill.give(policy)
    return built, policy


@pytest.fixture(scope="module")
def walk() -> Skill:
    return open_skill("spacetime/walk")


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("onnx") / "walk.onnx"
    assert main(["export", "spacetime/walk", str(path)]) == 0
    return path


def test_it_acts_as_the_policy_does_where_the_policy_gets_to(exported: Path, walk: Skill) -> None:
    model = session(exported)
    built, policy = acting(walk)
    observations = built.environment.reset(3, "test")
    worst = 0.0
    for _ in range(30):
        with torch.no_grad():
            wanted = policy.distribution(observations).mode()
        given = {i.name: observations[i.name].numpy() for i in model.get_inputs()}
        action, control = model.run(["action", "control"], given)
        worst = max(worst, float(np.abs(action - wanted.numpy()).max()))
        np.testing.assert_array_equal(control, action)
        observations = built.environment.step(torch.from_numpy(action)).observations
    built.environment.close()
    assert worst < 1e-5
    assert float(wanted.abs().max()) > 0.1


def test_its_weights_are_those_of_the_policy_bit_for_bit(exported: Path, walk: Skill) -> None:
    """Nothing is rounded: what a pack loses a model does not."""
    import onnx
    from onnx import numpy_helper

    held = [
        turned
        for tensor in onnx.load(str(exported)).graph.initializer
        for array in [numpy_helper.to_array(tensor)]
        for turned in (array, array.T)
    ]
    matrices = {
        name: value.numpy()
        for name, value in walk.policy.items()
        if value.ndim == 2 and "critic" not in name
    }
    assert len(matrices) > 2
    for name, value in matrices.items():
        assert value.dtype == np.float32
        assert any(np.array_equal(array, value) for array in held), name


def test_it_says_how_it_is_used(exported: Path) -> None:
    found = facts(session(exported))
    assert found["control"] == {"frequency": 30.0, "servo_timestep": pytest.approx(1 / 600)}
    state = found["observations"]["state"]
    assert state["encoder"] == "spacetime/state"
    assert "Columns, for L links" in state["about"]
    links, effectors = (len(found["character"][k]) for k in ("links", "end_effectors"))
    assert state["shape"] == [9 + 15 * links + 3 * effectors]
    assert state["reads"]["link_rotations"] == [links, 6]
    assert found["action"]["parts"] == {"action": len(found["controls"])}
    assert found["action"]["reads"] == []
    chest = found["controls"][0]
    assert chest["joint"] == "chest"
    assert chest["kp"] == pytest.approx(1000.0)
    assert chest["kd"] == pytest.approx(100.0)
    assert chest["limit"] == pytest.approx(200.0)
    assert found["motion"]["licence"] == "Apache-2.0 (generated)"
    assert found["success"]["rate"] >= 0.9


def test_it_says_nothing_of_whose_files_it_was_made_of(exported: Path) -> None:
    """The exporter notes of each operation in which file its code is."""
    content = exported.read_bytes()
    assert b"site-packages" not in content
    assert b".py" not in content
    assert str(Path(understudy_export.__file__).parent).encode() not in content


def test_the_reference_beside_it_is_what_the_task_observes(exported: Path, walk: Skill) -> None:
    table = np.load(exported.with_suffix(".reference.npz"))
    built, _ = acting(walk)
    observations = built.environment.reset(3, "test")
    time = built.environment.table["motion_time"].numpy()
    cycle = len(table["time"]) * (table["time"][1] - table["time"][0])
    assert bool(table["loop"])
    rows = np.append(table["time"], cycle)
    targets = np.concatenate(
        [table["reference_joint_targets"], table["reference_joint_targets"][:1]]
    )
    for world, now in enumerate(time % cycle):
        found = [np.interp(now, rows, column) for column in targets.T]
        np.testing.assert_allclose(found, observations["feedforward"][world], atol=1e-4)
    built.environment.close()
    end = table["reference_root_position"][0, :2] + table["cycle_displacement"]
    before = table["reference_root_position"][-1, :2]
    step = np.linalg.norm(
        table["reference_root_position"][1, :2] - table["reference_root_position"][0, :2]
    )
    assert np.linalg.norm(end - before) == pytest.approx(step, rel=0.2)


def test_choices_and_boxes_are_outputs_of_their_own(tmp_path: Path) -> None:
    policy = make_policy(MLPPolicy, MLPPolicy.Options(), line_context(SIDE_AND_STEP))
    actuation = SimpleNamespace(action_space=SIDE_AND_STEP, reads=("place",), keeps={})
    parts = SimpleNamespace(actuation=SimpleNamespace(part=actuation))
    built: Any = SimpleNamespace(environment=SimpleNamespace(parts=parts))
    seen = torch.linspace(-2.0, 2.0, 10).view(5, 2)
    acts = Acting(policy, built, ("state",))
    write_model(acts, [seen[:1]], {"task": '"line"'}, tmp_path / "line.onnx")
    model = session(tmp_path / "line.onnx")
    assert [output.name for output in model.get_outputs()] == ["side", "step"]
    side, step = model.run(None, {"state": seen.numpy()})
    with torch.no_grad():
        wanted = SIDE_AND_STEP.split(policy.distribution({"state": seen}).mode())
    assert side.dtype == np.int64
    np.testing.assert_array_equal(side, wanted["side"])
    assert 0 < side.sum() < len(side)  # it does not choose the same everywhere
    np.testing.assert_allclose(step, wanted["step"], atol=1e-5)


def test_an_image_is_an_input_as_it_is(tmp_path: Path) -> None:
    experiment = load_experiment(["experiment=miniature/amorphous"])
    built = build_environment(experiment, num_worlds=1, evaluating=True)
    policy = build_policy(experiment, built.context)
    built.environment.close()
    skill = Skill("grains", experiment, policy.state_dict(), 0, {})
    write_policy(skill, tmp_path / "grains.onnx", {})
    model = session(tmp_path / "grains.onnx")
    built, policy = acting(skill)
    observations = built.environment.reset(3, "test")
    built.environment.close()
    with torch.no_grad():
        wanted = built.environment.parts.actuation.part.action_space.split(
            policy.distribution(observations).mode()
        )
    given = {i.name: observations[i.name].numpy() for i in model.get_inputs()}
    for name, value in wanted.items():
        np.testing.assert_allclose(model.run([name], given)[0], value.numpy(), atol=1e-5)
    assert not (tmp_path / "grains.reference.npz").exists()


@pytest.mark.parametrize("earlier", [False, True])
def test_a_model_is_not_there_without_what_belongs_beside_it(
    earlier: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Where a folder has the name of the reference's table, which is written last."""
    model, table = tmp_path / "walk.onnx", tmp_path / "walk.reference.npz"
    table.mkdir()
    if earlier:
        model.write_bytes(b"earlier")
    assert main(["export", "spacetime/walk", str(model), *["--overwrite"] * earlier]) == 2
    assert capsys.readouterr().err == f"understudy: {table}: cannot be written: Is a directory.\n"
    assert sorted(tmp_path.iterdir()) == ([model, table] if earlier else [table])
    assert not earlier or model.read_bytes() == b"earlier"


def test_options_of_motions_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", "spacetime/walk", "walk.onnx", "--rate", "30"]) == 2
    assert "--rate is for motions, and walk.onnx is a policy" in capsys.readouterr().err


def test_a_clip_has_no_policy(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", "hop", "hop.onnx"]) == 2
    assert "There is no skill 'hop'" in capsys.readouterr().err


def test_without_the_libraries_it_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("understudy_export.policy.importlib.util.find_spec", lambda name: None)
    assert main(["export", "spacetime/walk", "walk.onnx"]) == 2
    assert "pip install 'understudy[onnx]'" in capsys.readouterr().err

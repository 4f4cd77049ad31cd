"""Names of the columns of observations, and what is printed of an environment."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from understudy.command.cli import main
from understudy.errors import ConfigError
from understudy.records.runs import create
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy_characters.layout import LINK_COLUMNS
from understudy_gym.worlds import Worlds, flattened
from understudy_reinforcement.collector import Collector
from understudy_reinforcement.policy import build_policy


def built(task: str, *overrides: str) -> Any:
    made = build_environment(load_experiment([f"task={task}", *overrides, "num_worlds=2"]))
    made.environment.reset(0)
    return made.environment


def seen(environment: Any, name: str, **changed: Tensor) -> Tensor:
    """The observation `name`, (N, D), with other fields."""
    encoder = environment.parts.encoders[name]
    return encoder.part.encode(**{**environment.table.pick(encoder.reads), **changed})


@pytest.mark.parametrize("task", ["spacetime/walk", "deepmimic/walk"])
def test_a_links_columns_are_its_own(task: str) -> None:
    environment = built(task)
    columns, before = environment.observation_columns["state"], seen(environment, "state")
    assert len(columns) == len(set(columns)) == before.shape[1]
    for field in LINK_COLUMNS:
        links = [c.split("/")[1] for c in columns if c.startswith(f"{field}/")]
        for number, link in enumerate(dict.fromkeys(links)):
            value = environment.table[field].clone()
            value[:, number] += torch.rand_like(value[:, number])
            other = (seen(environment, "state", **{field: value}) != before).any(0)
            moved = {c for c, differs in zip(columns, other.tolist(), strict=True) if differs}
            assert moved
            assert all(c.startswith(f"{field}/{link}/") for c in moved)


def test_the_rest_of_the_walks_columns() -> None:
    environment = built("spacetime/walk")
    table = environment.table
    columns = environment.observation_columns["state"]
    value = dict(zip(columns, seen(environment, "state").T, strict=True))
    torch.testing.assert_close(value["phase"], table["phase"])
    torch.testing.assert_close(value["root_position/z"], table["root_position"][:, 2])
    torch.testing.assert_close(value["heading_deviation/cos"], table["heading_deviation"].cos())
    ends = table["aligned_end_effector_positions"]
    torch.testing.assert_close(torch.stack([value[c] for c in columns[-3:]], 1), ends[:, -1])
    targets = environment.observation_columns["feedforward"]
    assert len(targets) == environment.action_size
    assert all(c.startswith("reference_joint_targets/") and not c[-1:].isdigit() for c in targets)


def test_the_sitters_joints_by_name() -> None:
    environment = built("sitting/walk")
    columns = environment.observation_columns["state"]
    model = environment.parts.simulator.model
    value = dict(zip(columns, seen(environment, "state").T, strict=True))
    hinges = [j for j in range(model.njnt) if model.jnt_type[j] == 3]
    assert hinges
    for joint in map(model.joint, hinges):
        qpos, qvel = environment.table["qpos"], environment.table["qvel"]
        torch.testing.assert_close(
            value[f"joint_coordinates/{joint.name}"], qpos[:, joint.qposadr[0]]
        )
        torch.testing.assert_close(
            value[f"joint_velocities/{joint.name}"], qvel[:, joint.dofadr[0]]
        )
    pitch = environment.table["torso_angles"][:, 0]
    torch.testing.assert_close(value["torso_angles/pitch"], pitch)
    height = environment.table["torso_position"][:, 2]
    torch.testing.assert_close(value["torso_position/z"], height)
    assert len(columns) == environment.observation_shapes["state"][0]


def test_columns_of_a_row_and_of_none_that_have_names() -> None:
    worlds = Worlds("miniature/go", 1)
    assert worlds.columns == {"state": ("offset/x", "offset/y", "velocity/x", "velocity/y")}
    row = flattened(worlds.environment.reset(0))
    table = worlds.environment.table
    torch.testing.assert_close(row[:, 2:], table["velocity"])
    worlds.environment.parts.encoders["state"].part.columns = ()
    assert worlds.columns == {"state": ("0", "1", "2", "3")}
    worlds.environment.parts.encoders["state"].part.columns = ("x",)
    with pytest.raises(ConfigError, match=r"names 1 columns; its shape is \(4,\)"):
        worlds.environment.reset(0)


def test_on_the_command_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["describe", "task/miniature/go", "--columns"]) == 0
    assert capsys.readouterr().out.splitlines()[:2] == ["state [4]", "     0  offset/x"]
    assert main(["describe", "learner/ppo", "--columns"]) == 2
    assert "--columns takes a task, an experiment or a run folder" in capsys.readouterr().err


def test_what_parts_can_read(capsys: pytest.CaptureFixture[str]) -> None:
    """Each field of the task's table in a line, and those that words add; what is refused names the option."""
    mean = "memory.mean={name: running_mean, reads: {value: root_heading}}"
    assert main(["describe", "--fields", "task/spacetime/walk", mean]) == 0
    *lines, _, ends = capsys.readouterr().out.splitlines()
    assert ends.endswith(
        "end_effectors, in their order: right_wrist, left_wrist, right_ankle, left_ankle."
    )
    rows = [line.split() for line in lines]
    found = {name: (" ".join(row[:-1]), row[-1]) for name, *row in rows}
    table = built("spacetime/walk", mean).table
    assert found.keys() == table.shapes.keys()
    assert found["com_position"] == ("[3]", "fields.kinematics")
    assert found["xipos"] == (str(list(table.shapes["xipos"])) + " the", "simulator")
    assert found["mean"] == ("[]", "memory.mean")
    assert main(["describe", "learner/ppo", "--fields"]) == 2
    assert "--fields takes a task, an experiment or a run folder" in capsys.readouterr().err
    assert main(["describe", "task/spacetime/walk", "--fields", "--columns"]) == 2
    assert "--columns" in capsys.readouterr().err


def heads(text: str) -> list[str]:
    return [line for line in text.splitlines() if line[0] != " "]


def test_as_overrides_change_it_and_what_reads_it(capsys: pytest.CaptureFixture[str]) -> None:
    more = ["encoder.extra={name: miniature/reach}", "encoder.other={name: miniature/reach}"]
    words = ["--columns", "experiment/miniature/go", *more, "policy.critic=[state,extra]"]
    assert main(["describe", *words]) == 0
    assert heads(capsys.readouterr().out) == [
        "state [4], read by actor and critic",
        "extra [4], read by critic",
        "other [4], read by no network",
    ]
    assert main(["describe", "learner/ppo", "learner.gamma=0.9"]) == 2
    assert "KEY=VALUE goes with --observations, --columns" in capsys.readouterr().err


def test_in_a_line_each(capsys: pytest.CaptureFixture[str]) -> None:
    """What ``--columns`` has, without the columns."""
    words = ["experiment/spacetime/walk", "encoder.extra={name: deepmimic/state}"]
    assert main(["describe", "--columns", *words]) == 0
    expected = heads(capsys.readouterr().out)
    assert main(["describe", "--observations", *words]) == 0
    found = capsys.readouterr().out.splitlines()
    assert found == expected
    assert len(found) == 3
    assert "read by no network" in found[-1]
    assert main(["describe", "learner/ppo", "--observations"]) == 2
    assert "--observations takes a task, an experiment or a run" in capsys.readouterr().err


def test_of_a_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["experiment=miniature/go", "encoder.extra={name: miniature/reach}", "device=cuda"]
    create(load_experiment([*words, f"run.dir={tmp_path / 'run'}"]), words, {})
    assert main(["describe", "--columns", str(tmp_path / "run")]) == 0
    expected = ["state [4], read by actor and critic", "extra [4], read by no network"]
    assert heads(capsys.readouterr().out) == expected
    read = "policy.observation=[state,extra]"
    assert main(["describe", "--columns", str(tmp_path / "run"), read]) == 0
    assert "extra [4], read by actor and critic" in capsys.readouterr().out


@pytest.mark.parametrize("flag", [[], ["--columns"]])
def test_a_kind_and_a_name_apart(flag: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["describe", "task", "deepmimic/walk", *flag]) == 2
    assert "Did you mean `understudy describe task/deepmimic/walk`?" in capsys.readouterr().err


def test_what_is_printed_fits_a_screen() -> None:
    experiment = load_experiment(["experiment=miniature/go", "num_worlds=8"])
    made = build_environment(experiment)
    made.environment.reset(0)
    policy = build_policy(experiment, made.context)
    rollout = Collector(made.environment, policy, 0).collect(3)
    text = repr(made.environment)
    assert text == "Environment(8 worlds on cpu, 10 Hz; sees state [4]; acts 2)"
    assert repr(rollout).startswith("Rollout(3 decisions of 8 worlds on cpu; state [3, 8, 4]")
    assert "learner=ppo" in repr(experiment)
    assert max(map(len, map(repr, (experiment, rollout)))) < 800

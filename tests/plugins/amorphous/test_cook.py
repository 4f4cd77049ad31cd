"""A figure that follows a recorded tool (section 4.4): eq. 13 and 14, the command, and what it writes."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import understudy_amorphous
from understudy.command import cli
from understudy.errors import FileError, UnderstudyError
from understudy.records import runs
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import installed
from understudy_amorphous.character import GRIPS, TABLE, TOOL, Figure, Grip, figure, placed
from understudy_amorphous.character_command import TOLERANCE, limits_met, top_speed
from understudy_amorphous.character_drawing import draw
from understudy_amorphous.report import MapsSection
from understudy_amorphous.scene import TOOLS, AmorphousScene
from understudy_characters.character import load_character
from understudy_motion.readers import npz
from understudy_motion.reading import read_clip

pytest.importorskip("mink", reason="mink is not installed (pip install 'understudy[ik]')")

from understudy_amorphous.inverse_kinematics import Motion, Options, follow

DT = 1 / 30
Path_ = tuple[np.ndarray, np.ndarray]
#: A shoulder, an elbow and a wrist of three, two and two hinges, and a trunk that only stands.
ARM = """
<mujoco><compiler angle="degree" autolimits="true"/><worldbody>
  <body name="trunk" pos="0 0 1.3"><freejoint/><geom size=".1"/>
    <body name="upper" pos="0 -.2 0">
      <joint axis="0 -1 0" range="-60 180"/><joint axis="-1 0 0" range="-75 180"/>
      <joint axis="0 0 1" range="-90 90"/>
      <geom type="capsule" fromto="0 0 0 0 0 -.3" size=".03"/>
      <body name="lower" pos="0 0 -.3">
        <joint axis="0 -1 0" range="0 150"/><joint axis="0 0 1" range="-90 90"/>
        <geom type="capsule" fromto="0 0 0 0 0 -.25" size=".03"/>
        <body name="fist" pos="0 0 -.25">
          <joint axis="1 0 0" range="-80 80"/><joint axis="0 -1 0" range="-40 40"/>
          <geom size=".03"/><site name="holds" xyaxes="0 0 -1 0 1 0"/>
        </body></body></body></body></worldbody>
  <keyframe><key qpos="0 0 1.3 1 0 0 0  .4 .2 0 1.3 0 0 0"/></keyframe>
</mujoco>"""


def circle(
    radius: float = 3.0, turn: float = 0.8, seconds: float = 6.0, height: float = 0.0
) -> Path_:
    """Once around the table at `radius` m, turning to either side by `turn` rad."""
    t = np.linspace(0.0, 2 * np.pi, round(seconds / DT) + 1)
    place = np.stack([radius * np.cos(t), radius * np.sin(t), np.full_like(t, height)], axis=1)
    yaw = 0.5 + turn * np.sin(2 * t)
    return place, Rotation.from_euler("z", yaw[:, None]).as_quat(scalar_first=True)


def toss() -> Path_:
    """A pan that goes up, down and around, and tilts by half a radian."""
    t = np.arange(0.0, 4.0, DT)
    place = [0.5 * np.sin(1.7 * t), 0.5 * np.sin(1.1 * t), 1.7 + 0.3 * np.sin(4 * t)]
    tilt = 0.5 * np.sin(3 * t)
    return np.stack(place, axis=1), Rotation.from_euler("y", tilt[:, None]).as_quat(
        scalar_first=True
    )


def holding(tool: str = "scraper", grip: Grip | None = None, *, turning: bool = False) -> Figure:
    return figure(
        "amorphous/cook",
        "right_grip",
        TOOLS[tool](),
        grip or GRIPS[tool],
        installed().registry,
        turning=turning,
    )


def followed(held: Figure, grip: Grip, path: Path_, **options: Any) -> Motion:
    """How the figure follows `path`, a path of the run's world."""
    placement = placed(grip, path[1])
    return follow(
        held.model,
        TOOL,
        placement.points(path[0]),
        placement.orientations(path[1]),
        dt=DT,
        start=held.start,
        still=held.still,
        apart=held.apart,
        options=Options(**options),
    )


def assert_within_ranges(model: mujoco.MjModel, qpos: np.ndarray) -> None:
    for j in range(model.njnt):
        if model.jnt_limited[j]:
            low, high = model.jnt_range[j]
            angles = qpos[:, model.jnt_qposadr[j]]
            assert low <= angles.min() <= angles.max() <= high, model.joint(j).name


def touching(held: Figure, qpos: np.ndarray) -> float:
    """m: the least distance of the geoms that are to stay apart; negative where they overlap."""
    data, least = mujoco.MjData(held.model), np.inf
    for pose in qpos:
        data.qpos[:] = pose
        mujoco.mj_kinematics(held.model, data)
        for group, others in held.apart:
            for a in group:
                for b in others:
                    d = mujoco.mj_geomDistance(held.model, data, a, b, 0.1, np.zeros(6))
                    least = min(least, d)
    return least


@pytest.mark.parametrize(
    ("tool", "path"),
    [("scraper", circle()), ("scraper", circle(4.5, 0.5)), ("pan", toss())],
    ids=["middle", "edge", "pan"],
)
def test_the_tool_is_followed_within_the_joints_limits(tool: str, path: Path_) -> None:
    held = holding(tool)
    motion = followed(held, GRIPS[tool], path)
    assert motion.position_error.max() < 1e-5
    assert motion.orientation_error.max() < 1e-4
    assert_within_ranges(held.model, motion.qpos)
    assert touching(held, motion.qpos) > 0.0
    assert top_speed(held, motion.qpos, DT)[0] < 8.0
    root = held.character.root_address
    assert np.ptp(motion.qpos[:, root : root + 7], axis=0).max() < 1e-6


def test_the_errors_are_those_of_the_model() -> None:
    """What `follow` says, forward kinematics says too, within reach and out of it."""
    held, grip = holding(), GRIPS["scraper"]
    path = circle(9.0, seconds=1.5)
    motion, placement = followed(held, grip, path), placed(grip, path[1])
    places, turns = placement.points(path[0]), placement.orientations(path[1])
    data = mujoco.MjData(held.model)
    for frame in range(0, len(places), 5):
        data.qpos[:] = motion.qpos[frame]
        mujoco.mj_kinematics(held.model, data)
        away = np.linalg.norm(data.body(TOOL).xpos - places[frame])
        between = Rotation.from_quat(data.body(TOOL).xquat, scalar_first=True).inv()
        turned = (between * Rotation.from_quat(turns[frame], scalar_first=True)).magnitude()
        assert motion.orientation_error[frame] == pytest.approx(turned, abs=1e-6)
        assert motion.position_error[frame] == pytest.approx(away, abs=1e-9)
    assert motion.position_error.max() > 0.05
    assert_within_ranges(held.model, motion.qpos)


def test_each_pose_is_the_nearest_to_the_one_before() -> None:
    """Eq. 13: of the step between two frames nothing is left along which the tool would not move."""
    held, grip = holding(), GRIPS["scraper"]
    motion = followed(held, grip, circle(2.0, 0.3), cost="equal", relax=0.0)
    model, data = held.model, mujoco.MjData(held.model)
    jacobian, step = np.zeros((6, model.nv)), np.zeros(model.nv)
    checked = 0
    for before, after in zip(motion.qpos[:-1], motion.qpos[1:], strict=True):
        free = np.ones(model.nv, bool)
        free[list(held.still)] = False
        for j in range(model.njnt):
            if model.jnt_limited[j]:
                angle, (low, high) = after[model.jnt_qposadr[j]], model.jnt_range[j]
                free[model.jnt_dofadr[j]] &= low + 1e-6 < angle < high - 1e-6
        data.qpos[:] = after
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_jacBody(model, data, jacobian[:3], jacobian[3:], model.body(TOOL).id)
        mujoco.mj_differentiatePos(model, step, 1.0, before, after)
        reduced = jacobian[:, free]
        left = step[free] - np.linalg.pinv(reduced) @ reduced @ step[free]
        assert np.abs(left).max() < 1e-4 + 0.01 * np.abs(step).max()
        checked += 1
    assert checked == 180
    assert np.abs(np.diff(motion.qpos, axis=0)).max() > 1e-3


def test_a_joint_costs_the_mass_that_it_moves() -> None:
    held, grip, path = holding(), GRIPS["scraper"], circle(3.0, 0.3, seconds=3.0)
    chest = [held.model.joint(name).qposadr[0] for name in held.limbs if "chest" in name]
    moved = {
        cost: np.ptp(followed(held, grip, path, cost=cost).qpos[:, chest], axis=0).sum()
        for cost in ("mass", "equal")
    }
    assert moved["mass"] < 0.8 * moved["equal"]


def test_joints_are_no_faster_than_allowed_and_catch_up() -> None:
    held, grip = holding(), GRIPS["scraper"]
    place, turn = circle(2.0, 0.0)
    place[40:80] = place[40] + np.array([0.0, 1.5, 0.0])  # 9 cm away at once
    place[80:] = place[80]
    motion = followed(held, grip, (place, turn), speed=1.0)
    assert top_speed(held, motion.qpos, DT)[0] <= 1.0 + 1e-6
    assert motion.position_error[40] > 0.02
    assert motion.position_error[70] < 1e-5
    assert motion.position_error[-1] < 1e-5


def test_the_arm_stays_out_of_the_table() -> None:
    """The fist on the tool's own edge would be 4 cm deep in the table."""
    grip = replace(GRIPS["scraper"], tool=(0.0, 0.0, 0.0, 0.0, 0.0, 0.0), rod=(0.0, 0.0))
    held = holding(grip=grip)
    motion = followed(held, grip, circle(2.0, 0.2, seconds=1.0))
    assert touching(held, motion.qpos) > 0.0
    np.testing.assert_allclose(motion.position_error, 0.044, atol=0.001)  # and 5 mm above it


def test_a_tool_that_turns_in_the_hand_goes_all_the_way_around() -> None:
    place, turn = circle(1.5, 0.0, seconds=4.0)
    yaw = np.linspace(0.0, 2 * np.pi, len(place))
    turn = Rotation.from_euler("z", yaw[:, None]).as_quat(scalar_first=True)
    grip = replace(GRIPS["scraper"], facing=None)
    fixed = followed(holding(), grip, (place, turn))
    assert fixed.orientation_error.max() > np.radians(10)
    held = holding(turning=True)
    motion = followed(held, grip, (place, turn))
    assert motion.orientation_error.max() < 1e-4
    assert motion.position_error.max() < 1e-5
    assert held.limbs[-1] == f"{TOOL}_turn"


def test_any_figure_with_a_hand_will_do(tmp_path: Path) -> None:
    file = tmp_path / "arm.xml"
    file.write_text(ARM)
    grip = replace(GRIPS["scraper"], scale=0.05, table=(0.4, -0.2, 1.0), facing=0.3)
    held = figure(str(file), "holds", TOOLS["scraper"](), grip, installed().registry)
    motion = followed(held, grip, circle(1.0, 0.2))
    assert motion.position_error.max() < 1e-5
    assert_within_ranges(held.model, motion.qpos)
    assert held.character.joint_names == ("trunk", "upper", "lower", "fist")


def test_balls_turn_too() -> None:
    """The humanoid's trunk and shoulder are balls; it has no wrist, but the tool turns in its hand."""
    turned = (-0.1, 0.03, -0.05, 0.0, 0.5 * np.pi, 0.0)
    grip = Grip(scale=0.03, tool=turned, table=(0.42, -0.2, 1.0), facing=None)
    tool, registry = TOOLS["scraper"](), installed().registry
    held = figure("humanoid", "right_wrist", tool, grip, registry, turning=True)
    place, turn = circle(1.0, 0.2, seconds=2.0)
    motion = followed(held, grip, (place - [3.0, 0.0, 0.0], turn))
    assert motion.position_error.max() < 1e-5
    assert_within_ranges(held.model, motion.qpos)
    assert top_speed(held, motion.qpos, DT)[0] <= 10.0 + 1e-6


def test_the_mean_direction_is_where_the_grip_says() -> None:
    turn = Rotation.from_euler("z", [[3.0], [3.2], [3.4]]).as_quat(scalar_first=True)
    placement = placed(replace(GRIPS["scraper"], facing=0.8), turn)
    forward = Rotation.from_quat(placement.orientations(turn), scalar_first=True).apply([1, 0, 0])
    np.testing.assert_allclose(np.arctan2(forward[:, 1], forward[:, 0]), [0.6, 0.8, 1.0])
    point = placement.points(np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(point, np.add(GRIPS["scraper"].table, (0, 0, 0.06)))


def test_limits_met_counts_frames() -> None:
    held = holding()
    qpos = np.tile(held.start, (4, 1))
    joint = held.model.joint("right_wrist_tilt")
    qpos[1:, joint.qposadr[0]] = joint.range[1]
    assert limits_met(held, qpos) == (0.75, "right_wrist_tilt")
    assert limits_met(held, qpos[:1]) == (0.0, "")


# ------------------------------------------------------------------ the command

#: With sixteen particles.
OVERRIDES = [
    "experiment=amorphous/gather_small",
    "scene.blocks=1",
    "scene.block=[4,4,1]",
    "curriculum.most=1",
]


@pytest.fixture
def recorded(tmp_path: Path) -> Callable[..., Path]:
    """A run folder of the small gathering with this path of the tool; nothing is trained."""

    def make(path: Path_, **changed: Any) -> Path:
        overrides = [*OVERRIDES, f"run.dir={tmp_path / 'run'}"]
        runs.create(load_experiment(overrides), overrides, {}).unlock()
        frames = len(path[0])
        material = np.random.default_rng(0).uniform(0.1, 1.0, (16, 3))
        arrays: dict[str, Any] = {
            "control_dt": DT,
            "first_episode": frames - 1,
            "tool_position": path[0].astype(np.float32),
            "tool_orientation": path[1].astype(np.float32),
            "particle_position": np.tile(material, (frames, 1, 1)).astype(np.float32),
            "active_particles": np.ones((frames, 16), np.float32),
            "goal": np.zeros((frames, 2), np.float32),
            **changed,
        }
        np.savez(tmp_path / "run" / "recording.npz", **arrays)
        return tmp_path / "run"

    return make


def command(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    status = cli.main(["amorphous", "character", *map(str, arguments)])
    shown = capsys.readouterr()
    return status, shown.out, shown.err


@pytest.mark.parametrize("ending", ["npz", "bvh"])
def test_the_clip_is_the_motion(
    recorded: Callable[..., Path], capsys: pytest.CaptureFixture[str], tmp_path: Path, ending: str
) -> None:
    """Written, read, and put on the cook again, it has the tool where it was recorded."""
    path = circle(3.0, 0.5, seconds=2.0)
    out = tmp_path / f"cook.{ending}"
    status, shown, _ = command(capsys, recorded(path), out, "--no-video")
    assert status == 0
    for expected in (
        "0.000 mm and 0.000°",
        "at its limit in",
        "rad/s",
        "60 frames",
        "understudy export",
    ):
        assert expected in shown
    registry, held, grip = installed().registry, holding(), GRIPS["scraper"]
    clip = read_clip(out, registry)
    assert clip.num_frames == 60
    assert clip.duration == pytest.approx(59 * DT, rel=1e-5)
    qpos = load_character("amorphous/cook", registry).qpos(clip).numpy()
    assert_within_ranges(held.model, np.clip(qpos, -10, 10).round(9) * (1 - 1e-6))
    places = placed(grip, path[1][:60]).points(path[0])
    data = mujoco.MjData(held.model)
    for frame in range(60):
        data.qpos[:] = qpos[frame]
        mujoco.mj_kinematics(held.model, data)
        assert np.linalg.norm(data.body(TOOL).xpos - places[frame]) < 1e-4


def test_the_exporters_take_it(
    recorded: Callable[..., Path], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    run = recorded(circle(2.0, 0.2, seconds=1.0))
    assert command(capsys, run, "--no-video")[0] == 0
    for name in ("cook.glb", "cook.csv"):
        assert cli.main(["export", str(run / "character.npz"), str(tmp_path / name)]) == 0
        assert "joints of amorphous/cook" in capsys.readouterr().out
        assert (tmp_path / name).stat().st_size > 10_000


def test_out_of_reach_is_one_sentence_and_nothing_is_written(
    recorded: Callable[..., Path], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    run = recorded(circle(9.0, 0.2, seconds=1.0))
    before = sorted(run.iterdir())
    status, shown, error = command(capsys, run)
    assert (status, shown) == (2, "")
    assert "out of reach from" in error
    assert error.count("\n") == 1
    away = float(error.split("the hand stays ")[1].split(" mm")[0])
    assert 50 < away < 700
    assert sorted(run.iterdir()) == before
    status, shown, _ = command(capsys, run, tmp_path / "near.npz", "--nearest", "--no-video")
    assert status == 0
    assert "It is out of reach in" in shown


def test_turning_in_the_hand_is_an_option(
    recorded: Callable[..., Path], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    place, turn = circle(1.5, 0.0, seconds=4.0)
    yaw = np.linspace(-2.5, 2.5, len(place))
    turn = Rotation.from_euler("z", yaw[:, None]).as_quat(scalar_first=True)
    run, out = recorded((place, turn)), tmp_path / "cook.npz"
    status, _, error = command(capsys, run, out, "--no-video")
    assert status == 2
    assert "--turn-in-hand" in error
    assert command(capsys, run, out, "--turn-in-hand", "--no-video")[0] == 0
    assert read_clip(out, installed().registry).joint_names[-4] == TOOL


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--hand", "right_gripp"], "Did you mean 'right_grip'"),
        (["--hand", "root"], "no joint between"),
        (["--character", "amorphous/cok"], "Did you mean 'amorphous/cook'"),
        (["--relax", "-1"], "relax"),
        (["--facing", "nan"], "nan is not a finite number"),
        (["--table", "0", "inf", "0"], "inf is not a finite number"),
        (["cook.fbx", "--no-video"], "no format is written to '.fbx'"),
        (["."], "no format is written to '' files"),
    ],
)
def test_what_the_user_can_get_wrong(
    recorded: Callable[..., Path],
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    reason: str,
) -> None:
    status, _, error = command(capsys, recorded(circle(1.0, 0.1, seconds=0.5)), *arguments)
    assert status == 2
    assert reason in error


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"first_episode": 1}, "ended before its second frame"),
        ({"tool_orientation": np.zeros((16, 4), np.float32)}, "not one unit quaternion"),
        ({"tool_position": np.full((16, 3), np.nan, np.float32)}, "not finite"),
        ({"particle_position": np.zeros((16, 9, 3), np.float32)}, "particle_position"),
    ],
)
def test_damaged_recordings(
    recorded: Callable[..., Path],
    capsys: pytest.CaptureFixture[str],
    changed: dict[str, Any],
    reason: str,
) -> None:
    run = recorded(circle(1.0, 0.1, seconds=0.5), **changed)
    status, _, error = command(capsys, run, "--no-video")
    assert status == 2
    assert reason in error
    assert not (run / "character.npz").exists()


def test_without_material_there_is_no_video_and_nothing_is_written(
    recorded: Callable[..., Path], capsys: pytest.CaptureFixture[str]
) -> None:
    run = recorded(circle(1.0, 0.1, seconds=0.5))
    with np.load(run / "recording.npz") as arrays:
        left = {name: arrays[name] for name in arrays.files if name != "particle_position"}
    np.savez(run / "recording.npz", **left)
    status, _, error = command(capsys, run)
    assert status == 2
    assert "no material to draw (particle_position); leave the video out" in error
    assert not (run / "character.npz").exists()
    assert command(capsys, run, "--no-video")[0] == 0


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({}, ""),
        ({"first_episode": 1e300}, ""),
        ({"particle_position": np.zeros((3, 16, 3))}, "'particle_position': its shape is"),
        ({"goal": np.full((16, 2), np.nan)}, "'goal' is not finite"),
        ({"tool_position": np.zeros((10**5, 3))}, "the arrays are larger than"),
    ],
    ids=["sound", "episode", "frames", "nan", "large"],
)
def test_maps_of_a_recording(
    recorded: Callable[..., Path],
    changed: dict[str, Any],
    reason: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(npz, "MAX_ARRAY_BYTES", 10**6)
    run = runs.open_run(recorded(circle(1.0, 0.1, seconds=0.5), **changed))
    run.config["encoder"] = {"maps": {"name": "amorphous/maps"}}
    if reason:
        with pytest.raises(FileError, match=reason):
            MapsSection().html(run)
    else:
        html = MapsSection().html(run)
        assert html is not None
        assert "Density" in html


def test_a_run_without_a_recording(
    recorded: Callable[..., Path], capsys: pytest.CaptureFixture[str]
) -> None:
    run = recorded(circle(1.0, 0.1, seconds=0.5))
    (run / "recording.npz").unlink()
    status, _, error = command(capsys, run)
    assert status == 2
    assert "understudy render" in error


def test_without_mink_there_is_one_sentence(
    recorded: Callable[..., Path],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "mink", None)
    monkeypatch.delitem(sys.modules, "understudy_amorphous.inverse_kinematics")
    monkeypatch.delattr(understudy_amorphous, "inverse_kinematics")
    status, _, error = command(capsys, recorded(circle(1.0, 0.1, seconds=0.5)))
    assert status == 2
    assert "pip install 'understudy[ik]'" in error


def test_figure_tool_and_material_are_drawn() -> None:
    held, grip = holding(), GRIPS["scraper"]
    path = circle(2.0, 0.2, seconds=0.5)
    motion, placement = followed(held, grip, path), placed(grip, path[1])
    scene = AmorphousScene(AmorphousScene.Options(blocks=1, block=(4, 4, 1)), None)  # type: ignore[arg-type]
    particles = scene.model()
    shown = np.tile(particles.positions, (3, 1, 1))
    there = np.ones(shown.shape[:2])
    there[1] = 0.0  # in the second picture there is no material
    tracks = {"particle_position": shown, "active_particles": there}
    qpos = motion.qpos[[0, 0, 10]]
    try:
        with_it, without, later = draw(held, qpos, particles, tracks, placement, 320, 180)
    except UnderstudyError as error:
        pytest.skip(str(error))
    differs = np.abs(with_it.astype(int) - without).max(axis=2) > 20
    assert 10 < differs.sum() < 1500
    assert (np.abs(later.astype(int) - with_it).max(axis=2) > 20).sum() > 100


def test_the_table_is_under_the_run() -> None:
    held, grip = holding(), GRIPS["scraper"]
    data = mujoco.MjData(held.model)
    mujoco.mj_kinematics(held.model, data)
    table = held.model.geom(TABLE)
    top = data.geom(TABLE).xpos[2] + table.size[2]
    assert top == pytest.approx(grip.table[2])
    assert TOLERANCE[0] == 1e-3

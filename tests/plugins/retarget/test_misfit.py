"""A clip of a human on figures that are none: it is said, and learning it is not offered."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path

import pytest
from robots import robot_xml

from understudy.command.cli import main

LEG = """<body name="{name}_hip" pos="{x} {y} 0"><joint axis="1 0 0" range="-1 1"/><geom size=".04" mass=".5"/>
  <body name="{name}_thigh"><joint axis="0 1 0" range="-1.6 1.6"/>
    <geom type="capsule" fromto="0 0 0 0 0 -.2" size=".025" mass=".8"/>
    <body name="{name}_calf" pos="0 0 -.2"><joint axis="0 1 0" range="-2.6 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 -.2" size=".02" mass=".3"/></body></body></body>"""


def dog(names: tuple[str, str, str, str]) -> str:
    legs = "".join(
        LEG.format(name=name, x=x, y=y)
        for name, (x, y) in zip(
            names, ((0.19, 0.08), (0.19, -0.08), (-0.19, 0.08), (-0.19, -0.08)), strict=True
        )
    )
    return f"""<mujoco><compiler angle="radian"/><worldbody><body name="trunk" pos="0 0 .45"><freejoint/>
        <geom type="box" size=".2 .08 .06" mass="6"/>{legs}</body></worldbody></mujoco>"""


def retargeted(folder: Path, text: str, clip: str = "walk") -> list[str]:
    (folder / "figure.xml").write_text(text)
    return ["motion", "retarget", clip, str(folder / "figure.xml"), str(folder / "out.npz")]


@pytest.mark.parametrize(
    "names",
    [
        ("FL", "FR", "RL", "RR"),
        ("front_left", "front_right", "rear_left", "rear_right"),
        ("left_front", "right_front", "left_hind", "right_hind"),
    ],
)
def test_a_quadruped(
    names: tuple[str, str, str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = retargeted(tmp_path, dog(names))
    assert main(arguments) == 0
    said = capsys.readouterr()
    assert "is not built for this motion: key points are missed by" in said.err
    assert "To learn it" not in said.out
    assert (tmp_path / "out.npz").is_file()
    assert main([*arguments, "--overwrite", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["fits"] is False


@pytest.mark.skipif(not importlib.util.find_spec("gymnasium"), reason="needs Gymnasium's models")
def test_gymnasiums_ant(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    origin = importlib.util.find_spec("gymnasium")
    assert origin is not None
    ant = Path(str(origin.origin)).parent / "envs" / "mujoco" / "assets" / "ant.xml"
    assert main(["motion", "retarget", "walk", str(ant), str(tmp_path / "out.npz")]) == 0
    said = capsys.readouterr()
    assert "is not built for this motion" in said.err
    assert "To learn it" not in said.out


@pytest.mark.parametrize("clip", ["walk", "cartwheel", "sit"])
def test_a_robot_like_a_human(
    clip: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(retargeted(tmp_path, robot_xml(), clip)) == 0
    said = capsys.readouterr()
    assert "is not built for this motion" not in said.err
    assert "To learn it" in said.out

"""A grip: how a hand holds a tool, at some angles between its parts; as a JSON file. Some come with the package."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from understudy.errors import ConfigError, FileError
from understudy.folders import read, write_atomically
from understudy_gripping.hold import Held, hold, placed
from understudy_gripping.styles import Style, read_style, written
from understudy_hand.scene import HandScene
from understudy_hand.table import ARM_POSE, Measures
from understudy_hand.tools import GRIPPERS, Tool, upper_pose

__all__ = ["Grip", "load_grip"]

_VERSION = 1
#: bytes that a file of a grip may have.
LARGEST = 1 << 20
TOOLS = {"sticks": "two sticks", "tongs": "tongs", "brush": "a brush", "none": "no tool"}
THE_TOOL = {"sticks": "the sticks", "tongs": "the tongs", "brush": "the brush"}


@dataclass(frozen=True)
class Grip:
    """K angles, H hinges of the hand; m, rad, in the palm's frame. The lower part of a tool that has one is that one."""

    measures: Measures  #: of the hand
    style: Style
    places: tuple[float, ...]  #: by finger that touches, along its part: x of section 5.5.3
    hinges: tuple[str, ...]
    lower: np.ndarray  #: (7,) the lower part's position and rotation, at all angles
    angles: np.ndarray  #: (K,) by which the parts are closed, rising
    poses: np.ndarray  #: (K, H)
    targets: np.ndarray  #: (K, H) of the servos, which press as much as holds the tool
    tool: Tool = "sticks"
    #: Whether it holds the tool without a policy; the T-pose of figure 5.6 does not touch it.
    holds: bool = True
    robot: str = ""  #: the model of the hand (``HandScene.robot``); empty is the human one

    @property
    def upper(self) -> np.ndarray:
        """(K, 7) the upper part's position and rotation; of a tool of one part that one's."""
        angles = torch.from_numpy(self.angles)
        lower = torch.from_numpy(self.lower).expand(len(angles), 7)
        if (gripper := GRIPPERS.get(self.tool)) is None:
            return lower.numpy()
        return torch.cat(upper_pose(lower[:, :3], lower[:, 3:], angles, gripper), dim=1).numpy()

    @property
    def touching(self) -> tuple[str, ...]:
        """The fingers that touch a stick."""
        return tuple(f for f, s in zip(self.measures.names, self.style, strict=True) if s)

    def need(self, scene: HandScene) -> None:
        """Raises:
        ConfigError: it is a grip of another hand than the scene's, or of another tool.
        """
        if scene.options.tool != self.tool:
            raise ConfigError(
                f"The grip {written(self.style)} holds {TOOLS[self.tool]}, and the scene has "
                f"{TOOLS[scene.options.tool]}. Set scene.tool={self.tool}, or another grip."
            )
        if scene.robot != self.robot:
            hands = [name or "the human one" for name in (self.robot, scene.robot)]
            raise ConfigError(
                f"The grip {written(self.style)} is one of another hand: {hands[0]}, and the scene's is {hands[1]}. "
                "Set another scene, such as scene=hand/adroit, or another grip."
            )
        if scene.measures != self.measures:
            raise ConfigError(
                f"The grip {written(self.style)} is one of a hand with {_said(self.measures)}, and the "
                f"scene's has {_said(scene.measures)}. Find one: understudy grip STYLE FILE --fingers "
                f"{scene.measures.fingers} --finger-length {scene.measures.finger_length:g} --size "
                f"{scene.measures.size:g}, then grip.file=FILE."
            )
        model = scene.model
        hand = tuple(model.joint(j).name for j in range(len(ARM_POSE), scene.hinges))
        if len(hand) != len(self.hinges) or (not self.robot and hand != self.hinges):
            raise ConfigError(
                f"The grip {written(self.style)} names other hinges than the scene's hand has. Find it anew: "
                "understudy grip STYLE FILE."
            )

    def held(self, scene: HandScene, row: int, seconds: float, settle: float = 0.5) -> Held:
        """The grip at its angle number `row`, simulated under its targets."""
        data = placed(scene, np.array(ARM_POSE), self.poses[row], self.upper[row], self.lower)
        return hold(scene, data, np.array([*ARM_POSE, *self.targets[row]]), seconds, settle)

    def save(self, path: Path) -> None:
        values = {
            "version": _VERSION,
            "hand": asdict(self.measures),
            "tool": self.tool,
            "style": written(self.style),
            "places": rounded(self.places),
            "hinges": list(self.hinges),
            **{n: rounded(getattr(self, n)) for n in ("lower", "angles", "poses", "targets")},
            **({} if self.holds else {"holds": False}),
            **({"robot": self.robot} if self.robot else {}),
        }
        lines = ",\n".join(f" {json.dumps(k)}: {json.dumps(v)}" for k, v in values.items())
        write_atomically(path, f"{{\n{lines}\n}}\n".encode())


def _said(measures: Measures) -> str:
    return (
        f"{measures.fingers} fingers, finger_length {measures.finger_length:g} and size "
        f"{measures.size:g}"
    )


def rounded(values: Any) -> Any:
    return np.round(np.asarray(values, np.float64), 7).tolist()


def load_grip(path: Path) -> Grip:
    """The grip in the JSON file `path`, as :meth:`Grip.save` writes it.

    Raises
    ------
    FileError
        the file is missing, or no grip.
    """
    try:
        values = json.loads(read(path, LARGEST))
        if not isinstance(values, dict) or values.get("version") != _VERSION:
            raise ValueError(f"it is not of version {_VERSION}")
        measures = Measures(
            int(values["hand"]["fingers"]), *(float(values["hand"][k]) for k in ("finger_length", "size"))
        )  # fmt: skip
        tool = values.get("tool", "sticks")  # what the first of these files were of
        if tool not in THE_TOOL:
            raise ValueError(f"there is no tool {tool!r}")
        if not isinstance(holds := values.get("holds", True), bool):
            raise ValueError("holds is neither true nor false")
        style = read_style(str(values["style"]), measures.fingers, tool)
        hinges = tuple(map(str, values["hinges"]))
        if len(set(hinges)) != len(hinges) or not hinges:
            raise ValueError("its hinges are not named each once")
        rows = len(values["angles"])
        grip = Grip(
            measures,
            style,
            tuple(_numbers(values, "places", (sum(map(bool, style)),)).tolist()),
            hinges,
            _numbers(values, "lower", (7,)),
            _numbers(values, "angles", (rows,)),
            _numbers(values, "poses", (rows, len(hinges))),
            _numbers(values, "targets", (rows, len(hinges))),
            tool,
            holds,
            str(values.get("robot", "")),
        )
        if rows < 2 or (np.diff(grip.angles) <= 0).any():
            raise ValueError("its angles are not two or more that rise")
        if not math.isclose(np.linalg.norm(grip.lower[3:]), 1.0, abs_tol=1e-3):
            raise ValueError("the lower stick's rotation is no unit quaternion")
    except FileNotFoundError as error:
        raise FileError(f"There is no grip at {path}.") from error
    except (
        OSError, ValueError, TypeError, KeyError, ArithmeticError, RecursionError, ConfigError
    ) as error:  # fmt: skip
        # without number and path of the system's
        known = isinstance(error, OSError) and error.strerror
        reason = (
            f"it has no {error}" if isinstance(error, KeyError) else known or str(error).rstrip(".")
        )
        raise FileError(f"{path} is no grip: {reason}.") from error
    return grip


def _numbers(values: dict[str, Any], name: str, shape: tuple[int, ...]) -> np.ndarray:
    found = np.array(values[name])
    if found.shape != shape or found.dtype.kind not in "if" or not np.isfinite(found).all():
        raise ValueError(f"{name} are not {' × '.join(map(str, shape))} finite numbers")
    if np.abs(found).max() > 1e3:
        raise ValueError(f"{name} are larger than any of a hand's")
    return found.astype(np.float64)


def _packaged(name: str) -> Path:
    return Path(__file__).parent / "grips" / f"{name}.json"


def standard() -> Path:
    """The standard style of the human hand, found from the T-pose."""
    return _packaged("standard")


def t_pose() -> Path:
    """Straight fingers beside the sticks (figure 5.6), which hold nothing: what figure 5.22 compares with."""
    return _packaged("t_pose")


#: Other tools in the human hand.
tongs, tongs_wide, brush = (partial(_packaged, name) for name in ("tongs", "tongs_wide", "brush"))
#: Sticks in other hands (section 5.7.3), the last a robot's.
long, large, tri_finger, adroit = (
    partial(_packaged, name) for name in ("long", "large", "tri_finger", "adroit")
)

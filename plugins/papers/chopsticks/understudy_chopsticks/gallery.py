"""The gallery of a search over grips: a card for each style, in one page that needs nothing else."""

from __future__ import annotations

import base64
import time
from collections.abc import Mapping
from dataclasses import asdict
from html import escape
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from understudy import __version__
from understudy.errors import UnderstudyError
from understudy.folders import write_atomically
from understudy.setup.config import Experiment
from understudy_chopsticks.found import best_of_styles, grip_file
from understudy_gripping.grip import Grip, load_grip
from understudy_gripping.hold import hold, placed
from understudy_hand.scene import HandScene
from understudy_hand.table import ARM_POSE
from understudy_mujoco.drawing import draw_motion
from understudy_report.charts import Chart, draw_chart
from understudy_report.page import html_page
from understudy_report.pictures import png
from understudy_sweeps.journal import Journal
from understudy_sweeps.page import SweepPage

#: Degrees around the hand, and above it, from which it is drawn; pixels of a picture.
_VIEWS = ((345.0, -14.0), (285.0, -14.0), (205.0, -20.0))
_SIZE = (400, 320)
#: m, in the palm's frame, and m from there.
_AIM, _DISTANCE = np.array([0.01, -0.06, 0.09]), 0.3
#: m an arrow is long for each N, and thick; its colour.
_PER_NEWTON, _THICK, _ARROW = 0.02, 0.0015, np.array([0.85, 0.1, 0.1, 1.0], np.float32)
#: N: less is not drawn.
_LEAST = 0.05
_STYLE = """
.grips { display: grid; gap: 18px; grid-template-columns: repeat(auto-fill, minmax(min(100%, 560px), 1fr)); }
.grips .views { display: grid; grid-template-columns: repeat(3, 1fr); gap: 4px; }
.grips img { width: 100%; border-radius: 6px; }
.grips h3 { display: flex; margin: 0 0 8px; }
.grips h3 b { margin-left: auto; }
"""


class Gallery(SweepPage):
    """Writes ``gallery.html``: of each style's best grip close-ups from three sides, held for a second without a policy, with the forces on the
    sticks as arrows; its score and its curve."""

    def write(
        self, folder: Path, title: str, experiment: Experiment, journal: Journal
    ) -> Path | None:
        chosen = experiment.one("outer_loop")
        # By name: its class needs the libraries of searches, and every sweep asks here.
        if chosen is None or chosen.component.name != "chopsticks/grips":
            return None
        rows = list(best_of_styles(chosen.build(experiment.root.seed), journal))
        cards = "".join(_card(row, folder) for row in rows)
        most = chosen.options.evaluations
        begun = sum(row["evaluations"] > 0 for row in rows)
        done = sum(row["evaluations"] >= most for row in rows)
        content = (
            f"<p>{begun} of {len(rows)} styles were tried, {done} of them in all of their {most} evaluations. Each card shows the "
            "best grip so far, after a second under fixed targets, without its policy; arrows are forces on the sticks, "
            f"{1e3 * _PER_NEWTON:g} mm for each N.</p><div class='grips'>{cards}</div>"
        )
        path = folder / "gallery.html"
        over = f"understudy gallery of grips · {__version__}"
        page = html_page(title, over, time.strftime("%Y-%m-%d %H:%M"), content, _STYLE)
        write_atomically(path, page)
        return path


def close_ups(grip: Grip) -> list[np.ndarray]:
    """Pictures (H, W, 3) uint8 of the grip in parallel, held for a second under fixed targets, from three sides.

    Raises
    ------
    UnderstudyError
        it is no grip of a human hand, or there is no OpenGL to draw with.
    """
    scene = HandScene(HandScene.Options(**asdict(grip.measures), tool=grip.tool))
    grip.need(scene)
    data = placed(scene, np.array(ARM_POSE), grip.poses[0], grip.upper[0], grip.lower)
    hold(scene, data, np.array([*ARM_POSE, *grip.targets[0]]), 1.0)
    arrows = _forces(scene, data)
    model, camera = scene.shown().compile(), mujoco.MjvCamera()
    camera.distance = _DISTANCE
    palm = model.body("palm").id

    def aim(frame: int, now: mujoco.MjData) -> None:
        camera.azimuth, camera.elevation = _VIEWS[frame]
        camera.lookat = now.xpos[palm] + now.xmat[palm].reshape(3, 3) @ _AIM

    def more(frame: int, now: mujoco.MjData, drawn: mujoco.MjvScene) -> None:
        for begin, end in arrows:
            geom, kind = drawn.geoms[drawn.ngeom], mujoco.mjtGeom.mjGEOM_ARROW
            mujoco.mjv_initGeom(geom, kind, np.zeros(3), begin, np.eye(3).ravel(), _ARROW)
            mujoco.mjv_connector(geom, kind, _THICK, begin, end)
            drawn.ngeom += 1

    motion = np.tile(data.qpos, (len(_VIEWS), 1))
    return [picture.copy() for picture in draw_motion(model, motion, _SIZE, camera, aim, more)]


def _forces(scene: HandScene, data: mujoco.MjData) -> list[tuple[np.ndarray, np.ndarray]]:
    """Arrows, from tail to head (m), of the forces of the hand on the tool, from where it is touched: a head is seen beyond it."""
    sticks = {scene.model.geom(name).id for name in scene.tool_bodies}
    found = []
    for number in range(data.ncon):
        contact, force = data.contact[number], np.zeros(6)
        first, second = (int(geom) in sticks for geom in contact.geom)
        if first == second:
            continue
        mujoco.mj_contactForce(scene.model, data, number, force)
        # It is the force on the second geom, in the contact's frame.
        pushed = (1.0 if second else -1.0) * (contact.frame.reshape(3, 3).T @ force[:3])
        if np.linalg.norm(pushed) > _LEAST:
            found.append((contact.pos.copy(), contact.pos + _PER_NEWTON * pushed))
    return found


def _card(row: Mapping[str, Any], folder: Path) -> str:
    name = f"{row['style']} {str(row['name']).replace('_', ' ')}".strip()
    score = "no grip held" if row["score"] is None else f"{row['score']:.3f}"
    held = f"{row['held']} of {row['evaluations']} candidates held the sticks"
    text = f"<h3>{row['rank']}. {escape(name)}<b>{score}</b></h3>"
    if row["score"] is None:
        return f'<div class="card">{text}<p>{held}.</p></div>'
    path = grip_file(folder, row)
    try:
        if path is None:
            raise UnderstudyError("Its run keeps no grip.")
        shown = "".join(
            f'<img alt="from side {k + 1}" src="data:image/png;base64,{base64.b64encode(png(view)).decode()}">'
            for k, view in enumerate(close_ups(load_grip(path)))
        )
        views = f'<div class="views">{shown}</div>'
    except UnderstudyError as error:
        views = f"<p>{escape(str(error))}</p>"
    curve = draw_chart(
        Chart("score", "score", dots=True), [{"samples": x, "score": y} for x, y in row["curve"]]
    )
    said = f"<p>{held}; the best was evaluation {row['evaluation']}, the first to hold had {row['first']:.3f}.</p>"
    return f'<div class="card">{text}{views}{said}{curve}</div>'

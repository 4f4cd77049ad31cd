"""What the tests' fork server has imported: all that a command comes to need, so that its forks begin at once. The
processes of ``make test`` are forks of one that has, too.

Nothing runs here that a fork could see: no thread, no random number, no file.
"""

from __future__ import annotations

import contextlib
import gc
import importlib

import coarse_films
import known_entries
import lazy_choices
import mujoco
import torch

from understudy.setup.composition import load_experiment
from understudy.setup.plugins import installed

#: What takes long, and is imported where it is first needed: by optimisers, films, pages, progress, searches, torch's modes.
LATE = (
    "pytest", "PIL.ImageDraw", "imageio_ffmpeg", "rich.live", "rich.progress", "scipy.optimize",
    "scipy.signal", "scipy.spatial", "tensorboard.summary.writer.event_file_writer", "torch._dynamo", "trimesh", "understudy.testing",
    "understudy_ppo.learner", "understudy_report.page", "understudy_report.video", "understudy_sweeps.processes",
    "commands", "executors", "worlds",
)  # fmt: skip

gc.disable()  # of what imports make hardly anything goes
torch.set_num_threads(1)
lazy_choices.use()
known_entries.use()
for name in LATE:
    importlib.import_module(name)
for component in installed().registry.components.values():
    if component.kind in ("command", "observer", "report_section"):
        with contextlib.suppress(Exception):  # one that cannot be imported is for its test to say
            _ = component.factory
load_experiment(["experiment=miniature/stop"])
mujoco.Renderer.__init__ = coarse_films.coarse
gc.freeze()  # and no fork has to go through it
gc.enable()

"""What two iterations of shipped experiments leave, as one digest each: unchanged where nothing was to change.

Every tensor and number of the whole state counts (worlds, policy, learner, progress), but for measured times.
Before and after a change, on the same machine::

    OMP_NUM_THREADS=1 python tests/digests.py > before.txt      # some minutes; or with names of experiments
"""

from __future__ import annotations

import hashlib
import sys
import tempfile
from collections.abc import Iterator, Mapping
from typing import Any

from torch import Tensor

from understudy.running.training import Training
from understudy.setup.composition import load_experiment
from understudy.signals import StopRequest

#: One of each wing of simulators and learners, with what makes it small.
EXPERIMENTS = {
    "spacetime/walk": ("learner.rollout_steps=16",),
    "spacetime/walk_imagined": (),
    "deepmimic/walk": ("learner.rollout_steps=32",),
    "jumping/high_small": ("learner.rollout_steps=16",),
    "morphology/walk": ("learner.rollout_steps=16",),
    "amorphous/gather_small": ("learner.rollout_steps=8",),
    "sitting/sit_small": ("learner.rollout_steps=16",),
    "chopsticks/open_close_small": ("learner.rollout_steps=16",),
    "pose_vae/generated": (),
    "miniature/jumping": (),
}
SMALL = ("num_worlds=8", "evaluation.episodes=4", "seed=3")


def leaves(state: Any, where: str = "") -> Iterator[tuple[str, bytes]]:
    """By place: the bytes of everything in a nested `state`."""
    if isinstance(state, Mapping):
        for name, value in state.items():
            if name != "seconds" and "progress" not in where:
                yield from leaves(value, f"{where}/{name}")
    elif isinstance(state, list | tuple):
        for i, value in enumerate(state):
            yield from leaves(value, f"{where}/{i}")
    elif isinstance(state, Tensor):
        yield where, state.detach().cpu().contiguous().numpy().tobytes()
    else:
        yield where, repr(state).encode()


def digest(name: str) -> str:
    """Of the state that two iterations and an evaluation of the experiment `name` leave."""
    experiment = load_experiment([f"experiment={name}", *SMALL, *EXPERIMENTS.get(name, ())])
    training = Training(experiment).prepare()
    try:
        rows = [training.iterate() for _ in range(2)]
        judged = training.job.evaluate("digest", 4)
        found = hashlib.sha256()
        for where, content in leaves(training.state_dict()):
            found.update(where.encode() + b"\0" + content)
        found.update(repr((rows[-1]["samples"], judged.as_json(0))).encode())
    finally:
        training.close()
    return found.hexdigest()


if __name__ == "__main__":
    with tempfile.TemporaryDirectory(), StopRequest(at_once=True):
        for each in sys.argv[1:] or EXPERIMENTS:
            print(each, digest(each), flush=True)

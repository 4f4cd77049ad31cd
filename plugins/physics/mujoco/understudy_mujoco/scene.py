"""The scene type that MuJoCo simulators accept, and one read from a file."""

from __future__ import annotations

import hashlib
import json
from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from understudy.errors import FileError
from understudy.inputs import Inputs
from understudy.task import Context, Scene
from understudy_mujoco.contact import Contact
from understudy_mujoco.mjcf import read_mjcf, split_root
from understudy_mujoco.trial import spec_of, try_out

__all__ = ["LICENCES", "MjcfFile", "MujocoScene", "model_digest"]

#: Files beside a model that say on what terms it may be used, which a run keeps with it; and most bytes.
LICENCES = ("LICENSE", "LICENSE.txt", "LICENSE.md", "LICENCE", "LICENCE.txt", "COPYING")
_LICENCE_BYTES = 2**18


def _log_nothing() -> None:
    """Keep MuJoCo from writing each warning to the console and, without end, to MUJOCO_LOG.TXT in
    the working folder; simulators count them (``report``), and errors are exceptions anyway."""
    config = mujoco.MjLogConfig.get()
    config.logto_file = config.logto_console = False
    config.set()


_log_nothing()


def model_digest(model: mujoco.MjModel) -> bytes:
    """SHA-256 of all that `model` has, names and options included: what is computed of it alone need be computed once."""
    content = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, content)
    return hashlib.sha256(content.tobytes()).digest()


class MujocoScene(Scene):
    """A scene that compiles to one ``mujoco.MjModel``."""

    contact = Contact()  #: how contacts are solved, where not as :meth:`spec` has it

    @abstractmethod
    def spec(self) -> mujoco.MjSpec:
        """A fresh model specification, to be compiled or added to."""

    def shown(self) -> mujoco.MjSpec:
        """The same with what is only there to be seen."""
        return self.spec()

    def look(self, model: mujoco.MjModel, tracks: Mapping[str, np.ndarray], frame: int) -> None:
        """Give the `model`, that of :meth:`shown`, the looks that the world had in a `frame` of what was recorded of it, where
        worlds differ in looks."""

    @cached_property
    def model(self) -> mujoco.MjModel:
        """What :meth:`spec` compiles to, to be looked at."""
        return self.spec().compile()

    def compiled(
        self,
        context: Context,
        disable: int = 0,
        compile: Callable[[mujoco.MjSpec], mujoco.MjModel] = mujoco.MjSpec.compile,
    ) -> mujoco.MjModel:
        """The model at the task's physics rate, with the engine's flags `disable` switched off.

        Raises
        ------
        ConfigError
            if its settings do not go together.
        FileError
            if it does not compile.
        """
        spec = self.spec()
        self.contact.apply(spec)
        spec.option.timestep = context.control_dt / context.substeps
        spec.option.disableflags |= disable
        try:
            return compile(spec)
        except (ValueError, RuntimeError, mujoco.FatalError) as error:
            reason = str(error).splitlines()[0]
            raise FileError(f"The scene's model does not compile: {reason}") from error

    def describe(self) -> dict[str, Any]:
        model = self.model
        return {
            "nq": model.nq,
            "nv": model.nv,
            "nu": model.nu,
            "mass_kg": float(model.body_mass.sum()),
        }

    def identity(self) -> Mapping[str, str]:
        """The bodies' that move: their joints in order, where these are and which way they go, to 1 µm."""
        model = self.model
        joints = []
        for i in range(model.njnt):
            body, free = model.jnt_bodyid[i], model.jnt_type[i] == mujoco.mjtJoint.mjJNT_FREE
            lengths = [
                model.jnt_axis[i],
                model.jnt_pos[i],
                model.body_pos[body],
                model.body_quat[body],
            ]
            places = [] if free else [np.rint(v * 1e6).astype(int).tolist() for v in lengths]
            joints.append([model.joint(i).name, int(model.jnt_type[i]), places])
        found = hashlib.sha256(json.dumps(joints).encode()).hexdigest()[:12]
        return {"qpos": f"bodies of {model.njnt} joints ({found})"}


class MjcfFile(MujocoScene):
    """A model from an MJCF or URDF file, which may refer to files of its folder and to nothing else."""

    @dataclass(frozen=True)
    class Options:
        #: Path of the MJCF or URDF file. It may refer to files of its own folder; a double slash in the path
        #: (``package//mjcf/robot.xml``) says from which other folder on.
        file: str
        contact: Contact = field(default_factory=Contact)  #: how contacts are solved

    def __init__(self, options: Options, context: Context | None = None) -> None:
        self.contact = options.contact
        inputs = context.inputs if context else Inputs()
        own, root = split_root(options.file)

        def keep(folder: Path) -> None:
            folder.mkdir(parents=True, exist_ok=True)
            self._mjcf.write(folder / own.name)
            for name in LICENCES:
                if (found := own.parent / name).is_file() and not found.is_symlink():
                    with found.open("rb") as file:
                        (folder / name).write_bytes(file.read(_LICENCE_BYTES))

        folder = inputs.folder_of(f"mjcf {own}", own.parent, keep)
        kept = folder != own.parent
        self._mjcf = read_mjcf(folder / own.name, folder if kept else root)
        try_out(folder / own.name, folder if kept else root, self._mjcf)
        self.attaches = "<attach" in self._mjcf.text  #: whether it has other models in it

    def spec(self) -> mujoco.MjSpec:
        return spec_of(self._mjcf)

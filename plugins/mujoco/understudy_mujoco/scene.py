"""The scene type that MuJoCo simulators accept, and one read from a file."""

from __future__ import annotations

import re
from abc import abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco

from understudy.errors import FileError
from understudy.interfaces import Context, Scene


class MujocoScene(Scene):
    """A scene that compiles to one ``mujoco.MjModel``."""

    @abstractmethod
    def spec(self) -> mujoco.MjSpec:
        """A fresh model specification, to be compiled or added to."""

    def compiled(self, context: Context, disable: int = 0) -> mujoco.MjModel:
        """The model at the task's physics rate, with the engine's flags `disable` switched off.

        Raises
        ------
        FileError
            if it does not compile.
        """
        spec = self.spec()
        spec.option.timestep = context.control_dt / context.substeps
        spec.option.disableflags |= disable
        try:
            return spec.compile()
        except (ValueError, mujoco.FatalError) as error:
            reason = str(error).splitlines()[0]
            raise FileError(f"The scene's model does not compile: {reason}") from error

    def describe(self) -> dict[str, Any]:
        model = self.spec().compile()
        return {
            "nq": model.nq,
            "nv": model.nv,
            "nu": model.nu,
            "mass_kg": float(model.body_mass.sum()),
        }


#: Elements and attributes by which MJCF reaches files other than its own.
_REACHES_OUT = re.compile(
    rb"<\s*(include|plugin|extension)\b|\b(file|meshdir|texturedir|assetdir)\s*=", re.I
)
_MAX_BYTES = 16 << 20


class MjcfFile(MujocoScene):
    """A model from one self-contained MJCF file.

    Includes, plugins and asset files are refused: a model from a stranger must not reach out of its
    own file.
    """

    @dataclass(frozen=True)
    class Options:
        file: str  #: path of the MJCF file

    def __init__(self, options: Options, context: Context | None = None) -> None:
        self._path = Path(options.file)
        try:
            if self._path.stat().st_size > _MAX_BYTES:
                raise FileError(
                    f"{self._path} is larger than {_MAX_BYTES >> 20} MiB; no MJCF model is."
                )
            text = self._path.read_bytes()
        except OSError as error:
            raise FileError(f"The model {self._path} cannot be read: {error.strerror}.") from error
        found = _REACHES_OUT.search(text)
        if found:
            raise FileError(
                f"The model {self._path} refers to other files or plugins "
                f"('{found.group(0).decode(errors='replace')}'); give one self-contained MJCF file."
            )
        self._text = text.decode("utf-8", errors="replace")
        self.spec().compile  # noqa: B018 - parsing is what can fail

    def spec(self) -> mujoco.MjSpec:
        try:
            return mujoco.MjSpec.from_string(self._text)
        except (ValueError, mujoco.FatalError) as error:
            reason = str(error).strip().splitlines()[0]
            raise FileError(f"The model {self._path} does not load: {reason}") from error

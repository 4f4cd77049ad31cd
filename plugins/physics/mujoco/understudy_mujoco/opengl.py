"""What MuJoCo draws with. It decides when it is imported, and fails to import without that library."""

import ctypes
import os
import sys

from understudy.errors import UnderstudyError

_LIBRARIES = {"egl": ("libEGL.so.1",), "osmesa": ("libOSMesa.so.8", "libOSMesa.so.6")}
_OFF = ("disable", "disabled", "off", "false", "0")
_OTHERS = ("glfw", "glx", "enable", "enabled", "on", "true", "1", *_OFF)

#: Why nothing is drawn although ``MUJOCO_GL`` asks for it; empty where that is not so.
_missing = ""


def choose() -> None:
    """Sets ``MUJOCO_GL`` before MuJoCo is imported, on Linux.

    EGL needs no display. Where the library is missing, training goes on without pictures.
    """
    global _missing
    if sys.platform != "linux":
        return
    asked = os.environ.get("MUJOCO_GL", "").lower().strip()
    if asked in _OTHERS:
        return
    name = asked or "egl"
    if name in _LIBRARIES and _loads(_LIBRARIES[name]):
        os.environ["MUJOCO_GL"] = name
        return
    os.environ["MUJOCO_GL"] = "disable"
    if asked in _LIBRARIES:
        _missing = f"MUJOCO_GL={asked} needs {_LIBRARIES[asked][0]}: install it, or leave it unset"
    elif asked:
        _missing = f"MUJOCO_GL={asked} is none of egl, osmesa, glfw, disable"


def _loads(libraries: tuple[str, ...]) -> bool:
    for library in libraries:
        try:
            ctypes.CDLL(library)
            return True
        except OSError:
            continue
    return False


def no_opengl(error: Exception) -> UnderstudyError:
    """What to say where a picture was asked for and ``error`` was what the platform raised."""
    if _missing:
        return UnderstudyError(f"No OpenGL here ({_missing}).")
    if os.environ.get("MUJOCO_GL", "").lower().strip() in _OFF:
        return UnderstudyError("No OpenGL here (MUJOCO_GL says so, or there is no libEGL.so.1).")
    reason = str(error).strip().splitlines()
    return UnderstudyError(f"No OpenGL here ({reason[0] if reason else error}).")

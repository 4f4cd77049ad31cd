"""The simulator as a part of a configuration: what it takes is known without MuJoCo Warp, whose import takes seconds."""

from __future__ import annotations

from dataclasses import dataclass

from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.task import Context, Simulator


class MujocoWarp:
    """Fields are torch views of Warp's arrays, float32; ``ctrl`` is the control.

    A call is one CUDA graph, captured when it is first made: all sub-steps, then everything that
    was ever read at the new state, so that what is read belongs to the same moment. The first read
    of a sensor, and of a force or an acceleration, makes all later calls compute them.

    While the caller captures a CUDA graph of its own, the kernels go into that one.

    On the CPU, where there are no graphs, it computes the same slowly; tests use that.

    *Limits:* float32; on a GPU contacts come in another order each time, so it does not
    repeat bit for bit. Contacts beyond what was sized are left out and counted. Of both
    limits of a joint that act at once it knows only one, and refuses such a scene.
    """

    @dataclass(frozen=True)
    class Options:
        #: Contacts to hold per world; null takes the most the scene can make.
        contacts: int | None = None
        #: Constraint rows to hold per world; null takes 4 a contact, and one a limited joint.
        constraints: int | None = None

        def __post_init__(self) -> None:
            check_range(self, "contacts", "constraints", least=1, most=100_000)

    def __new__(cls, options: Options, context: Context) -> Simulator:  # type: ignore[misc]
        try:
            from understudy_mujoco_warp.simulator import MujocoWarpSimulator
        except ImportError as error:
            raise ConfigError(
                f"simulator=mujoco_warp needs MuJoCo Warp ({error}): pip install 'understudy[gpu]', or choose "
                "simulator=mujoco."
            ) from error
        return MujocoWarpSimulator(options, context)

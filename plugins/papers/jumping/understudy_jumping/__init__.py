"""Athletic jumping (thesis, chapter 4): the athlete, the bar, the box, the run-up."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES = (
    "networks", "skills", "tensors", "terms", "mujoco", "motion", "characters", "humanoid", "inspect", "ppo", "deepmimic", "pose_vae",
    "report",
)  # fmt: skip

_HERE = "understudy_jumping"


@hookimpl
def understudy_register(register: Registrar) -> None:
    def add(kind: str, name: str, where: str, summary: str) -> None:
        register.component(kind, f"jumping/{name}", f"{_HERE}.{where}", summary)

    register.section("arena", f"{_HERE}.arena:ArenaOptions", f"{_HERE}.arena:Arena")
    add("character", "weak_leg", "athletes:build_weak_leg", "the jumper with a weak take-off leg")
    add("character", "stiff_spine", "athletes:build_stiff_spine", "the jumper, never arched back")
    add("character", "fixed_knee", "athletes:build_fixed_knee", "the jumper with a knee held bent")
    add("initial_states", "takeoff", "initial_states:Takeoffs", "at take-offs of given features")
    add("initial_states", "harvested", "initial_states:Harvested", "where run-ups ended")
    add("memory", "attempt", "attempt:Attempt", "what was touched and cleared")
    add("fields", "jump", "attempt:Jump", "orientation over the bar, effort")
    add("encoder", "state", "encoder:GlobalState", "links in the world's frame")
    add("actuation", "targets", "targets:Targets", "PD targets within a person's range")
    add("termination", "crashed", "terms:crashed", "touched what it must not")
    add("termination", "landed", "terms:landed", "landed on the mat")
    add("reward", "spin", "terms:spin", "little rotation of the root")
    add("reward", "safety", "terms:safety", "not on the head")
    add("initial_states", "run_up", "run_up:Beginnings", "in the run-up's clip")
    add(
        "actuation", "offset_targets", "run_up:OffsetTargets", "the reference's targets and offsets"
    )
    add("fields", "arrival", "run_up:Arrival", "how near the take-off is to the one wanted")
    add("termination", "arrived", "run_up:arrived", "the take-off has come")
    add("reward", "match", "run_up:match", "the take-off that is wanted")
    add("curriculum", "accumulated", "curriculum:Accumulated", "a higher bar for enough reward")
    register.task("jumping/high", "jump over a bar from a take-off state")
    register.task("jumping/obstacle", "jump over a box from a take-off state")
    register.task("jumping/run_up", "imitate a run-up, and arrive at a take-off state")
    register.component(
        "command", "jumping join", f"{_HERE}.join:Join", "join a run-up and its jump in one motion"
    )
    register.component(
        "command",
        "jumping heights",
        f"{_HERE}.heights:Heights",
        "the highest bar that a run clears",
    )
    register.citation(
        "yin2021jumping",
        "Yin, Yang, van de Panne, Yin. Discovering diverse athletic jumping strategies. ACM Transactions "
        "on Graphics 40(4), 2021.",
    )


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"

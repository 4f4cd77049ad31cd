"""Spacetime bounds (Ma et al. 2021; thesis chapter 3): learn a skill by staying near a clip."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar
from understudy_skills.packaged import register_skills

#: Plugins that this one builds on.
REQUIRES = (
    "networks",
    "skills",
    "tensors",
    "terms",
    "characters",
    "doctor",
    "imagination",
    "motion",
    "mujoco",
    "ppo",
    "report",
)

_HERE = "understudy_spacetime"


@hookimpl
def understudy_register(register: Registrar) -> None:
    register_skills(register, Path(__file__).parent / "skills")
    add = register.component
    add(
        "termination",
        "spacetime/com_bound",
        f"{_HERE}.bounds:ComBound",
        "centre of mass, per axis",
    )
    add("termination", "spacetime/root_bound", f"{_HERE}.bounds:RootBound", "root orientation")
    add("termination", "spacetime/joint_bound", f"{_HERE}.bounds:JointBound", "joint orientations")
    add(
        "termination",
        "spacetime/end_effector_bound",
        f"{_HERE}.bounds:EndEffectorBound",
        "hands and feet",
    )
    add(
        "fields",
        "spacetime/alignment",
        f"{_HERE}.alignment:Alignment",
        "the frame in which character and reference are compared",
    )
    add("reward", "spacetime/survival", f"{_HERE}.rewards:survival", "1 within the bounds, else 0")
    add(
        "measure",
        "spacetime/within_all_bounds",
        f"{_HERE}.rewards:within_all_bounds",
        "1 inside all bounds and without a fall, else 0",
    )
    add(
        "measure",
        "spacetime/com_deviation",
        f"{_HERE}.rewards:com_deviation",
        "how far the centre of mass is from its reference",
    )
    add(
        "measure",
        "spacetime/joint_deviation",
        f"{_HERE}.rewards:joint_deviation",
        "how far the farthest joint is from its reference",
    )
    add(
        "encoder",
        "spacetime/state",
        f"{_HERE}.encoders:StateEncoder",
        "character, phase, root error",
    )
    add(
        "encoder", "spacetime/feedforward", f"{_HERE}.encoders:FeedforwardEncoder", "reference pose"
    )
    add(
        "policy",
        "spacetime/feedforward_feedback",
        f"{_HERE}.policy:FeedforwardFeedback",
        "reference pose plus learned offset",
    )
    add(
        "initial_states",
        "spacetime/importance",
        f"{_HERE}.initial_states:Importance",
        "reference states, more where returns are low",
    )
    add(
        "initial_states",
        "spacetime/evolution",
        f"{_HERE}.initial_states:Evolution",
        "elite states of past rollouts",
    )
    add(
        "initial_states",
        "spacetime/clip_start",
        f"{_HERE}.initial_states:ClipStart",
        "the clip's beginning",
    )
    add(
        "initial_states", "spacetime/phases", f"{_HERE}.initial_states:Phases", "a part of the clip"
    )
    add(
        "initial_states",
        "spacetime/flyable",
        f"{_HERE}.initial_states:Flyable",
        "any time of the clip from which it can be flown",
    )
    add(
        "initial_states",
        "spacetime/evolved",
        f"{_HERE}.initial_states:Evolved",
        "the evolved initial states of another run",
    )
    add(
        "curriculum",
        "spacetime/adaptive_bounds",
        f"{_HERE}.adaptive:AdaptiveBounds",
        "bounds that tighten where the motion is mastered",
    )
    add("character", "revolute", f"{_HERE}.revolute:build_revolute", "a robot of hinges, 58 kg")
    add(
        "report_section",
        "spacetime/evolved_states",
        f"{_HERE}.section:EvolvedSection",
        "where initial states have evolved to",
    )
    add(
        "report_section",
        "spacetime/by_phase",
        f"{_HERE}.by_phase:ByPhaseSection",
        "success by where episodes begin, beside where that cannot be",
    )
    add(
        "command",
        "motion learned",
        f"{_HERE}.learned:Learned",
        "write the motion that a run learned as a clip, in place of its reference",
    )
    add("overlay", "spacetime/bounds", f"{_HERE}.overlay:BoundsOverlay", "a run's bounds")
    register.task("spacetime/walk", "walk within spacetime bounds of a clip, survival reward only")
    register.citation(
        "spacetime",
        "Ma, Yang, Tong, Guo, Yin 2021. Learning and exploring motor skills with spacetime bounds. "
        "Computer Graphics Forum 40(2), 251-263.",
    )


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"

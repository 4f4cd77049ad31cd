"""Spacetime bounds (Ma et al. 2021; thesis chapter 3): learn a skill by staying near a clip."""

from understudy_skills.packaged import skills_beside

#: Plugins that this one builds on.
REQUIRES = (
    "networks",
    "skills",
    "tensors",
    "terms",
    "characters",
    "credits",
    "imagination",
    "motion",
    "mujoco",
    "ppo",
    "report",
    "reinforcement",
)

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "termination": {
        "spacetime/com_bound": ("bounds:ComBound", "centre of mass, per axis"),
        "spacetime/root_bound": ("bounds:RootBound", "root orientation"),
        "spacetime/joint_bound": ("bounds:JointBound", "joint orientations"),
        "spacetime/end_effector_bound": ("bounds:EndEffectorBound", "hands and feet"),
    },
    "fields": {
        "spacetime/alignment": ("alignment:Alignment", "the frame of comparison"),
    },
    "reward": {
        "spacetime/survival": ("rewards:survival", "1 within the bounds, else 0"),
    },
    "measure": {
        "spacetime/within_all_bounds": ("rewards:within_all_bounds", "1 in all bounds, no fall"),
        "spacetime/com_deviation": ("rewards:com_deviation", "distance of the centres of mass"),
        "spacetime/joint_deviation": ("rewards:joint_deviation", "the farthest joint's angle, rad"),
    },
    "encoder": {
        "spacetime/state": ("encoders:StateEncoder", "character, phase, root error"),
        "spacetime/feedforward": ("encoders:FeedforwardEncoder", "reference pose"),
    },
    "policy": {
        "spacetime/feedforward_feedback": ("policy:FeedforwardFeedback", "reference and offset"),
    },
    "initial_states": {
        "spacetime/importance": ("importance:Importance", "more where returns are low"),
        "spacetime/evolution": ("evolution:Evolution", "states drawn from past rollouts"),
        "spacetime/clip_start": ("clip_starts:ClipStart", "the clip's beginning"),
        "spacetime/phases": ("clip_starts:Phases", "a part of the clip"),
        "spacetime/flyable": ("clip_starts:Flyable", "any time from which it can be flown"),
        "spacetime/evolved": ("evolution:Evolved", "another run's evolved initial states"),
    },
    "curriculum": {
        "spacetime/adaptive_bounds": ("adaptive:AdaptiveBounds", "tighter where well learned"),
    },
    "character": {
        "revolute": ("revolute:build_revolute", "a robot of hinges, 58 kg"),
    },
    "report_section": {
        "spacetime/evolved_states": ("section:EvolvedSection", "where initial states evolved to"),
        "spacetime/by_phase": ("by_phase:ByPhaseSection", "success by where episodes begin"),
    },
    "command": {
        "motion learned": ("learned:Learned", "write the motion that a run learned as a clip"),
    },
    "overlay": {
        "spacetime/bounds": ("overlay:BoundsOverlay", "a run's bounds"),
    },
}

#: Tasks, ``conf/task/NAME.yaml``, and what is learned in each.
TASKS = {
    "spacetime/walk": "walk within spacetime bounds of a clip, survival reward only",
}

#: How to cite what is implemented here.
CITATIONS = {
    "spacetime": (
        "Ma, Yang, Tong, Guo, Yin 2021. Learning and exploring motor skills with spacetime bounds. "
        "Computer Graphics Forum 40(2), 251-263."
    ),
}

understudy_register = skills_beside(__file__)

"""Learning to sit (2019): four skills and a controller above them."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar
from understudy_skills.packaged import register_skills

#: Plugins that this one builds on.
REQUIRES = (
    "curricula",
    "networks",
    "skills",
    "tensors",
    "terms",
    "characters",
    "humanoid",
    "motion",
    "mujoco",
    "play",
    "ppo",
    "report",
    "sweeps",
)

_HERE = "understudy_sitting"
#: By module and kind: the component's name, its class or function, and what it is.
_PARTS = {
    ("figure", "character"): {
        "sitting/humanoid": ("build_humanoid", "the humanoid of 21 hinges, 45 kg"),
    },
    ("clips", "clip"): {
        "sitting/step_back": ("generated_step_back", "a generated walk backwards"),
        "sitting/whole": ("generated_whole", "generated walking, turning and sitting down"),
    },
    ("state", "fields"): {
        "sitting/body": ("Body", "the figure's 50 numbers, the torso's motion"),
        "sitting/reference": ("Reference", "the same of the reference"),
        "sitting/goal": ("Goal", "the direction to a target"),
        "sitting/seat": ("Seat", "the chair, and the pelvis on its seat"),
    },
    ("state", "encoder"): {"sitting/state": ("State", "figure, goal and chair")},
    ("actuation", "actuation"): {
        "sitting/around_clip": ("AroundClip", "servo targets in units of the clip"),
    },
    ("orders", "actuation"): {
        "sitting/in_order": ("InOrder", "skills in a fixed order, Table 3"),
    },
    ("targets", "memory"): {
        "sitting/target_ahead": ("TargetAhead", "a place to walk to, drawn anew"),
    },
    ("targets", "fields"): {
        "sitting/target_by_chair": ("TargetByChair", "a place that was chosen, by the chair"),
    },
    ("terms", "reward"): {
        "sitting/pose": ("pose", "joint angles are the reference's, eq. 3"),
        "sitting/velocity": ("velocity", "joint velocities are the reference's, eq. 3"),
        "sitting/steering": ("steering", "moves as the reference does, eq. 4"),
        "sitting/approach": ("Approach", "comes to the target, eq. 5"),
        "sitting/turning": ("turning", "turns as the reference does, eq. 6"),
        "sitting/nearing": ("Nearing", "the pelvis comes to the seat, eq. 7"),
        "sitting/sit_down": ("SitDown", "on the seat or nearing it, eq. 8"),
    },
    ("terms", "measure"): {
        "sitting/pose": ("pose", "joint angles are the reference's, eq. 3"),
        "sitting/approach": ("Approach", "comes to the target, eq. 5"),
        "sitting/turning": ("turning", "turns as the reference does, eq. 6"),
    },
    ("terms", "termination"): {
        "sitting/low": ("low", "the torso is too low"),
        "sitting/off_course": ("off_course", "turned otherwise than the reference"),
    },
    ("trials", "command"): {
        "sitting trials": ("Trials", "judge a controller that sits down over many trials"),
    },
    ("kinematics", "command"): {
        "sitting kinematics": (
            "Kinematics",
            "how near a clip comes to the seat that is only played",
        ),
    },
    ("room_command", "command"): {
        "sitting room": ("SitInRoom", "a controller sits down in a room seen in a picture"),
    },
    ("follow", "command"): {
        "sitting follow": ("Follow", "the figure walks to where one clicks in the browser"),
    },
    ("trials", "report_section"): {
        "sitting/trials": ("TransitionsSection", "success by zone, which skill followed which"),
    },
    ("initial_states", "initial_states"): {
        "sitting/from_reference": ("FromReference", "the reference, the chair behind"),
        "sitting/where_others_ended": ("WhereOthersEnded", "where other skills ended"),
        "sitting/around_chair": ("AroundChair", "standing around the chair, by zones"),
    },
}


@hookimpl
def understudy_register(register: Registrar) -> None:
    register_skills(register, Path(__file__).parent / "skills")
    for (module, kind), parts in _PARTS.items():
        for name, (target, summary) in parts.items():
            register.component(kind, name, f"{_HERE}.{module}:{target}", summary)
    for section, where in {
        "chair": "chair:Chair",
        "soles": "chair:Soles",
        "room": "room:Room",
    }.items():
        register.section(section, f"{_HERE}.{where}Options", f"{_HERE}.{where}")
    register.task("sitting/walk", "walk to targets that are drawn anew")
    register.task("sitting/turn", "turn in place")
    register.task("sitting/sit", "sit down on a chair behind")
    register.citation(
        "sitting",
        "Chao, Yang, Chen, Deng 2021. Learning to sit: synthesizing human-chair interactions via "
        "hierarchical control. AAAI; here as arXiv:1908.07423, 2019.",
    )


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"

"""Learning to sit (2019): four skills and a controller above them."""

from understudy_skills.packaged import skills_beside

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
    "reinforcement",
)

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "character": {
        "sitting/humanoid": ("figure:build_humanoid", "the humanoid of 21 hinges, 45 kg"),
    },
    "clip": {
        "sitting/step_back": ("clips:generated_step_back", "a generated walk backwards"),
        "sitting/whole": ("clips:generated_whole", "generated walking, turning and sitting down"),
    },
    "fields": {
        "sitting/body": ("state:Body", "the figure's 50 numbers, the torso's motion"),
        "sitting/reference": ("state:Reference", "the same of the reference"),
        "sitting/goal": ("state:Goal", "the direction to a target"),
        "sitting/seat": ("state:Seat", "the chair, and the pelvis on its seat"),
        "sitting/manner": ("manner:Manner", "pelvis and feet by seat and floor"),
        "sitting/feet": ("manner:Feet", "feet on the floor, without a chair"),
        "sitting/target_by_chair": ("targets:TargetByChair", "a chosen place, by the chair"),
    },
    "encoder": {
        "sitting/state": ("state:State", "figure, goal and chair"),
    },
    "actuation": {
        "sitting/around_clip": ("actuation:AroundClip", "servo targets in units of the clip"),
        "sitting/in_order": ("orders:InOrder", "skills in a fixed order, Table 3"),
    },
    "memory": {
        "sitting/target_ahead": ("targets:TargetAhead", "a place to walk to, drawn anew"),
        "sitting/descent": ("manner:Descent", "how the figure sat down: falls, slides, squats"),
    },
    "learner": {
        "sitting/after_clip": ("cloning:AfterClip", "imitates the clip's own servo targets"),
    },
    "reward": {
        "sitting/pose": ("terms:pose", "joint angles are the reference's, eq. 3"),
        "sitting/velocity": ("terms:velocity", "joint velocities are the reference's, eq. 3"),
        "sitting/steering": ("terms:steering", "moves as the reference does, eq. 4"),
        "sitting/approach": ("terms:Approach", "comes to the target, eq. 5"),
        "sitting/turning": ("terms:turning", "turns as the reference does, eq. 6"),
        "sitting/nearing": ("terms:Nearing", "the pelvis comes to the seat, eq. 7"),
        "sitting/sit_down": ("terms:SitDown", "on the seat or nearing it, eq. 8"),
        "sitting/planted": ("manner:planted", "feet stay where they stand"),
        "sitting/unhurried": ("manner:unhurried", "the pelvis does not fall"),
        "sitting/servos": ("manner:Servos", "servo targets are the clip's own"),
        "sitting/spent": ("manner:spent", "minus the growth of a sum, such as how far feet slid"),
    },
    "measure": {
        "sitting/pose": ("terms:pose", "joint angles are the reference's, eq. 3"),
        "sitting/approach": ("terms:Approach", "comes to the target, eq. 5"),
        "sitting/turning": ("terms:turning", "turns as the reference does, eq. 6"),
    },
    "termination": {
        "sitting/low": ("terms:low", "the torso is too low"),
        "sitting/off_course": ("terms:off_course", "turned otherwise than the reference"),
    },
    "command": {
        "sitting trials": ("trials:Trials", "judge a controller that sits down over many trials"),
        "sitting kinematics": ("kinematics:Kinematics", "how near a played clip comes to the seat"),
        "sitting room": ("room_command:SitInRoom", "a controller sits down in a room in a picture"),
        "sitting follow": ("follow:Follow", "the figure walks to where you click in the browser"),
    },
    "report_section": {
        "sitting/trials": ("trials:TransitionsSection", "success by zone, order of skills"),
    },
    "initial_states": {
        "sitting/from_reference": ("initial_states:FromReference", "the reference, a chair behind"),
        "sitting/where_others_ended": ("initial_states:WhereOthersEnded", "where skills ended"),
        "sitting/around_chair": ("initial_states:AroundChair", "around the chair, by zones"),
    },
}

#: Sections of a configuration: the options, and what is built of them.
SECTIONS = {
    "chair": ("chair:ChairOptions", "chair:Chair"),
    "soles": ("chair:SolesOptions", "chair:Soles"),
    "room": ("room:RoomOptions", "room:Room"),
}

#: Tasks, ``conf/task/NAME.yaml``, and what is learned in each.
TASKS = {
    "sitting/walk": "walk to targets that are drawn anew",
    "sitting/turn": "turn in place",
    "sitting/sit": "sit down on a chair behind",
}

#: How to cite what is implemented here.
CITATIONS = {
    "sitting": (
        "Chao, Yang, Chen, Deng 2021. Learning to sit: synthesizing human-chair interactions via "
        "hierarchical control. AAAI; here as arXiv:1908.07423, 2019."
    ),
}

understudy_register = skills_beside(__file__)

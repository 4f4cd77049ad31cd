"""Gathering, spreading and flipping of amorphous materials with a tool (Zhang et al. 2020)."""

from understudy_skills.packaged import skills_beside

#: Plugins that this one builds on.
REQUIRES = (
    "curricula",
    "networks",
    "tensors",
    "terms",
    "characters",
    "motion",
    "mujoco",
    "pbd",
    "ppo",
    "report",
    "skills",
    "sweeps",
    "warp_torch",
)

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "scene": {
        "amorphous/table": ("scene:AmorphousScene", "blocks of a material, and a tool"),
    },
    "initial_states": {
        "amorphous/clusters": ("initial_states:AroundGoal", "blocks around a goal"),
        "amorphous/pile": ("initial_states:Pile", "a block in the middle of the table"),
        "amorphous/on_tool": ("initial_states:OnTool", "a block on the tool"),
    },
    "encoder": {
        "amorphous/maps": ("maps:MaterialMaps", "density, height and goal as images"),
        "amorphous/tool": ("tool:ToolState", "the tool's pose and velocity"),
    },
    "fields": {
        "amorphous/table_map": ("maps:TableMap", "how many cells have material"),
        "amorphous/farthest": ("gathering:Farthest", "the particle farthest from the goal"),
        "amorphous/toss": ("flipping:Toss", "how high and how fast the material turns"),
    },
    "actuation": {
        "amorphous/tool": ("tool:ToolTarget", "a target in the tool's own frame"),
    },
    "reward": {
        "amorphous/gathering": ("gathering:gathering", "eq. 6: to the goal, or to the material"),
        "amorphous/occupied": ("spreading:newly_occupied", "eq. 7: more cells have material"),
        "amorphous/lowered": ("spreading:lowered", "eq. 8: the material is lower"),
        "amorphous/movement": ("spreading:movement", "eq. 9: what is high moves"),
        "amorphous/outliers": ("spreading:outliers", "eq. 10: nothing leaves the table"),
        "amorphous/height": ("flipping:height", "eq. 11: high above the pan"),
        "amorphous/spin": ("flipping:spin", "eq. 12: turning in the air"),
    },
    "measure": {
        "amorphous/gathered_share": ("gathering:gathered_share", "how much is near the goal"),
        "amorphous/share_distance": ("gathering:share_distance", "how far 95 % are from the goal"),
        "amorphous/flipped": ("flipping:flipped", "turned over, and caught"),
    },
    "memory": {
        "amorphous/turned": ("flipping:Turned", "how far the material has turned"),
    },
    "curriculum": {
        "amorphous/clusters": ("curricula:Clusters", "one more cluster whenever all are gathered"),
        "amorphous/lengths": ("curricula:Lengths", "episodes of different lengths"),
    },
    "report_section": {
        "amorphous/maps": ("report:MapsSection", "the material as the policy sees it"),
    },
    "character": {
        "amorphous/cook": ("character:build_cook", "a cook, standing"),
    },
    "command": {
        "amorphous character": ("character_command:HoldTool", "a figure that moves a run's tool"),
    },
}

#: Tasks, ``conf/task/NAME.yaml``, and what is learned in each.
TASKS = {
    "amorphous/gather": "a scraper gathers clusters of a material at a goal",
    "amorphous/spread": "a scraper spreads a pile over a table",
    "amorphous/flip": "a pan tosses a disk so that it turns over",
}

#: How to cite what is implemented here.
CITATIONS = {
    "amorphous": (
        "Zhang, Yu, Liu, Kemp, Turk 2020. Learning to manipulate amorphous materials. ACM Transactions "
        "on Graphics 39(6), 189."
    ),
}

understudy_register = skills_beside(__file__)

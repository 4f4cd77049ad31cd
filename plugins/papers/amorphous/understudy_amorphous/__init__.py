"""Gathering, spreading and flipping of amorphous materials with a tool (Zhang et al. 2020)."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

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
    "sweeps",
    "warp_torch",
)

#: By module and kind: the component's name less ``amorphous.``, its class or function, and what it is.
_PARTS = {
    ("scene", "scene"): {"table": ("AmorphousScene", "blocks of a material, and a tool")},
    ("initial_states", "initial_states"): {
        "clusters": ("AroundGoal", "blocks around a goal"),
        "pile": ("Pile", "a block in the middle of the table"),
        "on_tool": ("OnTool", "a block on the tool"),
    },
    ("maps", "encoder"): {"maps": ("MaterialMaps", "density, height and goal as images")},
    ("maps", "fields"): {"table_map": ("TableMap", "how many cells have material")},
    ("tool", "encoder"): {"tool": ("ToolState", "the tool's pose and velocity")},
    ("tool", "actuation"): {"tool": ("ToolTarget", "a target in the tool's own frame")},
    ("gathering", "fields"): {"farthest": ("Farthest", "the particle farthest from the goal")},
    ("gathering", "reward"): {"gathering": ("gathering", "eq. 6: to the goal, or to the material")},
    ("gathering", "measure"): {
        "gathered_share": ("gathered_share", "the share of the material that is near the goal"),
        "share_distance": ("share_distance", "how far from the goal most of the material is"),
    },
    ("spreading", "reward"): {
        "occupied": ("newly_occupied", "eq. 7: more cells have material"),
        "lowered": ("lowered", "eq. 8: the material is lower"),
        "movement": ("movement", "eq. 9: what is high moves"),
        "outliers": ("outliers", "eq. 10: nothing leaves the table"),
    },
    ("flipping", "fields"): {"toss": ("Toss", "how high and how fast the material turns")},
    ("flipping", "memory"): {"turned": ("Turned", "how far the material has turned")},
    ("flipping", "reward"): {
        "height": ("height", "eq. 11: high above the pan"),
        "spin": ("spin", "eq. 12: turning in the air"),
    },
    ("flipping", "measure"): {"flipped": ("flipped", "turned over, and caught")},
    ("curricula", "curriculum"): {
        "clusters": ("Clusters", "a cluster more whenever all are gathered"),
        "lengths": ("Lengths", "episodes of different lengths"),
    },
    ("report", "report_section"): {"maps": ("MapsSection", "the material as the policy sees it")},
}


@hookimpl
def understudy_register(register: Registrar) -> None:
    for (module, kind), parts in _PARTS.items():
        for name, (target, summary) in parts.items():
            where = f"understudy_amorphous.{module}:{target}"
            register.component(kind, f"amorphous/{name}", where, summary)
    here = "understudy_amorphous"
    register.component(
        "character", "amorphous/cook", f"{here}.character:build_cook", "a cook, standing"
    )
    register.component(
        "command",
        "amorphous character",
        f"{here}.character_command:HoldTool",
        "a figure whose hand moves the tool of a finished run",
    )
    for name, summary in {
        "gather": "a scraper gathers clusters of a material at a goal",
        "spread": "a scraper spreads a pile over a table",
        "flip": "a pan tosses a disk so that it turns over",
    }.items():
        register.task(f"amorphous/{name}", summary)
    register.citation(
        "amorphous",
        "Zhang, Yu, Liu, Kemp, Turk 2020. Learning to manipulate amorphous materials. ACM Transactions "
        "on Graphics 39(6), 189.",
    )


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"

"""Seven small tasks on toy physics, each of the shape of a published system."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES = ("curricula", "networks", "skills", "tensors", "terms", "ppo", "sequencing", "sweeps")

#: By module and kind: the component's name less ``miniature.``, its class or function, and what it is.
_PARTS = {
    ("plane", "scene"): {"plane": ("PlaneScene", "points on a plane")},
    ("plane", "simulator"): {"plane": ("Plane", "points with drag, gravity, springs")},
    ("plane", "initial_states"): {"somewhere": ("Somewhere", "points around a place")},
    ("plane", "fields"): {
        "body": ("Body", "one point's position and velocity"),
        "place": ("Place", "a place that never moves"),
        "offset": ("Offset", "the way to a target"),
    },
    ("plane", "encoder"): {
        "reach": ("Reach", "the way to go and the velocity"),
        "motion": ("Motion", "the velocity"),
    },
    ("plane", "actuation"): {"force": ("Force", "the action is a force")},
    ("plane", "measure"): {"slow": ("slow", "at rest")},
    ("plane", "reward"): {"near": ("near", "near a target"), "slow": ("slow", "at rest")},
    ("sitting", "fields"): {"contact": ("Contact", "at rest on the seat")},
    ("amorphous", "scene"): {"grains": ("GrainsScene", "grains and a tool")},
    ("amorphous", "simulator"): {"grains": ("Grains", "a tool pushes grains")},
    ("amorphous", "initial_states"): {"clusters": ("Clusters", "grains around some centres")},
    ("amorphous", "fields"): {"heap": ("Heap", "how far grains are spread")},
    ("amorphous", "encoder"): {
        "density_map": ("DensityMap", "grains as an image"),
        "tool": ("ToolState", "the tool's state"),
    },
    ("amorphous", "actuation"): {"tool_target": ("ToolTarget", "where the tool should go")},
    ("amorphous", "reward"): {"gathered": ("gathered", "grains came nearer")},
    ("jumping", "fields"): {"bar": ("Bar", "a bar, and how it is crossed")},
    ("jumping", "encoder"): {"run": ("Run", "position, velocity, the bar's height")},
    ("jumping", "actuation"): {"legs": ("Legs", "pushes against the floor")},
    ("jumping", "termination"): {
        "cleared": ("cleared", "passed above the bar"),
        "knocked": ("knocked", "ran into the bar"),
    },
    ("jumping", "measure"): {"height": ("height", "clearance at the bar")},
    ("jumping", "reward"): {
        "completion": ("completion", "nearly cleared, with little effort"),
        "forward": ("forward", "runs forward"),
    },
    ("cmfbo", "outer_loop"): {"random": ("RandomFidelity", "random points, rising fidelity")},
    ("poses", "poses"): {"arcs": ("Arcs", "arcs and waves of an arm")},
    ("poses", "job"): {"autoencoder": ("LearnPoses", "an auto-encoder of poses")},
    ("styles", "scene"): {"arm": ("ArmScene", "an arm of many joints")},
    ("styles", "simulator"): {"arm": ("Arm", "joints that follow targets")},
    ("styles", "initial_states"): {"straight": ("Straight", "the arm nearly straight")},
    ("styles", "fields"): {"tip": ("Tip", "where the arm ends")},
    ("styles", "encoder"): {"posture": ("Posture", "joint angles and the target")},
    ("styles", "actuation"): {"decoded_pose": ("DecodedPose", "a decoder's pose and an offset")},
    ("styles", "reward"): {"sparse": ("sparse", "without offsets")},
}


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.kind("poses", "poses to learn from")
    register.slot("poses", "poses", "what an auto-encoder of poses learns from")
    for (module, kind), parts in _PARTS.items():
        for name, (target, summary) in parts.items():
            where = f"understudy_miniature.{module}:{target}"
            register.component(kind, f"miniature/{name}", where, summary)
    for name, summary in {
        "go": "a point goes to a target that is drawn anew",
        "stop": "a point comes to rest",
        "amorphous": "a tool pushes grains together",
        "sleeve": "a point reaches a first place",
        "in_sequence": "a point reaches a first place, then a second",
        "jumping": "a point jumps over a bar",
        "chopsticks": "two sticks take two objects to their places",
    }.items():
        register.task(f"miniature/{name}", summary)


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"

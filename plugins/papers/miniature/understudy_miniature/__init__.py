"""Seven small tasks on toy physics, each built like a published system."""

#: Plugins that this one builds on.
REQUIRES = (
    "curricula", "networks", "skills", "tensors", "terms", "ppo", "sequencing", "sweeps", "reinforcement",
)  # fmt: skip

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "scene": {
        "miniature/plane": ("plane:PlaneScene", "points on a plane"),
        "miniature/grains": ("amorphous:GrainsScene", "grains and a tool"),
        "miniature/arm": ("styles:ArmScene", "an arm of many joints"),
    },
    "simulator": {
        "miniature/plane": ("plane:Plane", "points with drag, gravity, springs"),
        "miniature/grains": ("amorphous:Grains", "a tool pushes grains"),
        "miniature/arm": ("styles:Arm", "joints that follow targets"),
    },
    "initial_states": {
        "miniature/somewhere": ("plane:Somewhere", "points around a place"),
        "miniature/clusters": ("amorphous:Clusters", "grains around some centres"),
        "miniature/straight": ("styles:Straight", "the arm nearly straight"),
    },
    "fields": {
        "miniature/body": ("plane:Body", "one point's position and velocity"),
        "miniature/place": ("plane:Place", "a place that never moves"),
        "miniature/offset": ("plane:Offset", "the way to a target"),
        "miniature/contact": ("sitting:Contact", "at rest on the seat"),
        "miniature/heap": ("amorphous:Heap", "how far grains are spread"),
        "miniature/bar": ("jumping:Bar", "a bar, and how it is crossed"),
        "miniature/tip": ("styles:Tip", "where the arm ends"),
    },
    "encoder": {
        "miniature/reach": ("plane:Reach", "the way to go and the velocity"),
        "miniature/motion": ("plane:Motion", "the velocity"),
        "miniature/density_map": ("amorphous:DensityMap", "grains as an image"),
        "miniature/tool": ("amorphous:ToolState", "the tool's state"),
        "miniature/run": ("jumping:Run", "position, velocity, the bar's height"),
        "miniature/posture": ("styles:Posture", "joint angles and the target"),
    },
    "actuation": {
        "miniature/force": ("plane:Force", "the action is a force"),
        "miniature/tool_target": ("amorphous:ToolTarget", "where the tool should go"),
        "miniature/legs": ("jumping:Legs", "pushes against the floor"),
        "miniature/decoded_pose": ("styles:DecodedPose", "a decoder's pose and an offset"),
    },
    "measure": {
        "miniature/slow": ("plane:slow", "at rest"),
        "miniature/height": ("jumping:height", "clearance at the bar"),
    },
    "reward": {
        "miniature/near": ("plane:near", "near a target"),
        "miniature/slow": ("plane:slow", "at rest"),
        "miniature/gathered": ("amorphous:gathered", "grains came nearer"),
        "miniature/completion": ("jumping:completion", "nearly cleared, with little effort"),
        "miniature/forward": ("jumping:forward", "runs forward"),
        "miniature/sparse": ("styles:sparse", "without offsets"),
    },
    "termination": {
        "miniature/cleared": ("jumping:cleared", "passed above the bar"),
        "miniature/knocked": ("jumping:knocked", "ran into the bar"),
    },
    "outer_loop": {
        "miniature/random": ("cmfbo:RandomFidelity", "random points, rising fidelity"),
    },
    "poses": {
        "miniature/arcs": ("poses:Arcs", "arcs and waves of an arm"),
    },
    "job": {
        "miniature/autoencoder": ("poses:LearnPoses", "an auto-encoder of poses"),
    },
}

#: Kinds of parts that this one adds, and what each is.
KINDS = {"poses": "poses to learn from"}

#: Slots of a configuration that this one adds.
SLOTS = {"poses": {"kind": "poses", "summary": "what an auto-encoder of poses learns from"}}

#: Tasks, ``conf/task/NAME.yaml``, and what is learned in each.
TASKS = {
    "miniature/go": "a point goes to a target that is drawn anew",
    "miniature/stop": "a point comes to rest",
    "miniature/amorphous": "a tool pushes grains together",
    "miniature/sleeve": "a point reaches a first place",
    "miniature/jumping": "a point jumps over a bar",
    "miniature/chopsticks": "two sticks take two objects to their places",
}

"""Outer loops over whole runs: the command ``sweep``, its journal, executors, and the grid."""

#: Plugins that this one builds on.
REQUIRES = ("reinforcement", "report", "skills", "training")

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "command": {
        "sweep": ("command:Sweep", "run an outer loop over trainings: ablation=… or search=…"),
        "compare": ("compare:Compare", "show runs beside one another and what differs, as a page"),
    },
    "outer_loop": {
        "grid": ("grid:Grid", "variants × seeds"),
        "chain": ("chain:Chain", "trainings that build on one another"),
    },
    "executor": {
        "in_process": ("in_process:InProcess", "one trial after another"),
        "processes": ("processes:Processes", "trials in processes of this machine"),
    },
}

#: Kinds of parts that this one adds, and what each is.
KINDS = {"sweep_page": "a page of a finished sweep beside its own"}

"""Policies that were trained one by one, in sequence: Algorithm 1 of the dressing paper, and the state machine
that plays what it trained."""

#: Plugins that this one builds on.
REQUIRES = ("skills", "sweeps")

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "outer_loop": {
        "algorithm_1": ("algorithm:Algorithm1", "subtasks that end where the next begins"),
    },
    "initial_states": {
        "sequencing/gaussian": ("gaussian:Gaussian", "as a Gaussian fits a bank"),
    },
    "reward": {
        "sequencing/next_start": ("terms:NextStart", "near the mean of the next one's starts"),
    },
    "actuation": {
        "sequencing/stages": ("stages:Stages", "other runs' policies, one after another"),
    },
    "termination": {
        "sequencing/finished": ("terms:finished", "all stages are done"),
        "sequencing/overtime": ("terms:overtime", "a stage took too long"),
    },
    "measure": {
        "sequencing/completed": ("terms:completed", "whether a stage was done"),
    },
}

#: How to cite what is implemented here.
CITATIONS = {
    "sequencing": (
        "Clegg, Yu, Tan, Liu, Turk 2018. Learning to dress: synthesizing human dressing motion via deep "
        "reinforcement learning. ACM Transactions on Graphics 37(6), 179. Section 5."
    ),
}

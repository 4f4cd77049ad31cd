"""Terms, memories and an observation of any field, whatever the task."""

#: Plugins that this one builds on.
REQUIRES = ("tensors",)

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "measure": {
        "value": ("terms:value", "a field itself"),
        "value_where": ("terms:value_where", "a field where another is not 0"),
    },
    "reward": {
        "value": ("terms:value", "a field itself"),
        "steady": ("terms:steady", "a field changes little in a decision"),
        "small": ("terms:small", "a field is small"),
    },
    "termination": {
        "reached": ("terms:reached", "a field is small enough"),
        "beyond": ("terms:beyond", "a field is too large"),
        "out_of_bounds": ("terms:OutOfBounds", "a field leaves bounds that change with time"),
    },
    "encoder": {
        "value": ("encoders:Value", "a field itself"),
    },
    "memory": {
        "timer": ("memories:Timer", "how long a condition has held"),
        "latch": ("memories:Latch", "a field as it was when a condition first held"),
        "running_mean": ("memories:RunningMean", "a field's mean over the episode"),
        "roughness": ("memories:Roughness", "how rough a field's course was, such as its jerk"),
        "extremes": ("memories:Extremes", "the least and the most that a field was"),
        "redrawn_target": ("memories:RedrawnTarget", "a random point in a box"),
        "history": ("memories:History", "a field's last values"),
    },
}

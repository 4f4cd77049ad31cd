"""Grips: how a hand holds two sticks, tongs or a brush: styles, poses by inverse kinematics, forces that balance. Knows no task."""

#: Plugins that this one builds on.
REQUIRES = ("hand", "mujoco", "tensors")

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "grip": {
        "standard": ("grip:standard", "the style 11120"),
        "t_pose": ("grip:t_pose", "straight fingers beside the sticks, which fall"),
        "tongs": ("grip:tongs", "tongs, by thumb, index and middle finger"),
        "tongs_wide": ("grip:tongs_wide", "tongs, closed upon what is 1 to 2 cm wide"),
        "brush": ("grip:brush", "a brush, by thumb, index and middle finger"),
        "long": ("grip:long", "the style 11120, of a hand with long fingers"),
        "large": ("grip:large", "the style 11200, of a hand twice as large"),
        "tri_finger": ("grip:tri_finger", "the style 112, of a hand with three fingers"),
        "adroit": ("grip:adroit", "the style 11120, of the Adroit hand (scene=hand/adroit)"),
    },
    "command": {
        "grip": ("command:FindGrip", "find how a hand holds a tool"),
    },
}

#: Kinds of parts that this one adds, and what each is.
KINDS = {"grip": "how a hand holds a tool: a function that gives the file's path"}

#: Sections of a configuration: the options, and what is built of them.
SECTIONS = {"grip": ("section:GripOptions", "section:build_grips")}

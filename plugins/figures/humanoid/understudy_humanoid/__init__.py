"""The 34-DoF humanoid and the jumper, and motions made for them. Knows no paper."""

#: Plugins that this one builds on.
REQUIRES = ("mujoco", "motion", "characters")

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "character": {
        "humanoid": ("character:build_humanoid", "the humanoid, 45 kg"),
        "jumper": ("jumper:build_jumper", "a stronger humanoid, 60 kg"),
    },
    "clip": {
        "walk": ("clips:generated_walk", "a generated walk, straight or along an arc"),
        "run": ("clips:generated_run", "a generated run"),
        "hop": ("clips:generated_hop", "generated hops, on both legs or one"),
        "turn_left": ("clips:generated_turn_left", "a generated turn to the left in place"),
        "turn_right": ("clips:generated_turn_right", "a generated turn to the right in place"),
        "sit": ("clips:generated_sit", "generated sitting down on a chair"),
        "stand": ("clips:generated_stand", "generated standing up from a chair"),
        "cartwheel": ("clips:generated_cartwheel", "a generated cartwheel to the left"),
        "backflip": ("clips:generated_backflip", "a generated backflip"),
    },
}

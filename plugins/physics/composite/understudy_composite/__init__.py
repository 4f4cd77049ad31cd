"""Several simulators as one: a body and cloth, a hand and grains."""

#: Plugins that this one builds on: bodies are named by a MuJoCo model.
REQUIRES = ("mujoco", "tensors")

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "scene": {
        "composite": ("scene:CompositeScene", "several scenes, by name"),
    },
    "simulator": {
        "composite": ("simulator:CompositeSimulator", "several simulators that move on together"),
    },
    "coupling": {
        "composite/tools": ("couplings:ToolsFollow", "tools that go where bodies go"),
    },
}

#: Kinds of parts that this one adds, and what each is.
KINDS = {"coupling": "what one member of a composite does to another"}

#: Slots of a configuration that this one adds.
SLOTS = {
    "scenes": {"kind": "scene", "summary": "the scenes of a composite, by member", "many": True},
    "simulators": {
        "kind": "simulator",
        "summary": "the simulators of a composite, by member",
        "many": True,
    },
    "couplings": {"kind": "coupling", "summary": "what members do to one another", "many": True},
}

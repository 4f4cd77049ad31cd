"""Several simulators as one: a body and cloth, a hand and grains."""

from understudy import hookimpl
from understudy.setup.registry import Registrar

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


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.kind("coupling", "what one member of a composite does to another")
    register.slot("scenes", "scene", "the scenes of a composite, by member", many=True)
    register.slot("simulators", "simulator", "the simulators of a composite, by member", many=True)
    register.slot("couplings", "coupling", "what members do to one another", many=True)
    register.parts(__name__, PARTS)

"""Several simulators as one: a body and cloth, a hand and grains."""

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on: bodies are named by a MuJoCo model.
REQUIRES = ("mujoco", "tensors")

_HERE = "understudy_composite"


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.kind("coupling", "what one member of a composite does to another")
    register.slot("scenes", "scene", "the scenes of a composite, by member", many=True)
    register.slot("simulators", "simulator", "the simulators of a composite, by member", many=True)
    register.slot("couplings", "coupling", "what members do to one another", many=True)
    add = register.component
    add("scene", "composite", f"{_HERE}.scene:CompositeScene", "several scenes, by name")
    add(
        "simulator",
        "composite",
        f"{_HERE}.simulator:CompositeSimulator",
        "several simulators that move on together",
    )
    add(
        "coupling",
        "composite/tools",
        f"{_HERE}.couplings:ToolsFollow",
        "tools of particles or cloth that go where bodies go",
    )

"""A walker whose links' lengths and radii are parameters (thesis, section 6.4.1)."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES = ("curricula", "networks", "tensors", "terms", "mujoco", "motion", "characters", "ppo")

_HERE = "understudy_morphology"


@hookimpl
def understudy_register(register: Registrar) -> None:
    def add(kind: str, name: str, where: str, summary: str) -> None:
        register.component(kind, f"morphology/{name}", f"{_HERE}.{where}", summary)

    add("scene", "walker", "scene:WalkerScene", "a walker of twelve scales")
    add("fields", "guidance", "assistance:Guidance", "how stiff the help is, and the target speed")
    add("actuation", "helped_torques", "assistance:HelpedTorques", "torques, and the hand of God")
    add("fields", "gait", "walking:Gait", "how the walker moves")
    add("fields", "worth", "walking:Worth", "the reward of a step")
    add("memory", "speed", "walking:Speed", "how much too slow it has been")
    add("measure", "normalised", "walking:normalised", "eq. 6.4, to be summed")
    add("termination", "fallen", "walking:fallen", "low, leaning or turned away")
    add("encoder", "body", "walking:Body", "what the walker feels")
    add("initial_states", "standing", "walking:Standing", "standing, a little disturbed")
    add("curriculum", "lessons", "lessons:Lessons", "less help when the return allows it")
    register.task("morphology/walk", "walk fast with little torque, whatever the limbs")
    register.citation(
        "yu2018symmetric",
        "Yu, Turk, Liu. Learning symmetric and low-energy locomotion. ACM TOG 37(4), 2018.",
    )


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"

"""Chopsticks (thesis, chapter 5): a grip that is held while a plan is followed."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar
from understudy_skills.packaged import register_skills

#: Plugins that this one builds on.
REQUIRES = (
    "bayes",
    "gripping",
    "hand",
    "mujoco",
    "networks",
    "ppo",
    "skills",
    "sweeps",
    "tensors",
    "terms",
    "tool_planner",
)

_HERE = "understudy_chopsticks"


@hookimpl
def understudy_register(register: Registrar) -> None:
    register_skills(register, Path(__file__).parent / "skills")

    def add(kind: str, name: str, where: str, summary: str) -> None:
        register.component(kind, f"chopsticks/{name}", f"{_HERE}.{where}", summary)

    add("initial_states", "open_and_close", "plan:OpenAndClose", "a grip, and a motion to follow")
    add("fields", "plan", "plan:Plan", "where arm, hand and sticks shall be")
    add("fields", "tracking", "tracking:Tracking", "the sticks in the palm, and errors")
    add("encoder", "state", "control:State", "table 5.1")
    add("actuation", "offsets", "control:Offsets", "offsets from the grip")
    add("reward", "hand", "tracking:Hand", "eq. 5.2: arm and hand as planned")
    add("reward", "sticks", "tracking:sticks", "eq. 5.3: both sticks as planned")
    add("reward", "contact", "tracking:contact", "eq. 5.5: fingertips at their places")
    add("termination", "dropped", "tracking:dropped", "a stick is far from where it is planned")
    add("termination", "contact_lost", "tracking:contact_lost", "fingertips left their places")
    add("initial_states", "relocations", "relocate:Relocations", "an object, and a plan to follow")
    add("fields", "follow", "relocate:Follow", "where everything shall be, by a plan of its own")
    add("fields", "object", "relocate:Object", "the object in the palm, and errors")
    add("reward", "object", "relocate:thing", "eq. 5.4: the object as planned")
    add("termination", "lost", "relocate:lost", "the object is far from where it is planned")
    add("termination", "missed", "relocate:missed", "the plan is over, the object elsewhere")
    add("termination", "placed", "relocate:placed", "the object is where it shall be")
    register.component(
        "outer_loop",
        "chopsticks/grips",
        f"{_HERE}.search:GripSearch",
        "places of fingers, by style",
    )
    register.task("chopsticks/open_close", "hold two sticks, and open and close them as planned")
    register.task("chopsticks/relocate", "take an object with two sticks and put it elsewhere")
    register.citation(
        "yang2022chopsticks",
        "Yang, Yin, Liu. Learning to use chopsticks in diverse gripping styles. ACM Transactions on "
        "Graphics 41(4), 2022.",
    )


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"

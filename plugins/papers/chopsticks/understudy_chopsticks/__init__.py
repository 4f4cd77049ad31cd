"""Chopsticks (thesis, chapter 5): a grip that is held while a plan is followed."""

from understudy_skills.packaged import skills_beside

#: Plugins that this one builds on.
REQUIRES = (
    "bayes",
    "gripping",
    "hand",
    "mujoco",
    "networks",
    "ppo",
    "report",
    "skills",
    "sweeps",
    "tensors",
    "terms",
    "tool_planner",
)

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "initial_states": {
        "chopsticks/open_and_close": ("plan:OpenAndClose", "a grip, and a motion to follow"),
        "chopsticks/relocations": ("relocate:Relocations", "an object, and a plan to follow"),
        "chopsticks/strokes": ("strokes:Strokes", "a brush, and a curve to follow"),
    },
    "fields": {
        "chopsticks/plan": ("plan:Plan", "where arm, hand and sticks should be"),
        "chopsticks/tracking": ("tracking:Tracking", "the sticks in the palm, and errors"),
        "chopsticks/follow": ("follow:Follow", "where everything should be, by a plan of its own"),
        "chopsticks/object": ("object:Object", "the object in the palm, and errors"),
        "chopsticks/stroke": ("strokes:Stroke", "where arm, hand and a brush should be"),
    },
    "memory": {
        "chopsticks/again": ("again:Again", "which plan is followed; made anew where one fails"),
    },
    "encoder": {
        "chopsticks/state": ("control:State", "table 5.1"),
    },
    "actuation": {
        "chopsticks/offsets": ("control:Offsets", "offsets from the grip"),
    },
    "reward": {
        "chopsticks/hand": ("tracking:Hand", "eq. 5.2: arm and hand as planned"),
        "chopsticks/sticks": ("tracking:sticks", "eq. 5.3: both sticks as planned"),
        "chopsticks/contact": ("tracking:contact", "eq. 5.5: fingertips at their places"),
        "chopsticks/object": ("object:thing", "eq. 5.4: the object as planned"),
        "chopsticks/tip": ("strokes:tip", "eq. 5.4 of a brush: its tip as planned"),
    },
    "termination": {
        "chopsticks/dropped": ("tracking:dropped", "a stick is far from where it is planned"),
        "chopsticks/turned": ("tracking:turned", "a stick is turned far from its plan"),
        "chopsticks/contact_lost": ("tracking:contact_lost", "fingertips left their places"),
        "chopsticks/lost": ("object:lost", "the object is far from where it is planned"),
        "chopsticks/missed": ("object:missed", "the plan is over, the object elsewhere"),
        "chopsticks/placed": ("object:placed", "the object is where it should be"),
    },
    "sweep_page": {
        "chopsticks/gallery": ("gallery:Gallery", "the best grip of each style"),
    },
    "outer_loop": {
        "chopsticks/grips": ("search:GripSearch", "places of fingers, by style"),
    },
}

#: Tasks, ``conf/task/NAME.yaml``, and what is learned in each.
TASKS = {
    "chopsticks/open_close": "hold two sticks, and open and close them as planned",
    "chopsticks/brush": "hold a brush, and follow a curve with its tip",
    "chopsticks/relocate": "take an object with two sticks and put it elsewhere",
}

#: How to cite what is implemented here.
CITATIONS = {
    "yang2022chopsticks": (
        "Yang, Yin, Liu. Learning to use chopsticks in diverse gripping styles. ACM Transactions on "
        "Graphics 41(4), 2022."
    ),
}

understudy_register = skills_beside(__file__)

"""Athletic jumping (thesis, chapter 4): the athlete, the bar, the box, the run-up."""

#: Plugins that this one builds on.
REQUIRES = (
    "networks", "skills", "tensors", "terms", "curricula", "sequencing", "mujoco", "motion", "characters", "humanoid", "judging", "ppo", "deepmimic", "pose_vae",
    "credits", "report", "reinforcement",
)  # fmt: skip

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "character": {
        "jumping/weak_leg": ("athletes:build_weak_leg", "the jumper with a weak take-off leg"),
        "jumping/stiff_spine": ("athletes:build_stiff_spine", "the jumper, never arched back"),
        "jumping/fixed_knee": ("athletes:build_fixed_knee", "the jumper with a knee held bent"),
    },
    "initial_states": {
        "jumping/takeoff": ("initial_states:Takeoffs", "at take-offs of given features"),
        "jumping/harvested": ("initial_states:Harvested", "where run-ups ended"),
        "jumping/approach": ("approach:Approach", "where a run-up to the bar begins"),
        "jumping/run_up": ("run_up:Beginnings", "in the run-up's clip"),
    },
    "memory": {
        "jumping/attempt": ("attempt:Attempt", "what was touched and cleared"),
    },
    "fields": {
        "jumping/jump": ("attempt:Jump", "orientation over the bar, effort"),
        "jumping/approached": ("approach:Approached", "where the clip is on an approach"),
        "jumping/arrival": ("run_up:Arrival", "how near the take-off is to the one wanted"),
    },
    "encoder": {
        "jumping/state": ("encoder:GlobalState", "links in the world's frame"),
    },
    "actuation": {
        "jumping/targets": ("targets:Targets", "PD targets within a person's range"),
        "jumping/offset_targets": ("run_up:OffsetTargets", "the reference's targets and offsets"),
    },
    "termination": {
        "jumping/crashed": ("terms:crashed", "touched what it must not"),
        "jumping/landed": ("terms:landed", "landed on the mat"),
        "jumping/fell": ("terms:fell", "lies on the mat, not landed as it should"),
        "jumping/fell_running": ("run_up:FellRunning", "fell before the take-off"),
        "jumping/arrived": ("run_up:arrived", "the take-off has come"),
    },
    "reward": {
        "jumping/spin": ("terms:spin", "little rotation of the root"),
        "jumping/safety": ("terms:safety", "not on the head"),
        "jumping/feet_first": ("terms:feet_first", "the feet before anything else"),
        "jumping/lying": ("terms:lying", "not upside down"),
        "jumping/match": ("run_up:match", "the take-off that is wanted"),
    },
    "measure": {
        "jumping/beside": ("approach:beside", "how far beside its place a run-up ended"),
    },
    "curriculum": {
        "jumping/accumulated": ("curriculum:Accumulated", "a higher bar for enough reward"),
    },
    "command": {
        "jumping join": ("join:Join", "join a run-up and its jump in one motion"),
        "jumping heights": ("heights:Heights", "the highest bar that a run clears"),
    },
}

#: Sections of a configuration: the options, and what is built of them.
SECTIONS = {"arena": ("arena:ArenaOptions", "arena:Arena")}

#: Tasks, ``conf/task/NAME.yaml``, and what is learned in each.
TASKS = {
    "jumping/high": "jump over a bar from a take-off state",
    "jumping/obstacle": "jump over a box from a take-off state",
    "jumping/run_up": "imitate a run-up, and arrive at a take-off state",
}

#: How to cite what is implemented here.
CITATIONS = {
    "yin2021jumping": (
        "Yin, Yang, van de Panne, Yin. Discovering diverse athletic jumping strategies. ACM Transactions "
        "on Graphics 40(4), 2021."
    ),
}

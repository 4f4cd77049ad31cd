"""Commands that show what there is."""

#: Plugins that this one builds on.
REQUIRES: tuple[str, ...] = ()

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "observer": {
        "origins": ("origins:RecordOrigins", "where a run's files come from"),
        "code": ("code:RecordCode", "which code a run ran"),
    },
    "command": {
        "experiments": ("commands:list_experiments", "list what can be trained"),
        "tasks": ("commands:list_tasks", "list the tasks"),
        "plugins": ("commands:list_plugins", "list the plugins and what they provide"),
        "describe": ("commands:Describe", "print a part's options: describe learner/ppo"),
        "config": ("commands:ShowConfiguration", "print every value and where it is from"),
        "replay": ("commands:Replay", "repeat the step in which a run's numbers went wrong"),
        "completion": ("completion:Completion", "print the completion of bash, zsh or fish"),
    },
}

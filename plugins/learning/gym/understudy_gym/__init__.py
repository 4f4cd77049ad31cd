"""Tasks as Gymnasium environments, for users of other learners: ``import understudy_gym.envs``."""

#: Plugins that this one builds on.
REQUIRES: tuple[str, ...] = ()

"""The walk, and a walk by imitation, with few worlds and small networks."""

SMALL = (
    "learner=imagination", "num_worlds=4", "control.substeps=5", "scene.servos.step_speed=10",
    "learner.rollout_steps=8", "learner.tail=4", "learner.model.hidden=[16]",
    "learner.model.first_samples=64", "learner.model.first_updates=3", "learner.model.updates=2",
    "learner.updates=2", "learner.model.replay=100",
)  # fmt: skip
WALK = ("experiment=spacetime/walk", "policy.feedback.hidden=[16]", *SMALL)
#: Its rewards have derivatives, and its only margin is a fall's.
IMITATION = ("experiment=deepmimic/walk", "policy.hidden=[16]", *SMALL)

"""The walk with few worlds and small networks."""

WALK = (
    "experiment=spacetime/walk", "learner=imagination", "num_worlds=4", "control.substeps=5",
    "scene.servos.step_speed=10", "policy.feedback.hidden=[16]", "learner.rollout_steps=8",
    "learner.tail=4", "learner.model.hidden=[16]", "learner.model.first_samples=64",
    "learner.model.first_updates=3", "learner.model.updates=2", "learner.updates=2",
    "learner.model.replay=100",
)  # fmt: skip

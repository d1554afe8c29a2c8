"""A recipe and an expert that are tuned within a second."""

from armctl.tuning import candidate_of

RECIPE = """
learner = "bc"
env = "armctl/ArmReach-v0"
teacher = "reach_ik:prepared=false"

[options]
demonstrations = 4
steps = 60
worlds = 4
evaluation_every = 20
validation_episodes = 4
evaluation_episodes = 4
learning_rate = 1e-3
hidden_units = 16

[tune.options]
learning_rate = { low = 1e-4, high = 1e-2, log = true }
hidden_units = { choices = [8, 16] }
"""


def expert(episodes=3, **options):
    return candidate_of("reach_mpc", episodes=episodes, **options)

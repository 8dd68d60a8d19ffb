"""A policy that learns to walk to what is asked for, and the measure of whether it beats random actions.

What is learnt: the environments are Gymnasium's. `WithEstimate` adds the direction that a method estimates, and
`ForTraining` makes all of it numbers that a library takes. Needs Stable-Baselines3 and a few minutes:
`pip install stable-baselines3`. The detector `truth` of the simulator has errors, and the target is often out of sight.
"""

import argparse

import gymnasium
import numpy as np
import torch
from stable_baselines3 import PPO

import eagor.tasks  # noqa: F401 (registers the environments)
from eagor.statistics import paired_difference, wilson_interval
from eagor.tasks.rules import NavigationRules
from eagor.tasks.training import ForTraining, WithEstimate

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--steps", type=int, default=40_000, help="of training")
parser.add_argument("--episodes", type=int, default=100, help="that judge, in apartments not trained in")
parser.add_argument("--method", default="vmf", help="estimates the direction: vmf is fast, eagor is better")
options = parser.parse_args()
torch.set_num_threads(1)  # small matrices


def make(apartments):
    """The environment in apartments of these seeds."""
    rules = NavigationRules(max_steps=100)
    settings = {"actions": "discrete", "panorama": None, "seeds": apartments, "rules": rules}
    env = gymnasium.make("Eagor/MapFreeNavigation-v0", **settings)
    return ForTraining(WithEstimate(env, "truth", options.method))


def judge(env, choose):
    """Success in each episode, and its apartment."""
    found = []
    for seed in range(options.episodes):
        (observation, _), over = env.reset(seed=seed), False
        while not over:
            observation, _, terminated, truncated, info = env.step(choose(observation))
            over = terminated or truncated
        found.append((info["success"], env.unwrapped.episode.slot.seed))
    return np.array(found).T


model = PPO("MultiInputPolicy", make(range(16)), n_steps=1024, batch_size=128, gamma=0.97, seed=0, device="cpu")
model.learn(options.steps)
env = make(range(1000, 1000 + max(2, options.episodes // 5)))
dice = np.random.default_rng(0)
trained, places = judge(env, lambda observation: int(model.predict(observation)[0]))
chance, _ = judge(env, lambda observation: int(dice.integers(4)))
for name, wins in (("trained", trained), ("random", chance)):
    low, high = wilson_interval(int(wins.sum()), len(wins))[:2]
    print(f"{name:8} reaches the target in {100 * wins.mean():.0f} % ({100 * low:.0f} to {100 * high:.0f})")
gain = paired_difference(trained, chance, np.random.default_rng(0), groups=places)
low, high = (100 * value for value in gain.interval[:2])
print(f"gain     {100 * gain.difference:.0f} points, 95 % interval {low:.0f} to {high:.0f}, whole apartments resampled")

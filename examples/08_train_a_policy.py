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
parser.add_argument("--steps", type=int, default=20_000, help="of training, in four apartments")
parser.add_argument("--apartments", type=int, default=20, help="others, with five episodes each, that judge")
parser.add_argument("--method", default="vmf", help="estimates the direction: vmf is fast, eagor is better")
options = parser.parse_args()
torch.set_num_threads(1)  # small matrices


def make(apartments):
    """The environment in apartments of these seeds."""
    settings = {"actions": "discrete", "panorama": None, "seeds": apartments, "rules": NavigationRules(max_steps=100)}
    return ForTraining(WithEstimate(gymnasium.make("Eagor/MapFreeNavigation-v0", **settings), "truth", options.method))


def success(env, seed, choose):
    """Whether an episode played with this choice of actions ends at the target."""
    (observation, _), over = env.reset(seed=seed), False
    while not over:
        observation, _, terminated, truncated, info = env.step(choose(observation))
        over = terminated or truncated
    return info["success"]


model = PPO("MultiInputPolicy", make(range(4)), n_steps=1024, batch_size=128, gamma=0.97, seed=0, device="cpu")
model.learn(options.steps)
dice = np.random.default_rng(0)
ways = {"trained": lambda seen: int(model.predict(seen)[0]), "random": lambda seen: int(dice.integers(4))}
found, places = {name: [] for name in ways}, np.repeat(np.arange(1000, 1000 + options.apartments), 5)
for place in np.unique(places).tolist():
    env = make(range(place, place + 1))
    for seed in range(5):
        for name, choose in ways.items():
            found[name].append(success(env, seed, choose))
for name, wins in found.items():
    ends = wilson_interval(int(sum(wins)), len(wins))
    print(f"{name} reaches the target in {100 * np.mean(wins):.0f} % ({100 * ends.low:.0f} to {100 * ends.high:.0f})")
gain = paired_difference(found["trained"], found["random"], np.random.default_rng(0), groups=places)
low, high = 100 * gain.interval.low, 100 * gain.interval.high
print(f"gain: {100 * gain.difference:.0f} points, 95 % interval {low:.0f} to {high:.0f} (apartments resampled)")

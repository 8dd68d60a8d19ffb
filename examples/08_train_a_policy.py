"""A policy that learns to walk to what is asked for, and the measure of whether it beats random actions.

What is learnt: the environments are Gymnasium's, and its wrappers make of them what a library takes. `Estimate` is one
more: its observation is the direction that a method estimates. Needs Stable-Baselines3 and a few minutes:
`pip install stable-baselines3`. The detector `truth` of the simulator has errors, and the target is often out of sight.
"""

import argparse

import gymnasium
import numpy as np
import torch
from gymnasium.wrappers import RescaleAction
from scipy.stats import binomtest
from stable_baselines3 import PPO

from eagor import perception
from eagor.conventions import rotation_from_wxyz
from eagor.lab.agents.methods import answer_at, make_estimator
from eagor.lab.agents.models import EpisodePerception
from eagor.lab.envs.rules import NavigationRules
from eagor.statistics import paired_difference

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--steps", type=int, default=20_000, help="of training, in four apartments")
parser.add_argument("--apartments", type=int, default=20, help="others, with five episodes each, that judge")
parser.add_argument("--method", default="vmf", help="estimates the direction: vmf is fast, eagor is better")
options = parser.parse_args()
torch.set_num_threads(1)  # small matrices
truth = perception.load("truth")


class Estimate(gymnasium.Wrapper):
    """The observation is the direction (x, y, z) of the target in the body frame, as the method estimates it."""

    observation_space = gymnasium.spaces.Box(-1, 1, (3,), np.float32)

    def reset(self, **settings):
        seen, info = self.env.reset(**settings)
        self.eye = EpisodePerception(truth, self.unwrapped.episode.spec, info["instances"]["labels"])
        self.method = make_estimator(options.method, np.random.default_rng(0), "truth")
        return self.estimate(seen, info), info

    def step(self, action):
        seen, reward, terminated, truncated, info = self.env.step(action)
        return self.estimate(seen, info), reward, terminated, truncated, info

    def estimate(self, seen, info):
        stamp = info["num_steps"] * self.unwrapped.camera.seconds
        pose = rotation_from_wxyz(seen["pose"][3:]), seen["pose"][:3]
        return answer_at(self.method, stamp, *pose, self.eye.infer(seen, info, stamp)).astype(np.float32)


def make(apartments):
    """The environment in apartments of these seeds; both numbers of an action are from -1 to 1."""
    settings = {"panorama": None, "seeds": apartments, "rules": NavigationRules(max_steps=100)}
    env = gymnasium.make("eagor.lab.tasks:Eagor/MapFreeNavigation-v0", **settings)
    return RescaleAction(Estimate(env), np.float32(-1), np.float32(1))


def success(env, seed, choose):
    """Whether an episode played with this choice of actions ends at the target."""
    (observation, _), over = env.reset(seed=seed), False
    while not over:
        observation, _, terminated, truncated, info = env.step(choose(observation))
        over = terminated or truncated
    return info["success"]


settings = {"n_steps": 1024, "batch_size": 128, "gamma": 0.97, "policy_kwargs": {"log_std_init": -1.0}}
model = PPO("MlpPolicy", make(range(4)), seed=0, device="cpu", **settings)
model.learn(options.steps)
dice = np.random.default_rng(0)
ways = {"trained": lambda seen: model.predict(seen)[0], "random": lambda seen: dice.uniform(-1, 1, 2)}
found, places = {name: [] for name in ways}, np.repeat(np.arange(1000, 1000 + options.apartments), 5)
for place in np.unique(places).tolist():
    env = make(range(place, place + 1))
    for seed in range(5):
        for name, choose in ways.items():
            found[name].append(success(env, seed, choose))
for name, wins in found.items():
    ends = binomtest(int(sum(wins)), len(wins)).proportion_ci(method="wilson")
    print(f"{name} reaches the target in {100 * np.mean(wins):.0f} % ({100 * ends.low:.0f} to {100 * ends.high:.0f})")
gain = paired_difference(found["trained"], found["random"], np.random.default_rng(0), groups=places)
low, high = 100 * gain.interval.low, 100 * gain.interval.high
print(f"gain: {100 * gain.difference:.0f} points, 95 % interval {low:.0f} to {high:.0f} (apartments resampled)")

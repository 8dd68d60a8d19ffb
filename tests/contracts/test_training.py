"""Training libraries learn in the environments: Gymnasium's statistics and vectors, and PPO of Stable-Baselines3."""

from __future__ import annotations

import math
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from flat_world import in_the_flat  # noqa: F401 (a fixture for every test)
from gymnasium.wrappers import FilterObservation, FlattenObservation, RescaleAction

import eagor.lab.tasks  # noqa: F401 (registers the environments)
from eagor.errors import WorldError
from eagor.lab.envs.rules import NavigationRules, TrackingRules, WaypointRules

stable_baselines3 = pytest.importorskip("stable_baselines3")
RULES = {
    "MapFreeNavigation": NavigationRules(max_steps=40),
    "WaypointFollowing": WaypointRules(leg_steps=6),
    "TargetTracking": TrackingRules(steps=30),
}
ROWS = 36  # the least that the network of Stable-Baselines3 takes
STEPS = 64


def make(name, **settings):
    return gymnasium.make(f"Eagor/{name}-v0", disable_env_checker=True, rules=RULES[name], **settings)


def wrapped(name, **settings):
    """What Gymnasium's own wrappers make of an environment: one vector, and actions from -1 to 1."""
    env = FlattenObservation(FilterObservation(make(name, **settings), ["rotation", "range"]))
    return RescaleAction(env, np.float32(-1), np.float32(1))


# One with all that it shows, one wrapped: Gymnasium's own checker passes for each (test_environments).
@pytest.mark.parametrize(
    ("name", "flat_vector"),
    [
        ("TargetTracking", False),
        ("MapFreeNavigation", True),
        pytest.param("WaypointFollowing", False, marks=pytest.mark.slow),
    ],
)
def test_ppo_learns_in_an_environment(name, flat_vector):
    make_it = wrapped if flat_vector else make
    policy = {"net_arch": [8]} | ({} if flat_vector else {"features_extractor_kwargs": {"cnn_output_dim": 8}})
    env = make_it(name, panorama=None if flat_vector else ROWS, with_range=True)
    model = stable_baselines3.PPO(
        "MlpPolicy" if flat_vector else "MultiInputPolicy",
        env,
        n_steps=STEPS,
        batch_size=STEPS,
        n_epochs=1,
        policy_kwargs=policy,
        device="cpu",
        seed=0,
    )
    model.learn(STEPS)
    assert model.num_timesteps == STEPS
    assert len(model.ep_info_buffer) >= 1, "an episode ended, and its statistics were kept"
    assert all(math.isfinite(each["r"]) for each in model.ep_info_buffer)
    assert all(bool(value.isfinite().all()) for value in model.policy.state_dict().values())


def test_a_start_far_from_the_origin_is_refused():
    env = make("TargetTracking", panorama=None)
    env.reset(seed=0)
    far = replace(env.unwrapped.episode, start=(2e4, 0.0))
    with pytest.raises(WorldError, match="within 10 km"):
        env.reset(options={"episode": far})

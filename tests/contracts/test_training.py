"""Training libraries learn in the environments: Gymnasium's statistics and vectors, and PPO of Stable-Baselines3."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from flat_world import loaders, the_flat
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import RecordEpisodeStatistics
from gymnasium.wrappers.vector import RecordEpisodeStatistics as RecordVectorStatistics

import eagor.tasks  # noqa: F401 (registers the environments)
from eagor.errors import EagorError, WorldError
from eagor.sphere import angular_distance, direction
from eagor.tasks.place_env import AZIMUTHS, ELEVATIONS, answer_from_indices, indices_of_answer
from eagor.tasks.rules import Disturbances, NavigationRules, TrackingRules, WaypointRules
from eagor.tasks.training import LEVEL, REACH, WORDS, ForTraining, WithEstimate

stable_baselines3 = pytest.importorskip("stable_baselines3")
check_for_stable_baselines = pytest.importorskip("stable_baselines3.common.env_checker").check_env
MODES = [
    ("MapFreeNavigation", {"actions": "continuous"}),
    ("MapFreeNavigation", {"actions": "discrete"}),
    ("WaypointFollowing", {"actions": "guided"}),
    ("WaypointFollowing", {"actions": "continuous"}),
    ("WaypointFollowing", {"actions": "discrete"}),
    ("TargetTracking", {}),
]
IDS = ["-".join([name, *settings.values()]) for name, settings in MODES]
RULES = {
    "MapFreeNavigation": NavigationRules(max_steps=40),
    "WaypointFollowing": WaypointRules(leg_steps=6),
    "TargetTracking": TrackingRules(steps=30),
}
ROWS = 36  # the least that the network of Stable-Baselines3 takes
STEPS = 256


@pytest.fixture(scope="module")
def flat():
    return the_flat()


@pytest.fixture(autouse=True)
def _in_the_flat(flat, monkeypatch):
    for module, load in loaders(flat):
        monkeypatch.setattr(module, "load_place", load)


def make(name, **settings):
    return gymnasium.make(f"Eagor/{name}-v0", disable_env_checker=True, rules=RULES[name], **settings)


def make_elsewhere():
    """An environment in a process of its own, where nothing is patched yet."""
    for module, load in loaders(the_flat()):
        module.load_place = load
    return ForTraining(make("TargetTracking", panorama=16))


# One plain and one wrapped; each mode, both ways, is a slow test.
LEARNT = [(*mode, wrapped) for wrapped in (False, True) for mode in MODES]
QUICK = (("TargetTracking", False), ("WaypointFollowing-guided", True))


@pytest.mark.parametrize(
    ("name", "settings", "wrapped"),
    [
        pytest.param(*each, marks=() if (name, each[2]) in QUICK else pytest.mark.slow, id=f"{name}-{each[2]}")
        for each, name in zip(LEARNT, 2 * IDS, strict=True)
    ],
)
def test_ppo_learns_in_every_environment_and_mode(name, settings, wrapped):
    if wrapped:
        env = ForTraining(WithEstimate(make(name, panorama=None, **settings), "truth", "centroid"))
    else:
        env = make(name, panorama=ROWS, with_range=settings.get("actions") == "discrete", **settings)
    model = stable_baselines3.PPO(
        "MultiInputPolicy",
        env,
        n_steps=STEPS,
        batch_size=STEPS,
        n_epochs=1,
        policy_kwargs={"net_arch": [8], "features_extractor_kwargs": {"cnn_output_dim": 8}},
        device="cpu",
        seed=0,
    )
    before = {key: value.clone() for key, value in model.policy.state_dict().items()}
    model.learn(STEPS)
    assert model.num_timesteps == STEPS
    assert len(model.ep_info_buffer) >= 1, "an episode ended, and its statistics were kept"
    assert all(math.isfinite(each["r"]) for each in model.ep_info_buffer)
    after = model.policy.state_dict()
    assert all(bool(value.isfinite().all()) for value in after.values())
    assert any(not value.equal(before[key]) for key, value in after.items())
    if wrapped and name == "MapFreeNavigation":
        assert len(model.ep_success_buffer) == len(model.ep_info_buffer), "success is logged"


@pytest.mark.parametrize(("name", "settings"), MODES, ids=IDS)
def test_the_checkers_find_nothing_to_wonder_about(name, settings):
    env = ForTraining(make(name, panorama=ROWS, with_range=True, **settings))
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*is different from the unwrapped version.*")
        check_env(env, skip_render_check=True)
        check_for_stable_baselines(env, warn=True)


@pytest.mark.parametrize(("name", "settings"), MODES, ids=IDS)
def test_episode_statistics_are_gymnasiums(name, settings):
    env = RecordEpisodeStatistics(make(name, panorama=None, **settings))
    env.action_space.seed(0)
    _, info = env.reset(seed=1)
    assert info["episode_id"] == env.unwrapped.episode.slot.id
    total, steps, over = 0.0, 0, False
    while not over:
        _, reward, terminated, truncated, info = env.step(env.action_space.sample())
        total, steps, over = total + reward, steps + 1, terminated or truncated
    assert info["episode"]["r"] == pytest.approx(total)
    assert info["episode"]["l"] == steps


@pytest.mark.parametrize(("name", "settings"), [MODES[0], MODES[4], MODES[5]], ids=[IDS[0], IDS[4], IDS[5]])
def test_vectors_go_on_after_an_episodes_end(name, settings):
    envs = gymnasium.make_vec(
        f"Eagor/{name}-v0", 2, "sync", wrappers=[ForTraining], rules=RULES[name], panorama=16, **settings
    )
    _plays_on(RecordVectorStatistics(envs), 45 if name != "WaypointFollowing" else 260)


@pytest.mark.slow  # each process imports PyTorch
def test_vectors_of_processes_go_on_after_an_episodes_end():
    envs = gymnasium.vector.AsyncVectorEnv([make_elsewhere] * 2, context="spawn")
    _plays_on(RecordVectorStatistics(envs), 35)


def _plays_on(envs, steps):
    envs.action_space.seed(0)
    observation, _ = envs.reset(seed=3)
    assert observation["panorama"].shape == (2, 16, 32, 3)
    ended = 0
    for _ in range(steps):
        observation, reward, _, _, info = envs.step(envs.action_space.sample())
        assert np.isfinite(reward).all()
        assert envs.observation_space.contains(observation)
        if "episode" in info:
            ended += int(info["_episode"].sum())
    assert ended >= 2
    envs.close()


def test_observations_for_training_say_what_the_environment_said():
    env = ForTraining(make("MapFreeNavigation", panorama=16, with_range=True, disturbances=Disturbances.walking()))
    first, info = env.reset(seed=4)
    assert np.allclose(first["pose"], [0, 0, 0, 1, 0, 0, 0], atol=1e-6)
    said = {word for word, asked in zip(WORDS, first["query"], strict=True) if asked}
    assert said == set(str(info["query"]).split(" ", 1)) or said == {str(info["query"])}
    inner = env.unwrapped
    start = inner.body.odometry
    for _ in range(5):
        observation, *_ = env.step(np.array([0.1, 1.0], np.float32))
    own = inner._observation()
    now = inner.body.odometry
    ahead = start.world_R_body.T @ (now.position - start.position)
    assert np.allclose(observation["pose"][:3] * REACH, ahead, atol=1e-5)
    assert np.allclose(observation["rotation"].reshape(3, 3), own["rotation"], atol=1e-6)
    shown = observation["range"][..., 0] * LEVEL
    assert np.abs(shown - np.minimum(own["range"], 255 * LEVEL)).max() <= LEVEL / 2 + 1e-6


def test_normalised_actions_span_the_environments_own():
    plain, wrapped = make("MapFreeNavigation", panorama=None), ForTraining(make("MapFreeNavigation", panorama=None))
    for scaled, own in [
        ((0.5, 1.0), (math.pi / 2, 0.25)),
        ((-0.25, -1.0), (-math.pi / 4, 0.0)),
        ((9.0, 0.0), (math.pi, 0.125)),
    ]:
        plain.reset(seed=2)
        wrapped.reset(seed=2)
        plain.step(np.array(own))
        wrapped.step(np.array(scaled))
        assert np.allclose(plain.unwrapped.body.xy, wrapped.unwrapped.body.xy, atol=1e-7)
        assert plain.unwrapped.body.yaw == pytest.approx(wrapped.unwrapped.body.yaw, abs=1e-6)


def test_a_walked_route_tells_where_its_leg_ends():
    env = ForTraining(make("WaypointFollowing", panorama=None, actions="discrete"))
    observation, info = env.reset(seed=6)
    cos, sin, distance = observation["waypoint"]
    assert math.atan2(sin, cos) == pytest.approx(info["waypoint"]["heading"], abs=1e-5)
    assert distance * REACH == pytest.approx(info["waypoint"]["distance"], abs=1e-4)
    answer = indices_of_answer(info["truth"]["direction"])
    *_, info = env.step(np.array([2, *answer]))
    assert info["error_deg"] < 3.6
    assert env.action_space == gymnasium.spaces.MultiDiscrete([4, AZIMUTHS, ELEVATIONS])


def test_the_estimate_is_the_one_that_a_run_would_give():
    config = {"task": "tracking", "perception": "truth", "camera": {}, "rules": {"steps": 30}, "rows": 32}
    config |= {"disturbances": {"latency": 2}}
    from eagor.tasks.play import Player

    player = Player(config)
    env = WithEstimate(make("TargetTracking", panorama=None, disturbances=Disturbances(latency=2)), "truth", "vmf")
    observation, _ = env.reset(seed=5)
    episode, over = env.unwrapped.episode, False
    found = [observation["estimate"]]
    while not over:
        observation, _, over, _, _ = env.step(np.array([1.0, 0, 0]))
        found.append(observation["estimate"])
    trace = player.play(episode.slot, ["vmf"])["methods"]["vmf"]["trace"]
    azimuth, elevation = (np.radians(trace[key]) for key in ("azimuth_deg", "elevation_deg"))
    off = angular_distance(np.array(found, dtype=np.float64), direction(azimuth, elevation))
    assert np.degrees(off).max() < 0.05


def test_answers_in_whole_numbers_are_near_every_direction():
    rng = np.random.default_rng(0)
    for answer in [*rng.standard_normal((500, 3)), np.array([0, 0, 1.0]), np.array([-1.0, -1e-9, 0])]:
        again = answer_from_indices(*indices_of_answer(answer))
        assert math.degrees(float(angular_distance(answer, again))) < 3.6


@pytest.mark.parametrize(
    ("action", "says"),
    [
        ({"answer": np.ones(3), "move": 1}, "wanted 3 numbers"),
        (np.array([1, 2]), "wanted 3 numbers"),
        (np.array([1, AZIMUTHS, 0]), "wanted an azimuth from 0 to 71"),
        (np.array([1, 0, -1]), "elevation from 0 to 36"),
    ],
)
def test_other_actions_are_refused(action, says):
    env = make("WaypointFollowing", panorama=None, actions="discrete")
    env.reset(seed=0)
    with pytest.raises(WorldError, match=says):
        env.step(action)


def test_wrappers_say_what_they_need():
    with pytest.raises(WorldError, match="leave instances on"):
        WithEstimate(make("TargetTracking", panorama=None, instances=False), "truth")
    with pytest.raises(WorldError, match="sees panoramas; set panorama"):
        WithEstimate(make("TargetTracking", panorama=None), "colour")
    with pytest.raises(EagorError, match="no method"):
        WithEstimate(make("TargetTracking", panorama=None), "truth", "guess")
    with pytest.raises(WorldError, match="none of the environments"):
        ForTraining(gymnasium.make("CartPole-v1"))
    env = make("TargetTracking", panorama=None)
    env.reset(seed=0)
    far = replace(env.unwrapped.episode, start=(2e4, 0.0))
    with pytest.raises(WorldError, match="within 10 km"):
        env.reset(options={"episode": far})

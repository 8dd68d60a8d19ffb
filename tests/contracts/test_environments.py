"""The Gymnasium environments keep Gymnasium's contract, and Habitat's definitions."""

from __future__ import annotations

import json
import math
import warnings
from dataclasses import replace
from functools import cache

import gymnasium
import msgspec
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from rooms import two_rooms

from eagor.errors import EagorError, WorldError
from eagor.lab.envs import place_env, places
from eagor.lab.envs.episodes import EpisodeSpec
from eagor.lab.envs.rules import (
    RATIO,
    Camera,
    NavigationRules,
    NoiseModel,
    TrackingRules,
    WaypointRules,
)
from eagor.lab.tasks.sim import navigation, tracking, waypoint
from eagor.lab.tasks.sim.rollout import Runner
from eagor.lab.worlds.ground import Ground
from eagor.lab.worlds.render import Renderer
from eagor.sphere import angular_distance

SHORT_LEGS = WaypointRules(leg_steps=6)
SETTINGS = {"waypoint": {"rules": SHORT_LEGS}}


@cache
def the_flat():
    scene = two_rooms()
    return places.Place(scene, Ground.from_scene(scene), Renderer(scene))


@pytest.fixture(autouse=True)
def in_the_flat(monkeypatch):
    """The little flat of boxes is the place of every episode."""
    for module in (places, navigation, waypoint, tracking, place_env):
        monkeypatch.setattr(module, "load_place", lambda *_: the_flat())


def make(task, **settings):
    name = {"waypoint": "WaypointFollowing", "navigation": "MapFreeNavigation", "tracking": "TargetTracking"}[task]
    return gymnasium.make(f"Eagor/{name}-v0", disable_env_checker=True, **(SETTINGS.get(task, {}) | settings))


@pytest.mark.parametrize(
    ("task", "settings"),
    [
        ("navigation", {"panorama": 16, "with_range": True}),
        ("navigation", {"panorama": None}),
        ("waypoint", {"panorama": 16, "with_range": True}),
        ("tracking", {"panorama": 16, "with_range": True}),
    ],
)
def test_gymnasiums_checker_passes(task, settings):
    with warnings.catch_warnings():
        # Headings and metres are not scaled to [-1, 1] (`RescaleAction` does that): Gymnasium wonders.
        warnings.filterwarnings("ignore", message=".*symmetric and normalized space.*")
        check_env(make(task, **settings, render_mode="rgb_array").unwrapped, skip_render_check=False)


def test_stable_baselines_learns_from_all_that_an_environment_shows():
    """Examples/08 trains with Gymnasium's own wrappers around one."""
    ppo = pytest.importorskip("stable_baselines3").PPO
    env = make(
        "tracking", rules=TrackingRules(steps=30), panorama=36, with_range=True
    )  # the least that its network takes
    policy = {"net_arch": [8], "features_extractor_kwargs": {"cnn_output_dim": 8}}
    model = ppo(
        "MultiInputPolicy", env, n_steps=64, batch_size=64, n_epochs=1, policy_kwargs=policy, device="cpu", seed=0
    )
    model.learn(64)
    assert len(model.ep_info_buffer) >= 1, "an episode ended, and its statistics were kept"
    assert all(math.isfinite(each["r"]) for each in model.ep_info_buffer)
    assert all(bool(value.isfinite().all()) for value in model.policy.state_dict().values())


def test_navigation_starts_facing_away_and_scores_as_habitat_does():
    env = make("navigation", panorama=None)
    for seed in range(3):
        _, info = env.reset(seed=seed)
        episode = env.unwrapped.episode
        azimuth = math.atan2(*info["truth"]["direction"][1::-1])
        assert abs(math.remainder(azimuth - math.pi, 2 * math.pi)) <= math.radians(20) + 1e-9
        rules = NavigationRules()
        assert rules.nearest <= episode.shortest <= rules.farthest
        assert episode.stratum["ratio"] <= RATIO
        assert info["distance_to_goal"] == pytest.approx(episode.shortest)
        walked, place = 0.0, env.unwrapped.body.xy.copy()
        over = False
        while not over:
            target = info["truth"]["direction"]
            _, _, terminated, truncated, info = env.step(np.array([math.atan2(target[1], target[0]), 0.25]))
            walked += float(np.hypot(*(env.unwrapped.body.xy - place)))
            place = env.unwrapped.body.xy.copy()
            over = terminated or truncated
        left = info["distance_to_goal"]
        assert info["success"] == float(terminated) == float(left < 1.0)
        assert info["spl"] == pytest.approx(info["success"] * episode.shortest / max(episode.shortest, walked))
        gained = max(0.0, 1 - left / episode.shortest)
        assert info["soft_spl"] == pytest.approx(gained * episode.shortest / max(episode.shortest, walked))
        assert info["num_steps"] <= 500


def test_a_wall_stops_a_step_without_sliding_and_bends_it_with():
    ends = []
    for sliding in (False, True):
        env = make("navigation", panorama=None, rules=NavigationRules(sliding=sliding, max_steps=30))
        env.reset(seed=4)
        body, over = env.unwrapped.body, [False]
        while not any(over):  # always north-east in the world
            before = body.xy.copy()
            _, _, *over, info = env.step(np.array([math.remainder(0.7 - body.yaw, 2 * math.pi), 9.0]))
            assert np.hypot(*(body.xy - before)) <= 0.25 + 1e-9, "a step is no longer, whatever is asked for"
        assert info["collisions"]["count"] > 0
        ends.append(body.xy)
    assert not np.allclose(*ends)


def test_the_observation_is_of_the_camera_and_the_truth_of_the_world():
    env = make("waypoint", panorama=16)
    observation, info = env.reset(seed=5)
    rotations, poses = [], [info["truth"]]
    over = False
    while not over:
        observation, reward, over, _, info = env.step(info["truth"]["direction"].astype(np.float32))
        rotations.append(observation["rotation"])
        poses.append(info["truth"])
        assert reward == pytest.approx(0.0, abs=2e-3)
    for rotation, before, after in zip(rotations, poses[:-1], poses[1:], strict=True):
        assert np.allclose(rotation, after["world_R_body"].T @ before["world_R_body"], atol=1e-12)
    centre = env.unwrapped.place.scene.instances[env.unwrapped.episode.targets[0]].centre
    for pose in poses:
        offset = pose["world_R_body"].T @ (centre - pose["position"])
        assert angular_distance(offset, pose["direction"]) < 1e-9
        assert pose["distance"] == pytest.approx(np.linalg.norm(offset))


def test_waypoint_routes_have_four_legs_of_growing_turns():
    for seed in range(3):
        spec = EpisodeSpec("waypoint", "apartment", seed, 0, 0)
        env = waypoint.WaypointFollowingEnv(rules=SHORT_LEGS, panorama=None)
        episode = env.plan(spec)
        route, legs = np.array(episode.route), np.array(episode.legs)
        assert list(dict.fromkeys(legs)) == ["L1", "L2", "L3", "L4"]
        for leg in ("L1", "L2", "L3", "L4"):
            assert (legs == leg).sum() >= SHORT_LEGS.leg_steps
        steps = np.linalg.norm(np.diff(route[:, :2], axis=0), axis=-1)
        assert steps.max() <= 0.25 + 1e-6
        turns = np.abs([math.remainder(b - a, 2 * math.pi) for a, b in zip(route[:-1, 2], route[1:, 2], strict=True)])
        assert np.degrees(turns.max()) <= 30 + 1e-6
        assert episode == env.plan(spec), "the same spec is the same episode"


def test_the_ball_goes_where_the_scenario_says():
    seen = {}
    for number in range(3):
        env = tracking.TargetTrackingEnv(panorama=None)
        episode = env.plan(EpisodeSpec("tracking", "apartment", 7, number, number))
        _, info = env.reset(options={"episode": episode})
        present, over = [info["truth"]["present"]], False
        while not over:
            _, _, over, _, info = env.step(np.array([1.0, 0, 0], np.float32))
            present.append(info["truth"]["present"])
        seen[episode.stratum["scenario"]] = (np.array(present), episode)
    gone, episode = seen["target gone"]
    assert 0.1 < 1 - gone.mean() < 0.3
    assert gone[0]
    assert gone[-1]
    balls = [ball for ball in seen["moving target"][1].balls if ball is not None]
    assert np.linalg.norm(np.diff(balls, axis=0), axis=-1).max() <= 0.2 + 1e-9
    assert len({tuple(row) for row in seen["moving target"][1].route}) == 1
    assert len(set(seen["moving camera"][1].balls)) == 1
    assert len({tuple(row) for row in seen["moving camera"][1].route}) > 30


@pytest.mark.parametrize(
    ("task", "names"),
    [("navigation", ["centroid", "eagor_paper"]), ("tracking", ["centroid", "particle_filter", "eagor"])],
)
def test_running_the_same_spec_twice_gives_the_same_record(task, names):
    config = {"task": task, "perception": "truth", "camera": {}, "rows": 32}
    config |= {"rules": {"steps": 8} if task == "tracking" else {}}
    config["disturbances"] = msgspec.structs.asdict(NoiseModel.walking(latency=2))
    spec = EpisodeSpec(task, "apartment", 11, 1, 1)
    first, second = (Runner(config).run_episode(spec, names) for _ in range(2))
    assert json.dumps(first, sort_keys=True, allow_nan=False) == json.dumps(second, sort_keys=True, allow_nan=False)
    alone = Runner(config).run_episode(spec, names[-1:])
    assert alone["methods"][names[-1]] == first["methods"][names[-1]], "a method is not disturbed by others"


@pytest.mark.parametrize(
    ("kind", "rules", "says"),
    [
        (Camera, {"height": math.nan}, "Camera.*Expected `float` > 0"),
        (NoiseModel, {"latency": 0.5}, "NoiseModel.*Expected `int`"),
        (NavigationRules, {"nearest": 9.0}, "farthest = 8.0; wanted no less than nearest = 9.0"),
        (TrackingRules, {"gone": (0.0, 0.5)}, "wanted an ascending pair, with the ball present at step 1 of 60"),
        (TrackingRules, {"gone": (0.5, 0.4)}, "wanted an ascending pair"),
    ],
)
def test_rules_that_nothing_can_be_played_under_are_refused(kind, rules, says):
    with pytest.raises(WorldError, match=says):
        kind(**rules)
    with pytest.raises(msgspec.ValidationError, match=says.partition(".*")[2] or says):
        msgspec.convert(rules, kind)


def test_bad_input_says_what_was_wanted():
    with pytest.raises(WorldError, match="render_mode"):
        navigation.MapFreeNavigationEnv(render_mode="human")
    env = make("navigation", panorama=None)
    env.reset(seed=0)
    with pytest.raises(WorldError, match="wanted 2 finite numbers"):
        env.step(np.array([np.nan, 0.25]))
    with pytest.raises(EagorError, match="unknown field `height_of`"):
        Runner({"task": "navigation", "perception": "truth", "camera": {"height_of": 2}})
    with pytest.raises(EagorError, match="no task"):
        Runner({"task": "swimming", "perception": "truth"})
    good = env.unwrapped.episode
    for change, says in (({"start": (2e4, 0.0)}, "within 10 km"), ({"scene_hash": "0" * 16}, "plan the episode again")):
        with pytest.raises(WorldError, match=says):
            env.reset(options={"episode": replace(good, **change)})


@pytest.mark.parametrize("policy", ["search", "follow"])
def test_a_body_that_believes_that_it_has_arrived_calls_stop(policy):
    rules = {"stop": "call", "policy": policy}
    config = {"task": "navigation", "perception": "truth:ideal", "camera": {}, "rules": rules, "disturbances": {}}
    spec = EpisodeSpec("navigation", "apartment", 2, 0, 0)
    arrived = Runner(config | {"rows": 32}).run_episode(spec, ["oracle"])["methods"]["oracle"]["metrics"]
    assert (arrived["success"], arrived["distance_to_goal"] < 1.0, arrived["steps"] < 500) == (1.0, True, True)
    assert arrived["mae"] == pytest.approx(0.0, abs=1e-6)
    unknowing = Runner(config | {"rows": 32, "rules": rules | {"max_steps": 30}}).run_episode(spec, ["vmf"])
    never = unknowing["methods"]["vmf"]["metrics"]
    assert (never["success"], never["steps"]) == (0, 30), "it knows no distance"


def test_an_episode_in_a_file_is_the_same_wherever_the_file_is(tmp_path):
    files = [tmp_path / folder / "house.glb" for folder in ("one", "other")]
    for file in files:
        file.parent.mkdir()
        file.write_bytes(b"the same")

    def drawn(world):
        return EpisodeSpec("navigation", str(world), 3, 1, 1).rng("plan").random()

    assert drawn(files[0]) == drawn(files[1])
    assert drawn(f"habitat:{files[0]}?up=y") == drawn(f"habitat:{files[1]}?up=y") != drawn(files[0])
    before = drawn(files[1])
    files[1].write_bytes(b"another one")
    assert drawn(files[1]) != before
    assert drawn("apartment") == 0.3246801282763019, "as in every run so far"

"""Navigation over the episodes of a file, in our own world: what is played, how it is judged, what is said about it."""

import gzip
import json

import numpy as np
import pytest
from commands import answer, eagor
from listed_rooms import content, exported, rewrite

from eagor.errors import WorldError
from eagor.lab.envs.episodes import FileEpisodeSpec, file_episode_specs, plan_listed, spec_from_json
from eagor.lab.envs.places import load_place
from eagor.lab.envs.rules import Camera, NavigationRules
from eagor.lab.eval import log
from eagor.lab.eval.episodes import spec_in
from eagor.lab.eval.results import read
from eagor.lab.worlds.glb import ON_MESH
from eagor.lab.worlds.objectnav import read_episodes


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    return exported(tmp_path_factory.mktemp("listed"), episodes=5, names=("room", "other"))


@pytest.fixture(scope="module")
def run(file, tmp_path_factory):
    out = tmp_path_factory.mktemp("runs") / "run"
    words = ["bench", "run", "navigation", "--perception", "truth", "--methods", "oracle", "eagor", "--out", out,
             "--episodes-file", file, "--episodes", "6", "--set", "max_steps=60"]  # fmt: skip
    answer(*words)
    return out, words


@pytest.mark.slow
def test_a_run_plays_some_episodes_of_each_scene_and_says_how_they_were_judged(run):
    out, words = run
    said = eagor(*words).stdout
    assert "Map-Free Navigation: 6 episodes" in said
    assert "success: less than 0.1 m along the floor from a view point of the goal" in said
    assert "without sliding" in said
    records = log.read(out)
    assert [record["key"] for record in records if record["key"].endswith("oracle")] == [
        f"navigation/{name}-{index}/oracle" for name in ("other", "room") for index in range(3)
    ]
    settings = log.description(out)
    assert settings["episodes"] == 6
    assert settings["development"] is False  # no apartment's seed
    assert (settings["rules"]["success_distance"], settings["rules"]["goal"]) == (0.1, "view_points")
    assert settings["rules"]["sliding"] is False
    answer("bench", "report", out)
    for name in ("report.html", "tables.md"):
        text = (out / name).read_text(encoding="utf-8")
        assert "less than 0.1 m along the floor from a view point of the goal" in text
    shown = answer("bench", "failures", out)
    assert isinstance(spec_in(read(out), shown["cases"][0]["case"]), FileEpisodeSpec)


def test_each_measure_is_that_of_the_recorded_path(run, file):
    """Made again from the path, the file and the floor, by the formulas of habitat-lab's measures."""
    out, _ = run
    by_scene = {each.episodes[0].scene: each for each in read_episodes(file)}
    for record in log.read(out):
        spec = spec_from_json(record["episode"]["slot"])
        assert isinstance(spec, FileEpisodeSpec)
        listed = by_scene[spec.scene].episodes[spec.episode]
        ground = load_place(spec.world, spec.seed, 0.18).ground
        views = [goal.view_positions[:, :2] for goal in by_scene[spec.scene].goals[listed.category]]
        way = ground.field(np.concatenate(views))
        ((method, entry),) = record["methods"].items()
        path, found = np.array(entry["path"]), entry["metrics"]
        assert path[0] == pytest.approx([*listed.position[:2], ground.floor], abs=1e-9)
        assert listed.position[2] == pytest.approx(ground.floor + ON_MESH)
        assert len(path) == found["steps"] + 1 == len(entry["trace"]["pose"]) + 1
        steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
        assert steps.max() <= 0.25 + 2e-9  # records keep nine digits of each coordinate
        length, left, shortest = steps.sum(), float(way.distance(path[-1, :2])), float(way.distance(path[0, :2]))
        won = float(left < 0.1)
        efficiency = shortest / max(shortest, length)
        assert shortest == pytest.approx(listed.geodesic, abs=1e-6)
        assert found["distance_to_goal"] == pytest.approx(left, abs=2e-4)
        assert found["success"] == won, method
        assert found["spl"] == pytest.approx(won * efficiency, abs=1e-6)
        assert found["soft_spl"] == pytest.approx(max(0, 1 - left / shortest) * efficiency, abs=1e-4)
        assert not won or (path[-1] == path[-2]).all(), "it ends where stop was called, which moves nothing"


def test_other_rules_of_success_are_taken_and_said(file, tmp_path):
    words = ["bench", "run", "navigation", "--perception", "truth", "--methods", "oracle", "--out", tmp_path,
             "--episodes-file", file, "--episodes", "2", "--set", "success_distance=1.5", "goal=footprint",
             "sliding=true"]  # fmt: skip
    said = eagor(*words).stdout
    assert "success: less than 1.5 m along the floor from the target's footprint" in said
    assert "with sliding" in said
    for record in log.read(tmp_path):
        ((_, entry),) = record["methods"].items()
        assert entry["metrics"]["success"] == 1
        assert entry["metrics"]["distance_to_goal"] < 1.5


# --- one episode ---


def planned(file, change=None, number=0):
    if change is not None:
        rewrite(file, change)
    spec = file_episode_specs("navigation", file, None, "apartment", None)[number]
    return spec, plan_listed(spec, str(file), Camera(), NavigationRules.objectnav())


def test_an_episode_looks_for_all_things_of_its_category_and_starts_as_the_file_says(file):
    spec, episode = planned(file)
    place = load_place(spec.world, spec.seed, 0.18)
    assert episode.query == "chair"
    assert [place.scene.instances[index].category for index in episode.targets] == ["chair", "chair"]
    (mine,) = (each for each in read_episodes(file) if each.episodes[0].scene == spec.scene)
    listed = mine.episodes[0]
    assert np.allclose(episode.start, listed.position[:2])
    assert np.cos(episode.yaw) == pytest.approx(listed.world_R_body[0, 0])
    assert np.sin(episode.yaw) == pytest.approx(listed.world_R_body[1, 0])
    assert float(place.way_to_views(episode.view_points).distance(episode.start)) == episode.shortest
    said = episode.as_json()
    assert said["listed"]["geodesic_distance"] == pytest.approx(episode.shortest, abs=1e-6)
    assert "view_points" not in said
    json.dumps(said, allow_nan=False)


def test_view_points_of_another_storey_are_not_reached_from_this_one(tmp_path):
    file = exported(tmp_path)
    spec, before = planned(file)
    place = load_place(spec.world, spec.seed, 0.18)

    def lifted(found):
        (goals,) = found["goals_by_category"].values()
        for view in goals[0]["view_points"]:
            view["agent_state"]["position"][1] += 3.0

    _, episode = planned(file, lifted)
    (goals,) = content(file)["goals_by_category"].values()
    away = episode.view_points[: len(goals[0]["view_points"]), :2]
    assert place.way_to_views(before.view_points).distance(away).max() < 0.1
    assert place.way_to_views(episode.view_points).distance(away).min() > 0.3
    assert len(episode.goals) == 1

    def all_lifted(found):
        (goals,) = found["goals_by_category"].values()
        for view in goals[1]["view_points"]:
            view["agent_state"]["position"][1] += 3.0

    with pytest.raises(WorldError, match="no view points on the storey of its start"):
        planned(file, all_lifted)


# --- files ---


def test_few_episodes_are_taken_from_each_scene_in_turn(file):
    def taken(count):
        return [each.id for each in file_episode_specs("navigation", file, count, "apartment", None)]

    assert taken(3) == ["other-0", "other-1", "room-0"]
    assert taken(4) == ["other-0", "other-1", "room-0", "room-1"]
    assert len(taken(None)) == len(taken(99)) == 10


def test_starts_on_stairs_do_not_join_the_storeys(tmp_path):
    file = exported(tmp_path)

    def on_stairs(found):
        for episode, height in zip(found["episodes"], (0.0, 1.1, 2.2, 2.9), strict=True):
            episode["start_position"][1] += height

    rewrite(file, on_stairs)
    episode_specs = file_episode_specs("navigation", file, None, "habitat", None)
    assert [each.world.rpartition("&")[2] for each in episode_specs] == ["storey=0.56"] * 2 + ["storey=2.56"] * 2


def test_a_start_on_another_storey_is_refused(tmp_path):
    def upstairs(found):
        found["episodes"][0]["start_position"][1] += 2.9

    with pytest.raises(WorldError, match=r"starts at the height 2.91 m, but the ground there is at 0.00 m in .*storey"):
        planned(exported(tmp_path), upstairs)


def test_one_file_may_hold_several_scenes(tmp_path):
    file = exported(tmp_path, names=("room", "other"))
    both, other = (content(file, name) for name in ("room", "other"))
    both["episodes"] += other["episodes"]
    both["goals_by_category"] |= other["goals_by_category"]
    together = tmp_path / "data" / "both" / "val.json.gz"
    together.parent.mkdir()
    together.write_bytes(gzip.compress(json.dumps(both).encode()))
    wanted = {each.episodes[0].scene: each for each in read_episodes(file)}
    found = {each.episodes[0].scene: each for each in read_episodes(together)}
    assert found.keys() == wanted.keys()
    for scene, each in found.items():
        assert [tuple(one.position) for one in each.episodes] == [tuple(one.position) for one in wanted[scene].episodes]
        assert [goal.instance for goal in each.goals["chair"]] == [
            goal.instance for goal in wanted[scene].goals["chair"]
        ]
    assert len(file_episode_specs("navigation", together, None, "apartment", None)) == 8


def test_random_numbers_do_not_depend_on_where_the_scenes_are(file):
    one = file_episode_specs("navigation", file, None, "apartment", None)[0]
    two = FileEpisodeSpec(**{**vars(one), "world": "elsewhere", "seed": 3})
    assert one.rng("plan").random() == two.rng("plan").random()
    assert one.rng("plan").random() != one.rng("method").random()
    assert one.id == two.id == "other-0"


def test_in_habitat_each_scene_is_a_world_with_its_dataset_its_storeys_and_the_options(file):
    home = file.parents[5] / "scene_datasets"
    dataset = home / "eagor/eagor.scene_dataset_config.json"
    for world, options in (("habitat", "body=0.88"), ("habitat:?body=1.41&gpu=-1", "body=1.41&gpu=-1")):
        assert [each.world for each in file_episode_specs("navigation", file, 2, world, None)] == [
            f"habitat:{home}/eagor/val/{place}.glb?dataset={dataset}&{options}&storey=0.01"
            for place in ("00001-other/other", "00000-room/room")
        ]
    one, scene = file.parent / "content" / "room.json.gz", home / "eagor/val/00000-room/room.glb"
    specs = file_episode_specs("navigation", one, None, f"habitat:{scene}", None)
    assert {each.world for each in specs} == {f"habitat:{scene}?body=0.88"}

"""habitat-lab reads what we write, its own mesh leads to our goals, and our policy plays in it.

Needs habitat-lab and Habitat-Sim, which no extra of ours brings.
"""

import habitat_lab
import numpy as np
import pytest
from listed_rooms import contents, exported

pytestmark = [
    pytest.mark.habitat,
    pytest.mark.skipif(habitat_lab.missing() is not None, reason=habitat_lab.missing() or "all is there"),
    pytest.mark.filterwarnings("ignore"),  # of gym, and of what habitat-lab imports
]


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    return exported(tmp_path_factory.mktemp("lab"), episodes=6, names=("room", "other"))


@pytest.fixture(scope="module")
def found(file):
    return habitat_lab.dataset(file, file.parents[5] / "scene_datasets")


def test_its_reader_finds_the_episodes_that_we_wrote(file, found):
    assert len(found.episodes) == 12
    assert found.category_to_task_category_id == found.category_to_scene_annotation_category_id == {"chair": 0}
    ours = [(each, episode) for each in contents(file) for episode in each["episodes"]]
    home = file.parents[5] / "scene_datasets"
    for (content, mine), theirs in zip(ours, found.episodes, strict=True):
        assert theirs.scene_id == str(home / mine["scene_id"])
        assert (home / mine["scene_id"]).is_file()
        for name in ("object_category", "start_position", "start_rotation", "info"):
            assert getattr(theirs, name) == mine[name]
        (goals,) = content["goals_by_category"].values()
        assert [goal.object_id for goal in theirs.goals] == [goal["object_id"] for goal in goals]
        for goal, wanted in zip(theirs.goals, goals, strict=True):
            places = [view.agent_state.position for view in goal.view_points]
            assert np.allclose(places, [view["agent_state"]["position"] for view in wanted["view_points"]])


def test_our_policy_plays_its_episodes_and_stops_by_itself(file, tmp_path):
    played = habitat_lab.played(file, tmp_path / "played.json", "scout", 5)
    assert len(played) == 5
    assert all(set(episode["actions"]) <= {"stop", "move_forward", "turn_left", "turn_right"} for episode in played)
    assert any(episode["actions"][-1] == "stop" for episode in played)
    assert np.isfinite([episode["start_m"] for episode in played]).all(), "its own mesh leads from the start to a goal"
    for episode in played:
        assert episode["metrics"]["success"] <= (episode["actions"][-1] == "stop"), "success needs the stop action"

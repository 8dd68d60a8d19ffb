"""The whole command on an exported folder, in Habitat: with a stand-in for Habitat-Sim, which runs everywhere."""

import sys

import numpy as np
import pytest
from commands import eagor
from habitat_stand_in import installed
from listed_rooms import exported, rewrite

from eagor.lab.eval import log
from eagor.lab.worlds.habitat import world


@pytest.fixture(autouse=True)
def habitat(monkeypatch):
    yield from installed(monkeypatch)


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """Exported where there is no Habitat-Sim: no meshes."""
    return exported(tmp_path_factory.mktemp("data"), episodes=2, names=("room", "other"))


def bench(file, out, *more):
    words = ["bench", "run", "navigation", "--perception", "truth", "--methods", "oracle", "--set", "max_steps=80"]
    return eagor(*words, "--episodes-file", file, "--out", out, *more)


def test_the_same_episodes_are_played_in_both_worlds(file, tmp_path):
    bench(file, tmp_path / "ours")
    assert "4 episodes" in bench(file, tmp_path / "there", "--world", "habitat").stdout
    ours, there = (log.read(tmp_path / name) for name in ("ours", "there"))
    assert [record["key"] for record in ours] == [record["key"] for record in there]
    for mine, theirs in zip(ours, there, strict=True):
        assert theirs["episode"]["scene"].startswith("habitat ")
        assert mine["episode"]["query"] == theirs["episode"]["query"] == "chair"
        for key in ("start", "yaw", "shortest"):
            assert theirs["episode"][key] == pytest.approx(mine["episode"][key], abs=0.05), key
        found, wanted = (record["methods"]["oracle"] for record in (theirs, mine))
        assert found["metrics"]["success"] == wanted["metrics"]["success"]
        assert found["trace"]["true_azimuth_deg"][0] == pytest.approx(wanted["trace"]["true_azimuth_deg"][0], abs=0.1)
        assert found["trace"]["true_range_m"][0] == pytest.approx(wanted["trace"]["true_range_m"][0], abs=0.01)
        assert np.allclose(found["path"][0], wanted["path"][0], atol=1e-6)


def test_a_start_off_the_mesh_costs_its_episode_alone(tmp_path):
    file = exported(tmp_path, episodes=2)
    rewrite(file, lambda found: found["episodes"][0].update(start_position=[4.0, 0.0, -3.0]))
    done = bench(file, tmp_path / "run", "--world", "habitat")
    assert done.returncode == 3
    assert "not on free ground" in done.stderr


def test_without_the_simulator_nothing_is_begun(file, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "habitat_sim", None)
    world.open_scene.cache_clear()
    done = bench(file, tmp_path / "run", "--world", "habitat")
    assert done.returncode == 2
    assert "Habitat-Sim" in done.stderr
    assert not (tmp_path / "run").exists()

"""Runs that are killed at random moments; ``python benchmarks/kills.py --kills 20`` does it as often as wanted."""

import os
import subprocess
import sys
from pathlib import Path

import hstar_data
import pytest

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "kills.py"
ENVIRONMENT = {name: value for name, value in os.environ.items() if name != "EAGOR_DEBUG"}

pytestmark = [
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="finds processes as Linux shows them"),
    pytest.mark.slow,  # one kill of each kind is in tests/end_to_end/test_runner.py
]


def kills(*words):
    done = subprocess.run(
        [sys.executable, SCRIPT, *map(str, words)], capture_output=True, text=True, timeout=600, env=ENVIRONMENT
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_killed_run_of_a_simulated_task_comes_to_the_same():
    said = kills("--kills", 1, "--episodes", 4, "--task", "waypoint")
    assert "1 kills" in said
    assert "no process left behind" in said


def test_a_killed_run_of_a_benchmark_comes_to_the_same_whoever_is_killed(tmp_path):
    data = hstar_data.write(tmp_path)
    words = ("--task", "hstar-hos", "--data", data, "--episodes", 16, "--who", "worker", "parent", "all")
    assert "3 kills" in kills("--kills", 3, *words)

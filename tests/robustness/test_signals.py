"""Promised: SIGTERM is heeded as Ctrl-C is. It is said, results are kept, nobody is left behind."""

import os
import signal
import subprocess
import sys

import hstar_data
import processes
import pytest
from processes import alive, sessions_of, wait_for

from eagor.lab.eval import log

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="finds processes as Linux shows them")

MODEL = """
import time
from pathlib import Path

def silent():
    return answer

def answer(messages):
    (Path(__file__).parent / "asked").touch()
    time.sleep(600)
"""


STARTED = []


@pytest.fixture(autouse=True)
def _nobody_goes_on():
    """A run that a test has not ended would work for hours."""
    yield
    while STARTED:
        run = STARTED.pop()
        if run.poll() is None:
            for pid in alive(sessions_of(run.pid)):
                os.kill(pid, signal.SIGKILL)
            run.communicate()


def begun(*words, path=""):
    STARTED.append(processes.begun(*words, path=path, text=True))
    return STARTED[-1]


def ended(run, number, whole_session=False):
    """Send the signal; the exit code and what was said, once every process has left."""
    sessions = sessions_of(run.pid)
    (os.killpg if whole_session else os.kill)(run.pid, number)
    out, said = run.communicate(timeout=300)
    wait_for(lambda: not alive(sessions))
    assert "Traceback" not in said
    return run.returncode, out, said.splitlines()[-1]


def kept(folder):
    return log.read(folder) if folder.exists() else []


TOLD = {signal.SIGTERM: (143, "", "eagor: terminated"), signal.SIGINT: (130, "", "eagor: interrupted")}


@pytest.mark.parametrize("number", [signal.SIGTERM, pytest.param(signal.SIGINT, marks=pytest.mark.slow)])
def test_a_run_that_is_ended_says_so_keeps_its_results_and_leaves_nobody(tmp_path, number):
    out = tmp_path / "run"
    words = ("bench", "run", "tracking", "--perception", "truth", "--methods", "vmf", "--set", "steps=4")
    run = begun(*words, "--episodes", 500, "--workers", 2, "--out", out, "--json")
    wait_for(lambda: len(kept(out)) >= 2)
    before = kept(out)
    assert ended(run, number, whole_session=True) == TOLD[number]
    after = kept(out)
    assert [record for record in after if record in before] == before
    assert {record["status"] for record in after} == {"ok"}


@pytest.mark.parametrize("number", [signal.SIGKILL, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
@pytest.mark.slow
def test_a_run_on_ray_that_is_ended_at_any_time_leaves_nobody(tmp_path, number):
    """Ray takes SIGTERM for itself while it begins, and some of its servers wait a minute for one that has gone."""
    words = ("bench", "run", "waypoint", "--perception", "truth", "--episodes", 500, "--workers", 2)
    run = begun(*words, "--engine", "ray", "--out", tmp_path / "run", "--json")
    wait_for(lambda: any("gcs_server" in each for each in alive(sessions_of(run.pid)).values()))
    if number == signal.SIGTERM:
        assert ended(run, number) == TOLD[number]
        return
    wait_for(lambda: kept(tmp_path / "run"))
    sessions = sessions_of(run.pid)
    run.kill()
    run.communicate()
    wait_for(lambda: not alive(sessions))


@pytest.mark.slow
def test_threads_that_wait_for_a_silent_model_hold_nobody_up(tmp_path):
    (tmp_path / "silent_model.py").write_text(MODEL)
    data = hstar_data.write(tmp_path / "data")
    words = ("--agent", "vlm", "--model", "silent_model:silent", "--engine", "threads", "--workers", 3)
    run = begun("bench", "run", "hstar-hos", "--data", data, *words, "--out", tmp_path / "run", path=tmp_path)
    wait_for((tmp_path / "asked").exists)
    assert ended(run, signal.SIGINT) == TOLD[signal.SIGINT]


OWN = """
import os, signal, threading
signal.signal(signal.SIGTERM, lambda *_: print("heard"))
from eagor.odometry.two_views import import_pycolmap
thread = threading.Thread(target=import_pycolmap)
thread.start()
thread.join()
os.kill(os.getpid(), signal.SIGTERM)
"""


def test_a_program_still_hears_its_sigterm_when_pictures_have_told_the_motion():
    pytest.importorskip("pycolmap")
    done = subprocess.run([sys.executable, "-c", OWN], capture_output=True, text=True, timeout=300)
    assert (done.stdout, done.returncode) == ("heard\n", 0), done.stderr

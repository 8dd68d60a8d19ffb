"""``eagor robot run``: a simulated walk in one command, what it tells, and that nothing stays behind."""

import json
import os
import resource
import signal
import subprocess
import sys
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from types import SimpleNamespace

import pytest
from processes import alive, sessions_of, wait_for

pytest.importorskip("cyclonedds")
pytest.importorskip("rosbags")
pytest.importorskip("onnxruntime")

from eagor.cli import main, robot_run
from eagor.errors import DeviceError
from eagor.robots.dds import free_domain

pytestmark = pytest.mark.xdist_group("real time")


def command(*words):
    """The command, which gives its processes time to start: this machine may be busy."""
    return [sys.executable, "-m", "eagor", "robot", "run", *words, "--patience", "120"]


def test_a_simulated_robot_walks_to_the_sofa_though_the_disk_is_full(tmp_path):
    with walking("--seconds", "240", "--record", str(tmp_path / "walk"), "--json") as child:
        resource.prlimit(child.pid, resource.RLIMIT_FSIZE, (1000, resource.RLIM_INFINITY))
        out, err = child.communicate(timeout=300)
    assert child.returncode == 3, err
    assert "recording" in err
    told = json.loads(out)
    assert (told["ended"], told["doing"]) == ("arrived", "arrived")
    assert told["metres"] > 0.5
    assert told["median_error_deg"] < 35  # a sofa is wide, and near


@contextmanager
def walking(*words):
    """The command in a session of its own, its robot on the way, and what it says of that, line by line."""
    words = command("purple sofa", "--sim", "--arm", *(words or ("--stay", "--seconds", "600")))
    child = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True)
    try:
        heard(child.stderr, " armed, ")
        yield child
    finally:
        with suppress(ProcessLookupError):
            os.killpg(child.pid, signal.SIGKILL)
        child.wait()
        child.stdout.close()
        child.stderr.close()


def heard(lines, *words):
    """Wait for a line with all these words."""
    said = []
    for line in lines:
        said.append(line)
        if all(word in line for word in words):
            return
    raise AssertionError("".join(said))


def hang_the_perception(child):
    """Of the processes that were spawned, by whatever thread, the perception's is the youngest."""
    spawned = {}
    for listed in Path(f"/proc/{child.pid}/task").glob("*/children"):
        for pid in map(int, listed.read_text().split()):
            if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes():
                spawned[int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[19])] = pid
    os.kill(spawned[max(spawned)], signal.SIGSTOP)


def test_a_perception_that_hangs_stops_the_robot_and_a_killed_walk_leaves_no_process():
    with walking() as child:
        hang_the_perception(child)
        heard(child.stderr, " standing, ", "look of the perception is")
        sessions = sessions_of(child.pid)
        assert len(alive(sessions)) >= 5, alive(sessions)  # the command, the robot, its camera, perception, guard
        os.kill(child.pid, signal.SIGKILL)
        child.wait(300)
        wait_for(lambda: not alive(sessions))


@pytest.mark.slow
@pytest.mark.parametrize(("how", "everyone"), [(signal.SIGINT, True), (signal.SIGINT, False), (signal.SIGTERM, False)])
def test_a_walk_that_is_ended_says_so_and_leaves_no_process(how, everyone):
    with walking() as child:
        sessions = sessions_of(child.pid)
        (os.killpg if everyone else os.kill)(child.pid, how)  # as a terminal does at Ctrl-C, or one alone
        child.stderr.read()
        assert child.wait(300) == {signal.SIGINT: 130, signal.SIGTERM: 143}[how]
        assert child.stdout.read().startswith("interrupted: ")
        wait_for(lambda: not alive(sessions))


@pytest.mark.parametrize(("words", "said"), [
    (["red chair"], "a robot needs a camera"),
    (["red chair", "--source", "x.mp4", "--arm", "--deadman", "none"], "--deadman none is only for simulated robots"),
    (["red chair", "--sim", "--interface", "eth0"], "--interface is for a real robot: --sim brings its own"),
    (["red chair", "--sim", "--distance", "0"], "distance = 0.0"),
    (["red chair", "--sim", "--mount", "0", "0", "40"], "--mount 0 0 40; wanted metres"),
    (["red chair", "--sim", "--latency", "1"], "never moves by pictures older than 0.5 s"),
    (["red chair", "--sim", "--seed", "602"], "there is no red chair in apartment"),
])  # fmt: skip
def test_what_cannot_be_is_said_and_nothing_is_started(words, said, capsys):
    assert main(["robot", "run", *words]) == 2
    assert said in capsys.readouterr().err


def test_a_guard_that_ended_is_no_usage_error_and_further_interrupts_stop_no_cleanup(monkeypatch, capsys):
    loop = SimpleNamespace(stopped=False, clock=None, stop=lambda: setattr(loop, "stopped", True))
    guard = SimpleNamespace(set_velocity=lambda *_: signal.raise_signal(signal.SIGINT))
    monkeypatch.setattr(robot_run, "_simulated", lambda *_: nullcontext(robot_run.Place(free_domain(), "lo", None)))
    monkeypatch.setattr("eagor.robots.safety.guard.Guard", lambda **_: nullcontext(guard))
    monkeypatch.setattr("eagor.live.loop.Loop", lambda *_, **__: loop)

    def ended(*_):
        raise DeviceError("the guard has ended; this program sent StopMove itself")

    monkeypatch.setattr(robot_run, "_walk", lambda *_: signal.raise_signal(signal.SIGINT))
    assert main(["robot", "run", "sofa", "--sim", "--arm"]) == 130
    assert capsys.readouterr().out.startswith("interrupted: ")
    guard.set_velocity = lambda *_: None
    monkeypatch.setattr(robot_run, "_walk", ended)
    assert main(["robot", "run", "sofa", "--sim", "--arm"]) == 1
    assert "the guard has ended; this program sent StopMove itself" in capsys.readouterr().err

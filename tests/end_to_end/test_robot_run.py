"""``eagor robot run``: a simulated walk in one command, its report, and that nothing stays behind."""

import json
import math
import os
import re
import signal
import subprocess
import sys
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from eagor.robots.run_page import RobotPage, Sample
from processes import alive, little_room, sessions_of, wait_for

from eagor.cli import main, robot_run
from eagor.errors import DeviceError
from eagor.robots.dds import free_domain

pytestmark = pytest.mark.xdist_group("real time")

pytest.importorskip("cyclonedds")
pytest.importorskip("rosbags")
pytest.importorskip("onnxruntime")


def command(*words):
    """The command, which gives its processes time to start: this machine may be busy."""
    return [sys.executable, "-m", "eagor", "robot", "run", *words, "--patience", "120"]


def test_a_simulated_robot_walks_to_the_sofa_and_leaves_a_report(tmp_path):
    start = ("--start", "2.05", "6.2", "30")  # two metres from it, which is 60 degrees to the left
    words = command("white sofa", "--sim", "--arm", *start, "--seconds", "240", "--report", str(tmp_path / "walk"))
    done = subprocess.run([*words, "--json"], capture_output=True, text=True, timeout=400)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["ended"] == "arrived"
    record = json.loads((tmp_path / "walk" / "run.json").read_text())
    samples, limits = record["samples"], record["limits"]
    assert record["summary"]["metres"] > 0.5
    last = samples[-1]
    true, begun = last["true_xy"], next(sample["true_xy"] for sample in samples if sample["true_xy"])
    assert math.dist(true, begun) > 0.5
    assert last["error"] < math.radians(35)  # a sofa is wide, and near
    for sample in samples:
        if sample["sent"]:
            forward, left, turn = sample["sent"]
            assert sample["mode"] == "armed"
            assert -limits["backward"] <= forward <= limits["forward"]
            assert left == 0
            assert abs(turn) <= limits["turn"]
    page = (tmp_path / "walk" / "report.html").read_text()
    assert "To “white sofa”" in page
    assert page.count("<img ") >= 3
    assert "armed" in page
    assert not re.search(r"(src|href)=\"(?!data:)", page)  # one file, which sends no request


@pytest.mark.slow
def test_a_dry_run_moves_nothing(tmp_path):
    words = command("white sofa", "--sim", "--seconds", "6", "--report", str(tmp_path / "dry"))
    done = subprocess.run(words, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert "dry run: nothing is commanded" in done.stderr
    record = json.loads((tmp_path / "dry" / "run.json").read_text())
    assert {sample["mode"] for sample in record["samples"]} == {"dry run"}
    assert all(sample["sent"] is None and sample["stops"] == 0 for sample in record["samples"])
    places = [sample["true_xy"] for sample in record["samples"] if sample["true_xy"]]
    assert max(math.dist(place, places[0]) for place in places) < 1e-6


@contextmanager
def walking(folder):
    """The command in a session of its own, its robot on the way, and what it says of that, line by line."""
    words = command("white sofa", "--sim", "--arm", "--stay", "--seconds", "600", "--report", str(folder))
    child = subprocess.Popen(words, stderr=subprocess.PIPE, text=True, start_new_session=True)
    assert child.stderr is not None
    try:
        heard(child.stderr, " armed, ")
        yield child
    finally:
        with suppress(ProcessLookupError):
            os.killpg(child.pid, signal.SIGKILL)
        child.wait()
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


def test_a_perception_that_hangs_stops_the_robot_and_a_killed_walk_leaves_no_process(tmp_path):
    with walking(tmp_path / "walk") as child:
        hang_the_perception(child)
        heard(child.stderr, " standing, ", "look of the perception is")
        sessions = sessions_of(child.pid)
        assert len(alive(sessions)) >= 5, alive(sessions)  # the command, the robot, its camera, perception, guard
        os.kill(child.pid, signal.SIGKILL)
        child.wait(300)
        wait_for(lambda: not alive(sessions))
    assert not (tmp_path / "walk" / "report.html").exists()


@pytest.mark.slow
@pytest.mark.parametrize(("how", "everyone"), [(signal.SIGINT, True), (signal.SIGINT, False), (signal.SIGTERM, False)])
def test_a_walk_that_is_ended_leaves_a_report_and_no_process(tmp_path, how, everyone):
    with walking(tmp_path / "walk") as child:
        sessions = sessions_of(child.pid)
        if everyone:  # as a terminal does at Ctrl-C
            os.killpg(child.pid, how)
        else:
            os.kill(child.pid, how)
        child.stderr.read()
        assert child.wait(300) == {signal.SIGINT: 130, signal.SIGTERM: 143}[how]
        wait_for(lambda: not alive(sessions))
    assert (tmp_path / "walk" / "report.html").exists()


@pytest.mark.slow
def test_a_robot_that_is_simulated_elsewhere_is_walked_as_a_real_one(tmp_path):
    domain = str(free_domain())
    simulated = [sys.executable, "-m", "eagor", "robot", "sim", "--seed", "7", "--target", "green sofa"]
    robot = subprocess.Popen([*simulated, "--domain", domain], stdout=subprocess.PIPE, text=True)
    assert robot.stdout is not None
    try:
        for line in robot.stdout:
            if "x3/image" in line:
                break
        words = command(
            "green sofa", "--source", "ros:/x3/image/compressed", "--interface", "lo", "--domain", domain, "--arm",
            "--deadman", "none", "--perception", "scout", "--seconds", "20", "--json", "--report",
            str(tmp_path / "walk"), "--latency", "0",
        )  # fmt: skip
        done = subprocess.run(words, capture_output=True, text=True, timeout=200)
        assert done.returncode == 0, done.stderr
        samples = json.loads((tmp_path / "walk" / "run.json").read_text())["samples"]
        assert any(sample["sent"] and any(sample["sent"]) for sample in samples)
        assert all(sample["true_xy"] is None for sample in samples)  # nobody tells a real robot's program the truth
    finally:
        robot.send_signal(signal.SIGINT)
        robot.stdout.read()
        robot.wait(300)
        robot.stdout.close()


@pytest.mark.slow  # that it stands then is tried above
def test_a_report_tells_of_a_perception_that_hung(tmp_path):
    with walking(tmp_path / "walk") as child:
        hang_the_perception(child)
        heard(child.stderr, "look of the perception is")
        os.kill(child.pid, signal.SIGINT)
        child.stderr.read()
        assert child.wait(300) == 130
    samples = json.loads((tmp_path / "walk" / "run.json").read_text())["samples"]
    hung = [sample for sample in samples if any("look of the perception is" in why for why in sample["reasons"])]
    assert hung
    assert all(sample["sent"] is None for sample in hung)


@pytest.mark.parametrize(("words", "said"), [
    (["red chair"], "a robot needs a camera"),
    (["red chair", "--source", "x.mp4", "--arm", "--deadman", "none"], "--deadman none is only for simulated robots"),
    (["red chair", "--sim", "--interface", "eth0"], "--sim brings its own camera and network"),
    (["red chair", "--sim", "--seconds", "-1"], "wanted seconds above 0"),
    (["red chair", "--sim", "--distance", "0"], "distance = 0.0"),
    (["red chair", "--sim", "--mount", "nan", "0", "0"], "--mount nan 0 0; wanted metres"),
    (["red chair", "--sim", "--mount", "0", "0", "40"], "--mount 0 0 40; wanted metres"),
    (["red chair", "--sim", "--latency", "1"], "never moves by pictures older than 1 s"),
    (["red chair", "--sim", "--seed", "602"], "there is no red chair in apartment"),
    (["red chair", "--source", "x.mp4", "--interface", "eth7"], "there is no network interface 'eth7'"),
])  # fmt: skip
def test_what_cannot_be_is_said_and_nothing_is_started(words, said, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["robot", "run", *words]) == 2
    assert said in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


SAMPLES = [
    Sample(
        float(seconds), "tracking", 0.9, 0.1, 0.2, 2.0, "walking", "it walks: 2.0 m", (0.3, 0.0, 0.0), (0.3, 0.0, 0.0),
        0, "armed", (), 0.2, 0.0, (0.2 * seconds, 0.0), 0.0,
    )
    for seconds in range(2)
]  # fmt: skip


@pytest.fixture
def stands_in(monkeypatch, tmp_path):
    """The command with nothing of a robot: `walk()` is all that happens after two samples; what it says and returns."""

    loop, guard = SimpleNamespace(stopped=False, clock=None), SimpleNamespace(stop=None)
    loop.stop = lambda: setattr(loop, "stopped", True)
    place = robot_run.Place(0, "lo", lambda: None)
    monkeypatch.setattr("eagor.cli.robot_run._simulated", lambda *_: nullcontext(place))
    monkeypatch.setattr("eagor.robots.safety.guard.Guard", lambda **_: nullcontext(guard))
    monkeypatch.setattr("eagor.live.loop.LiveLoop", lambda *_, **__: loop)

    def run(walk, *words, meanwhile=lambda: None):
        def walked(_, __, page, ___):
            page.samples.extend(SAMPLES)
            return walk()

        guard.stop = meanwhile
        monkeypatch.setattr("eagor.cli.robot_run._walk", walked)
        return main(["robot", "run", "sofa", "--sim", "--arm", "--report", str(tmp_path / "walk"), *words])

    return run


def interrupt():
    signal.raise_signal(signal.SIGINT)


def the_guard_ends():
    raise DeviceError("the guard has ended; this program sent StopMove itself")


@pytest.mark.parametrize(
    ("walk", "ended", "code"), [(lambda: "arrived", "arrived", 1), (interrupt, "interrupted", 130)]
)
def test_a_full_disk_costs_the_report_alone(stands_in, capsys, walk, ended, code):
    with little_room(100):
        assert stands_in(walk, "--json") == code
    out, err = capsys.readouterr()
    assert "run.json cannot be written" in err
    told = json.loads(out)
    assert (told["ended"], told["report"], told["seconds"]) == (ended, None, 1.0)


def test_a_full_disk_does_not_hide_that_the_guard_ended_and_that_is_no_usage_error(stands_in, capsys):
    with little_room(100):
        assert stands_in(the_guard_ends) == 1
    first, last = [line for line in capsys.readouterr().err.splitlines() if "error:" in line]
    assert "run.json cannot be written" in first
    assert "the guard has ended; this program sent StopMove itself" in last


def test_further_interrupts_do_not_stop_the_report(stands_in, capsys, tmp_path):
    assert stands_in(interrupt, meanwhile=interrupt) == 130
    out, err = capsys.readouterr()
    assert (tmp_path / "walk" / "report.html").exists()
    assert "interrupted; writing the report" in err
    assert out == "interrupted: it walks: 2.0 m; 0.20 m in 1.0 s\n"


def test_why_it_stands_is_said_where_the_gate_has_no_objection(monkeypatch, capsys):
    still = replace(SAMPLES[0], doing="holding", words="", reasons=("zero velocity is wanted",), mode="standing")
    samples = iter([
        SAMPLES[0], replace(SAMPLES[0], words="it walks: 1.9 m"),
        replace(still, words="several places are likely: it stands"),
        replace(still, words="the distance is still not known after 3 m: it stands"),
        replace(still, reasons=("the newest picture is 1.20 s old",)),
    ])  # fmt: skip
    monkeypatch.setattr(robot_run, "_sample", lambda *_: next(samples))
    monkeypatch.setattr(robot_run, "QUIET", 0.0)
    step = SimpleNamespace(frame=None, answer=SimpleNamespace(estimate=None))
    options = SimpleNamespace(seconds=None, sim=False, stay=True)
    robot_run._walk(options, iter([step] * 5), RobotPage("sofa"), None)
    assert [line.partition(" s  ")[2] for line in capsys.readouterr().err.splitlines()] == [
        "armed, walking: it walks: 2.0 m",
        "standing, holding: several places are likely: it stands",
        "standing, holding: the distance is still not known after 3 m: it stands",
        "standing, holding: the newest picture is 1.20 s old",
    ]

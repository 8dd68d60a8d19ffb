"""``eagor robot sim`` and ``eagor robot check``, as they are typed."""

from __future__ import annotations

import json
import re
import shlex
import signal
import subprocess
import sys
from functools import partial
from itertools import pairwise, takewhile
from pathlib import Path

import pytest
from commands import eagor
from processes import alive, sessions_of, wait_for

pytest.importorskip("cyclonedds")
pytest.importorskip("rosbags")

from eagor.robots.dds import Participant, free_domain, raw
from eagor.robots.go2.sim import SimSettings, SimulatedGo2
from eagor.robots.go2.state import SportModeState

pytestmark = pytest.mark.xdist_group("real time")

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "go2.md"


def check(domain, *words):
    return eagor("robot", "check", "--domain", domain, "--interface", "lo", *words)


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), pytest.param(signal.SIGTERM, 143, marks=pytest.mark.slow)]
)
def test_a_simulated_robot_is_heard_checked_and_ends_with_nothing_left(number, code):
    domain = free_domain()
    words = f"-m eagor robot sim --domain {domain} --rows 16 --seed 7 --json --target".split()
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "start_new_session": True}
    with subprocess.Popen([sys.executable, *words, "purple sofa"], **pipes) as process:
        try:
            said = json.loads(process.stdout.readline())
            assert said["domain"] == domain
            assert said["targets"][0]["name"] == "purple sofa"
            assert said["things"]["purple sofa"] == 1
            assert "rt/x3/image/compressed" in said["topics"]
            done = check(domain, "--json", "--seconds", 2)
            report = json.loads(done.stdout)
            assert set(said["topics"]) - {"rt/api/sport/request", "rt/api/obstacles_avoid/request"} <= {
                *report["topics"]
            }
            assert (report["firmware"], report["mode"]) == ("states of 516 bytes, with a planned path", "standing")
            assert (report["sport_version"], report["error_code"]) == ("1.0.0.1", 0)
            assert 50 < report["battery"] <= 87  # it empties while a busy machine takes its time
            assert report["cameras"] == ["rt/x3/image/compressed"]
            assert report["rates"]["rt/sportmodestate"] > 0
            slow = [problem for problem in report["problems"] if "processor" not in problem]  # this machine may be busy
            assert slow == []
            assert done.returncode == (1 if report["problems"] else 0)
            sessions = sessions_of(process.pid)
        finally:
            process.send_signal(number)
            _, log = process.communicate(timeout=300)
    assert (process.returncode, "interrupted" in log or "terminated" in log) == (code, True), log
    wait_for(lambda: not alive(sessions))


def test_what_is_wrong_with_a_robot_is_said_with_what_to_change():
    domain, settings = free_domain(), SimSettings(None, short=True, battery=9, clock_offset=-777.0)
    with SimulatedGo2(settings, domain) as robot, Participant(domain, "lo") as link:
        robot.error_code = 1001
        link.publish("rt/sportmodestate", raw(SportModeState))
        done = check(domain, "--seconds", 1.5)
        assert done.returncode == 1, done.stderr
        assert "states of 236 bytes, without a planned path" in done.stdout
        behind = re.search(r"([\d.]+) s behind this machine's", done.stdout)
        assert behind is not None, done.stdout
        assert 770 < float(behind[1]) < 800  # less the time that messages take
        assert "problem: the robot reports error 1001" in done.stdout
        assert "problem: the battery is at 9 %: charge it" in done.stdout
        assert "2 publish rt/sportmodestate" in done.stdout
        assert done.stdout.endswith("it cannot be used like this\n")
        assert [*robot.requests] == []  # nothing was moved


@pytest.mark.parametrize(("words", "said"), [
    ("check --interface lo --domain 233", "wanted a whole number from 0 to 232"),
    ("check --interface lo --seconds 0", "--seconds 0; wanted seconds above 0"),
    ("sim --interface wlan77 --camera none", "there is no network interface 'wlan77'"),
    ("sim --target elephant", "names nothing known here"), ("sim --rows 33", "rows = 33; wanted an even number"),
    ("sim --speed 9", "--speed 9; wanted 0 to 3"),
])  # fmt: skip
def test_wrong_usage_is_one_line(words, said):
    done = eagor("robot", *words.split())
    assert (done.returncode, done.stdout) == (2, "")
    errors = [line for line in done.stderr.splitlines() if line.startswith("eagor: error:")]
    assert len(errors) == 1
    assert said in errors[0]


def blocks_of_the_page(language, needs):
    """The blocks of the page in a language whose line before says what they need, or has none."""
    parts = PAGE.read_text(encoding="utf-8").split(f"```{language}\n")
    return [part.split("```")[0].strip() for before, part in pairwise(parts) if needs in before[-60:]]


@pytest.mark.slow
def test_the_page_about_the_go2_runs_as_written(tmp_path, monkeypatch):
    start, look = (shlex.split(line) for line in blocks_of_the_page("sh", "\n\n")[:2])
    monkeypatch.setenv("ROS_DOMAIN_ID", str(free_domain()))
    run = partial(subprocess.run, capture_output=True, text=True, timeout=300, cwd=tmp_path)
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "start_new_session": True}
    with subprocess.Popen([sys.executable, "-m", *start], **pipes) as robot:
        try:
            said = list(takewhile(lambda line: line != "end it with Ctrl-C\n", robot.stdout))
            assert any("purple sofa" in line for line in said)
            done = run([sys.executable, "-m", *look])
            busy = "processor" in done.stdout  # this machine, not the robot
            assert done.returncode == (1 if busy else 0), (done.stdout, done.stderr)
            pages = blocks_of_the_page("python", "*Needs the simulated robot")
            prints = r"(-?\d+ degrees to the left\n)+", r".* m/s standing 0\n(\d+.*\n){3}"
            for text, printed in zip(pages, prints, strict=True):
                (tmp_path / "page.py").write_text(text, encoding="utf-8")
                done = run([sys.executable, "page.py"])
                assert (done.returncode, re.fullmatch(printed, done.stdout) is not None) == (0, True), done
        finally:
            robot.send_signal(signal.SIGINT)
            _, log = robot.communicate(timeout=300)
    assert (robot.returncode, "walked 0.00 m" in log) == (130, True)


def test_nobody_there_and_a_taken_domain_are_said():
    domain = free_domain()
    done = check(domain, "--seconds", 1)
    assert (done.returncode, done.stdout) == (2, "")
    assert f"no Go2 is heard within 3 s (domain {domain}, lo). Is it on?" in done.stderr
    with SimulatedGo2(SimSettings(None), domain):
        done = eagor("robot", "sim", "--domain", domain, "--camera", "none", "--seconds", 1)
    assert done.returncode == 2
    assert f"a robot already speaks on DDS domain {domain}, lo" in done.stderr
    assert "take another --domain" in done.stderr

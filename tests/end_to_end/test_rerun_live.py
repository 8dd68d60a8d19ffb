"""The live loop's log for the Rerun viewer."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from rerunreading import read

from eagor import DirectionTracker, Evidence
from eagor.drawing import rerun_log
from eagor.lab.worlds.painted import painted_room
from eagor.live.events import Answer, Fault, ImageReceived, PoseReceived, Tick
from eagor.live.rerun import LiveLog
from eagor.media import Pose
from eagor.sphere import world_R_body

BEGIN = 1.79e9


def answers(stamp: float, *faults: Fault) -> list[Answer]:
    tracker = DirectionTracker()
    tracker.add_pose(stamp, world_R_body(0.3))
    tracker.observe(Evidence.from_points(np.array([[0.0, 1.0, 0.0]]), stamp=stamp))
    return [
        Answer(stamp, query, tracker.estimate(stamp), pose_age=0.0, look_age=0.0, image_age=0.0, faults=faults)
        for query in ("chair", "door")
    ]


def wait_until_drawn(log: LiveLog) -> None:
    """Until the thread has taken what it was given, or has ended: answers that come faster are left out."""
    done = threading.Event()
    for _ in range(1000):
        with log._turn:
            if not log._answers or log.problem is not None:
                return
        done.wait(0.02)


def test_pictures_answers_positions_and_faults_are_logged(tmp_path):
    path = tmp_path / "live.rrd"
    log = LiveLog(path)
    gone = Fault("camera", "no picture for 2.0 s", BEGIN + 1)
    for k in range(8):
        now = BEGIN + k
        log.take(ImageReceived(now, now, "x", painted_room(32, 64)), [])
        log.take(PoseReceived(now, Pose(now, np.eye(3), np.array([float(k), 0.0, 0.0]))), [])
        log.take(Tick(now), answers(now, *([gone] if k in (2, 3) else [])))
        log.take(Tick(now + 0.01), answers(now + 0.01))  # too soon after the last one
        wait_until_drawn(log)
    log.close()
    assert log.problem is None
    found = read(path)
    for query in ("chair", "door"):
        (name,) = (key for key in found if key.startswith(f"/plots/angles/{query}/azimuth") and "scalars" in key)
        assert [round(at - BEGIN, 2) for at, _ in found[name]] == [0, 1, 2, 3, 4, 5, 6, 7]
    (name,) = (key for key in found if key.startswith("/panorama EncodedImage:blob"))
    assert len(found[name]) == 8
    (name,) = (key for key in found if key.startswith("/world/body Transform3D:translation"))
    assert {float(np.array(value.tolist()).ravel()[0]) for _, value in found[name]} == {float(k) for k in range(8)}
    (name,) = (key for key in found if key.startswith("/status TextLog:text"))
    said = [(round(at - BEGIN), value[0]) for at, value in found[name]]
    assert said.count((2, "no picture for 2.0 s")) == 1
    assert (3, "no picture for 2.0 s") not in said
    assert (6, "camera: all is well again") in said


def test_a_log_that_cannot_be_written_ends_alone(tmp_path, monkeypatch):
    log = LiveLog(tmp_path / "live.rrd")

    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(rerun_log.RerunLog, "add", full)
    for k in range(3):
        log.take(Tick(BEGIN + k), answers(BEGIN + k))
        wait_until_drawn(log)
    log.close()
    assert log.problem is not None
    assert "No space left" in log.problem


@pytest.mark.parametrize("name", ["live.mp4", "none/live.rrd"])
def test_bad_names_are_refused_at_once(tmp_path, name):
    with pytest.raises(ValueError, match=r"live\."):
        LiveLog(tmp_path / name)

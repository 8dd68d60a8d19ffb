"""The log for the Rerun viewer as a sink of the loop."""

from __future__ import annotations

import numpy as np
import pytest
from rerunreading import read

from eagor import DirectionTracker, Evidence
from eagor.errors import EagorError, StorageError
from eagor.grids import PerspectiveGrid
from eagor.lab.worlds.painted import painted_room
from eagor.live.events import Answer, Fault, ImageReceived, PoseReceived, Tick
from eagor.live.rerun import RerunLog
from eagor.sources import Pose
from eagor.sphere import world_R_body

BEGIN = 1.79e9
QUERIES = {"a chair": "a_chair", "椅子": "椅子"}  # and what their entities are called


def answers(stamp: float, *faults: Fault) -> list[Answer]:
    tracker = DirectionTracker()
    tracker.add_pose(stamp, world_R_body(0.3))
    tracker.observe(Evidence.from_points(np.array([[0.0, 1.0, 0.0]]), stamp=stamp))
    return [
        Answer(stamp, query, tracker.estimate(stamp), pose_age=0.0, look_age=0.0, image_age=0.0, faults=faults)
        for query in QUERIES
    ]


@pytest.mark.parametrize("realtime", [False, True])
def test_pictures_answers_positions_and_faults_are_logged(tmp_path, realtime):
    path = tmp_path / "live.rrd"
    log = RerunLog(path, realtime=realtime)
    gone, view = Fault("camera", "no picture for 2.0 s", BEGIN + 1), PerspectiveGrid(32, 48, 1.2)
    for k in range(8):
        now = BEGIN + k
        picture, grid = (painted_room(32, 64), None) if k else (np.zeros((32, 48, 3), np.uint8), view)
        log.take(ImageReceived(now, now, "x", picture, grid, "it is dark" if k == 5 else ""), [])
        log.take(PoseReceived(now, Pose(now, np.eye(3), np.array([float(k), 0.0, 0.0]))), [])
        log.take(Tick(now), answers(now, *([gone] if k in (2, 3) else [])))
        if realtime:
            log.take(Tick(now + 0.01), answers(now + 0.01))  # too soon after the last one
            log._ended()  # else answers that come faster than they are drawn are left out
    log.close()
    assert log.problem is None
    found = read(path)
    for query in QUERIES.values():
        (name,) = (key for key in found if key.startswith(f"/plots/angles/{query}/azimuth ") and "scalars" in key)
        assert [round(at - BEGIN, 2) for at, _ in found[name]] == [0, 1, 2, 3, 4, 5, 6, 7]
    (name,) = (key for key in found if key.startswith("/picture EncodedImage:blob"))
    assert len(found[name]) == 8
    (name,) = (key for key in found if key.startswith("/world/body Transform3D:translation"))
    assert {float(np.array(value.tolist()).ravel()[0]) for _, value in found[name]} == {float(k) for k in range(8)}
    (name,) = (key for key in found if key.startswith("/status TextLog:text"))
    said = [(round(at - BEGIN), value[0]) for at, value in found[name]]
    assert said.count((2, "no picture for 2.0 s")) == 1
    assert (3, "no picture for 2.0 s") not in said
    assert (6, "camera: all is well again") in said
    assert (5, "x is left out: it is dark") in said


def test_a_log_that_cannot_be_written_ends_alone(tmp_path, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(RerunLog, "_write", full)
    log = RerunLog(tmp_path / "live.rrd")
    for k in range(3):
        log.take(Tick(BEGIN + k), answers(BEGIN + k))
    log.close()
    assert log.problem is not None
    assert "No space left" in log.problem


def test_bad_names_are_refused_at_once(tmp_path):
    with pytest.raises(EagorError, match=r"does not end in \.rrd"):
        RerunLog(tmp_path / "live.mp4")
    with pytest.raises(StorageError, match="cannot be written"):
        RerunLog(tmp_path / "none" / "live.rrd")

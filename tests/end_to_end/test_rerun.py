"""Logs for the Rerun viewer, of a track and as a sink of the loop: they hold what was answered, and it opens them."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from eagor import DirectionTracker, Evidence
from eagor.cli import main
from eagor.errors import EagorError, StorageError
from eagor.grids import PerspectiveGrid
from eagor.lab.worlds.painted import painted_room
from eagor.live.events import Answer, Fault, ImageReceived, PoseReceived, Tick
from eagor.live.rerun import RerunLog
from eagor.sources import Pose
from eagor.sphere import azimuth_elevation, world_R_body

VIEWER = Path(sys.executable).with_name("rerun")


def read(path) -> dict[str, list[tuple[float, np.ndarray]]]:
    """Each component of a log by entity and name, with its times in seconds."""
    from rerun.chunk import RrdReader

    found: dict[str, list[tuple[float, np.ndarray]]] = {}
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        names = batch.schema.names
        times = None
        if "time" in names:
            column = batch.column("time").cast("int64")
            times = np.array(column.to_pylist(), dtype=float) / 1e9
        for name in names:
            if ":" not in name:
                continue
            for row, value in enumerate(batch.column(name).to_pylist()):
                if value is not None:
                    at = np.nan if times is None else times[row]
                    found.setdefault(f"{chunk.entity_path} {name}", []).append((at, np.array(value, dtype=object)))
    return found


@pytest.fixture(scope="module")
def followed(tmp_path_factory):
    """A red ball followed through six turned pictures, with a log and the answers."""
    folder = tmp_path_factory.mktemp("rerun")
    room = painted_room(128, 256)
    lines = ["stamp,yaw_deg,pitch_deg,roll_deg,x,y,z,frame"]
    (folder / "frames").mkdir()
    for k in range(6):
        Image.fromarray(np.roll(room, 16 * k, axis=1)).save(folder / "frames" / f"{k}.png")
        lines.append(f"{k / 2},{22.5 * k},0,0,{0.1 * k},0,1,{k}.png")
    (folder / "poses.csv").write_text("\n".join(lines) + "\n")
    words = ["track", folder / "frames", "red", "--poses", folder / "poses.csv"]
    words += ["--out", folder / "found.jsonl", "--rerun", folder / "run.rrd"]
    assert main([str(word) for word in words]) == 0
    return folder


def test_the_viewers_own_check_finds_no_fault(followed):
    run = subprocess.run([VIEWER, "rrd", "verify", followed / "run.rrd"], capture_output=True, text=True, timeout=120)
    assert run.returncode == 0, run.stderr
    assert "verified without error" in run.stdout + run.stderr


def test_a_log_holds_the_answers_of_the_table(followed):
    rows = [json.loads(line) for line in (followed / "found.jsonl").read_text().splitlines()]
    log = read(followed / "run.rrd")

    def plotted(what: str) -> list[float]:
        (name,) = (key for key in log if key.startswith(f"/plots/{what} ") and "scalars" in key)
        assert [at for at, _ in log[name]] == [row["stamp"] for row in rows]
        return [float(value[0]) for _, value in log[name]]

    np.testing.assert_allclose(plotted("angles/red/azimuth"), [row["azimuth_deg"] for row in rows], atol=0.01)
    np.testing.assert_allclose(plotted("presence/red"), [row["presence"] for row in rows], atol=1e-6)
    (vectors,) = (value for key, value in log.items() if key.startswith("/world/body/red") and "vectors" in key)
    last = np.array(vectors[-1][1].tolist(), dtype=float)[-1]
    azimuth, elevation = azimuth_elevation(last / np.linalg.norm(last))
    assert abs(np.degrees(float(azimuth)) - rows[-1]["azimuth_deg"]) < 0.1
    assert abs(np.degrees(float(elevation)) - rows[-1]["elevation_deg"]) < 0.1
    (places,) = (value for key, value in log.items() if key.startswith("/world/body Transform3D:translation"))
    np.testing.assert_allclose(
        [np.array(v.tolist(), float).ravel()[0] for _, v in places], 0.1 * np.arange(6), atol=1e-6
    )
    assert any("TextLog:text" in key for key in log)


# --- as a sink of the loop ---

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

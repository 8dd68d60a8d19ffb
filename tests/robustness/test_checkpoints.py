"""What is believed, from one process to another and from one day to the next."""

import json
import multiprocessing
import pickle

import numpy as np
import pytest

from eagor.belief import Belief
from eagor.belief.ranged import RangedBelief
from eagor.errors import FormatError
from eagor.evidence import Evidence
from eagor.evidence.calibration import Calibration
from eagor.evidence.detector import DetectorModel
from eagor.grids import ErpGrid, FisheyeGrid, PerspectiveGrid
from eagor.sphere import world_R_body
from eagor.tracking.checkpoint import STRUCTURE
from eagor.tracking.config import MotionModel, TrackerConfig
from eagor.tracking.tracker import DirectionTracker

CONFIGS = {
    "default": TrackerConfig(degree=7, floor_height=0.0, drift=0.01),
    "paper": TrackerConfig.paper(),
    "still": TrackerConfig(
        degree=5, ranges=[1.0, 2.0, 4.0], target_motion=MotionModel.still(), detector=DetectorModel()
    ),
}


def looks(number, stamp):
    """Evidence of every kind: a map, a map of a part, detections in views."""
    rng = np.random.default_rng(number)
    if number % 3 == 0:
        covered = rng.random((16, 32)) > 0.3
        return Evidence.from_response(rng.random((16, 32)) ** 4, ErpGrid(16, 32), None, stamp, coverage=covered)
    if number % 3 == 1:
        response = rng.random((8, 8)) ** 4
        calibration = Calibration(spread=0.1)
        return Evidence.from_response(response, PerspectiveGrid(8, 8, 1.2), calibration, stamp, source={"model": "x"})
    grid = FisheyeGrid(32, 3.3) if number % 2 else None
    return Evidence.from_points([[1.0, 0.1, 0.05]], scores=[0.9], grid=grid, stamp=stamp)


def go_on(tracker, start, end):
    for number in range(start, end):
        stamp = 0.3 * number
        tracker.add_pose(stamp, world_R_body(0.02 * number), np.array([0.05 * number, 0.0, 1.2]))
        tracker.observe(looks(number, stamp - 0.1 if number else stamp))
        if number % 4 == 0:
            tracker.observe(looks(2, stamp), target="chair")
            tracker.estimate(stamp)
    return tracker


def told(tracker, now):
    found = []
    for target in tracker.targets:
        e = tracker.estimate(now, target)
        found += [e.presence, *e.direction, e.credible_angle, e.distance or 0.0, *(m.weight for m in e.modes)]
        found += [*e.log_density(np.eye(3)), e.status == "tracking"]
    return found


@pytest.mark.parametrize("name", CONFIGS)
@pytest.mark.parametrize("way", ["file", "pickle"])
def test_a_tracker_goes_on_after_a_checkpoint_as_if_nothing_had_been(name, way, tmp_path):
    tracker = go_on(DirectionTracker(CONFIGS[name]), 0, 14)
    if way == "file":
        path = tracker.save(tmp_path / "folder" / "tracker.eagor")
        assert b"\0" in path.read_bytes()
        found = DirectionTracker.load(str(path))
        assert found.config.degree == tracker.config.degree
    else:
        found = pickle.loads(pickle.dumps(tracker))
    assert found.targets == tracker.targets
    assert repr(found.config) == repr(tracker.config)
    np.testing.assert_allclose(told(found, 4.2), told(tracker, 4.2), rtol=1e-9, atol=1e-12)
    for each in (found, tracker):
        go_on(each, 14, 20)
    np.testing.assert_allclose(told(found, 6.4), told(tracker, 6.4), rtol=1e-9, atol=1e-12)
    for each in (found, tracker):
        each.observe(looks(2, 3.05))  # late
    np.testing.assert_allclose(told(found, 6.5), told(tracker, 6.5), rtol=1e-9, atol=1e-12)


def read_elsewhere(value):
    """What another process reads out of it."""
    if isinstance(value, Evidence):
        return value.coefficients(5)
    if isinstance(value, DirectionTracker):
        return np.array(told(value, 9.0))
    if isinstance(value, Belief | RangedBelief):
        return np.array([*value.mode(), value.presence(), value.credible_region(0.9).area])
    return np.array([*value.direction, value.presence, value.credible_angle])


def test_everything_travels_to_another_process_after_it_was_read():
    tracker = go_on(DirectionTracker(CONFIGS["default"]), 0, 6)
    evidence = [looks(number, 1.0) for number in range(3)]
    values = [
        Belief.uniform(7).update(evidence[0]),
        RangedBelief.uniform(5, [1.0, 2.0, 4.0]).update(evidence[2]),
        *evidence,
        tracker.estimate(2.0),
        tracker,
    ]
    wanted = [read_elsewhere(value) for value in values]
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        found = pool.map(read_elsewhere, values)
    for a, b in zip(found, wanted, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-12)


def test_files_that_are_no_whole_tracker_of_this_version_are_refused(tmp_path):
    good = go_on(DirectionTracker(CONFIGS["paper"]), 0, 5).save(tmp_path / "good").read_bytes()
    damaged = bytearray(good)
    damaged[len(good) // 2] ^= 1
    old = b'{"format": "eagor tracker", "version": 7, "bytes": 2, "sha256": ""}\n{}'
    wrong = [b"", b"{}", old, b"PK\x03\x04", pickle.dumps(print), good[:20], good[: len(good) // 2], good[:-1]]
    path = tmp_path / "bad"
    for content in [*wrong, bytes(damaged), good.replace(STRUCTURE.encode(), b"eagor 7")]:
        path.write_bytes(content)
        with pytest.raises(FormatError, match="not a whole tracker of this version"):
            DirectionTracker.load(path)
    np.savez(path.with_suffix(".npz"), foreign=np.eye(3))
    with pytest.raises(FormatError, match="not a whole tracker of this version"):
        DirectionTracker.load(path.with_suffix(".npz"))
    for place in (tmp_path, tmp_path / "nothing"):
        with pytest.raises(FormatError, match="cannot be read"):
            DirectionTracker.load(place)


def crafted(place, structure, *arrays):
    """A whole file that holds this."""
    with place.open("wb") as file:
        np.savez(file, *arrays, **{STRUCTURE: np.frombuffer(json.dumps(structure).encode(), np.uint8)})
    return place


def test_what_a_file_names_is_made_only_of_what_trackers_are_made_of(tmp_path):
    new = (
        ["os", "system", {"dict": []}],
        ["eagor.tracking.nothing", "State", {"dict": []}],
        ["eagor.evidences", "Evidence", {"dict": []}],
        ["eagor.belief.direction", "math", {"dict": []}],
        ["eagor.belief.direction", "Belief", {"dict": [["coefficients", {"array": 0}], ["more", 1]]}],
    )
    for each in new:
        with pytest.raises(FormatError, match="not a whole tracker of this version"):
            DirectionTracker.load(crafted(tmp_path / "made", {"new": each}, np.zeros(4)))
    with pytest.raises(FormatError, match="Object arrays"):
        DirectionTracker.load(crafted(tmp_path / "made", {"array": 0}, np.array([print])))


def test_a_tracker_is_loaded_only_from_the_parts_of_one(tmp_path):
    parts = json.loads(DirectionTracker().save(tmp_path / "saved").read_bytes())["dict"]  # nothing in it is an array
    for number in range(len(parts)):
        wrong = [[key, True if at == number else value] for at, (key, value) in enumerate(parts)]
        with pytest.raises(FormatError, match="holds no tracker"):
            DirectionTracker.load(crafted(tmp_path / "made", {"dict": wrong}))
    parts[2][1] = {"dict": [["target", 1]]}
    with pytest.raises(FormatError, match="holds no tracker"):
        DirectionTracker.load(crafted(tmp_path / "made", {"dict": parts}))

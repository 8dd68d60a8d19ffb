"""What errors are made of: the parts divide the steps, and a distance is asked for once the camera has moved."""

import numpy as np
import pytest

from eagor.lab.eval import tables

SEEN = [False, True, True, False, True]


def record(seed=1, seen=SEEN, errors=(90, 10, 20, 30, 0), stated=None, ranges=None, step=1.0):
    count = len(seen)
    poses = [[step * k, 0.0, 1.2, 1.0, 0.0, 0.0, 0.0] for k in range(count)]
    truth = {"visible": list(seen), "pose": poses, "range_m": list(ranges or [4.0] * count)}
    trace = {"error_deg": list(errors), "distance_m": list(stated or [None] * count)}
    return {
        "status": "ok",
        "episode": {"id": f"{seed}-0", "seed": seed},
        "truth": truth,
        "methods": {"a": {"trace": trace}},
    }


def test_the_parts_divide_the_steps():
    found = {part: tables.error_in([record(1), record(2)], "a", part) for part in tables.PARTS}
    assert [found[part].mean for part in tables.PARTS] == [90, 10, 30]
    assert [found[part].share for part in tables.PARTS] == pytest.approx([0.2, 0.6, 0.2])
    assert found[tables.IN_SIGHT].episodes == 2
    after = tables.error_in([record(1), record(2)], "a", tables.SEEN)
    assert (after.mean, after.share) == (15, pytest.approx(0.8))


def test_steps_without_a_truth_are_in_no_part():
    found = tables.error_in([record(1, errors=(None, 10, None, 30, 0)), record(2)], "a", tables.UNSEEN)
    assert found.mean == 90
    assert found.episodes == 1
    assert found.share == pytest.approx(1 / 8)


def test_episodes_weigh_alike_however_many_steps_they_have():
    longer = record(2, seen=[True] * 5, errors=(0, 0, 0, 0, 0))
    found = tables.error_in([record(1), longer], "a", tables.IN_SIGHT)
    assert found.mean == 5
    assert found.low <= 5 <= found.high


def test_who_was_always_in_sight_has_no_other_part():
    assert tables.error_in([record(seen=[True] * 5)], "a", tables.UNSEEN) is None
    assert tables.error_in([record()], "nobody", tables.IN_SIGHT) is None


def test_a_distance_is_asked_for_once_the_camera_has_moved():
    """Seen from x = 1 on, at 4 m: the baseline passes a tenth of that at x = 2, one metre further."""
    stated = [40.0, 40.0, 5.0, 3.0, 4.0]
    found = tables.distance_error([record(1, stated=stated), record(2, stated=stated)], "a")
    assert found.mean == pytest.approx(100 * (0.25 + 0.25 + 0) / 3)
    assert found.share == pytest.approx(3 / 5)
    near = tables.distance_error([record(1, stated=stated, step=0.1)], "a")
    assert near is None, "0.3 m is less than a tenth of 4 m"


def test_the_baseline_counts_only_places_with_the_target_in_sight():
    stated, seen = [4.0, 4.0, 4.0, 4.0, 2.0], [True, False, False, False, False]
    assert tables.distance_error([record(seen=seen, stated=stated)], "a") is None


def test_methods_without_a_distance_have_no_distance_error():
    assert tables.distance_error([record()], "a") is None
    plain = record()
    del plain["methods"]["a"]["trace"]["distance_m"]
    assert tables.distance_error([plain], "a") is None


def test_where_each_method_goes_its_own_way_the_truth_is_in_its_trace():
    own = record(stated=[8.0] * 5)
    trace = own["methods"]["a"]["trace"]
    trace |= {"visible": own["truth"]["visible"], "pose": own["truth"]["pose"], "true_range_m": own["truth"]["range_m"]}
    del own["truth"]
    assert tables.error_in([own], "a", tables.HIDDEN).mean == 30
    assert tables.distance_error([own], "a").mean == pytest.approx(100)
    assert np.isfinite(tables.error_in([own], "a", tables.UNSEEN).mean)

"""What the steps of episodes say: curves, and what errors are made of."""

import numpy as np
import pytest

from eagor.lab.eval import steps
from eagor.lab.eval.results import Result


def walk(errors, seed=1, **more):
    truth = {"visible": [k % 2 == 0 for k in range(len(errors))]}
    return Result(
        {"episode": {"id": str(seed), "seed": seed}, "truth": truth}, {"trace": {"error_deg": errors, **more}}
    )


def test_a_curve_by_step_ends_where_fewer_than_half_go_on():
    curve = steps.by_step([walk([length] * length, seed=length) for length in (3, 5, 5, 9)])
    assert (curve.x, curve.n) == ((0, 1, 2, 3, 4), (4, 4, 4, 3, 3))
    assert curve.y == pytest.approx((5.5, 5.5, 5.5, 19 / 3, 19 / 3))
    gap = steps.by_step([walk([1, None, 3]), walk([1, None, 5], seed=2)])
    assert (gap.y, gap.n) == ((1.0, None, 4.0), (2, 0, 2))
    assert steps.by_step([walk([None])]) is steps.by_step([]) is None


def test_honest_regions_lie_on_the_diagonal():
    rng = np.random.default_rng(0)
    curve = steps.reliability([walk([1.0] * 4000, seed=k, mass_above=rng.random(4000).tolist()) for k in range(3)])
    assert curve.y == pytest.approx(curve.x, abs=2)
    assert steps.reliability([walk([1.0])]) is None


def test_coverage_in_and_out_of_sight():
    result = walk([1.0] * 6, inside=[True, False, True, False, False, None])
    assert steps.coverage([result], True).mean == pytest.approx(200 / 3)
    assert steps.coverage([result], False).mean == 0.0


# Parts

SEEN = [False, True, True, False, True]


def seen(seed=1, visible=SEEN, errors=(90, 10, 20, 30, 0), stated=None, step=1.0):
    """Seen from x = 1 on, 4 m away; the camera moves by `step` along x."""
    poses = [[step * k, 0.0, 1.2, 1.0, 0.0, 0.0, 0.0] for k in range(len(visible))]
    truth = {"visible": list(visible), "pose": poses, "range_m": [4.0] * len(visible)}
    trace = {"error_deg": list(errors), "distance_m": list(stated or [None] * len(visible))}
    return Result({"episode": {"id": f"{seed}-0", "seed": seed}, "truth": truth}, {"trace": trace})


def test_the_parts_divide_the_steps():
    found = {part: steps.error_in([seen(1), seen(2)], part) for part in steps.PARTS}
    assert [found[part].mean for part in steps.PARTS] == [90, 10, 30]
    assert [found[part].share for part in steps.PARTS] == pytest.approx([0.2, 0.6, 0.2])
    assert found[steps.IN_SIGHT].episodes == 2
    after = steps.error_in([seen(1), seen(2)], steps.SEEN)
    assert (after.mean, after.share) == (15, pytest.approx(0.8))
    assert steps.error_in([seen(visible=[True] * 5)], steps.UNSEEN) is None


def test_steps_without_a_truth_are_in_no_part():
    found = steps.error_in([seen(1, errors=(None, 10, None, 30, 0)), seen(2)], steps.UNSEEN)
    assert (found.mean, found.episodes, found.share) == (90, 1, pytest.approx(1 / 8))


def test_episodes_weigh_alike_however_many_steps_they_have():
    found = steps.error_in([seen(1), seen(2, visible=[True] * 5, errors=(0,) * 5)], steps.IN_SIGHT)
    assert found.mean == 5
    assert found.low <= 5 <= found.high


def test_a_distance_is_asked_for_once_the_camera_has_moved():
    """The baseline, between places with the target in sight, passes a tenth of the distance one metre further."""
    stated = [40.0, 40.0, 5.0, 3.0, 4.0]
    found = steps.distance_error([seen(1, stated=stated), seen(2, stated=stated)])
    assert found.mean == pytest.approx(100 * (0.25 + 0.25 + 0) / 3)
    assert found.share == pytest.approx(3 / 5)
    assert steps.distance_error([seen(stated=stated, step=0.1)]) is None, "0.3 m is less than a tenth of 4 m"
    assert steps.distance_error([seen(stated=[4.0] * 5, visible=[True, False, False, False, False])]) is None
    assert steps.distance_error([seen()]) is None, "it states none"


def test_where_each_method_goes_its_own_way_the_truth_is_in_its_trace():
    common = seen(stated=[8.0] * 5)
    truth = common.record["truth"]
    trace = common.answer["trace"] | {"visible": truth["visible"], "pose": truth["pose"]}
    own = Result({"episode": common.record["episode"]}, {"trace": trace | {"true_range_m": truth["range_m"]}})
    assert steps.error_in([own], steps.HIDDEN).mean == 30
    assert steps.distance_error([own]).mean == pytest.approx(100)

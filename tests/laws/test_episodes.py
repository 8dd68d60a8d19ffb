"""What the steps of episodes say: curves, and what errors are made of."""

import pytest

from eagor.lab.eval import episodes
from eagor.lab.eval.results import Result

SEEN = [False, True, True, False, True]


def seen(seed=1, visible=SEEN, errors=(90, 10, 20, 30, 0), stated=None, step=1.0, **more):
    """Seen from x = 1 on, 4 m away; the camera moves by `step` along x."""
    poses = [[step * k, 0.0, 1.2, 1.0, 0.0, 0.0, 0.0] for k in range(len(visible))]
    truth = {"visible": list(visible), "pose": poses, "range_m": [4.0] * len(visible)}
    trace = {"error_deg": list(errors), "distance_m": list(stated or [None] * len(visible)), **more}
    return Result({"episode": {"id": f"{seed}-0", "seed": seed}, "truth": truth}, {"trace": trace})


def means(*results):
    return {name: mean for name, (mean, *_) in episodes.parts(results)[0].items()}


def test_a_curve_by_step_ends_where_fewer_than_half_go_on():
    curve = episodes.by_step([seen(length, errors=[length] * length) for length in (3, 5, 5, 9)])
    assert curve == pytest.approx([5.5, 5.5, 5.5, 19 / 3, 19 / 3])
    gap = episodes.by_step([seen(1, errors=[1, None, 3]), seen(2, errors=[1, None, 5])])
    assert gap == [1.0, None, 4.0]
    assert episodes.by_step([seen(errors=[None])]) == episodes.by_step([]) == []


def test_the_parts_divide_the_steps_and_episodes_weigh_alike():
    found, shares = episodes.parts([seen(1), seen(2)])
    assert [found[part][0] for part in (*episodes.PARTS, episodes.SEEN)] == [90, 10, 30, 15]
    assert list(shares.values()) == pytest.approx([0.2, 0.6, 0.2])
    assert episodes.UNSEEN not in means(seen(visible=[True] * 5))
    mean, ends = episodes.parts([seen(1), seen(2, visible=[True] * 9, errors=(0,) * 9)])[0][episodes.IN_SIGHT]
    assert ends[0] <= mean == 5 <= ends[1]
    found, shares = episodes.parts([seen(1, errors=(None, 10, None, 30, 0)), seen(2)])
    assert found[episodes.UNSEEN][0] == 90, "steps without a truth are in no part"
    assert shares[episodes.UNSEEN] == pytest.approx(1 / 8)


def test_coverage_in_and_out_of_sight():
    found = means(seen(inside=[True, False, True, None, True]))
    assert found[episodes.COVERED] == pytest.approx(200 / 3)
    assert found[episodes.COVERED_HIDDEN] == 100


def test_a_distance_is_asked_for_once_the_camera_has_moved():
    """The baseline, between places with the target in sight, passes a tenth of the distance one metre further."""
    stated = [40.0, 40.0, 5.0, 3.0, 4.0]
    assert means(seen(1, stated=stated), seen(2, stated=stated))[episodes.DISTANCE] == pytest.approx(50 / 3)
    assert episodes.DISTANCE not in means(seen(stated=stated, step=0.1)), "0.3 m is less than a tenth of 4 m"
    assert episodes.DISTANCE not in means(seen(stated=[4.0] * 5, visible=[True, False, False, False, False]))
    assert episodes.DISTANCE not in means(seen()), "it states none"


def test_where_each_method_goes_its_own_way_the_truth_is_in_its_trace():
    common = seen(stated=[8.0] * 5)
    truth = common.record["truth"]
    trace = common.answer["trace"] | {"visible": truth["visible"], "pose": truth["pose"]}
    found = means(Result({"episode": common.record["episode"]}, {"trace": trace | {"true_range_m": truth["range_m"]}}))
    assert found[episodes.HIDDEN] == 30
    assert found[episodes.DISTANCE] == pytest.approx(100)

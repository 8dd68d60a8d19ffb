"""Non-maximum suppression: the same as the loop of the textbook, and what must hold of what stays."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from eagor.perception.onnx.decoding import MOST_COMPARED, kept, overlaps

numbers = st.integers(0, 40)
boxes_of = st.lists(st.tuples(numbers, numbers, st.integers(0, 12), st.integers(0, 12), st.integers(0, 2)), max_size=40)


def by_loop(boxes, scores, classes, most):
    order, stay = list(np.argsort(-scores, kind="stable")), []
    while order:
        best = order.pop(0)
        stay.append(best)
        order = [
            at for at in order
            if classes[at] != classes[best] or overlaps(boxes[at][None], boxes[best][None])[0, 0] <= most
        ]  # fmt: skip
    return stay


@settings(max_examples=200)
@given(boxes_of, st.sampled_from([0.1, 0.3, 0.5, 0.9]), st.integers(0, 2**32 - 1))
def test_it_is_the_loop_of_the_textbook(found, most, seed):
    rows = np.array(found, dtype=float).reshape(-1, 5)
    boxes = np.concatenate([rows[:, :2], rows[:, :2] + rows[:, 2:4]], axis=1)
    scores = np.random.default_rng(seed).choice([0.2, 0.4, 0.4, 0.6, 0.9], len(rows))
    stay = kept(boxes, scores, rows[:, 4].astype(int), most)
    assert stay.tolist() == by_loop(boxes, scores, rows[:, 4], most)
    assert kept(boxes, scores, None, most).tolist() == by_loop(boxes, scores, np.zeros(len(rows)), most)


def test_overlaps_are_the_closed_form():
    boxes = np.array([[0, 0, 2, 2], [1, 1, 3, 3], [5, 5, 6, 6], [1, 1, 1, 4]], float)
    wanted = [[1, 1 / 7, 0, 0], [1 / 7, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 0]]
    np.testing.assert_allclose(overlaps(boxes, boxes), wanted)


def test_of_very_many_only_the_best_are_compared():
    scores = np.linspace(1, 0, 3 * MOST_COMPARED)
    boxes = np.arange(3 * MOST_COMPARED, dtype=float)[:, None] * 4 + np.array([0, 0, 1, 1])
    assert kept(boxes, scores).tolist() == list(range(MOST_COMPARED))

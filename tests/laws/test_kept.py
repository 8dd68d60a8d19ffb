"""What the studio keeps: it is weighed, bounded by bytes, and goes once nobody uses it."""

import sys

import numpy as np
import pytest

from eagor.studio.caching import Kept, weighed

MEGABYTE = 1 << 20


def test_arrays_are_weighed_once_and_views_with_what_they_show():
    array = np.zeros(MEGABYTE, np.uint8)
    assert weighed(array) == pytest.approx(MEGABYTE, abs=1000)
    assert weighed([array, array, array[:10], {"a": array[::2]}]) == pytest.approx(MEGABYTE, abs=3000)
    assert weighed(array[:10]) == pytest.approx(MEGABYTE, abs=1000)
    assert weighed(b"x" * MEGABYTE) == sys.getsizeof(b"x" * MEGABYTE)


def kept(most):
    made = []

    def make(key):
        made.append(key)
        return np.zeros(MEGABYTE, np.uint8)

    return Kept(make, most), made


def test_the_oldest_goes_when_the_bytes_are_full():
    cache, made = kept(3 * MEGABYTE + 5000)
    for key in [1, 2, 3, 1, 4, 1, 2]:
        assert cache(key).size == MEGABYTE
        assert cache.bytes <= cache.most
    assert made == [1, 2, 3, 4, 2]  # 2 was the oldest when 4 came


def test_one_that_is_too_large_is_kept_alone():
    cache, made = kept(10)
    for key in [1, 1, 2, 2, 1]:
        cache(key)
    assert made == [1, 2, 1]


def test_what_nobody_uses_is_given_back_but_for_the_spare():
    cache, made = kept(100 * MEGABYTE)
    for key in range(10):
        cache(key)
    cache.release(used={0, 1}, spare=4 * MEGABYTE + 5000)
    made.clear()
    for key in (0, 1, 8, 9, 7):
        cache(key)
    assert made == [7]
    cache.release(used=(), spare=0)
    assert cache.bytes == 0

"""Tests that measure real time, or share a page, run one after the other in one process."""

import os

import pytest


@pytest.mark.xdist_group("real time")
@pytest.mark.skipif("PYTEST_XDIST_WORKER" not in os.environ, reason="there is one process only")
def test_tests_in_real_time_are_a_group(request):
    """Versions of pytest and pytest-xdist that do not fit ignore groups, and say nothing."""
    assert request.node.nodeid.endswith("@real time")

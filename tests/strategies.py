"""What the laws draw from: rotations near every trap, directions near every pole, fields of every degree."""

import math

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st

from eagor.evidence import Evidence
from eagor.sphere import rotation
from eagor.tracking.tracker import DirectionTracker

# Readers of hostile input are tried with a hundred cases in every run, whatever laws are tried with.
HOSTILE = settings(max_examples=max(100, settings.default.max_examples))


def at_most(cases: int) -> settings:
    """So many cases of a law, but no more than of the others: 25, and all of them with ``make test-slow``."""
    return settings(max_examples=min(cases, settings.default.max_examples))


_ANGLES = st.one_of(
    st.floats(-math.pi, math.pi),
    st.sampled_from([0.0, 1e-8, -1e-8, math.pi / 2, math.pi, -math.pi, math.pi - 1e-8]),
)
_AXES = st.one_of(
    st.sampled_from([(0, 0, 1), (0, 0, -1), (0, 1, 0), (1, 0, 0), (1, 1, 0), (1, 1, 1)]),
    st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 1e-3),
)


@st.composite
def rotations(draw):
    """A rotation matrix: products of turns about special and general axes, by special and general angles."""
    found = np.eye(3)
    for _ in range(draw(st.integers(1, 2))):
        found = rotation(draw(_AXES), draw(_ANGLES)) @ found
    return found


@st.composite
def directions(draw):
    """A unit vector, often at or very near a pole, an axis or the seam."""
    axis = draw(_AXES)
    vector = np.array(axis, dtype=float) + draw(st.sampled_from([0.0, 1e-9])) * np.array([0.3, -0.7, 0.2])
    return vector / np.linalg.norm(vector)


def field(degree, seed, width=0.15):
    """Coefficients of a smooth random field, seeded."""
    rng = np.random.default_rng(seed)
    l = np.repeat(np.arange(degree + 1), 2 * np.arange(degree + 1) + 1)
    return rng.normal(size=(degree + 1) ** 2) * np.exp(-0.5 * (l * width) ** 2)


def random_directions(count, seed=0):
    """Uniform directions ``(count, 3)``, seeded."""
    vectors = np.random.default_rng(seed).normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def points_look(places, stamp, model, **more):
    """Evidence of a detector that saw the thing at `places` ``(n, 3)``."""
    return Evidence.from_points(np.reshape(places, (-1, 3)), detector=model, stamp=float(stamp), **more)


def estimate_after(looks, config):
    """What a tracker says right after the last of some looks."""
    tracker = DirectionTracker(config)
    for each in looks:
        tracker.observe(each)
    return tracker.estimate(looks[-1].stamp)

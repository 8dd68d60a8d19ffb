"""Which of many matched directions agree on one motion of the camera, without a threshold on the error.

Hypotheses come from random small samples (RANSAC). They are compared by the expected number of equally good agreements
among directions that have nothing to do with each other (a contrario RANSAC: Moisan & Stival, IJCV 57, 2004). That
number also tells whether there is an agreement at all. What is probable by chance depends on the field: directions in a
picture of 60 degrees are never far from each other. So all functions take its area.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import gammaln

BATCH = 128
MOST_ROTATIONS, MOST_MOTIONS = 2048, 512  # hypotheses
MISSED = 1e-4  # probability that no sample was free of mistakes, where sampling stops early
SPHERE = 4 * math.pi  # steradians
PARTS = 4  # squares along each edge of a cube's face, about 22 degrees: what is seen there may be one thing
IN_FIELD = 40  # parts of a field, at least: in a narrow one they are smaller, or there would be too few to vote
_LEAST = math.sin(math.radians(0.2) / 2) ** 2  # share of the sphere: SIFT's points are no more precise (half a pixel)


@dataclass(frozen=True, eq=False)
class Agreement:
    """A hypothesis: `rotation` ``(3, 3)``, `direction` ``(3,)`` of the motion or None, and how surprising it is.

    `log_chance`: logarithm of the expected number of as good ones by chance. `inliers`: booleans ``(n,)``.
    """

    rotation: np.ndarray
    direction: np.ndarray | None
    log_chance: float
    inliers: np.ndarray


@dataclass(frozen=True, eq=False)
class Inertia:
    """What is known of a turn before, as a camera cannot stop at once: `old_R_new` ``(3, 3)`` up to `most` radians."""

    old_R_new: np.ndarray
    most: float

    def allows(self, old_R_new: np.ndarray) -> np.ndarray:
        """Whether each of the turns ``(..., 3, 3)`` can be."""
        cosine = (np.sum(self.old_R_new * old_R_new, axis=(-2, -1)) - 1) / 2
        return cosine >= math.cos(min(self.most, math.pi)) - 1e-12


def agreeing_rotation(
    here: np.ndarray,
    there: np.ndarray,
    random: np.random.Generator,
    level: bool = False,
    area: float = SPHERE,
    inertia: Inertia | None = None,
) -> Agreement | None:
    """The rotation with ``rotation @ there = here`` for most of the unit vectors ``(n, 3)``; None if there are too few.

    `level`: only about z. A sample is two pairs, or one if level. `area`: of the field in which they are, steradians.
    `inertia`: others do not count.
    """
    size, parts = 1 if level else 2, Parts(here, area)
    if parts.count <= size:
        return None
    products = (here[:, :, None] * there[:, None, :]).reshape(-1, 9)
    best: Agreement | None = None
    tried, wanted = 0, float(MOST_ROTATIONS)
    while tried < min(wanted, MOST_ROTATIONS):
        chosen = parts.samples(random, BATCH, size)
        u, v = here[chosen], there[chosen]
        rotations = _yaws(u[:, 0], v[:, 0]) if level else _triads(u, v)
        tried += BATCH
        if inertia is not None:
            rotations = rotations[inertia.allows(rotations)]
        if len(rotations):
            shares = np.maximum((1 - rotations.reshape(-1, 9) @ products.T) / 2, _LEAST)  # of the sphere
            shares = np.minimum(shares * (SPHERE / area), 1)
            index, log_chance, inliers, part = parts.least_likely(shares, size)
            if best is None or log_chance < best.log_chance:
                best = Agreement(rotations[index], None, log_chance, inliers)
                wanted = _enough(part, size)
    return best


def agreeing_motion(
    here: np.ndarray,
    there: np.ndarray,
    rotation: np.ndarray,
    random: np.random.Generator,
    area: float = SPHERE,
) -> Agreement | None:
    """A rotation and a direction of motion that put most pairs of unit vectors ``(n, 3)`` on epipolar great circles.

    The less likely by chance of two: the best that keeps `rotation`, a first guess, and takes the direction from two
    pairs; and the best that takes both from eight pairs (Longuet-Higgins 1981, in unit vectors). The direction's sign
    and the rotation's twist by half a turn about it are chosen so that things lie ahead. None from too few parts.
    """
    parts = Parts(here, area)
    if parts.count <= 8:
        return None
    products = (here[:, :, None] * there[:, None, :]).reshape(-1, 9)
    normals = np.cross(here, there @ rotation.T)
    found = []
    for size, most in ((2, BATCH), (8, MOST_MOTIONS)):
        best: tuple[Agreement, float] | None = None
        tried, wanted = 0, float(most)
        while tried < min(wanted, most):
            chosen = parts.samples(random, BATCH, size)
            tried += BATCH
            if size == 2:
                directions = _normalised(np.cross(normals[chosen[:, 0]], normals[chosen[:, 1]]))
                rotations = np.broadcast_to(rotation, (len(directions), 3, 3))
            else:
                rotations, directions = _eight_points(products[chosen])
            if len(directions) == 0:
                continue
            shares = np.minimum(_off_circles(here, there, products, rotations, directions) * _band(area), 1)
            index, by_pairs, inliers = _least_likely(shares, size)
            if best is None or by_pairs < best[1]:
                chance = parts.least_likely(shares[index : index + 1], 8)[1]
                best = Agreement(rotations[index], directions[index], chance, inliers), by_pairs
                wanted = _enough(inliers.mean(), size)
        if best is not None:
            found.append(best[0])
    return _facing(min(found, key=lambda each: each.log_chance), here, there) if found else None


class Parts:
    """Pairs grouped by the part of the sphere in which they lie, so that each part counts once.

    Neighbours are not independent: a chair seen in two rooms is one coincidence, not thirty, and a tripod with a
    pattern is not more of the world than a wall with few points. `area`: of the field, steradians.
    """

    def __init__(self, here: np.ndarray, area: float = SPHERE) -> None:
        self.area = area
        owners = part_of_sphere(here, max(PARTS, math.ceil(math.sqrt(IN_FIELD * SPHERE / area / 6))))
        self.order = np.argsort(owners, kind="stable")
        _, self.starts, self.sizes = np.unique(owners[self.order], return_index=True, return_counts=True)
        self.count = len(self.starts)

    def samples(self, random: np.random.Generator, count: int, size: int) -> np.ndarray:
        """Samples ``(count, size)`` of pairs: a part at random, then a pair in it; repeats degenerate and lose."""
        part = random.integers(0, self.count, (count, size))
        return self.order[self.starts[part] + (random.random((count, size)) * self.sizes[part]).astype(np.intp)]

    @property
    def shares(self) -> np.ndarray:
        """Weights ``(n,)`` of pairs so that each part weighs the same: as many pairs as the median part has."""
        weights = np.empty(len(self.order))
        weights[self.order] = np.repeat(np.median(self.sizes) / self.sizes, self.sizes)
        return weights

    @property
    def weights(self) -> np.ndarray:
        """The same ``(n,)``, but no pair weighs more than 1: one pair alone in its part is easily a mistake."""
        return np.minimum(self.shares, 1)

    def least_likely(self, shares: np.ndarray, sample: int) -> tuple[int, float, np.ndarray, float]:
        """The hypothesis that chance explains least: its index, log of the expected number by chance, inliers ``(n,)``.

        And the share of parts that agree. `shares` ``(m, n)``: the probability that a pair by chance is as near. That
        of a part is the least of its pairs times their number (Bonferroni, valid whatever the dependence).
        """
        least = np.minimum.reduceat(shares[:, self.order], self.starts, axis=1)
        index, log_chance, agree = _least_likely(np.minimum(least * self.sizes, 1), sample)
        limit = least[index][agree].max() * (1 + 1e-9)
        return index, log_chance, shares[index] <= limit, float(agree.mean())


def _least_likely(shares: np.ndarray, sample: int) -> tuple[int, float, np.ndarray]:
    """The hypothesis that chance explains least: its index, log of the expected number, what agrees ``(n,)``.

    `shares` ``(m, n)``: the probability that each is as near by chance; `sample` of them determine a hypothesis. Moisan
    & Stival 2004, equation 12.
    """
    n = shares.shape[1]
    k = np.arange(sample + 1, n + 1)
    choices = gammaln(n + 1) - gammaln(n - k + 1) - gammaln(sample + 1) - gammaln(k - sample + 1)  # C(n,k) C(k,sample)
    ordered = np.sort(shares, axis=1)[:, sample:]
    log_chance = math.log(n - sample) + choices + (k - sample) * np.log(ordered)
    index, count = np.unravel_index(int(log_chance.argmin()), log_chance.shape)
    return int(index), float(log_chance[index, count]), shares[index] <= ordered[index, count] * (1 + 1e-9)


def _off_circles(
    here: np.ndarray, there: np.ndarray, products: np.ndarray, rotations: np.ndarray, directions: np.ndarray
) -> np.ndarray:
    """Shares ``(m, n)`` of the sphere that lie no farther from each epipolar great circle than the pair."""
    across = np.cross(directions[:, :, None], rotations, axis=1)  # E = [t]x R
    ends = np.einsum("mji,mj->mi", rotations, directions)
    sines = np.sqrt(np.clip(1 - np.minimum((directions @ here.T) ** 2, (ends @ there.T) ** 2), 1e-12, 1))
    return np.clip(np.abs(across.reshape(-1, 9) @ products.T) / sines, 2 * math.sqrt(_LEAST), 1)


def _band(area: float) -> float:
    """How much larger a share of a field than of the sphere a thin band along a great circle is, if the field is round.

    On the sphere a band of half-width d has the share sin d. A field of radius r has a band of 2 r at most.
    """
    radius = math.acos(max(1 - area / (2 * math.pi), -1.0))
    return 4 * radius / area


def part_of_sphere(directions: np.ndarray, parts: int = PARTS) -> np.ndarray:
    """A number ``(n,)`` for the part of the sphere of each direction ``(n, 3)``: a square on a face of the cube.

    `parts`: squares along each edge of the face.
    """
    axis = np.abs(directions).argmax(axis=1)
    row = np.arange(len(directions))
    ahead = directions[row, axis]
    plane = np.stack([directions[row, (axis + 1) % 3], directions[row, (axis + 2) % 3]], axis=1) / ahead[:, None]
    square = np.clip(((plane + 1) / 2 * parts).astype(int), 0, parts - 1)
    return ((axis * 2 + (ahead < 0)) * parts + square[:, 0]) * parts + square[:, 1]


def _enough(share: float, size: int) -> float:
    """So many samples contain one without mistakes, if `share` of the matches are right."""
    clean = min(share, 1 - 1e-9) ** size
    return math.log(MISSED) / math.log1p(-clean) if clean > 0 else math.inf


def _triads(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Rotations ``(m, 3, 3)`` that turn the pairs `v` ``(count, 2, 3)`` into `u`, as well as two pairs can."""
    frames, lengths = [], []
    for pair in (u, v):
        total, gap = pair[:, 0] + pair[:, 1], pair[:, 0] - pair[:, 1]  # orthogonal for unit vectors
        norms = np.linalg.norm(total, axis=1), np.linalg.norm(gap, axis=1)
        lengths.append(np.minimum(*norms))
        first = total / np.maximum(norms[0], 1e-12)[:, None]
        second = gap / np.maximum(norms[1], 1e-12)[:, None]
        frames.append(np.stack([first, second, np.cross(first, second)], axis=-1))
    good = np.minimum(*lengths) > 0.02  # two directions nearly the same, or opposite, leave one turn open
    return (frames[0] @ frames[1].swapaxes(1, 2))[good]


def _yaws(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Rotations ``(m, 3, 3)`` about z that turn `v` ``(count, 3)`` into the azimuth of `u`."""
    cosine, sine = u[:, 0] * v[:, 0] + u[:, 1] * v[:, 1], u[:, 1] * v[:, 0] - u[:, 0] * v[:, 1]
    length = np.hypot(cosine, sine)
    good = length > 0.01
    cosine, sine = cosine[good] / length[good], sine[good] / length[good]
    zero, one = np.zeros_like(cosine), np.ones_like(cosine)
    return np.stack([cosine, -sine, zero, sine, cosine, zero, zero, zero, one], axis=-1).reshape(-1, 3, 3)


def _eight_points(products: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotations ``(m, 3, 3)`` and directions ``(m, 3)`` from the products ``(m, 8, 9)`` of eight pairs."""
    essential = np.linalg.svd(products)[2][:, -1].reshape(-1, 3, 3)
    left, _, right = np.linalg.svd(essential)
    left = left * np.sign(np.linalg.det(left))[:, None, None]
    right = right * np.sign(np.linalg.det(right))[:, None, None]
    return left @ _QUARTER @ right, left[:, :, 2]


_QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def _facing(found: Agreement, here: np.ndarray, there: np.ndarray) -> Agreement:
    """The same epipolar circles with the rotation and the sign that move most things away from where we go."""
    assert found.direction is not None
    t = found.direction
    twist = 2 * np.outer(t, t) - np.eye(3)  # half a turn about the direction
    u, best, most = here[found.inliers], found, -math.inf
    for rotation in (found.rotation, twist @ found.rotation):
        turned = there[found.inliers] @ rotation.T
        for sign in (1.0, -1.0):
            away = u * (u @ t)[:, None] * sign - sign * t  # tangent at u, away from the motion
            along = np.sum(turned * away, axis=1) / np.maximum(np.linalg.norm(away, axis=1), 1e-9)
            nearer = np.sum(turned * u, axis=1)
            # Half a turn too much throws things far off; the wrong sign moves them the wrong way.
            score = float(np.sum(nearer) + 1e-3 * np.sum(np.sign(along)))
            if score > most:
                best, most = replace(found, rotation=rotation, direction=sign * t), score
    return best


def _normalised(vectors: np.ndarray) -> np.ndarray:
    """Unit vectors of those that are not near zero."""
    length = np.linalg.norm(vectors, axis=1)
    good = length > 1e-9
    return vectors[good] / length[good, None]

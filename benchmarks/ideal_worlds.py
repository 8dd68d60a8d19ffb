"""Synthetic detections for `ideal.py`: worlds of which everything is known, and the exact likelihood of a look.

One target, one look a second. A look detects the target with probability `Detector.detection`, at a place that is von
Mises-Fisher distributed about it with concentration 1 / spread^2, among false alarms: Poisson in number, even over the
sphere. The camera takes a fresh, uniformly random orientation before every look (in `drift` it only yaws).

In worlds with habits the target, and each of the things that are taken for it (Poisson in number, anywhere on the
sphere), is detected in a share of the looks that is its own, drawn once from a beta distribution.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from eagor.sphere import rotation, unit

STEP = 1.0  # seconds between looks
NEAREST, FARTHEST = 1.0, 8.0  # metres: how far away the target of the walking world is at the start
PACE = 0.25  # metres per look
CLEARANCE = 0.3  # metres: the walker never comes nearer to the target
TURN_RATE = 10.0  # degrees per second, `turn`
JUMP_RATE = 1 / 15  # per second, `jumps`
DRIFT_RATE = 1.0  # degrees per second, `drift`
# `habits`: beta distributions of the share of looks that detect the target, and a look-alike; look-alikes expected.
HABIT, ALIKE_HABIT, ALIKES = (0.8, 0.8), (0.5, 2.0), 0.7


@dataclass(frozen=True)
class Detector:
    """A detector as it is, or as a filter takes it to be: P_D, false alarms per look, spread in degrees."""

    detection: float = 0.7
    alarms: float = 0.2
    spread: float = 8.0

    @property
    def concentration(self) -> float:
        return 1 / math.radians(self.spread) ** 2

    def likelihood(self, points: np.ndarray, detections: np.ndarray) -> np.ndarray:
        """Of a whole look, against "no target", for a target at unit vectors `points` ``(..., 3)``.

        1 - P_D + P_D sum_i g(z_i | point) / lambda with lambda = alarms / 4 pi (METHOD section 8); `detections`
        ``(n, 3)`` in the axes of `points`.
        """
        kappa = self.concentration
        height = 2 * kappa / (-math.expm1(-2 * kappa) * self.alarms)  # g at its top, over lambda
        found = np.full(points.shape[:-1], 1 - self.detection)
        for detection in detections:
            found += self.detection * height * np.exp(kappa * (points @ detection - 1))
        return found


@dataclass(frozen=True, eq=False)
class Motion:
    """How the target of a run moves: what a filter that knows the motion is told.

    `axis` and `rate`: a constant turn, radians per second; `diffusion`: random walk, radians per root second and axis;
    `jumps`: rate per second of jumps to a place anywhere.
    """

    axis: np.ndarray | None = None
    rate: float = 0.0
    diffusion: float = 0.0
    jumps: float = 0.0

    def turned(self, time: float) -> np.ndarray:
        """The rotation ``(3, 3)`` that takes a direction at time 0 to where the constant turn has it at `time`."""
        return np.eye(3) if self.axis is None else rotation(self.axis, self.rate * time)


@dataclass(frozen=True, eq=False)
class Run:
    """T looks of one seeded run.

    `poses` ``(T, 3, 3)``: world_R_body as it is; `told`: as the odometry says; `positions` ``(T, 3)``: metres, or None
    where the camera stays where it is; `looks`: detections ``(n, 3)`` of each look in the body frame; `targets`
    ``(T, 3)``: where it is in the world, a unit vector where there are no positions; `present`: whether it is there.
    """

    poses: np.ndarray
    told: np.ndarray
    positions: np.ndarray | None
    looks: list[np.ndarray]
    targets: np.ndarray
    motion: Motion
    detector: Detector
    present: bool = True

    def __len__(self) -> int:
        return len(self.looks)

    @property
    def offsets(self) -> np.ndarray:
        """From the camera to the target ``(T, 3)``, world axes."""
        return self.targets if self.positions is None else self.targets - self.positions

    @property
    def truths(self) -> np.ndarray:
        """The true directions ``(T, 3)`` in the body frame."""
        return np.einsum("tij,ti->tj", self.poses, unit(self.offsets))

    @property
    def distances(self) -> np.ndarray:
        return np.linalg.norm(self.offsets, axis=-1)


def anywhere(rng: np.random.Generator, *shape: int) -> np.ndarray:
    """Uniform directions."""
    return unit(rng.normal(size=(*shape, 3)))


def any_rotations(count: int, rng: np.random.Generator) -> np.ndarray:
    """Uniform rotations ``(count, 3, 3)``, from uniform unit quaternions."""
    quaternions = rng.normal(size=(count, 4))
    w, x, y, z = (quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def near(direction: np.ndarray, concentration: float | np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A draw of the von Mises-Fisher distribution about each `direction` ``(..., 3)``; on the sphere it is exact."""
    shape = direction.shape[:-1]
    share = rng.random(shape)
    cosine = 1 + np.log(share + (1 - share) * np.exp(-2 * concentration)) / concentration
    side = unit(np.cross(direction, anywhere(rng, *shape)))
    return cosine[..., None] * direction + np.sqrt(np.maximum(0.0, 1 - cosine**2))[..., None] * side


def looks(truths: np.ndarray, detector: Detector, rng: np.random.Generator) -> list[np.ndarray]:
    """What the detector says of a target at `truths` ``(T, 3)``, in their axes."""
    found = []
    for truth in truths:
        points = list(anywhere(rng, rng.poisson(detector.alarms)))
        if rng.random() < detector.detection:
            points.append(near(truth, detector.concentration, rng))
        rng.shuffle(points)
        found.append(np.reshape(points, (-1, 3)))
    return found


def _run(
    targets: np.ndarray,
    rng: np.random.Generator,
    detector: Detector,
    positions: np.ndarray | None = None,
    poses: np.ndarray | None = None,
    motion: Motion | None = None,
) -> Run:
    poses = any_rotations(len(targets), rng) if poses is None else poses
    run = Run(poses, poses, positions, [], targets, motion or Motion(), detector)
    return replace(run, looks=looks(run.truths, detector, rng))


def turning(rng: np.random.Generator, detector: Detector, steps: int = 30) -> Run:
    """The target stands anywhere, the camera turns where it stands."""
    return _run(np.tile(anywhere(rng), (steps, 1)), rng, detector)


def walking(rng: np.random.Generator, detector: Detector, steps: int = 30) -> Run:
    """The camera walks past the target, 0.25 m a look along a circle or nearly a line, turning at random all the while.

    From the start the target is at any azimuth, within 30 degrees of the horizon (evenly over that part of the sphere)
    and 1 to 8 m away (evenly in the logarithm). The walk begins 10 to 90 degrees to its left or right and bends by up
    to 2 degrees a look; walks that would come within 0.3 m of the target are drawn anew.
    """
    azimuth, height = rng.uniform(-math.pi, math.pi), rng.uniform(-0.5, 0.5)
    level = math.sqrt(1 - height**2)
    distance = NEAREST * (FARTHEST / NEAREST) ** rng.random()
    target = distance * np.array([level * math.cos(azimuth), level * math.sin(azimuth), height])
    while True:
        start = azimuth + rng.choice([-1, 1]) * math.radians(rng.uniform(10, 90))
        headings = start + math.radians(rng.uniform(-2, 2)) * np.arange(steps)
        strides = PACE * np.stack([np.cos(headings), np.sin(headings), np.zeros(steps)], axis=1)
        positions = np.cumsum(strides, axis=0) - strides[0]
        if np.linalg.norm(target - positions, axis=1).min() > CLEARANCE:
            return _run(np.tile(target, (steps, 1)), rng, detector, positions)


def constant_turn(rng: np.random.Generator, detector: Detector, steps: int = 45) -> Run:
    """The target circles a random axis by 10 degrees a second."""
    motion = Motion(anywhere(rng), math.radians(TURN_RATE))
    start = anywhere(rng)
    return _run(np.array([motion.turned(t * STEP) @ start for t in range(steps)]), rng, detector, motion=motion)


def random_walk(rng: np.random.Generator, detector: Detector, degrees: float, steps: int = 45, parts: int = 20) -> Run:
    """Brownian motion on the sphere: `degrees` per root second along each of two axes, in `parts` steps a second."""
    sigma = math.radians(degrees)
    place = anywhere(rng)
    targets = [place]
    for _ in range(steps - 1):
        for _ in range(parts):
            push = rng.normal(0, sigma * math.sqrt(STEP / parts), 3)
            place = unit(place + push - (push @ place) * place)
        targets.append(place)
    return _run(np.array(targets), rng, detector, motion=Motion(diffusion=sigma))


def jumps(rng: np.random.Generator, detector: Detector, steps: int = 45) -> Run:
    """The target stands still, and now and then (every 15 s on average) it is suddenly anywhere."""
    targets = [anywhere(rng)]
    for _ in range(steps - 1):
        targets.append(anywhere(rng) if rng.random() < -math.expm1(-JUMP_RATE * STEP) else targets[-1])
    return _run(np.array(targets), rng, detector, motion=Motion(jumps=JUMP_RATE))


def drift(rng: np.random.Generator, detector: Detector, steps: int = 30) -> Run:
    """The target stands; the camera only yaws, by anything up to half a turn a look; its odometry drifts in yaw."""
    yaws = np.cumsum(rng.uniform(-math.pi, math.pi, steps))
    up = (0.0, 0.0, 1.0)
    poses = np.array([rotation(up, yaw) for yaw in yaws])
    errors = np.array([rotation(up, math.radians(DRIFT_RATE) * t * STEP) for t in range(steps)])
    run = _run(np.tile(anywhere(rng), (steps, 1)), rng, detector, poses=poses)
    return replace(run, told=errors @ poses, motion=Motion(np.array(up), math.radians(DRIFT_RATE)))


def habits(rng: np.random.Generator, detector: Detector, presence: float = 1.0, steps: int = 30) -> Run:
    """As `turning`, with habits and look-alikes; the target is there with probability `presence`."""
    there, recall = rng.random() < presence, rng.beta(*HABIT)
    targets = np.tile(anywhere(rng), (steps, 1))
    run = _run(targets, rng, replace(detector, detection=recall if there else 0.0))
    alikes = anywhere(rng, rng.poisson(ALIKES))
    taken = rng.random((steps, len(alikes))) < rng.beta(*ALIKE_HABIT, len(alikes))
    seen = [
        np.concatenate([look, near(alikes[which] @ pose, detector.concentration, rng)])
        for look, which, pose in zip(run.looks, taken, run.poses, strict=True)
    ]
    return replace(run, looks=seen, detector=detector, present=there)


World = Callable[[np.random.Generator, Detector], Run]
WORLDS: dict[str, tuple[str, World]] = {  # each with the group that `ideal.py --worlds` takes
    "turning": ("turning", turning),
    "walking": ("walking", walking),
    "constant turn, 10 deg/s": ("moving", constant_turn),
    "random walk, 2 deg/sqrt(s)": ("moving", lambda rng, detector: random_walk(rng, detector, 2.0)),
    "random walk, 10 deg/sqrt(s)": ("moving", lambda rng, detector: random_walk(rng, detector, 10.0)),
    "jumps, every 15 s": ("moving", jumps),
    "drift, 1 deg/s": ("drift", drift),
    "drift, 1 deg/s, error of 3 deg": ("drift", lambda rng, detector: drift(rng, replace(detector, spread=3.0))),
    "turning, error of 3 deg": ("sharp", lambda rng, detector: turning(rng, replace(detector, spread=3.0))),
    "turning, error of 1 deg": ("sharp", lambda rng, detector: turning(rng, replace(detector, spread=1.0))),
    "habits": ("habits", habits),
    "habits, half of them absent": ("habits", lambda rng, detector: habits(rng, detector, presence=0.5)),
}


def make(world: str, seed: int) -> Run:
    """The run of this world and seed, by the true detector."""
    return WORLDS[world][1](np.random.default_rng((17, list(WORLDS).index(world), seed)), Detector())

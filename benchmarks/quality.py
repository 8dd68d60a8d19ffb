"""How good are the answers? Ours against every rival, on the same evidence, on seeds that nothing was tuned on.

    python benchmarks/quality.py [--episodes N] [--split dev|report] [--tune]

Two experiments, both synthetic, both with the odometry exact:

- standing: a patch map of 37 x 74 cells per frame, blobs for the target and for what is not the target, the camera
  turning at random (mostly yaw) between frames; the answer after the last frame counts. Eight scenarios S1 to S8.
- the walk: 30 steps of 0.25 m past a target at about 4 m, one noisy bearing per step, misses and false alarms.

`--tune` sweeps the settings of every tunable method on the development seeds, the same number of trials each, and
prints the winners; the defaults of `eagor.baselines` come from there. `--split report` uses
other seeds. Brackets are 95 % bootstrap intervals of the mean over episodes.
"""

from __future__ import annotations

import itertools
import math
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import common
import numpy as np

from eagor import (
    Belief,
    Calibration,
    ErpGrid,
    Evidence,
    PatchGrid,
    RangedBelief,
    angular_distance,
)
from eagor import direction as direction_of
from eagor.baselines import (
    BestDetection,
    Centroid,
    CircularCentroid,
    GridFilter,
    HistogramFilter,
    LastDetection,
    ParticleFilter,
    Published,
    VonMisesFisherFilter,
)
from eagor.sphere import rotation, unit, world_R_body
from eagor.statistics import bootstrap_interval, paired_difference

SEEDS = {"dev": 1_000_003, "report": 2_000_003}  # first words of the seed sequences; the others: experiment, episode
GRID = PatchGrid(37, 74)
NEUTRAL = 0.05  # on the whole sphere it shifts the field and moves no direction
PARTICLES = 2000
HPD_GRID = ErpGrid(120, 240)
OURS = "Belief tuned"
TUNED = {
    "floor": 1.0,
    "keep": 0.8,
    "degree": 15,
    "temperature": 8.0,
}  # the winner for `Belief` on the development seeds
WALKS_PER_EPISODE = 0.2  # 200 episodes per scenario come with 40 walks

# ---------- what is estimated with


@dataclass(frozen=True)
class Ours:
    """`Belief` or `RangedBelief` behind the rivals' calls: a calibration, a forgetting factor per frame, the mode."""

    belief: Belief | RangedBelief
    calibration: Calibration | None = None
    keep: float = 1.0

    def predict(self, new_R_old: np.ndarray, translation: np.ndarray | None = None) -> Ours:
        if isinstance(self.belief, RangedBelief):
            belief: Belief | RangedBelief = self.belief.predict(new_R_old, translation)
        else:
            belief = self.belief.predict(new_R_old)
        return replace(self, belief=belief if self.keep == 1 else belief.forget(self.keep))

    def update(self, evidence: Evidence) -> Ours:
        read = evidence if self.calibration is None else evidence.with_calibration(self.calibration)
        return replace(self, belief=self.belief.update(read))

    def direction(self) -> np.ndarray:
        return self.belief.mode()

    def log_density(self, directions: np.ndarray) -> np.ndarray:
        return self.belief.log_density(directions)


Factory = Callable[[np.random.Generator], Any]


def belief(floor: float, keep: float, degree: int, temperature: float, ranged: bool = False) -> Ours:
    """Ours with these settings."""
    blank = RangedBelief.uniform(degree) if ranged else Belief.uniform(degree)
    return Ours(blank, Calibration(floor, NEUTRAL, temperature), keep)


def methods() -> dict[str, Factory]:
    """Every method of the comparison, as `rng` -> filter.

    Rivals and "Belief tuned" have the settings that won on the development seeds, equal numbers of trials each;
    "Belief" is the package's default (no forgetting).
    """
    return {
        "Centroid": lambda rng: Centroid(),
        "CircularCentroid": lambda rng: CircularCentroid(),
        "GridFilter": lambda rng: GridFilter(),
        "Published": lambda rng: Published(),
        "BestDetection": lambda rng: BestDetection(),
        "LastDetection": lambda rng: LastDetection(),
        "vMF": lambda rng: VonMisesFisherFilter(),
        "Histogram": lambda rng: HistogramFilter(),
        "Particles": lambda rng: ParticleFilter.uniform(PARTICLES, rng),
        "Belief L7": lambda rng: Ours(Belief.uniform(7)),
        "Belief": lambda rng: Ours(Belief.uniform(15)),
        OURS: lambda rng: belief(**TUNED),
    }


def walk_methods() -> dict[str, Factory]:
    """Those of the walk: the rivals as above, ours at degree 12."""
    return {
        **{name: make for name, make in methods().items() if not name.startswith("Belief")},
        OURS: methods()[OURS],
        "Belief rotation-only": lambda rng: Ours(Belief.uniform(12)),
        "Belief forget .9": lambda rng: Ours(Belief.uniform(12), keep=0.9),
        "RangedBelief": lambda rng: Ours(RangedBelief.uniform(12)),
    }


# ---------- standing: the generator


@dataclass(frozen=True)
class Scenario:
    """One kind of episode. Amplitudes are responses in [0, 1], widths and drifts degrees."""

    name: str
    what: str
    steps: int = 10
    detection: float = 0.7
    clutter: int = 0  # blobs per frame at random places, new ones in each frame
    distractor: float = 0.0  # amplitude of a blob that stays where it is
    distractor_width: float = 8.0
    slope: float = 0.0  # response of the floor straight below
    drift: float = 0.0  # degrees per frame, along a great circle


SCENARIOS = (
    Scenario("S1", "clean", detection=1.0),
    Scenario("S2", "30 % misses, 2 clutter blobs per frame", clutter=2),
    Scenario("S3", "15 % misses, a persistent distractor of 0.6", detection=0.85, distractor=0.6),
    Scenario("S4", "30 % misses, a wide (30 deg) distractor of 0.4", distractor=0.4, distractor_width=30.0),
    Scenario("S5", "30 % misses, attention that slopes to 0.05 on the floor", slope=0.05),
    Scenario("S6", "a single frame with 2 clutter blobs", steps=1, detection=1.0, clutter=2),
    Scenario("S7", "S2 for 50 frames", steps=50, clutter=2),
    Scenario("S8", "S2 for 30 frames, the target drifting 6 deg per frame", steps=30, clutter=2, drift=6.0),
)


@dataclass(frozen=True)
class Episode:
    """T looks, how the camera turned before each ``(T, 3, 3)``, where the target is after the last ``(3,)``."""

    evidence: list[Evidence]
    turns: np.ndarray
    truth: np.ndarray


def _somewhere(rng: np.random.Generator, *shape: int) -> np.ndarray:
    """World directions: any azimuth, elevation mostly within 40 degrees of the horizon."""
    elevation = np.clip(rng.normal(0, math.radians(20), shape), -1.2, 1.2)
    return direction_of(rng.uniform(-math.pi, math.pi, shape), elevation)


def _jittered(directions: np.ndarray, sigma_deg: float, rng: np.random.Generator) -> np.ndarray:
    return unit(directions + rng.normal(0, math.radians(sigma_deg), directions.shape))


def episode(scenario: Scenario, seed: tuple[int, ...]) -> Episode:
    """One seeded episode: all frames are rendered at once."""
    rng = np.random.default_rng(seed)
    steps = scenario.steps
    turns = np.stack([np.eye(3)] * steps)
    body_R_world = np.stack([world_R_body(rng.uniform(-3.14, 3.14), *rng.normal(0, 0.05, 2)).T] * steps)
    for t in range(1, steps):
        turns[t] = world_R_body(rng.uniform(-0.8, 0.8), *rng.normal(0, 0.05, 2)).T
        body_R_world[t] = turns[t] @ body_R_world[t - 1]
    start = _somewhere(rng)
    axis = unit(np.cross(start, rng.normal(size=3)))
    path = np.stack([rotation(axis, math.radians(scenario.drift) * t) @ start for t in range(steps)])
    # Blobs: the target, the distractor, the clutter; amplitudes of zero are the misses.
    blobs = [_jittered(path, 3.0, rng)[:, None]]
    amplitude = [(rng.random((steps, 1)) < scenario.detection) * rng.uniform(0.6, 1.0, (steps, 1))]
    width = [rng.uniform(6, 10, (steps, 1))]
    if scenario.distractor:
        blobs.append(_jittered(np.broadcast_to(_somewhere(rng), (steps, 3)), 3.0, rng)[:, None])
        amplitude.append(np.full((steps, 1), scenario.distractor))
        width.append(np.full((steps, 1), scenario.distractor_width))
    if scenario.clutter:
        blobs.append(_somewhere(rng, steps, scenario.clutter))
        amplitude.append(rng.uniform(0.2, 0.7, (steps, scenario.clutter)))
        width.append(rng.uniform(5, 12, (steps, scenario.clutter)))
    seen = np.einsum("tij,tbj->tbi", body_R_world, np.concatenate(blobs, axis=1)).astype(np.float32)
    kappa = (1 / np.radians(np.concatenate(width, axis=1)) ** 2).astype(np.float32)[..., None]
    cosine = seen @ GRID.directions.reshape(-1, 3).T.astype(np.float32)
    cosine = np.exp(kappa * (cosine - 1)) * np.concatenate(amplitude, axis=1).astype(np.float32)[..., None]
    response = cosine.max(axis=1)
    if scenario.slope:  # the floor is a world direction, and the camera is nearly level
        down = -GRID.directions.reshape(-1, 3) @ body_R_world[:, :, 2].T
        response = response + (scenario.slope * (1 + down.T) / 2).astype(np.float32)
    response = response + rng.uniform(0, 0.02, response.shape).astype(np.float32)
    maps = np.clip(response, 0, 1).reshape(steps, *GRID.shape)
    return Episode([Evidence.from_response(m, GRID) for m in maps], turns, body_R_world[-1] @ path[-1])


def follow(filter_: Any, run: Episode) -> Any:
    """The filter after the last frame."""
    for turn, evidence in zip(run.turns, run.evidence, strict=True):
        filter_ = filter_.predict(turn).update(evidence)
    return filter_


def score(filter_: Any, truth: np.ndarray) -> tuple[float, float | None, bool | None]:
    """Error in degrees, log density of the truth, and whether it lies in the smallest region that holds 90 % (or None).

    One quadrature for all methods: cells of 1.5 degrees integrate peaks down to a width of 1 degree.
    """
    error = math.degrees(float(angular_distance(filter_.direction(), truth)))
    if not hasattr(filter_, "log_density"):
        return error, None, None
    if isinstance(filter_, Ours | Published):  # the field itself: its own normalisation would be worked out each time
        field_, level = filter_.belief.log_ratio(HPD_GRID), float(filter_.belief.log_ratio(truth[None])[0])
    else:
        field_, level = filter_.log_density(HPD_GRID.directions), float(filter_.log_density(truth[None])[0])
    top = float(field_.max())
    mass = np.exp(field_ - top) * HPD_GRID.weights
    total = float(mass.sum())
    return error, level - top - math.log(total), float(mass[field_ > level].sum()) <= 0.9 * total


# ---------- the walk: the generator


@dataclass(frozen=True)
class Walk:
    """30 steps: evidence, turns ``(30, 3, 3)``, displacements ``(3,)`` in the new body frame, truths, distances (m)."""

    evidence: list[Evidence]
    turns: list[np.ndarray]
    displacements: list[np.ndarray]
    truths: np.ndarray
    distances: np.ndarray


def walk(seed: tuple[int, ...], steps: int = 30, step_m: float = 0.25, noise_deg: float = 8.0) -> Walk:
    """One straight walk past a target: 30 % misses, 20 % false alarms, bearings noisy by `noise_deg` per axis."""
    rng = np.random.default_rng(seed)
    heading = rng.uniform(-math.pi, math.pi)
    forward = direction_of(heading, 0.0)
    bearing = heading + rng.choice([-1, 1]) * rng.uniform(math.radians(10), math.radians(40))
    target = rng.uniform(3.6, 4.4) * direction_of(bearing, rng.uniform(-0.15, 0.15))
    kappa = 1 / math.radians(noise_deg) ** 2
    pose = world_R_body(heading)
    evidence, turns, displacements, truths, distances = [], [], [], [], []
    for t in range(steps):
        before, pose = pose, world_R_body(heading + rng.normal(0, 0.2), *rng.normal(0, 0.03, 2)) if t else pose
        position = step_m * t * forward
        offset = pose.T @ (target - position)
        points = []
        if rng.random() >= 0.3:
            points.append(_jittered(unit(offset), noise_deg, rng))
        if rng.random() < 0.2:
            points.append(unit(rng.normal(size=3)))
        evidence.append(Evidence.from_points(np.reshape(points, (-1, 3)), kappa, calibration=Calibration()))
        turns.append(pose.T @ before)
        displacements.append(pose.T @ forward * step_m * (t > 0))
        truths.append(unit(offset))
        distances.append(float(np.linalg.norm(offset)))
    return Walk(evidence, turns, displacements, np.array(truths), np.array(distances))


def follow_walk(filter_: Any, run: Walk) -> tuple[np.ndarray, float | None]:
    """Errors ``(30,)`` in degrees, and the mean relative error of the distance over the last ten steps."""
    found, distance = [], []
    for t in range(len(run.evidence)):
        filter_ = filter_.predict(run.turns[t], run.displacements[t]).update(run.evidence[t])
        found.append(filter_.direction())
        if t >= len(run.evidence) - 10 and isinstance(filter_, Ours) and isinstance(filter_.belief, RangedBelief):
            distance.append(abs(filter_.belief.distance() / run.distances[t] - 1))
    errors = np.degrees(angular_distance(np.array(found), run.truths))
    return errors, float(np.mean(distance)) if distance else None


# ---------- the comparison


def compare(split: str, episodes: int) -> tuple[dict[str, Any], dict[str, list]]:
    """Both experiments, all methods; raw values per episode."""
    base, standing = SEEDS[split], {}
    for index, scenario in enumerate(SCENARIOS):
        print(f"... {scenario.name}: {scenario.what}", file=sys.stderr, flush=True)
        rows: dict[str, list] = {name: [] for name in methods()}
        for number in range(episodes):
            run = episode(scenario, (base, index, number))
            for name, make in methods().items():
                rows[name].append(score(follow(make(np.random.default_rng((base, index, number, 1))), run), run.truth))
        standing[scenario.name] = {name: list(zip(*values, strict=True)) for name, values in rows.items()}
    walks: dict[str, list] = {name: [] for name in walk_methods()}
    print("... the walk", file=sys.stderr, flush=True)
    for number in range(max(12, round(WALKS_PER_EPISODE * episodes))):
        run_ = walk((base, 100, number))
        for name, make in walk_methods().items():
            walks[name].append(follow_walk(make(np.random.default_rng((base, 100, number, 1))), run_))
    return standing, walks


def _cell(values: Iterable[float]) -> str:
    array = np.asarray(list(values), dtype=float)
    span = bootstrap_interval(array, np.random.default_rng(0), resamples=1000)
    return f"{array.mean():.1f} [{span.low:.1f} {span.high:.1f}]"


def print_report(split: str, episodes: int, standing: dict[str, Any], walks: dict[str, list]) -> bool:
    """The tables, to stdout; whether what is required of the walk holds."""
    print(f"Split: {split}, seeds ({SEEDS[split]}, scenario, episode); {episodes} episodes per scenario.")
    for scenario in SCENARIOS:
        print(f"  {scenario.name}: {scenario.what}")
    columns = [*standing, "all"]
    pooled = {name: np.concatenate([standing[s][name][0] for s in standing]) for name in methods()}
    print("\nMean direction error after the last frame, degrees [95 % interval]")
    print(f"{'':17}" + "".join(f"{c:>19}" for c in columns))
    for name in methods():
        errors = [*(standing[s][name][0] for s in standing), pooled[name]]
        print(f"{name:17}" + "".join(f"{_cell(values):>19}" for values in errors))
    for part, title in (
        (2, "Share of truths inside the 90 % credible region (aim 0.85 to 0.95)"),
        (1, "Log score: mean log density of the truth, nats per steradian (knowing nothing: -2.53)"),
    ):
        print(f"\n{title}\n{'':17}" + "".join(f"{c:>8}" for c in columns))
        for name in methods():
            if standing["S1"][name][1][0] is not None:
                means = [float(np.mean(standing[s][name][part])) for s in standing]
                print(f"{name:17}" + "".join(f"{value:8.2f}" for value in [*means, np.mean(means)]))
    print(f"\n{OURS} minus the other, degrees, all scenarios, paired by episode (negative: ours is better)")
    for name in methods():
        if name != OURS:
            pair = paired_difference(pooled[OURS], pooled[name], np.random.default_rng(0))
            chance = "< 0.001" if pair.p < 0.001 else f"= {pair.p:.3f}"
            cell = f"{pair.difference:.1f} [{pair.interval.low:.1f} {pair.interval.high:.1f}]"
            print(f"  {name:17}{cell:>22}   p {chance}")
    count = len(walks["Published"])
    print(f"\nThe walk, {count} walks: mean error (deg), the same over the last ten steps, and of the distance there")
    late = {name: [float(errors[-10:].mean()) for errors, _ in runs] for name, runs in walks.items()}
    for name, runs in walks.items():
        distance = f"{_cell(100 * d for _, d in runs)} %" if runs[0][1] is not None else ""
        print(f"  {name:21}{_cell(errors.mean() for errors, _ in runs):>22}{_cell(late[name]):>22}   {distance}")
    required = {
        "RangedBelief_last_ten_below_12": np.mean(late["RangedBelief"]) < 12,
        "Published_last_ten_above_40": np.mean(late["Published"]) > 40,
    }
    for requirement, met in required.items():
        print(f"  required: {requirement}: {'met' if met else 'NOT MET'}")
    return all(required.values())


# ---------- tuning


@dataclass(frozen=True)
class Sweep:
    """The settings of one method, 54 combinations each, and how to make it from one of them."""

    name: str
    settings: dict[str, tuple]
    make: Callable[..., Factory]
    standing: bool = True

    def combinations(self) -> Iterator[dict[str, Any]]:
        for values in itertools.product(*self.settings.values()):
            yield dict(zip(self.settings, values, strict=True))


def _read(floor: float, temperature: float) -> Calibration:
    return Calibration(floor, NEUTRAL, temperature)


SWEEPS = (
    Sweep(
        "Belief",
        {"floor": (0.1, 0.4, 1.0), "keep": (1.0, 0.9, 0.8), "degree": (7, 15), "temperature": (2.0, 4.0, 8.0)},
        lambda **chosen: lambda rng: belief(**chosen),
    ),
    Sweep(
        "vMF",
        {"floor": (0.05, 0.1, 0.2, 0.4, 0.7, 1.0), "noise_deg": (6, 10, 15), "temperature": (2.0, 4.0, 8.0)},
        lambda floor, noise_deg, temperature: (
            lambda rng: VonMisesFisherFilter(calibration=_read(floor, temperature), noise=math.radians(noise_deg))
        ),
    ),
    Sweep(
        "Histogram",
        {
            "floor": (0.1, 0.4, 1.0),
            "diffusion_deg": (0, 1.5, 4),
            "mixing": (0.001, 0.02),
            "temperature": (2.0, 4.0, 8.0),
        },
        lambda floor, diffusion_deg, mixing, temperature: (
            lambda rng: HistogramFilter(
                calibration=_read(floor, temperature), diffusion=math.radians(diffusion_deg), mixing=mixing
            )
        ),
    ),
    Sweep(
        "Particles",
        {"floor": (0.1, 0.4, 1.0), "roughening_deg": (2, 5, 8), "reborn": (0.01, 0.05), "temperature": (2.0, 4.0, 8.0)},
        lambda floor, roughening_deg, reborn, temperature: (
            lambda rng: ParticleFilter.uniform(
                PARTICLES,
                rng,
                calibration=_read(floor, temperature),
                roughening=math.radians(roughening_deg),
                reborn=reborn,
            )
        ),
    ),
    Sweep(
        "RangedBelief (walk only)",
        {"floor": (0.1, 0.4, 1.0), "keep": (1.0, 0.97, 0.9), "degree": (7, 12), "temperature": (1.0, 2.0, 4.0)},
        lambda **chosen: lambda rng: belief(**chosen, ranged=True),
        standing=False,
    ),
)


def tune(episodes: int) -> None:
    """Sweep every method on the development seeds and print the best of each.

    The criterion, the same for all: the mean error over S1 to S8 and the walk with equal weights; among those within
    half a degree of the best, the highest log score.
    """
    base = SEEDS["dev"]
    runs = [[episode(s, (base, i, n)) for n in range(episodes)] for i, s in enumerate(SCENARIOS)]
    walks = [walk((base, 100, n)) for n in range(max(12, episodes // 3))]
    print(f"Development seeds ({base}, scenario, episode): {episodes} episodes per scenario, {len(walks)} walks")
    for sweep in SWEEPS:
        tried = []
        for chosen in sweep.combinations():
            make, errors, logs = sweep.make(**chosen), [], []
            for index, group in enumerate(runs if sweep.standing else []):
                ends = [
                    score(follow(make(np.random.default_rng((base, index, n, 1))), run), run.truth)
                    for n, run in enumerate(group)
                ]
                errors.append(np.mean([error for error, _, _ in ends]))
                logs.append(np.mean([log for _, log, _ in ends]))
            walked = [follow_walk(make(np.random.default_rng((base, 100, n, 1))), run) for n, run in enumerate(walks)]
            errors.append(np.mean([errors_ for errors_, _ in walked]))
            if not sweep.standing:
                logs.append(-np.mean([distance for _, distance in walked]))
            tried.append((float(np.mean(errors)), float(np.mean(logs)), chosen))
        best = min(error for error, _, _ in tried)
        tried.sort(key=lambda t: (t[0] > best + 0.5, -t[1]))
        kind = "log score" if sweep.standing else "minus relative distance error"
        print(f"\n{sweep.name}: {len(tried)} settings; mean error (deg), {kind}")
        for error, log, chosen in tried[:5]:
            print(f"  {error:6.2f} {log:7.2f}   " + ", ".join(f"{k} = {v}" for k, v in chosen.items()), flush=True)


def main() -> int:
    parser = common.parser(__doc__)
    parser.add_argument("--episodes", type=int, help="per scenario; a fifth as many walks (default 200; --tune 30)")
    parser.add_argument("--split", choices=SEEDS, help="default report, the seeds that nothing was tuned on")
    parser.add_argument("--tune", action="store_true", help="sweep all settings on the development seeds instead")
    args = parser.parse_args()
    if args.tune:
        if args.split == "report":
            parser.error("--tune never looks at the report seeds; leave --split out")
        tune(args.episodes or 30)
        return 0
    split, episodes = args.split or "report", args.episodes or 200
    return 0 if print_report(split, episodes, *compare(split, episodes)) else 1


if __name__ == "__main__":
    raise SystemExit(main())

"""How fast and how exact the core is, against rivals in the same process.

    python benchmarks/core.py [--repeats BATCHES, by default 40]

Times are CPU time of this process (`time.process_time`: what other programs do on the machine is not counted), and
ratios to one np.log over a 512 x 1024 float32 map, which is the least that any log-domain method pays for a full-size
response. One thread. The contestants alternate: each runs twice without being counted (so that none pays for the caches
that another left behind), then in a batch that is long against the clock's resolution, and then it is the next one's
turn, so that a change of the machine's speed hits all of them. The table gives the ratio of the medians over the
batches, and the range of that ratio over five parts of the run.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import common
import ducc0
import numpy as np
import torch
from e3nn import o3

import eagor
from eagor import conventions
from eagor.sphere import rotation, world_R_body

torch.set_num_threads(1)
RNG = np.random.default_rng(0)
FULL, PATCH = eagor.ErpGrid(512, 1024), eagor.PatchGrid(37, 74)
FULL_MAP = RNG.random(FULL.shape, dtype=np.float32)
HALF_MAP = FULL_MAP / 2  # its maximum is not 1, so that scaling by it is something to do
PATCH_MAP = RNG.random(PATCH.shape, dtype=np.float32)
YAW, ANY = rotation((0, 0, 1), 0.3), world_R_body(0.3, 0.2, -0.1)
L = 7
START = RNG.normal(size=(L + 1) ** 2)
FLOOR = 0.1
BATCH = 0.005  # seconds of CPU time that a batch takes at least, a thousand times the clock's steps


def ours(
    response: np.ndarray,
    grid: eagor.grids.Grid,
    turn: np.ndarray,
    decode: str = "mode",
    calibration: eagor.Calibration | None = None,
) -> Callable[[], np.ndarray]:
    belief = eagor.Belief(START)

    def step() -> np.ndarray:
        after = belief.predict(turn).update(eagor.Evidence.from_response(response, grid, calibration))
        return after.mode() if decode == "mode" else after.mean_direction()

    return step


def with_ducc(turn: np.ndarray) -> Callable[[], np.ndarray]:
    """log, weights, adjoint synthesis (`analysis_2d` is wrong for maps without a band limit), rotate, argmax."""
    alm0 = conventions.to_healpix_alm(START)
    weights = FULL.weights.astype(np.float32)
    (_, _, r02), (_, _, r12), (r20, r21, r22) = turn.tolist()
    angles = (math.atan2(r21, -r20), math.acos(max(-1.0, min(1.0, r22))), math.atan2(r12, r02))
    if abs(r22 - 1) < 1e-12:
        angles = (math.atan2(turn[1, 0], turn[0, 0]), 0.0, 0.0)
    grid = eagor.ErpGrid(64, 128)

    def step() -> np.ndarray:
        field = np.log(FULL_MAP + np.float32(FLOOR)) * weights
        found = ducc0.sht.adjoint_synthesis_2d(
            map=field[None], spin=0, lmax=L, geometry="F1", phi0=math.pi - math.pi / 1024, nthreads=1
        )[0]
        alm = ducc0.sht.rotate_alm(alm0, L, *angles, nthreads=1) + found
        values = ducc0.sht.synthesis_2d(
            alm=alm[None], spin=0, lmax=L, geometry="F1", ntheta=64, nphi=128, phi0=math.pi - math.pi / 128, nthreads=1
        )[0]
        return grid.directions.reshape(-1, 3)[values.argmax()]

    return step


def with_e3nn(turn: np.ndarray) -> Callable[[], np.ndarray]:
    """FromS2Grid, D_from_matrix, ToS2Grid: the same step with its public modules."""
    to_coefficients = o3.FromS2Grid((512, 1024), L)
    to_grid = o3.ToS2Grid(L, (64, 128))
    irreps = o3.Irreps([(1, (l, 1)) for l in range(L + 1)])
    start, image = torch.tensor(START, dtype=torch.float32), torch.tensor(FULL_MAP)
    matrix = torch.tensor(conventions.rotation_to_e3nn(turn), dtype=torch.float32)

    def step() -> np.ndarray:
        with torch.no_grad():
            found = to_coefficients(torch.log(image + FLOOR))
            after = irreps.D_from_matrix(matrix) @ start + found
            return to_grid(after).argmax().numpy()

    return step


def seconds(run: Callable[[], object], count: int) -> float:
    """CPU seconds of one run, the mean of `count` in a row."""
    start = time.process_time()
    for _ in range(count):
        run()
    return (time.process_time() - start) / count


def measure(contestants: dict[str, Callable[[], object]], batches: int) -> dict[str, list[float]]:
    """CPU seconds of one run in each batch, contestants in turn."""
    counts = {}
    for name, run in contestants.items():
        seconds(run, 2)  # what is computed once and kept
        counts[name] = max(1, math.ceil(BATCH / max(seconds(run, 2), 1e-7)))
    times: dict[str, list[float]] = {name: [] for name in contestants}
    for _ in range(batches):
        for name, run in contestants.items():
            seconds(run, 2)
            times[name].append(seconds(run, counts[name]))
    return times


def row(name: str, times: dict[str, list[float]], one: str, unit: str, aim: str = "") -> None:
    """Print the ratio of two contestants, its range over five parts of the run, and what is aimed at."""
    a, b = ([np.median(part) for part in np.array_split(times[each], 5)] for each in (one, unit))
    blocks, whole = np.array(a) / b, np.median(times[one]) / np.median(times[unit])
    print(f"  {name:50s} {whole:7.2f}   {blocks.min():5.2f}..{blocks.max():5.2f}  {aim}")


def accuracy() -> dict[str, float]:
    basis, rng = eagor.RealHarmonics(L), np.random.default_rng(1)
    c = rng.normal(size=basis.size)
    grid = eagor.ErpGrid(16, 32)
    equivariance = max(
        float(np.abs(basis.analyse(basis.synthesise(c, grid.directions @ R), grid) - basis.rotate(c, R)).max())
        for R in (rotation(rng.normal(size=3), rng.uniform(0, 3)) for _ in range(20))
    )
    turns = [rotation(rng.normal(size=3), rng.uniform(-3, 3)) for _ in range(200)]
    moved = c
    for R in turns:
        moved = basis.rotate(moved, R)
    for R in reversed(turns):
        moved = basis.rotate(moved, R.T)
    drift = eagor.angular_distance(eagor.Belief(moved).mean_direction(), eagor.Belief(c).mean_direction())
    turns32 = conventions.rotation_from_wxyz(rng.normal(size=(4096, 4)))
    batch = rng.normal(size=(4096, basis.size))
    in_torch = basis.rotate(torch.tensor(batch, dtype=torch.float32), torch.tensor(turns32, dtype=torch.float32))
    return {
        "equivariance error, 20 random rotations": equivariance,
        "drift after 200 rotations and back (degrees)": math.degrees(float(drift)),
        "torch float32 against NumPy float64, 4096 rotations": float(
            np.abs(in_torch.numpy() - basis.rotate(batch, turns32)).max()
        ),
    }


def main() -> None:
    options = common.parser(__doc__, repeats=40).parse_args()
    out = np.empty_like(FULL_MAP)

    def log() -> np.ndarray:  # into memory that is already there: a fresh 2 MB array can cost more than the logarithm
        return np.log(FULL_MAP, out=out)

    steps = {  # contestant and aim
        "patch, yaw": (ours(PATCH_MAP, PATCH, YAW), "<= 0.4"),
        "patch, any rotation": (ours(PATCH_MAP, PATCH, ANY), "<= 0.75"),
        "patch, yaw, published mean": (ours(PATCH_MAP, PATCH, YAW, "mean"), ""),
        "full map, yaw": (ours(FULL_MAP, FULL, YAW), "<= 3.5"),
        "full map, any rotation": (ours(FULL_MAP, FULL, ANY), "<= 3.5"),
        "full map, published calibration": (ours(HALF_MAP, FULL, ANY, "mean", eagor.Calibration.paper()), "<= 4"),
    }
    many, few = max(5, options.repeats), max(5, options.repeats // 2)
    small = measure({"log": log, **{name: run for name, (run, _) in steps.items()}, "ducc0": with_ducc(ANY)}, many)
    slow = measure({"ours": ours(FULL_MAP, FULL, ANY), "e3nn": with_e3nn(ANY)}, few)
    ranged = eagor.RangedBelief.uniform(12)
    for y in (0.64, 0.3, 0.0):  # a belief that has moved, so that its shells differ
        ranged = ranged.update(eagor.Evidence.from_points([[0.6, y, 0.48]], 50.0)).predict(YAW, [0.25, 0, 0])
    look, moved = eagor.Evidence.from_response(PATCH_MAP, PATCH), np.array([0.2, 0.1, -0.05])
    shells = measure({"log": log, "step": lambda: ranged.predict(ANY, moved).update(look)}, few)

    unit = 1e6 * np.median(small["log"])
    print(f"np.log over 512 x 1024 float32: {unit:.0f} us of CPU time (the unit of the first table)\n")
    print(f"{'cost, in units of that np.log':52s} {'ratio':>7s}   {'blocks':13s} aim")
    for name, (_, aim) in steps.items():
        row(f"whole step, {name}", small, name, "log", aim)
    row("RangedBelief step, 14 shells, L = 12", shells, "step", "log", "<= 15")
    print(f"\n{'how many times faster than a rival':52s} {'ratio':>7s}   {'blocks':13s} aim")
    row("ducc0 route / ours, full map", small, "ducc0", "full map, any rotation", ">= 2")
    row("e3nn route / ours, full map", slow, "e3nn", "ours", ">= 8")
    print()
    for name, value in accuracy().items():
        print(f"  {name:60s} {value:.1e}")


if __name__ == "__main__":
    main()

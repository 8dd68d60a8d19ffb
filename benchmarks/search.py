"""How well do we search? Ours against the fixed sweep and against answering from single views, with the same noisy eye.

    python benchmarks/search.py [--apartments 40] [--looks 2] [--noise miss=0.3,false_alarm=0.2] [--samples DIR]

Episodes of H*Bench's kind (ten views of 100 degrees, four starts per target): in the built-in apartments, one camera in
each, and, where --samples names them (a folder in H*Bench's layout), in the labelled photographs of `hstar_mini`. Every
agent looks through `truth` (`eagor.lab.tasks.hstar.agents`) with the same luck: 30 % misses and a false alarm in every
fifth view, each kept from look to look with probability 0.3, 8 degrees of error (or as --noise says, in the words of
`truth`); --looks: repetitions of every episode with other luck. Success is strict. What was tuned was tuned on other
apartments, with other luck.

Brackets are 95 % bootstrap intervals over targets (four starts and all repetitions of one together). Printed:

- success, views, success by turn;
- the ratio of our success to that of answering from single views: from the first view alone (`single`), and from the
  first view that responds (`centroid`), which has the whole sweep to find one;
- how many views the sweep needs for its best success, and how many ours for the same;
- the reliability of what is stated, and of the submissions that were made because the agent was sure;
- processor time per view.
"""

from __future__ import annotations

import json
import math
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import common
import numpy as np
from PIL import Image
from scipy.stats import binomtest

from eagor.grids import ErpGrid
from eagor.lab.envs.places import APARTMENT, Place, load_place
from eagor.lab.envs.rules import Camera
from eagor.lab.tasks.hstar import Episode
from eagor.lab.tasks.hstar.agents import HStarConfig, make_agent, open_detector
from eagor.lab.tasks.hstar.bench import ANNOTATION, read_episodes, run_episode
from eagor.perception.truth import Noise
from eagor.sphere import world_R_body
from eagor.statistics import bootstrap_interval, calibration_error, reliability

FIRST, LUCK = 8600, 2_000_000  # the first apartment; what seeds of noise begin with
AGENTS = ("eagor", "grid", "sweep", "centroid", "single")
RESAMPLES = 2000
ROWS = 128  # of the id image for the boxes: 1.4 degrees
SMALLEST = 12  # pixels of that image
HEIGHT = 1.25  # metres of the camera above the floor
CLEARANCE = 0.4
TRIES = 8
MOST = 4  # targets per apartment


def main() -> None:
    options = common.parser(__doc__, apartments=40, looks=2, noise="", samples=Path).parse_args()
    noise = Noise.parse(options.noise)
    with tempfile.TemporaryDirectory() as temporary:
        for seed in range(FIRST, FIRST + options.apartments):
            write_scene(seed, Path(temporary) / "hos_bench")
        sets = {"apartments": read_episodes(Path(temporary), "hos")}
        if options.samples:
            sets["photographs"] = read_episodes(options.samples, "hos")
        for name, episodes in sets.items():
            print(f"\n{name}: {len(episodes)} episodes, {options.looks} times each, {options.noise or 'moderate'}")
            show(measured(episodes, noise, options.looks))


def write_scene(seed: int, folder: Path) -> None:
    """Write a scene in the published layout, with a grey picture (`truth` reads none); nothing without targets.

    A camera stands in the apartment of this seed. Things in sight that a query names and that are large become targets.
    """
    place = load_place(APARTMENT, seed, Camera().radius)
    rng, best = np.random.default_rng([seed, 0x5EA]), []
    for _ in range(TRIES):
        position = np.array([*place.ground.sample(rng, CLEARANCE), HEIGHT])
        yaw = float(rng.uniform(-math.pi, math.pi))
        items = list(items_in_sight(place, position, yaw, rng))
        best = max(best, items, key=len)
        if len(items) == MOST:
            break
    if best:
        target = folder / f"apartment_{seed:04d}"
        target.mkdir(parents=True, exist_ok=True)
        Image.new("RGB", (16, 8), (128, 128, 128)).save(target / f"{target.name}.png")
        (target / ANNOTATION).write_text(json.dumps(best, indent=1) + "\n", encoding="utf-8")


def items_in_sight(
    place: Place, position: np.ndarray, yaw: float, rng: np.random.Generator
) -> Iterator[dict[str, Any]]:
    names = place.nameable()
    ids = place.ids(position, world_R_body(yaw), ROWS)
    seen = np.bincount(ids[ids >= 0], minlength=len(place.scene.instances))
    chosen = [index for index in names if seen[index] >= SMALLEST]
    for index in sorted(rng.permutation(chosen)[:MOST].tolist()):
        left, right, low, high = box_of(ids == index)
        yield {"task": f"Find the {names[index]}", "yaw": [left, right], "pitch": [low, high]}


def box_of(mask: np.ndarray) -> tuple[float, float, float, float]:
    """Yaw and pitch ranges, degrees, of the pixels ``(H, W)`` of one thing."""
    height, width = mask.shape
    columns, rows = np.flatnonzero(mask.any(axis=0)), np.flatnonzero(mask.any(axis=1))
    gaps = np.diff(np.append(columns, columns[0] + width))
    widest = int(gaps.argmax())
    first, last = columns[(widest + 1) % len(columns)], columns[widest]
    latitudes, degrees = ErpGrid(height, width).latitudes, 360.0 / width
    left, right = ((edge * degrees + 180.0) % 360.0 for edge in (first, last + 1))
    high = math.degrees(latitudes[rows[0]]) + 90.0 / height
    low = math.degrees(latitudes[rows[-1]]) - 90.0 / height
    return round(float(left), 2), round(float(right), 2), round(low, 2), round(high, 2)


def measured(episodes: Sequence[Episode], noise: Noise, looks: int) -> dict[str, list[dict[str, Any]]]:
    """The records of every agent, over all episodes and repetitions."""
    runs: dict[str, list[dict[str, Any]]] = {}
    for agent in AGENTS:
        began, records, config = time.process_time(), [], HStarConfig(task="hstar-hos", data="", agent=agent)
        for repetition in range(looks):
            for episode in episodes:
                detector = open_detector(noise, episode, LUCK + repetition)
                records.append(run_episode(episode, make_agent(config, episode, detector), "strict"))
        views = sum(record["views"] for record in records)
        milliseconds = 1000 * (time.process_time() - began) / views
        runs[agent] = records
        print(f"  {agent:9s} {line(records)}; {milliseconds:.1f} ms per view", flush=True)
    return runs


def line(records: Sequence[dict[str, Any]]) -> str:
    low, high = interval([record["score"] for record in records], records)
    turns = " ".join(f"{100 * share:.0f}" for share in by_turn(records))
    views = np.mean([record["views"] for record in records])
    success = 100 * np.mean([record["score"] for record in records])
    return f"{success:5.1f} % ({low:.1f} to {high:.1f}), {views:4.1f} views; by turn {turns}"


def show(runs: dict[str, list[dict[str, Any]]]) -> None:
    """What is printed below the agents."""
    ours = runs["eagor"]
    for other in ("single", "centroid"):
        ratio, low, high = ratio_of(ours, runs[other])
        print(f"  success over that of {other}: {ratio:.2f} ({low:.2f} to {high:.2f})")
    for other in ("sweep", "grid"):
        need, has, ratio, success = same_success(ours, runs[other])
        print(f"  {success:.1f} % takes the {other} {has} views and ours {need:.2f}: {ratio:.2f} times fewer")
    said = [(step["would"]["p"], step["would"]["strict"]) for record in ours for step in record["steps"]]
    table = reliability([p for p, _ in said], [good for _, good in said], 10)
    print("  stated -> found (n): " + ", ".join(f"{r.stated:.2f} -> {r.frequency:.2f} ({r.n})" for r in table if r.n))
    sure = [record["score"] == 1 for record in ours if record["sure"]]
    share = binomtest(sum(sure), len(sure)).proportion_ci(method="wilson")
    print(
        f"  submitted because sure: {len(sure)} of {len(ours)}, {100 * np.mean(sure):.1f} % right "
        f"({100 * share.low:.1f} to {100 * share.high:.1f}); calibration error {100 * calibration_error(table):.1f} %"
    )


def by_turn(records: Sequence[dict[str, Any]]) -> np.ndarray:
    return np.mean([record["by_turn"] for record in records], axis=0)


def interval(values: Sequence[float], records: Sequence[dict[str, Any]]) -> tuple[float, float]:
    found = bootstrap_interval(values, np.random.default_rng(1), groups=[record["cluster"] for record in records])
    return 100 * found.low, 100 * found.high


def ratio_of(ours: Sequence[dict[str, Any]], theirs: Sequence[dict[str, Any]]) -> tuple[float, float, float]:
    """Success over success, with a bootstrap interval over targets; the same targets are drawn for both."""
    _, place = np.unique([record["cluster"] for record in ours], return_inverse=True)  # in the order of both
    sums = np.array([np.bincount(place, [record["score"] for record in records]) for records in (ours, theirs)])
    drawn = np.random.default_rng(2).integers(sums.shape[1], size=(RESAMPLES, sums.shape[1]))
    a, b = sums[0][drawn].sum(axis=1), sums[1][drawn].sum(axis=1)
    low, high = np.quantile(a / np.maximum(b, 1), [0.025, 0.975])
    return float(sums[0].sum() / max(sums[1].sum(), 1)), float(low), float(high)


def same_success(ours: Sequence[dict[str, Any]], theirs: Sequence[dict[str, Any]]) -> tuple[float, int, float, float]:
    """Views that ours takes for the other's best success, views that the other takes, their ratio, and that success.

    Ours answered at a fixed turn, as the other is; between turns the curve is taken as straight.
    """
    curve, other = by_turn(ours), by_turn(theirs)
    has = int(np.argmax(other)) + 1
    wanted = float(other.max())
    above = np.flatnonzero(curve >= wanted)
    if len(above) == 0:
        return float("inf"), has, 0.0, 100 * wanted
    turn = int(above[0])
    need = turn + 1.0
    if turn and curve[turn] > curve[turn - 1]:
        need = turn + (wanted - curve[turn - 1]) / (curve[turn] - curve[turn - 1])
    return float(need), has, has / need, 100 * wanted


if __name__ == "__main__":
    main()

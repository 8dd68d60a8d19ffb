"""How many looks does an ordinary camera need until a thing is found? Ours against sweeps and against the belief alone.

    python benchmarks/search_looking.py [PANORAMAS] [--apartments 30] [--hfov 90]

A camera of 90 degrees (4:3) turns on the spot, a look a second, and a tracker follows (`eagor.cli.demo_looking`). A
thing is found once the answer is within 15 degrees of it (of any instance) and its presence is above 0.9. After 24
looks the search ends; it then counts as 24. Who chooses where to look next: `next`, `Estimate.next_look` with the
usual heights of things; `follow`, the direction of the estimate; `sweep`, ten views in a fixed order, as in H*Bench;
`ring`, four views around the horizon.

In the built-in apartments (seeds from 1200 on, which are for development), things that a query names uniquely are
looked for through `truth`, a detector with moderate noise: 30 % misses, a false alarm in every fifth look, both partly
lasting, confusions, 8 degrees of error. In the four photographs of the folder PANORAMAS it is `coco`, with truth marked
by hand (tests/photographs.json). Each thing is looked for from four headings. Brackets are 95 % bootstrap intervals
over things (the four starts of one together); the last column is the difference to `next`, in pairs.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import common
import numpy as np
from search import Spot, spot

from eagor.cli.demo_looking import CHOICES, Look, search
from eagor.evidence import DetectorModel, Evidence
from eagor.evidence.detections import View
from eagor.grids import PatchGrid, PerspectiveGrid
from eagor.media.panorama import cut, read_panorama
from eagor.perception.coco import from_text
from eagor.perception.things import spread_evidence
from eagor.perception.truth import TruthPerception
from eagor.sphere import angular_distance, direction, unit
from eagor.statistics import bootstrap_interval

NEAR, MOST = math.radians(15), 24
STARTS = (0, 90, 180, 270)
FIRST = 1200  # apartment
ROWS = 128  # of the ids that truth reads
ANNOTATIONS = Path(__file__).parents[1] / "tests" / "photographs.json"
ERRS = {"detection_probability": 0.7, "false_alarms_per_look": 0.2, "look_alikes": 0, "spread": math.radians(9)}


@dataclass(frozen=True, eq=False)
class Case:
    """A thing to find: `targets` ``(n, 3)`` are all instances; `look` makes the looks of one search, from its seed."""

    name: str
    targets: np.ndarray
    look: Callable[[int], Look]


def looks_until_found(case: Case, choice: str, start: int, grid: PerspectiveGrid) -> int:
    """The number of looks until the thing is found; `MOST` + 1 if it is not."""
    for count, taken in enumerate(search(case.look(start), choice, grid, MOST, start), 1):
        toward = taken.estimate.direction
        known = taken.sure and toward is not None
        if known and angular_distance(case.targets @ taken.world_R_body, toward).min() <= NEAR:
            return count
    return MOST + 1


def apartments(count: int) -> Iterator[Case]:
    """Things in built-in apartments, seen by `truth`."""
    perception, model, cells = TruthPerception(), DetectorModel(**ERRS), PatchGrid(ROWS, 2 * ROWS)
    for seed in range(FIRST, FIRST + count):
        stand = spot(seed)
        ids = stand.place.ids(stand.position, np.eye(3), ROWS)
        names = {str(name): index for index, name in stand.place.nameable().items()}

        def looks(query: str, luck: int, stand: Spot = stand, ids: np.ndarray = ids, seed: int = seed) -> Look:
            eye = perception.episode(stand.place.scene.instances, 1000 * seed + luck)

            def look(pose: np.ndarray, view: PerspectiveGrid, stamp: float) -> Evidence:
                there = replace(view, body_R_view=pose @ view.body_R_view)
                shown = np.where(there.project(cells.directions)[2], ids, -1)
                found = [report.direction for report in eye.look(shown, query, np.eye(3))]  # in the world's axes
                found = [toward for toward in found if there.project(toward)[2]]
                found_here = np.array(found).reshape(-1, 3) @ pose
                return spread_evidence([(d, np.zeros((2, 2)), 1.0) for d in found_here], model, View(view), stamp)

            return look

        for item in stand.items:
            query = str(item["task"]).removeprefix("Find the ")
            middle = unit((cells.directions * cells.weights[..., None])[ids == names[query]].sum(axis=0))
            yield Case(f"{stand.name}, {query}", middle[None], partial(looks, query))


def photographs(folder: Path) -> Iterator[Case]:
    """Things in photographs, seen by `coco`."""
    views = from_text()
    detect, known = views.detect, {}

    def remembered(picture: np.ndarray, query: str) -> object:
        key = hash(picture.tobytes())
        if key not in known:
            known[key] = detect(picture, query)
        return known[key]

    views.detect = remembered
    for name, marked in json.loads(ANNOTATIONS.read_text()).items():
        picture = read_panorama(folder / name)

        def looks(query: str, luck: int, picture: np.ndarray = picture) -> Look:
            def look(pose: np.ndarray, view: PerspectiveGrid, stamp: float) -> Evidence:
                seen = cut(picture, replace(view, body_R_view=pose @ view.body_R_view))[0]
                return views.view(seen, view, query, stamp=stamp)

            return look

        for query in sorted({each for thing in marked["things"] for each in thing["names"]}):
            at = [thing for thing in marked["things"] if query in thing["names"]]
            angles = np.radians([[thing["azimuth_deg"], thing["elevation_deg"]] for thing in at])
            yield Case(f"{name}, {query}", direction(*angles.T), partial(looks, query))


def table(cases: list[Case], grid: PerspectiveGrid) -> None:
    """Search for every thing from every heading with every choice; print the figures."""
    counts = {
        choice: np.array([[looks_until_found(c, choice, s, grid) for s in STARTS] for c in cases]) for choice in CHOICES
    }
    groups = np.repeat(np.arange(len(cases)), len(STARTS))
    print(f"{'':8}{'looks until found':>26}{'found':>8}{'more than next':>26}")
    for choice, all_looks in counts.items():
        looks, ours = (np.minimum(each, MOST).ravel() for each in (all_looks, counts["next"]))
        mean, more = interval(looks, groups), interval(looks - ours, groups)
        share = 100 * float((all_looks <= MOST).mean())
        other = "" if choice == "next" else "{:+.2f} ({:+.2f} to {:+.2f})".format(*more)
        print(f"{choice:8}{'{:.2f} ({:.2f} to {:.2f})'.format(*mean):>26}{share:>6.0f} %{other:>26}", flush=True)


def interval(values: np.ndarray, groups: np.ndarray) -> tuple[float, float, float]:
    """Mean and its interval."""
    found = bootstrap_interval(values, np.random.default_rng(1), groups=groups)
    return float(values.mean()), found.low, found.high


def main() -> int:
    """Search, print."""
    parser = common.parser(__doc__)
    parser.add_argument("panoramas", type=Path, nargs="?", help="the folder of the photographs")
    parser.add_argument("--apartments", type=int, default=30)
    parser.add_argument("--hfov", type=float, default=90.0)
    options = parser.parse_args()
    grid = PerspectiveGrid(480, 640, math.radians(options.hfov))
    sets = {"apartments, truth": (apartments(options.apartments), grid.resized(48, 64))}
    if options.panoramas:
        sets["photographs, coco"] = photographs(options.panoramas), grid
    for name, (cases, pixels) in sets.items():
        if things := list(cases):
            print(f"\n{name}: {len(things)} things, {len(STARTS)} headings each, {options.hfov:g} degrees", flush=True)
            table(things, pixels)
    return 0


if __name__ == "__main__":
    sys.exit(main())

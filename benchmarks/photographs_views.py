"""Ordinary cameras in real photographs, with a real detector. The first argument is the photographs' folder.

python benchmarks/photographs_views.py PANORAMAS [--looks views.jsonl] [--labels FILE ...]

Views of 70, 90 and 110 degrees (4:3) are cut from the photographs of `photographs`, by a camera that stays level and
turns by 9 degrees a second: once around and half a turn more, one look a second. `coco` looks at each view, and at the
panorama of the same frame. The tracker reads both with a model of the detector that is fitted on the panoramas of other
photographs, in --folds parts; "stands" is also told that targets never move (`MotionModel.still()`), which is so here.
Poses are the true ones, for views of 70 degrees also those that the views alone tell (`eagor.media.rotation`). The
rivals are told the looks at views. What was seen is kept in the file of --looks, so that a second run only plays it.

- In view: the error while an instance is in the view; how much larger it is than from the same part of the panoramas,
  which is the way with a panorama in between, and than from whole panoramas, which see everything at any time.
- Out of view: how much larger the error is, and presence, after 20 s without any instance in the view, than at the last
  look that showed one. The poses' own error is taken off. The second figure has only things for which nothing else was
  taken meanwhile (no box of score 0.3): else the answer may change, and sometimes should.

A unit of every interval is a thing on a photograph; intervals are 95 % bootstrap intervals of the mean, from a fixed
seed. The last line is the CPU time of a look without the detector, as a ratio to a panorama's.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from photographs import (
    ANNOTATIONS,
    BOX,
    Marked,
    as_json,
    as_thing,
    by_parts,
    cases_of,
    entries,
    marks,
    places,
    told_to,
)
from scipy.spatial.transform import Rotation

from eagor import MotionModel, TrackerConfig
from eagor.evidence import DetectorModel
from eagor.evidence.detections import View
from eagor.evidence.shapes import WHOLE_SPHERE
from eagor.grids import PerspectiveGrid
from eagor.media.panorama import cut, read_panorama, turn
from eagor.media.rotation import VisualOdometer
from eagor.perception.coco import CLASSES, coco_detector
from eagor.perception.things import Thing, spread_evidence
from eagor.perception.views import Views
from eagor.sphere import angular_distance, world_R_body
from eagor.statistics import bootstrap_interval
from eagor.tasks.methods import TrackerMethod, make_method

FIELDS = (70, 90, 110)
STEP, TURN, FRAMES, AWAY = math.radians(9), 40, 60, 20  # looks in a whole turn, in all, and out of view
POSES = [world_R_body(STEP * k) for k in range(FRAMES)]
ROWS, COLUMNS = 480, 640
WHOLE = 0  # the field of a panorama
SIGHTED = min(FIELDS)  # the camera whose poses are also told by its own pictures
# What is seen in each frame, of each class, by photograph and field.
Seen = dict[tuple[str, int], list[dict[str, list[Thing]]]]
# Poses and method.
STANDS = "eagor, stands"
METHODS = (
    ("true", "eagor"), ("sight", "eagor"), ("true", STANDS), ("true", "best_detection"), ("true", "last_detection")
)  # fmt: skip


def grid_of(field: int) -> PerspectiveGrid:
    """The view of a camera with this field, degrees."""
    return PerspectiveGrid(ROWS, COLUMNS, math.radians(field))


def shown(photograph: np.ndarray, field: int, frame: int) -> np.ndarray:
    """What the camera shows in one frame."""
    seen = grid_of(field)
    return cut(photograph, PerspectiveGrid(ROWS, COLUMNS, seen.hfov, POSES[frame]))[0]


def look(folder: Path, file: Path, photographs: Sequence[str]) -> Seen:
    """What the detector sees of each class in each frame, by photograph and field; kept in `file`."""
    known = {(each["photograph"], each["field"], each["frame"]): each["seen"] for each in entries([file])}
    views, found = Views(coco_detector()), {}
    with file.open("a") as out:
        for name in photographs:
            photograph = read_panorama(folder / name)
            for field in (WHOLE, *FIELDS):
                for frame in range(TURN):  # a whole turn; the rest is the same again
                    if (name, field, frame) in known:
                        continue
                    if field == WHOLE:
                        things = views.things(turn(photograph, POSES[frame].T), CLASSES, POSES[frame])
                    else:
                        things = views.things(shown(photograph, field, frame), CLASSES, grid=grid_of(field))
                    seen = {
                        query: list(map(as_json, each)) for query, each in zip(CLASSES, things, strict=True) if each
                    }
                    known[name, field, frame] = seen
                    out.write(json.dumps({"photograph": name, "field": field, "frame": frame, "seen": seen}) + "\n")
                looks = (known[name, field, frame % TURN] for frame in range(FRAMES))
                found[name, field] = [{q: [as_thing(*t) for t in ts] for q, ts in seen.items()} for seen in looks]
    return found


def by_sight(photograph: np.ndarray) -> list[np.ndarray]:
    """What the narrowest views alone say of the turning camera."""
    odometer = VisualOdometer()
    pictures = (shown(photograph, SIGHTED, frame) for frame in range(FRAMES))
    return [odometer.add(each, float(k), grid_of(SIGHTED)).world_R_body for k, each in enumerate(pictures)]


@dataclass(frozen=True)
class Run:
    """A method on a thing: degrees to the nearest instance, and presence, in each frame."""

    errors: np.ndarray
    presence: np.ndarray


def play(
    seen: Sequence[dict[str, list[Thing]]], query: str, targets: np.ndarray, field: int, told: Sequence[np.ndarray],
    name: str, model: DetectorModel,
) -> Run:  # fmt: skip
    """One method, told these poses, on the looks of one camera."""
    ours = TrackerConfig(target_motion=MotionModel.still()) if name == STANDS else None
    model = told_to(name, model)
    method = make_method(name.split(",")[0], np.random.default_rng(0), "coco", ours=ours, detector=model)
    view, errors, presence = View(WHOLE_SPHERE if field == WHOLE else grid_of(field)), [], []
    for frame, (things, pose) in enumerate(zip(seen, told, strict=True)):
        method.move(float(frame), pose, None)
        method.see(spread_evidence(things.get(query, []), model, view, float(frame)))
        errors.append(np.degrees(angular_distance(targets @ POSES[frame], method.direction())).min())
        presence.append(float(method.estimate.presence) if isinstance(method, TrackerMethod) else math.nan)
    return Run(np.array(errors), np.array(presence))


def models_of(seen: Seen, marked: Marked, folds: int) -> dict[str, DetectorModel]:
    """The model that each photograph is read with, fitted on once around in panoramas of the parts without it."""
    cases = [case for name, there in marked.items() for case in cases_of(name, "yaw", there, seen[name, WHOLE][:TURN])]
    return by_parts(cases, [*marked], folds)


def rows(name: str, folder: Path, seen: Seen, marked: Marked, models: dict[str, DetectorModel]) -> list[dict[str, Any]]:
    """The figures of each thing on one photograph: camera, poses and method."""
    found, model = [], models[name]
    things, sight = marked[name]["things"], by_sight(read_panorama(folder / name))
    off = np.degrees([Rotation.from_matrix(a.T @ b).magnitude() for a, b in zip(sight, POSES, strict=True)])
    for query in sorted({each for thing in things for each in thing["names"]}):
        targets, _ = places([thing for thing in things if query in thing["names"]])
        around = seen[name, WHOLE]
        whole = {each: play(around, query, targets, WHOLE, POSES, each, model) for each in ("eagor", STANDS)}
        for field in FIELDS:
            visible = np.array([grid_of(field).project(targets @ pose)[2].any() for pose in POSES])
            if not visible.any():  # it stands below the camera's view
                continue
            parts = part_of(around, query, field)
            part = {each: play(parts, query, targets, field, POSES, each, model) for each in ("eagor", STANDS)}
            for poses, method in METHODS:
                if poses == "sight" and field != SIGHTED:
                    continue
                told, slack = (sight, off) if poses == "sight" else (POSES, 0 * off)
                run = play(seen[name, field], query, targets, field, told, method, model)
                row: dict[str, Any] = {"photograph": name, "query": query, "field": field, "poses": poses}
                row |= {"method": method, "error": run.errors[visible].mean()}
                for rival, other in (("part", part), ("whole", whole)):
                    told_alike = other[method] if method in other else other["eagor"]
                    row[rival] = (run.errors - told_alike.errors)[visible].mean()
                if (last := last_seen(visible)) is not None:
                    row["away"] = run.errors[last + AWAY] - run.errors[last] - slack[last + AWAY]
                    row["presence"] = run.presence[last + AWAY] - run.presence[last]
                    meanwhile = seen[name, field][last + 1 : last + AWAY + 1]
                    if not any(thing.score >= BOX for each in meanwhile for thing in each.get(query, [])):
                        row["alone"] = row["away"]
                found.append(row)
    return found


def part_of(around: Sequence[dict[str, list[Thing]]], query: str, field: int) -> list[dict[str, list[Thing]]]:
    """What panoramas show of a thing where the camera looks."""
    grid = grid_of(field)
    return [{query: [t for t in seen.get(query, []) if grid.project(t.direction)[2]]} for seen in around]


def last_seen(visible: np.ndarray) -> int | None:
    """The last look before the first `AWAY` seconds in which nothing was in view."""
    for frame in np.flatnonzero(visible):
        if frame + AWAY < FRAMES and not visible[frame + 1 : frame + AWAY + 1].any():
            return int(frame)
    return None


def mean(values: Sequence[float]) -> str:
    """A mean with its interval."""
    if not values or math.isnan(values[0]):
        return "-"
    if len(values) == 1:
        return f"{values[0]:.2f}"
    span = bootstrap_interval(values, np.random.default_rng(0))
    return f"{np.mean(values):.2f} [{span.low:.2f}, {span.high:.2f}]"


def overhead(photograph: np.ndarray) -> float:
    """CPU time of a look at a view, the detector's left out, as a ratio to that at a panorama."""
    picture, grid = shown(photograph, 90, 0), grid_of(90)
    boxes = np.array([[200.0, 200.0, 300.0, 300.0]]), np.array([0.6]), ["chair"]
    views = Views(lambda picture, query: boxes, classes=CLASSES)

    def least(call: Any) -> float:
        spent = []
        for _ in range(20):
            began = time.process_time()
            call()
            spent.append(time.process_time() - began)
        return min(spent)

    return least(lambda: views.view(picture, grid, "chair")) / least(lambda: views(photograph, "chair"))


def main() -> None:
    """Look, play, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("panoramas", type=Path, help="the folder of the photographs")
    parser.add_argument("--looks", type=Path, default=Path("photographs-views.jsonl"), help="what was seen")
    parser.add_argument(
        "--labels", type=Path, nargs="+", default=[ANNOTATIONS], help="what is on the photographs, and where"
    )
    parser.add_argument("--folds", type=int, default=4, help="fit the detector in so many parts")
    options = parser.parse_args()
    folder, marked = options.panoramas, marks(options.labels)
    seen = look(folder, options.looks, [*marked])
    with ProcessPoolExecutor() as pool:
        one = partial(rows, folder=folder, seen=seen, marked=marked, models=models_of(seen, marked, options.folds))
        print_table([*chain.from_iterable(pool.map(one, marked))])
    first = read_panorama(folder / next(iter(marked)))
    print(f"CPU time of a look at a view, without the detector: {overhead(first):.2f} of a panorama's")


def print_table(found: Sequence[dict[str, Any]]) -> None:
    """A line for each camera, poses and method."""
    names = {
        "error": "error in view, deg", "part": "more than their part's", "whole": "more than panoramas'",
        "away": "more when away", "alone": "nothing else taken", "presence": "presence when away",
    }  # fmt: skip
    print("field  poses  method          things   " + "  ".join(f"{name:22}" for name in names.values()).rstrip())
    for field in FIELDS:
        for poses, method in METHODS:
            own = [r for r in found if (r["field"], r["poses"], r["method"]) == (field, poses, method)]
            if own:
                cells = [mean([each[key] for each in own if key in each]) for key in names]
                counts = f"{len(own):2} ({sum('away' in each for each in own):2})"
                print(f"{field:5}  {poses:5}  {method:14}  {counts}  " + "  ".join(f"{c:22}" for c in cells).rstrip())


if __name__ == "__main__":
    main()

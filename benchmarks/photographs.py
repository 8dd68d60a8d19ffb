"""Four real photographs, a real detector: every method on the same looks. The first argument is their folder.

python benchmarks/photographs.py PANORAMAS [--looks looks.jsonl] [--only yaw,tumble]

The detector is `coco`: CenterNet on MobileNetV3 (eagor models get coco). Truth was marked by hand:
tests/photographs.json names things, their azimuth, elevation and size, and classes that are certainly absent. Each
photograph is turned by known rotations, 40 frames a second apart:

- yaw: level, 9 degrees a frame; tumble: all axes, the seam and both poles crossed, 20 degrees a frame.
- large: as yaw, 5760 x 2880; jpeg: as tumble, JPEG at quality 50.
- tilt: as yaw, the mount is tilted by 10 degrees and the poses do not say so.
- drift: as yaw, the heading of the poses drifts by 1 degree a second; drift-told: the tracker is told so.
- sight: as tumble, poses from the pictures alone (`eagor.robots.rotation`).

The reading of the detector (`DetectorModel`) is fitted on three photographs and used on the fourth, four times over.
What was seen is kept in the file of --looks, so that a second run only plays it (the looks take about 25 minutes).
"""

from __future__ import annotations

import argparse
import io
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from eagor.evaluation.detector_fit import fit_detector
from eagor.evaluation.labelled_looks import LabelledLook
from eagor.evidence import DetectorModel, Evidence
from eagor.evidence.detections import View
from eagor.evidence.shapes import WHOLE_SPHERE
from eagor.perception.blobs import spread_evidence
from eagor.perception.coco.classes import CLASSES
from eagor.perception.pieces import Thing
from eagor.robots.rotation import VisualOdometer
from eagor.sphere import angular_distance, direction, unit, world_R_body
from eagor.statistics import bootstrap_interval
from eagor.tasks.methods import NAMES, TrackerMethod, make_method
from eagor.tracking import TrackerConfig
from eagor.worlds.panorama import read_panorama, turn

FRAMES, STEP, TUMBLE = 40, math.radians(9), math.radians(20)
TILT = math.radians(10)
SEEN = ("yaw", "tumble", "large", "jpeg", "tilt")  # what has to be looked at; the others use the same looks
LOOKS_OF = {"drift": "yaw", "drift-told": "yaw", "sight": "tumble"}
CONDITIONS = (*SEEN, *LOOKS_OF)
FITTED = (0, 1, 20, 21)  # frames of each case that the model of the detector is fitted on: neighbours, and far apart
JUDGED = (0, *range(FRAMES - 10, FRAMES))  # frames in which coverage is judged
ANNOTATIONS = Path(__file__).parents[1] / "tests" / "photographs.json"


def poses(condition: str) -> list[np.ndarray]:
    """The true ``world_R_body`` ``(3, 3)`` of each frame; the first is level and ahead."""
    if condition in ("tumble", "jpeg", "sight"):
        rng, found = np.random.default_rng(7), [np.eye(3)]
        axis = np.array([0.3, 1.0, 0.4])
        for _ in range(FRAMES - 1):
            axis = axis + 0.6 * rng.standard_normal(3)
            axis /= np.linalg.norm(axis)
            found.append(found[-1] @ Rotation.from_rotvec(TUMBLE * axis).as_matrix())
        return found
    tilt = Rotation.from_euler("y", TILT).as_matrix() if condition == "tilt" else np.eye(3)
    return [world_R_body(STEP * k) @ tilt for k in range(FRAMES)]


def by_sight(photograph: np.ndarray) -> list[np.ndarray]:
    """What the pictures alone say of the tumbling camera."""
    odometer = VisualOdometer()
    return [odometer.add(picture).world_R_body for picture in pictures(photograph, "tumble")]


def told(condition: str) -> list[np.ndarray]:
    """What the odometry says of the same frames; for "sight" see `by_sight`."""
    if condition == "tilt":
        return poses("yaw")
    if condition.startswith("drift"):
        return [world_R_body(math.radians(1) * k) @ pose for k, pose in enumerate(poses("yaw"))]
    return poses(condition)


def pictures(photograph: np.ndarray, condition: str) -> Iterator[np.ndarray]:
    """The frames of a camera that turns in a photograph ``(H, W, 3)``."""
    if condition == "large":
        large = np.asarray(Image.fromarray(photograph).resize((5760, 2880), Image.Resampling.LANCZOS))
        yield from (np.roll(large, round(5760 * STEP * k / math.tau), axis=1) for k in range(FRAMES))
        return
    for pose in poses(condition):
        picture = turn(photograph, pose.T)
        if condition == "jpeg":
            buffer = io.BytesIO()
            Image.fromarray(picture).save(buffer, "JPEG", quality=50)
            picture = np.asarray(Image.open(buffer))
        yield picture


def look(folder: Path, files: Sequence[Path], conditions: list[str]) -> None:
    """See what is not in the `files` yet, and add it to the first: one line for each frame."""
    from eagor.perception.coco import coco_detector
    from eagor.perception.views import Views

    lines = chain.from_iterable(file.read_text().splitlines() for file in files if file.exists())
    known = {(entry["photograph"], entry["condition"], entry["frame"]) for entry in map(json.loads, lines)}
    views = Views(coco_detector())
    with files[0].open("a") as out:
        for condition in conditions:
            for name in json.loads(ANNOTATIONS.read_text()):
                if all((name, condition, frame) in known for frame in range(FRAMES)):
                    continue
                photograph, say = read_panorama(folder / name), told(condition)
                for frame, picture in enumerate(pictures(photograph, condition)):
                    if (name, condition, frame) in known:
                        continue
                    seen = zip(CLASSES, views.things(picture, CLASSES, say[frame]), strict=True)
                    found = {query: [as_json(thing) for thing in things] for query, things in seen if things}
                    entry: dict[str, Any] = {"photograph": name, "condition": condition, "frame": frame, "seen": found}
                    out.write(json.dumps(entry) + "\n")
                    out.flush()


def as_json(thing: Thing) -> list[Any]:
    """Direction, covariance, score."""
    return [np.round(thing.direction, 5).tolist(), np.round(thing.covariance, 7).tolist(), round(thing.score, 4)]


def as_thing(where: list[float], covariance: list[list[float]], score: float) -> Thing:
    """The inverse of `as_json`."""
    return Thing(unit(np.array(where)), np.array(covariance), score)


@dataclass(frozen=True)
class Case:
    """A thing on a photograph, in one condition: what was seen in each frame, and where its instances are.

    `things`: of each frame; `targets` ``(n, 3)``: world directions of all instances, none if it is absent.
    """

    photograph: str
    condition: str
    query: str
    things: Sequence[Sequence[Thing]]
    targets: np.ndarray

    def evidence(self, frame: int, model: DetectorModel) -> Evidence:
        """The look of one frame, read with `model`."""
        return spread_evidence(self.things[frame], model, View(WHOLE_SPHERE), float(frame))


def read_cases(files: Sequence[Path], conditions: Sequence[str]) -> list[Case]:
    """Every annotated thing and absent class, in each condition."""
    seen: dict[tuple[str, str], dict[int, dict[str, list[Thing]]]] = {}
    for line in chain.from_iterable(file.read_text().splitlines() for file in files):
        entry = json.loads(line)
        things = {query: [as_thing(*thing) for thing in found] for query, found in entry["seen"].items()}
        seen.setdefault((entry["photograph"], entry["condition"]), {})[entry["frame"]] = things
    cases = []
    for photograph, told in json.loads(ANNOTATIONS.read_text()).items():
        names = {name for thing in told["things"] for name in thing["names"]}
        for condition in conditions:
            frames = seen.get((photograph, LOOKS_OF.get(condition, condition)), {})
            if len(frames) < FRAMES:
                print(f"{photograph}, {condition}: only {len(frames)} frames were looked at; left out")
                continue
            for query in sorted(names) + told["absent"]:
                at = [thing for thing in told["things"] if query in thing["names"]]
                angles = np.radians([(thing["azimuth_deg"], thing["elevation_deg"]) for thing in at]).reshape(-1, 2)
                things = [frames[frame].get(query, []) for frame in range(FRAMES)]
                cases.append(Case(photograph, condition, query, things, direction(angles[:, 0], angles[:, 1])))
    return cases


def fitted(cases: Sequence[Case], left_out: str) -> DetectorModel:
    """The model of the detector by all photographs but one: how to read scores, spread and repeats.

    Its rates stay unknown: they differ from class to class, and the tracker learns them.
    """
    looks = [
        LabelledLook(
            case.evidence(frame, DetectorModel()),
            case.targets @ poses(case.condition)[frame],
            float(frame),
            f"{case.photograph}, {case.query}, {case.condition}",
        )
        for case in cases
        if case.photograph != left_out and case.condition in ("yaw", "tumble")
        for frame in FITTED
    ]
    found = fit_detector(looks, resamples=0).model
    return replace(found, detection_probability=None, false_alarms_per_look=None)


def play(case: Case, name: str, model: DetectorModel, say: Sequence[np.ndarray]) -> dict[str, Any]:
    """One method on one case: errors to the nearest instance in degrees, coverage, presence, by frame."""
    config = TrackerConfig(drift=math.radians(1) if case.condition == "drift-told" else 0.0)
    method = make_method(name, np.random.default_rng(0), "coco", ours=config)
    true = poses(case.condition)
    errors, covered, presence = [], [], []
    for frame in range(FRAMES):
        method.move(float(frame), say[frame], None)
        method.see(case.evidence(frame, model))
        targets = case.targets @ true[frame]
        if isinstance(method, TrackerMethod):
            presence.append(float(method.estimate.presence))
        if not len(targets):
            continue
        errors.append(float(np.degrees(angular_distance(targets, method.direction()).min())))
        masses = [method.mass_above(target) for target in targets] if frame in JUDGED else []
        known = [mass for mass in masses if mass is not None]
        covered.append(min(known) <= 0.9 if known else math.nan)
    return {"errors": errors, "covered": covered, "presence": presence}


def main() -> None:
    """Look, play, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("panoramas", type=Path, help="the folder of the photographs")
    parser.add_argument(
        "--looks", type=Path, nargs="+", default=[Path("photographs-looks.jsonl")], help="what was seen"
    )
    parser.add_argument("--only", help="conditions, with commas")
    parser.add_argument("--methods", default=",".join(NAMES), help="methods, with commas")
    parser.add_argument("--plain", action="store_true", help="read scores as ratios, without a fit")
    options = parser.parse_args()
    conditions = options.only.split(",") if options.only else [*CONDITIONS]
    look(options.panoramas, options.looks, [each for each in conditions if each in SEEN])
    cases = read_cases(options.looks, conditions)
    fit_on = read_cases(options.looks, ("yaw", "tumble"))
    models = {
        name: DetectorModel(repeats=0.5) if options.plain else fitted(fit_on, name)
        for name in {case.photograph for case in cases}
    }
    for name, model in models.items():
        print(f"all but {name}: {model}")
    if not options.plain:
        print(f"all four: {fitted(fit_on, '')}")
    sight = {}
    if "sight" in conditions:
        sight = {name: by_sight(read_panorama(options.panoramas / name)) for name in models}
    played = [
        (case, name, play(case, name, models[case.photograph], says(case, sight)))
        for case in cases
        for name in options.methods.split(",")
        if len(case.targets) or (name == "eagor" and case.condition in ("yaw", "tumble"))
    ]
    print_found(played)
    print_absent(played)


def says(case: Case, sight: dict[str, list[np.ndarray]]) -> list[np.ndarray]:
    """The poses that the methods are told."""
    return sight[case.photograph] if case.condition == "sight" else told(case.condition)


Played = Sequence[tuple[Case, str, dict[str, Any]]]


def print_found(played: Played) -> None:
    """Errors and coverage of every method, by condition. A unit of the intervals is a thing on a photograph."""
    print(f"\n{'':14s}{'method':17s}{'first look, deg':>22s}{'last ten, deg':>22s}{'within 15':>11s}{'covered':>9s}")
    for condition in dict.fromkeys(case.condition for case, _, _ in played):
        for name in dict.fromkeys(name for _, name, _ in played):
            own = [p for case, n, p in played if (case.condition, n) == (condition, name) and len(case.targets)]
            first, last = [p["errors"][0] for p in own], [float(np.mean(p["errors"][-10:])) for p in own]
            near = np.mean([np.mean(np.array(p["errors"][-10:]) < 15) for p in own])
            held = [x for p in own for x in p["covered"][-10:] if not math.isnan(x)]
            coverage = f"{np.mean(held):9.2f}" if held else f"{'-':>9s}"
            print(f"{condition:14s}{name:17s}{cell(first):>22s}{cell(last):>22s}{near:11.2f}{coverage}")


def print_absent(played: Played) -> None:
    """How often the tracker claims a thing, here and absent, and what a single box of score 0.3 would have said."""
    print(f"\n{'':24s}{'presence > 0.5':>22s}{'a box of 0.3 or more':>24s}{'persistent mistakes':>26s}")
    print(
        f"{'':24s}{'first look':>12s}{'last':>10s}{'first look':>14s}{'last ten':>10s}{'share':>14s}{'presence':>12s}"
    )
    for condition in dict.fromkeys(case.condition for case, _, _ in played):
        ours = [(case, p) for case, name, p in played if (case.condition, name) == (condition, "eagor")]
        for words, here in (("here", True), ("absent", False)):
            own = [(case, p) for case, p in ours if here == bool(len(case.targets))]
            if not own:
                continue
            boxes = [[any(t.score >= 0.3 for t in things) for things in case.things] for case, _ in own]
            lasting = [p["presence"][-1] for case, p in own if persists(case)]
            shares = [
                np.mean([p["presence"][0] > 0.5 for _, p in own]),
                np.mean([p["presence"][-1] > 0.5 for _, p in own]),
                np.mean([each[0] for each in boxes]),
                np.mean([any(each[-10:]) for each in boxes]),
                len(lasting) / len(own),
            ]
            columns = "".join(f"{x:{wide}.3f}" for x, wide in zip(shares, (12, 10, 14, 10, 14), strict=True))
            presence = f"{np.mean(lasting):12.2f}" if lasting else f"{'-':>12s}"
            print(f"{condition:14s}{words:10s}{columns}{presence}   (of {len(own)})")


def persists(case: Case) -> bool:
    """Whether the detector sees a thing where none is in most frames: within 10 degrees of one place of the world."""
    true = poses(case.condition)
    seen = [
        np.array([pose @ t.direction for t in things]).reshape(-1, 3)
        for pose, things in zip(true, case.things, strict=True)
    ]
    for place in np.concatenate(seen):
        if len(case.targets) and angular_distance(case.targets, place).min() < math.radians(20):
            continue
        if np.mean([len(s) > 0 and angular_distance(s, place).min() < math.radians(10) for s in seen]) > 0.5:
            return True
    return False


def cell(values: Sequence[float]) -> str:
    """A mean with its 95 % interval."""
    found = bootstrap_interval(values, np.random.default_rng(0))
    return f"{np.mean(values):5.1f} [{found.low:5.1f} {found.high:5.1f}]"


if __name__ == "__main__":
    main()

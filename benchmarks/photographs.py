"""Four real photographs, a real detector: every method on the same looks. The first argument is their folder.

python benchmarks/photographs.py PANORAMAS [--looks looks.jsonl] [--only yaw,tumble]

The detector is `coco`: CenterNet on MobileNetV3 (eagor models get coco). Truth was marked by hand:
tests/photographs.json names things, their azimuth, elevation and size, and classes that are certainly absent. Each
photograph is turned by known rotations, 40 frames a second apart (--labels has the same of other photographs):

- yaw: level, 9 degrees a frame; tumble: all axes, the seam and both poles crossed, 20 degrees a frame.
- large: as yaw, 5760 x 2880; jpeg: as tumble, JPEG at quality 50.
- tilt: as yaw, the mount is tilted by 10 degrees and the poses do not say so.
- drift: as yaw, the heading of the poses drifts by 1 degree a second; drift-told: the tracker is told so.
- sight: as tumble, poses from the pictures alone (`eagor.media.rotation`).

The reading of the detector (`DetectorModel`) is fitted on three photographs and used on the fourth, four times over
(--folds 3: in three parts, each read with what the other two say); --model gives one instead. What was seen is kept in
the file of --looks, so that a second run only plays it (the looks take about 25 minutes). ByteTrack and BoT-SORT join
where their package is installed (`box_trackers`). The tables are those of `photographs_tables`. Methods without a
distribution have no coverage.

The log score of a tracker: where the thing is there, the log of the probability that it is there and within 15 degrees
of any instance; where it is not, the log of the probability that it is absent. It is the sum of both means.
"""

from __future__ import annotations

import argparse
import io
import json
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any

import box_trackers
import numpy as np
from photographs_tables import LEAST, NEAR, SCORED, Run, print_all
from PIL import Image
from scipy.spatial.transform import Rotation

from eagor.evaluation.detector_fit import fitted_model
from eagor.evaluation.labelled_looks import LabelledLook
from eagor.evidence import DetectorModel, Evidence, parse_model
from eagor.evidence.detections import View
from eagor.evidence.shapes import WHOLE_SPHERE
from eagor.grids import ErpGrid
from eagor.media.panorama import read_panorama, turn
from eagor.media.rotation import VisualOdometer
from eagor.perception.coco import CLASSES, DETECTOR
from eagor.perception.things import Thing, spread_evidence
from eagor.sphere import angular_distance, direction, unit, world_R_body
from eagor.tasks.methods import NAMES, Method, TrackerMethod, make_method
from eagor.tracking import Estimate, TrackerConfig

FRAMES, STEP, TUMBLE = 40, math.radians(9), math.radians(20)
TILT = math.radians(10)
SEEN = ("yaw", "tumble", "large", "jpeg", "tilt")  # what has to be looked at; the others use the same looks
LOOKS_OF = {"drift": "yaw", "drift-told": "yaw", "sight": "tumble"}
CONDITIONS = (*SEEN, *LOOKS_OF)
JUDGED = (0, *range(FRAMES - 10, FRAMES))  # frames in which coverage is judged
FITTED_IN = ("yaw", "tumble")
USUAL_ALARMS = 0.2  # false alarms in a look of a usual detector
BOX = 0.3  # score from which on a single box would be believed
GRID = ErpGrid(90, 180)  # of the body frame, for the mass about the targets
ANNOTATIONS = Path(__file__).parents[1] / "tests" / "photographs.json"
Marked = dict[str, dict[str, Any]]  # of each photograph its things and absent classes


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


def look(folder: Path, files: Sequence[Path], wanted: Sequence[tuple[str, str]]) -> None:
    """See what is `wanted` (photograph, condition) and not in the `files` yet; add it to the first, line by line."""
    known = {(entry["photograph"], entry["condition"], entry["frame"]) for entry in entries(files)}
    missing = {pair: [frame for frame in range(FRAMES) if (*pair, frame) not in known] for pair in wanted}
    if not any(missing.values()):
        return
    from eagor.perception.coco import coco_detector
    from eagor.perception.views import Views

    views = Views(coco_detector())
    with files[0].open("a") as out:
        for (name, condition), frames in missing.items():
            say = told(condition)
            photograph = read_panorama(folder / name) if frames else np.empty(0)
            for frame, picture in enumerate(pictures(photograph, condition) if frames else ()):
                if frame not in frames:
                    continue
                seen = zip(CLASSES, views.things(picture, CLASSES, say[frame]), strict=True)
                found = {query: [as_json(thing) for thing in things] for query, things in seen if things}
                entry: dict[str, Any] = {"photograph": name, "condition": condition, "frame": frame, "seen": found}
                out.write(json.dumps(entry) + "\n")
                out.flush()


def entries(files: Sequence[Path]) -> Iterator[dict[str, Any]]:
    """What was seen: one entry for each frame of each file that exists."""
    lines = chain.from_iterable(file.read_text().splitlines() for file in files if file.exists())
    return map(json.loads, lines)


def as_json(thing: Thing) -> list[Any]:
    """Direction, covariance, score."""
    return [np.round(thing.direction, 5).tolist(), np.round(thing.covariance, 7).tolist(), round(thing.score, 4)]


def as_thing(where: list[float], covariance: list[list[float]], score: float) -> Thing:
    """The inverse of `as_json`."""
    return Thing(unit(np.array(where)), np.array(covariance), score)


@dataclass(frozen=True)
class Case:
    """A thing on a photograph, in one condition: what was seen in each frame, and where its instances are.

    `things`: of each frame; `targets` ``(n, 3)``: world directions of all instances, none if it is absent; `sizes`
    ``(n,)``: the larger of an instance's width and height, radians.
    """

    photograph: str
    condition: str
    query: str
    things: Sequence[Sequence[Thing]]
    targets: np.ndarray
    sizes: np.ndarray

    def evidence(self, frame: int, model: DetectorModel) -> Evidence:
        """The look of one frame, read with `model`."""
        return spread_evidence(self.things[frame], model, View(WHOLE_SPHERE), float(frame))


def read_cases(files: Sequence[Path], conditions: Sequence[str], photographs: Marked) -> list[Case]:
    """Every marked thing and absent class on the `photographs`, in each condition."""
    seen: dict[tuple[str, str], dict[int, dict[str, list[Thing]]]] = {}
    for entry in entries(files):
        things = {query: [as_thing(*thing) for thing in found] for query, found in entry["seen"].items()}
        seen.setdefault((entry["photograph"], entry["condition"]), {})[entry["frame"]] = things
    cases = []
    for photograph, marked in photographs.items():
        for condition in conditions:
            frames = seen.get((photograph, LOOKS_OF.get(condition, condition)), {})
            if len(frames) < FRAMES:
                print(f"{photograph}, {condition}: only {len(frames)} frames were looked at; left out")
                continue
            cases += cases_of(photograph, condition, marked, [frames[frame] for frame in range(FRAMES)])
    return cases


def cases_of(
    photograph: str, condition: str, marked: dict[str, Any], seen: Sequence[dict[str, list[Thing]]]
) -> Iterator[Case]:
    """Every thing that is `marked`, and every absent class; `seen`: what was seen of each class, in each frame."""
    names = {name for thing in marked["things"] for name in thing["names"]}
    for query in sorted(names) + marked["absent"]:
        at = [thing for thing in marked["things"] if query in thing["names"]]
        yield Case(photograph, condition, query, [frame.get(query, []) for frame in seen], *places(at))


def marks(files: Sequence[Path]) -> Marked:
    """What is on the photographs, of all the `files`."""
    return {name: each for file in files for name, each in json.loads(file.read_text()).items()}


def places(instances: Sequence[dict[str, Any]]) -> tuple[np.ndarray, np.ndarray]:
    """Directions ``(n, 3)`` and sizes ``(n,)`` of marked instances; their widths are marked in degrees of azimuth."""
    names = ("azimuth_deg", "elevation_deg", "width_deg", "height_deg")
    marked = np.radians([[each[name] for name in names] for each in instances]).reshape(-1, 4)
    azimuth, elevation, width, height = marked.T
    return direction(azimuth, elevation), np.maximum(width * np.cos(elevation), height)


def fitted(cases: Sequence[Case], left_out: Sequence[str] = ()) -> DetectorModel:
    """The model of the detector by all photographs but some."""
    return fit([look for case in cases if case.photograph not in left_out for look in labelled(case)])


def labelled(case: Case) -> list[LabelledLook]:
    """The looks of a case that a model is fitted on, with the truth."""
    group = f"{case.photograph}, {case.query}, {case.condition}"
    return [
        LabelledLook(case.evidence(frame, DetectorModel()), case.targets @ pose, float(frame), group, pose)
        for frame, pose in enumerate(poses(case.condition))
    ]


def fit(looks: Sequence[LabelledLook]) -> DetectorModel:
    """The numbers of the detector; the share of looks in which a thing is found differs from place to place.

    Drawn towards the default, in logarithms: habits, look-alikes and false alarms halfway, spreads by a quarter.
    """
    found, usual = fitted_model(looks, DetectorModel()), DetectorModel(false_alarms_per_look=USUAL_ALARMS)
    shares = dict.fromkeys(("habit", "look_alike_habit", "look_alikes", "false_alarms_per_look"), 0.5)
    shares |= dict.fromkeys(("spread", "spread_of_size"), 0.25)
    drawn = {}
    for name, share in shares.items():
        own, other = (np.log(np.atleast_1d(value(model, name))) for model in (found, usual))
        values = [float(f"{number:.3g}") for number in np.exp(own + share * (other - own))]
        drawn[name] = tuple(values) if len(values) > 1 else values[0]
    return replace(found, detection_probability=None, **drawn)


def value(model: DetectorModel, name: str) -> float | tuple[float, float]:
    """A number of a model, as it is used."""
    return model.habits.look_alikes if name == "look_alikes" else getattr(model, name)


def by_parts(cases: Sequence[Case], photographs: Sequence[str], parts: int) -> dict[str, DetectorModel]:
    """The model that each of the `photographs` is read with, fitted on the parts without it."""
    models = {}
    for part in range(parts):
        left_out = photographs[part::parts]
        models |= dict.fromkeys(left_out, fitted(cases, left_out))
        print(f"all but {', '.join(left_out)}: {models[left_out[0]]}")
    return models


def told_to(name: str, model: DetectorModel) -> DetectorModel:
    """The model that a method reads with.

    The others take looks as independent, and each of them does better with boxes as wide as they are.
    """
    if re.split("[:,]", name)[0] == "eagor":
        return model
    spread = math.hypot(model.spread, model.offset)
    return replace(model, spread=spread, offset=0.0, spread_of_size=1.0, offset_of_size=0.0)


def play(case: Case, name: str, model: DetectorModel, say: Sequence[np.ndarray], lookalike: bool) -> Run:
    """One method on one case, told the poses `say`."""
    config = TrackerConfig(drift=math.radians(1) if case.condition == "drift-told" else None)
    model = told_to(name, model)
    method: Method = (
        box_trackers.BoxTracker(name)
        if name in box_trackers.NAMES
        else make_method(name, np.random.default_rng(0), "coco", ours=config, detector=model)
    )
    true = poses(case.condition)
    run = Run(
        case.photograph,
        case.condition,
        case.query,
        name,
        here=bool(len(case.targets)),
        lookalike=lookalike,
        boxes=[any(thing.score >= BOX for thing in things) for things in case.things],
        near_boxes=[seen_near(*each) for each in zip(case.things, (case.targets @ pose for pose in true), strict=True)],
    )
    for frame, pose in enumerate(true):
        method.move(float(frame), say[frame], None)
        method.see(case.evidence(frame, model))
        targets = case.targets @ pose
        if isinstance(method, TrackerMethod):
            judge_belief(run, method.estimate, targets, frame)
        if run.here:
            judge_answer(run, method, targets, case.sizes, frame)
    return run


def judge_answer(run: Run, method: Method, targets: np.ndarray, sizes: np.ndarray, frame: int) -> None:
    """Add what a method's answer is worth in one frame, against the `targets` ``(n, 3)`` of the body frame."""
    angles = angular_distance(targets, method.direction())
    nearest = int(np.argmin(angles))
    run.errors.append(float(np.degrees(angles[nearest])))
    run.right.append(bool(angles[nearest] <= max(math.radians(NEAR), sizes[nearest] / 2)))
    masses = [method.mass_above(target) for target in targets] if frame in JUDGED else []
    known = [mass for mass in masses if mass is not None]
    run.covered.append(min(known) <= 0.9 if known else None)


def judge_belief(run: Run, estimate: Estimate, targets: np.ndarray, frame: int) -> None:
    """Add what a tracker believes in one frame; its log score where that is wanted."""
    run.presence.append(float(estimate.presence))
    if run.here:
        run.status.append(estimate.status)
    if frame + 1 in SCORED:
        given = estimate.presence * mass_near(estimate, targets) if run.here else 1 - estimate.presence
        run.log_scores[frame + 1] = math.log(max(float(given), LEAST))


def mass_near(estimate: Estimate, targets: np.ndarray) -> float:
    """The probability, if the thing is here, that it is within 15 degrees of any of the `targets`."""
    near = np.any(GRID.directions @ targets.T >= math.cos(math.radians(NEAR)), axis=-1)
    return float(np.sum((estimate.density(GRID) * GRID.weights)[near]))


def seen_near(things: Sequence[Thing], targets: np.ndarray) -> bool:
    """Whether a box of score 0.3 or more is within 15 degrees of any of the `targets`."""
    boxes = [thing.direction for thing in things if thing.score >= BOX]
    return any(np.degrees(angular_distance(targets, box)).min(initial=math.inf) <= NEAR for box in boxes)


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


def parts_of(cases: Sequence[Case]) -> tuple[float, float, int]:
    """Of the boxes on things, the share that lies over three deviations from where most lie; how far, and of how many.

    The median distance is in half sizes of the thing. They show a part of it, mostly. Looks count once.
    """
    off, far = [], []
    for case in cases:
        if case.condition not in SEEN or not len(case.targets):
            continue
        seen = [case.evidence(frame, DETECTOR).detections for frame in range(FRAMES)]
        turned = [each.turned(pose) for each, pose in zip(seen, poses(case.condition), strict=True) if each is not None]
        boxes = np.concatenate([each.directions for each in turned])
        widths = np.concatenate([1 / np.sqrt((each.axes**2).sum(axis=-1)).min(axis=-1) for each in turned])
        for target, size in zip(case.targets, case.sizes, strict=True):
            on = angular_distance(boxes, target) < max(size / 2, math.radians(3))
            if np.count_nonzero(on) < 5:
                continue
            apart = np.arccos(np.clip(boxes[on] @ boxes[on].T, -1, 1)) / np.median(widths[on])
            middle = unit(boxes[on][apart[np.exp(-(apart**2) / 2).sum(axis=0).argmax()] < 2.5].mean(axis=0))
            distances = angular_distance(boxes[on], middle)
            off += (distances / widths[on]).tolist()
            far += (distances / (size / 2)).tolist()
    parts = np.array(off) > 3
    return float(parts.mean()), float(np.median(np.array(far)[parts])), len(parts)


def says(case: Case, sight: dict[str, list[np.ndarray]]) -> list[np.ndarray]:
    """The poses that the methods are told."""
    return sight[case.photograph] if case.condition == "sight" else told(case.condition)


def models_of(options: argparse.Namespace, photographs: Sequence[str]) -> dict[str, DetectorModel]:
    """The model that each photograph is played with; without --model, fitted on the other photographs."""
    if options.model is not None:
        model = DETECTOR if options.model == "coco" else parse_model(options.model)
        print(f"all photographs: {model}")
        return dict.fromkeys(photographs, model)
    fit_on = read_cases(options.looks, FITTED_IN, options.marked)
    models = by_parts(fit_on, photographs, options.folds or len(photographs))
    print(f"all of them: {fitted(fit_on)}")
    return models


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("panoramas", type=Path, help="the folder of the photographs")
    parser.add_argument(
        "--looks", type=Path, nargs="+", default=[Path("photographs-looks.jsonl")], help="what was seen"
    )
    parser.add_argument(
        "--labels", type=Path, nargs="+", default=[ANNOTATIONS], help="what is on the photographs, and where"
    )
    parser.add_argument("--only", help="conditions, with commas")
    parser.add_argument("--photographs", help="names of photographs, with commas")
    parser.add_argument("--methods", default=",".join((*box_trackers.NAMES, *NAMES)), help="methods, with commas")
    parser.add_argument("--folds", type=int, help="fit in so many parts (default: one for each photograph)")
    parser.add_argument("--model", help="read the detector so, without a fit: spread=3, or coco")
    options = parser.parse_args()
    options.marked = marks(options.labels)
    known = [*options.marked]
    options.only = options.only.split(",") if options.only else [*CONDITIONS]
    options.photographs = options.photographs.split(",") if options.photographs else known
    if wrong := [*(set(options.only) - set(CONDITIONS)), *(set(options.photographs) - set(known))]:
        parser.error(f"there is no {wrong[0]!r}; known are {', '.join((*CONDITIONS, *known))}")
    # A comma ends a method only if what follows is a name, not one more setting.
    options.methods = re.split(r",(?=[^=,:]+(?:[,:]|$))", options.methods)
    return options


def main() -> None:
    """Look, play, print."""
    options = arguments()
    only: list[str] = options.only
    wanted = [(name, LOOKS_OF.get(condition, condition)) for condition in only for name in options.photographs]
    if options.model is None:
        wanted += [(name, condition) for condition in FITTED_IN for name in options.marked]
    look(options.panoramas, options.looks, wanted)
    cases = read_cases(options.looks, only, {name: options.marked[name] for name in options.photographs})
    models = models_of(options, options.photographs)
    sight = {}
    if "sight" in only:
        sight = {name: by_sight(read_panorama(options.panoramas / name)) for name in options.photographs}
    runs, unseen = [], {}
    for case in cases:
        say, lookalike = says(case, sight), persists(case)
        for name in options.methods:
            if not len(case.targets) and not name.startswith("eagor"):
                continue
            if len(case.targets) or any(case.things):
                runs.append(play(case, name, models[case.photograph], say, lookalike))
                continue
            alike = case.photograph, case.condition, name  # of one absent class of which nothing was ever seen
            if alike not in unseen:
                unseen[alike] = play(case, name, models[case.photograph], say, lookalike)
            runs.append(replace(unseen[alike], query=case.query))
    print_all(runs)
    print("Boxes on parts of things: {:.2f} of them, {:.2f} of half the size off ({} boxes)".format(*parts_of(cases)))


if __name__ == "__main__":
    main()

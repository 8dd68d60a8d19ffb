"""Four real photographs, a real detector: every method on the same looks. The first argument is their folder.

python benchmarks/photographs.py PANORAMAS [--looks looks.jsonl] [--only yaw,tumble] [--photographs NAME,NAME]
                                 [--methods NAME,NAME] [--folds N] [--model spread=3 | coco]

The detector is `coco`: CenterNet on MobileNetV3 (eagor models get coco). Truth was marked by hand:
tests/photographs.json names things, their azimuth, elevation and size, and classes that are certainly absent. Each
photograph is turned by known rotations, 40 frames a second apart (--labels has the same of other photographs):

- yaw: level, 9 degrees a frame; tumble: all axes, the seam and both poles crossed, 20 degrees a frame.
- large: as yaw, 5760 x 2880; jpeg: as tumble, JPEG at quality 50.
- ordinary: as yaw, an ordinary camera of 80 degrees, which sees the thing in a quarter of the frames.
- tilt: as yaw, the mount is tilted by 10 degrees and the poses do not say so.
- drift: as yaw, the heading of the poses drifts by 1 degree a second; drift-told: the tracker is told so.
- sight: as tumble, poses from the pictures alone (`eagor.odometry.visual`).

The reading of the detector (`DetectorModel`) is fitted on three photographs and used on the fourth, four times over
(--folds 3: in three parts, each read with what the other two say); --model gives one instead. What was seen is kept in
the file of --looks, so that a second run only plays it (the looks take about 25 minutes). ByteTrack and BoT-SORT join
where their package is installed (`box_trackers`). Methods without a distribution have no coverage. A unit of
every interval is a thing on a photograph, or a class that is absent from one; intervals are 95 % bootstrap intervals.

The log score of a tracker: where the thing is there, the log of the probability that it is there and within 15 degrees
of any instance; where it is not, the log of the probability that it is absent. It is the sum of both means.
"""

from __future__ import annotations

import argparse
import io
import itertools
import json
import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import box_trackers
import common
import numpy as np
import pandas
from PIL import Image
from scipy.spatial.transform import Rotation

from eagor.evidence import DetectorModel, Evidence, parse_model
from eagor.evidence.detections import View
from eagor.evidence.shapes import WHOLE_SPHERE
from eagor.grids import ErpGrid, PerspectiveGrid
from eagor.lab.agents.methods import NAMES, Estimator, TrackerEstimator, make_estimator
from eagor.lab.eval.detector_fit import fitted_model
from eagor.lab.eval.labelled_looks import LabelledLook
from eagor.odometry.visual import VisualOdometer
from eagor.perception.coco import CLASSES, DETECTOR
from eagor.perception.fusion import SphericalDetection, fuse_views, pieces_of, spread_evidence
from eagor.sources.panorama import cut, read_panorama, turn
from eagor.sphere import angular_distance, direction, unit, world_R_body
from eagor.tracking import Estimate, TrackerConfig

FRAMES, STEP, TUMBLE = 40, math.radians(9), math.radians(20)
TILT = math.radians(10)
SEEN = ("yaw", "tumble", "large", "jpeg", "ordinary", "tilt")  # what has to be looked at; the others use the same looks
LOOKS_OF = {"drift": "yaw", "drift-told": "yaw", "sight": "tumble"}
CONDITIONS = (*SEEN, *LOOKS_OF)
FITTED_IN = ("yaw", "tumble")
ORDINARY = PerspectiveGrid(480, 640, math.radians(80), np.eye(3))
BOX = 0.3  # score from which on a single box would be believed
GRID = ErpGrid(90, 180)  # of the body frame, for the mass about the targets
OURS = re.compile(r"eagor([:,]|$)")
NEAR = 15  # degrees
SCORED = (1, 3, 10, 30, 40)  # after how many looks the log score is taken
STATUSES = ("tracking", "ambiguous", "searching")
LEAST = 1e-6  # probabilities are clipped from below
RESAMPLES = 2000
ANNOTATIONS = Path(__file__).parents[1] / "tests" / "photographs.json"
MARKED = ("azimuth_deg", "elevation_deg", "width_deg", "height_deg")  # widths in degrees of azimuth
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


def told(condition: str) -> list[np.ndarray]:
    """What the odometry says of the same frames; of "sight" the pictures say it."""
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
        if condition == "ordinary":
            yield cut(photograph, replace(ORDINARY, body_R_view=pose))[0]
            continue
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
    from eagor.perception.views import Detector

    views = Detector(coco_detector())
    with files[0].open("a") as out:
        for (name, condition), frames in missing.items():
            say = told(condition)
            photograph = read_panorama(folder / name) if frames else np.empty(0)
            for frame, picture in enumerate(pictures(photograph, condition) if frames else ()):
                if frame not in frames:
                    continue
                seen = views.detect(picture, say[frame], grid=ORDINARY if condition == "ordinary" else None)
                of_class = ((name, fuse_views(pieces_of(seen, {name}))) for name in CLASSES)
                found = {name: [stored(thing) for thing in found] for name, found in of_class if found}
                entry: dict[str, Any] = {"photograph": name, "condition": condition, "frame": frame, "seen": found}
                out.write(json.dumps(entry) + "\n")
                out.flush()


def stored(thing: SphericalDetection) -> list[Any]:
    return [np.round(thing.direction, 5).tolist(), np.round(thing.covariance, 7).tolist(), round(thing.score, 4)]


def entries(files: Sequence[Path]) -> Iterator[dict[str, Any]]:
    """What was seen: one entry for each frame of each file that exists."""
    lines = itertools.chain.from_iterable(file.read_text().splitlines() for file in files if file.exists())
    return map(json.loads, lines)


@dataclass(frozen=True)
class Case:
    """A thing on a photograph, in one condition: what was seen in each frame, and where its instances are.

    `things`: of each frame; `targets` ``(n, 3)``: world directions of all instances, none if it is absent; `sizes`
    ``(n,)``: the larger of an instance's width and height, radians.
    """

    photograph: str
    condition: str
    query: str
    things: Sequence[Sequence[SphericalDetection]]
    targets: np.ndarray
    sizes: np.ndarray

    def evidence(self, frame: int, model: DetectorModel) -> Evidence:
        """The look of one frame, read with `model`."""
        shown = ORDINARY if self.condition == "ordinary" else WHOLE_SPHERE
        return spread_evidence(self.things[frame], model, View(shown), float(frame))


def read_cases(files: Sequence[Path], conditions: Sequence[str], photographs: Marked) -> list[Case]:
    """Every marked thing and absent class on the `photographs`, in each condition."""
    seen: dict[tuple[str, str], dict[int, dict[str, list[SphericalDetection]]]] = {}
    for entry in entries(files):
        things = {
            query: [
                SphericalDetection(unit(np.array(where)), np.array(covariance), score)
                for where, covariance, score in found
            ]
            for query, found in entry["seen"].items()
        }
        seen.setdefault((entry["photograph"], entry["condition"]), {})[entry["frame"]] = things
    cases = []
    for photograph, marked in photographs.items():
        for condition in conditions:
            frames = seen.get((photograph, LOOKS_OF.get(condition, condition)), {})
            if len(frames) < FRAMES:
                print(f"{photograph}, {condition}: only {len(frames)} frames were looked at; left out")
                continue
            names = {name for thing in marked["things"] for name in thing["names"]}
            for query in sorted(names) + marked["absent"]:
                at = [[thing[key] for key in MARKED] for thing in marked["things"] if query in thing["names"]]
                azimuth, elevation, width, height = np.radians(at).reshape(-1, 4).T
                sizes = np.maximum(width * np.cos(elevation), height)
                things = [frames[frame].get(query, []) for frame in range(FRAMES)]
                cases.append(Case(photograph, condition, query, things, direction(azimuth, elevation), sizes))
    return cases


def fitted(cases: Sequence[Case], left_out: Sequence[str] = ()) -> DetectorModel:
    """The model of the detector by all photographs but some."""
    looks = []
    for case in cases:
        if case.photograph not in left_out:
            group = f"{case.photograph}, {case.query}, {case.condition}"
            for frame, pose in enumerate(poses(case.condition)):
                seen = case.evidence(frame, DetectorModel())
                looks.append(LabelledLook(seen, case.targets @ pose, float(frame), group, pose))
    return fit(looks)


def fit(looks: Sequence[LabelledLook]) -> DetectorModel:
    """The numbers of the detector; the share of looks in which a thing is found differs from place to place."""
    return replace(fitted_model(looks, DetectorModel()), detection_probability=None)


def told_to(name: str, model: DetectorModel) -> DetectorModel:
    """The model that a method reads with.

    The others take looks as independent, and each of them does better with boxes as wide as they are.
    """
    if OURS.match(name):
        return model
    spread = math.hypot(model.spread, model.offset)
    return replace(model, spread=spread, offset=0.0, spread_of_size=1.0, offset_of_size=0.0)


def play(case: Case, name: str, model: DetectorModel, say: Sequence[np.ndarray], lookalike: bool) -> dict[str, Any]:
    """One method on one case, told the poses `say`: what the tables are made of, without what the method does not say.

    `lookalike`: whether the detector sees the thing most of the time where it is not. An answer is right within 15
    degrees, or half the thing's size, of the nearest instance; the last ten are judged: "held" counts those whose 90 %
    region holds an instance, of the "judged" that have a region. Numbers are log scores after so many looks.
    """
    config = TrackerConfig(drift=math.radians(1) if case.condition == "drift-told" else None)
    model = told_to(name, model)
    method: Estimator = (
        box_trackers.BoxTracker(name)
        if name in box_trackers.NAMES
        else make_estimator(name, np.random.default_rng(0), "coco", ours=config, detector=model)
    )
    here, boxes = bool(len(case.targets)), [any(thing.score >= BOX for thing in things) for things in case.things]
    row: dict[str, Any] = {"condition": case.condition, "method": name, "here": here, "look-alikes": lookalike}
    row |= {"box, first": boxes[0], "box, last ten": any(boxes[-10:])}
    errors, held, right, estimates = [], [], [], []
    for frame, pose in enumerate(poses(case.condition)):
        method.move(float(frame), say[frame], None)
        method.see(case.evidence(frame, model))
        targets = case.targets @ pose
        if isinstance(method, TrackerEstimator):
            estimates.append(method.estimate)
            if len(estimates) in SCORED:
                row[len(estimates)] = log_score(method.estimate, targets)
        if here:
            angles = angular_distance(targets, method.direction())
            nearest = int(np.argmin(angles))
            errors.append(float(np.degrees(angles[nearest])))
            right.append(bool(angles[nearest] <= max(math.radians(NEAR), case.sizes[nearest] / 2)))
            masses = [method.mass_above(target) for target in targets] if frame >= FRAMES - 10 else []
            known = [mass for mass in masses if mass is not None]
            held += [min(known) <= 0.9] if known else []
    if here:
        last = np.array(errors[-10:])
        row |= {"first": errors[0], "last": last.mean(), "within": np.mean(last < NEAR)}
        row |= {"held": sum(held), "judged": len(held)}
    if estimates:
        first, last = (float(estimate.presence) for estimate in (estimates[0], estimates[-1]))
        row |= {"claim, first": first > 0.5, "claim, last": last > 0.5, "presence": last}
        words = [estimate.status for estimate in estimates] if here else []
        row |= {status: words.count(status) for status in STATUSES}
        row["right"] = sum(good for good, word in zip(right, words, strict=True) if word == "tracking")
    return row


def log_score(estimate: Estimate, targets: np.ndarray) -> float:
    """The log of what is given to the truth: near any of the `targets` ``(n, 3)``, or absent where there are none."""
    given = 1 - estimate.presence
    if len(targets):
        near = np.any(GRID.directions @ targets.T >= math.cos(math.radians(NEAR)), axis=-1)
        given = estimate.presence * float(np.sum((estimate.density(GRID) * GRID.weights)[near]))
    return math.log(max(float(given), LEAST))


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


# --- the tables: what each says of the runs of one condition and method ---


def found(own: pandas.DataFrame) -> dict[str, Any]:
    told = {"first look, deg": common.shown(own["first"], 1), "last ten, deg": common.shown(own["last"], 1)}
    judged = int(own["judged"].sum())
    covered = f"{own['held'].sum() / judged:.2f}" if judged else "-"
    return told | {"within 15": common.shown(own["within"]), "covered": covered, "of looks": judged}


def claims(own: pandas.DataFrame) -> dict[str, Any]:
    shares = own[["claim, first", "claim, last", "box, first", "box, last ten", "look-alikes"]].mean()
    lasting = own.loc[own["look-alikes"], "presence"].mean()
    return {name: f"{share:.3f}" for name, share in shares.items()} | {"their presence": lasting, "of cases": len(own)}


def log_scores(own: pandas.DataFrame) -> dict[str, Any]:
    here, absent = (own.loc[own["here"] == there, [*SCORED]] for there in (True, False))
    told = {str(looks): f"{total:.3f}" for looks, total in (here.mean() + absent.mean()).items()}
    rng = np.random.default_rng(0)  # things and absent classes are drawn each on its own
    drawn = sum(rng.choice(part[SCORED[-1]], (RESAMPLES, len(part))).mean(axis=1) for part in (here, absent))
    told[str(SCORED[-1])] += " [{:.3f}, {:.3f}]".format(*np.quantile(drawn, (0.025, 0.975)))
    return told | {"things": here[SCORED[-1]].mean(), "absent": absent[SCORED[-1]].mean()}


def statuses(own: pandas.DataFrame) -> dict[str, Any]:
    told = own[[*STATUSES]].sum()
    right = f"{own['right'].sum() / told['tracking']:.3f}" if told["tracking"] else "-"
    return {status: f"{number / told.sum():.3f}" for status, number in told.items()} | {"right while tracking": right}


def paired(there: pandas.DataFrame) -> Iterator[dict[str, Any]]:
    """Each rival minus each variant of ours, on the same things in the same order."""
    for condition, played in there.groupby("condition", sort=False):
        runs = {name: own.reset_index(drop=True) for name, own in played.groupby("method", sort=False)}
        for name, rival in itertools.product(runs, runs):
            if not OURS.match(name) or OURS.match(rival):
                continue
            row = {"": f"{condition}, {name}", "rival": rival}
            for key, sign, digits in (("last", 1, 1), ("within", -1, 2)):
                apart = runs[rival][key] - runs[name][key]
                _, low, high = common.mean_of(apart.to_numpy(float))
                row[key] = common.shown(apart, digits)
                row[f"ahead in {key}"] = ("ours" if sign * low > 0 else "rival") if low > 0 or high < 0 else ""
            yield row


def show(title: str, rows: pandas.DataFrame) -> None:
    if len(rows):
        print(f"\n{title}\n\n{rows.to_string(na_rep='-', float_format='%.3f')}")


def each(rows: pandas.DataFrame, table: Callable[[pandas.DataFrame], dict[str, Any]], *more: str) -> pandas.DataFrame:
    """The table's row for each condition and method (and what `more` tells apart)."""
    groups = rows.groupby(["condition", "method", *more], sort=False)
    return pandas.DataFrame.from_dict({", ".join(map(str, key)): table(own) for key, own in groups}, orient="index")


def print_all(rows: pandas.DataFrame) -> None:
    """Print every table that has rows. Only trackers say how probable a thing is."""
    there, trackers = rows[rows["here"]], rows[rows["presence"].notna()] if "presence" in rows else rows[:0]
    show("Things that are there: error, share within 15 degrees and coverage in the last ten looks", each(there, found))
    show("How often something is claimed: presence > 0.5, a box of 0.3 or more, and lasting look-alikes",
         each(trackers.assign(of=np.where(trackers["here"], "here", "absent")), claims, "of"))  # fmt: skip
    both = trackers.groupby(["condition", "method"])["here"].transform("nunique") == 2
    show("Log score after so many looks (higher is better), and parts of the last", each(trackers[both], log_scores))
    show("Rival minus ours over the last ten looks, and who is ahead beyond chance", pandas.DataFrame(paired(there)))
    show("Status, share of the looks at things that are there", each(trackers[trackers["here"]], statuses))


def models_of(options: argparse.Namespace, photographs: Sequence[str]) -> dict[str, DetectorModel]:
    """The model that each photograph is played with; without --model, fitted on the parts without it."""
    if options.model is not None:
        model = DETECTOR if options.model == "coco" else parse_model(options.model)
        print(f"all photographs: {model}")
        return dict.fromkeys(photographs, model)
    models, parts = {}, options.folds or len(photographs)
    fit_on = read_cases(options.looks, FITTED_IN, options.marked)
    for part in range(parts):
        left_out = photographs[part::parts]
        models |= dict.fromkeys(left_out, fitted(fit_on, left_out))
        print(f"all but {', '.join(left_out)}: {models[left_out[0]]}")
    print(f"all of them: {fitted(fit_on)}")
    return models


def arguments() -> argparse.Namespace:
    """The command line."""
    known = {"only": str, "photographs": str, "methods": ",".join((*box_trackers.NAMES, *NAMES))}
    files = {"looks": [Path("photographs-looks.jsonl")], "labels": [ANNOTATIONS]}
    parser = common.parser(__doc__, **known, **files, folds=int, model=str)
    parser.add_argument("panoramas", type=Path)
    options = parser.parse_args()
    options.marked = {name: each for file in options.labels for name, each in json.loads(file.read_text()).items()}
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
    sight: dict[str, list[np.ndarray]] = {}
    for name in options.photographs if "sight" in only else ():
        odometer, photograph = VisualOdometer(), read_panorama(options.panoramas / name)
        sight[name] = [odometer.add(picture).world_R_body for picture in pictures(photograph, "tumble")]
    runs, played = [], {}
    for case in cases:
        say = sight[case.photograph] if case.condition == "sight" else told(case.condition)
        lookalike = persists(case)
        for name in options.methods:
            if not len(case.targets) and not name.startswith("eagor"):
                continue
            # Absent classes of which nothing was ever seen are all alike.
            key = case.photograph, case.condition, name, case.query if len(case.targets) or any(case.things) else ""
            if key not in played:
                played[key] = play(case, name, models[case.photograph], say, lookalike)
            runs.append(played[key])
    print_all(pandas.DataFrame(runs))


if __name__ == "__main__":
    main()

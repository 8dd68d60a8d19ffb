"""Episodes as the page shows them: steps with belief, panorama, answers of all methods, in one JSON object.

An episode of a simulated task is played again (as `eagor.lab.eval.episodes` does): the method
with a belief sees what it saw in the run. What the other methods said is in the records. A live recording goes through
the live core again; of a robot's walk its report is read.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from eagor._checks import parsed
from eagor.conventions import rotation_from_wxyz
from eagor.drawing.timeline import Thinned
from eagor.errors import EagorError, FormatError
from eagor.lab.agents.methods import DESCRIPTIONS, TrackerEstimator
from eagor.lab.envs.episodes import Episode
from eagor.lab.envs.places import Place, load_place
from eagor.lab.eval.episodes import runner_of
from eagor.lab.eval.results import OURS, Run
from eagor.lab.tasks.sim.play import StepInfo
from eagor.lab.tasks.task import finished, sample_of
from eagor.live.core import LiveCore
from eagor.live.events import Answer, FrameCame, PoseCame
from eagor.live.recording import Replay
from eagor.sphere import direction, world_R_body
from eagor.studio.houses import plan_of
from eagor.studio.live import Waiting
from eagor.studio.messages import rounded, webp
from eagor.studio.steps import belief_in_json, believed, calibration_of, lens_of, scene_of, seen_webp, shown_jpeg

__all__ = ["REPORT", "Redrawn", "recorded", "redraw", "walked"]

STEPS = 60  # steps with a panorama, at most: the page of an export is to be sent by mail
ROWS = 512  # of panoramas
Advance = Callable[[int], object]


@dataclass(eq=False)
class Redrawn:
    """An episode for the page: its `scene`, its `steps`, and `pictures` (WebP or JPEG) by the number of their step.

    `poses`: world_R_camera of a picture, row by row, where it was not taken at its step.
    """

    scene: dict[str, Any]
    steps: list[dict[str, Any]] = field(default_factory=list)
    pictures: dict[int, bytes] = field(default_factory=dict)
    poses: dict[int, list[float]] = field(default_factory=dict)

    def as_json(self, address: Callable[[int], str]) -> dict[str, Any]:
        """The EPISODE of the page; `address` says where the picture of a step is."""
        steps = []
        for number, step in enumerate(self.steps):
            if number in self.pictures:
                pose = self.poses.get(number, step["world_R_camera"])
                shown = {"stamp": step["stamp"], "world_R_camera": pose, "url": address(number)}
                step = step | {"panorama": shown}
            steps.append(step)
        return {"scene": self.scene, "steps": steps, "methods": [each["name"] for each in self.scene["methods"]]}


def redraw(run: Run, case: str, advance: Advance = lambda _: None) -> Redrawn:
    """Episode `case` of a run of a simulated task, again, with pictures finer than what the perception looked at.

    `advance` is called with the number of each step, and for each picture.
    Raises `EagorError` for an unknown episode, or a run without a tracker.
    """
    records = [record for record in finished(run.records) if sample_of(record) == case]
    if not records:
        raise EagorError(f"the run has no episode {case!r} with a result; choose one of those that are listed")
    methods: dict[str, Any] = {}
    for record in records:
        methods |= {name: entry | {"record": record} for name, entry in record.get("methods", {}).items()}
    shown = _believer(run, case, methods)
    runner, spec = runner_of(run, case)
    episode = runner.plan(spec)
    place = load_place(spec.world, spec.seed, runner.camera.radius)
    made = runner.method(shown, spec)
    assert isinstance(made, TrackerEstimator)
    config = made.config
    found = Redrawn(_scene(run, episode, place, methods, shown, calibration_of(runner.perception, config)))
    seen: list[StepInfo] = []

    def watch(each: StepInfo) -> None:
        advance(len(seen))
        seen.append(each)
        found.steps.append(_step(each, config.degree))

    runner.run_episode(spec, [shown], watch)
    for done, number in enumerate(_spread(len(seen)), len(seen)):
        advance(done)
        picture = seen[number].picture(ROWS)
        assert picture is not None
        found.pictures[number] = webp(picture)
    for number, step in enumerate(found.steps):
        step["frame"] = {"n": number, "of": len(seen), "stamp": step["stamp"]}
    _others(found, methods, shown)
    return found


def _believer(run: Run, case: str, methods: Mapping[str, Any]) -> str:
    """The method whose belief is shown: ours, else another tracker."""
    known = [name for name in (OURS, *methods) if name in methods]
    trackers = [name for name in known if name.partition(":")[0] in (OURS, "eagor_paper")]
    if not trackers:
        raise EagorError(
            f"episode {case!r} was played by {', '.join(known)}: none keeps a belief that could be shown. Run it with "
            "--methods eagor"
        )
    return trackers[0]


def _scene(
    run: Run, episode: Episode, place: Place, methods: Mapping[str, Any], shown: str, calibrated: dict[str, Any]
) -> dict[str, Any]:
    plan = plan_of(place.ground, place.scene.instances)
    names = {place.scene.instances[index].name for index in episode.targets if index < len(place.scene.instances)}
    plan["things"] = [thing | {"target": thing["name"] in names} for thing in plan["things"]]
    listed = [shown, *(name for name in methods if name != shown)]
    return scene_of(
        "run", f"{run.task.name} {episode.spec.id}: {episode.query}", str(episode.query), plan=plan, method=shown,
        calibration=calibrated, perception=str(run.settings.get("perception", "")),
        methods=[{"name": name, "words": DESCRIPTIONS.get(name.partition(":")[0], name)} for name in listed],
        paths={name: path for name in listed if (path := _path(methods[name]))},
    )  # fmt: skip


def _trace(entry: Mapping[str, Any]) -> Mapping[str, Any]:
    """A method's trace, with the poses of the episode where they are common to all methods."""
    truth = entry["record"].get("truth", {})
    return {"pose": truth.get("pose", [])} | entry.get("trace", {})


def _path(entry: Mapping[str, Any]) -> list[list[float]]:
    return [rounded(pose[:2], 3) for pose in _trace(entry)["pose"]]


def _step(seen: StepInfo, degree: int) -> dict[str, Any]:
    """One step of the method whose belief is shown."""
    assert isinstance(seen.method, TrackerEstimator)
    estimate = seen.method.estimate
    step = believed(estimate, seen.stamp, seen.position, seen.truth)
    return step | {"belief": belief_in_json(estimate, seen.stamp, degree)}


def _spread(count: int) -> list[int]:
    """The steps with a picture: at most `STEPS`, evenly spread, the first and the last among them."""
    return sorted(
        {round(index * (count - 1) / (STEPS - 1)) for index in range(STEPS)} if count > STEPS else range(count)
    )


def _others(found: Redrawn, methods: Mapping[str, Any], shown: str) -> None:
    """What every method said at each step, from the records; in navigation each walks a way of its own."""
    for number, step in enumerate(found.steps):
        step["methods"] = {name: told for name, entry in methods.items() if (told := _said(entry, number))}
        step["rivals"] = {
            name: {"direction": told["estimate"]["direction"], "error_deg": told["error_deg"]}
            for name, told in step["methods"].items()
            if name != shown
        }


def _said(entry: Mapping[str, Any], number: int) -> dict[str, Any] | None:
    trace = _trace(entry)
    if number >= len(trace.get("azimuth_deg", ())):
        return None
    azimuth, elevation = (math.radians(trace[f"{each}_deg"][number]) for each in ("azimuth", "elevation"))
    found: dict[str, Any] = {
        "estimate": {
            "direction": rounded(direction(np.array(azimuth), np.array(elevation))),
            "azimuth": rounded(azimuth),
            "elevation": rounded(elevation),
        },
        "error_deg": trace["error_deg"][number],
    }
    if number < len(trace["pose"]):
        pose = np.array(trace["pose"][number], dtype=float)
        found["position"] = rounded(pose[:3], 3)
        found["world_R_camera"] = rounded(rotation_from_wxyz(pose[3:]).reshape(9), 5)
    return found


REPORT = "run.json"  # of a robot's walk
KEPT = 120  # steps of a recording or of a walk that are shown
APART = 0.2  # seconds between two of them, at least
ORDINARY = 320  # rows of an ordinary camera's pictures


def recorded(replay: Replay, query: str | None = None, advance: Advance = lambda _: None) -> Redrawn:
    """A recording of ``eagor live --record``, played again. `query`: one of its queries (default: the first).

    Raises `FormatError` for an unknown query, or a recording without an answer.
    """
    folder, queries = replay.path, replay.settings.queries
    asked = query or queries[0]
    if asked not in queries:
        raise FormatError(f"{folder} has no query {asked!r}; it has {', '.join(map(repr, queries))}")
    core, kept, lens = LiveCore(replay.settings), Thinned(KEPT), _lens(replay)
    waiting = Waiting()
    panorama: FrameCame | None = None
    place: np.ndarray | None = None
    last = -math.inf
    for event in replay.events(pictures=True):
        if isinstance(event, FrameCame) and event.picture is not None:
            waiting.add(event)
        elif isinstance(event, PoseCame) and event.pose.position is not None:
            place = event.pose.position
        for answer in core.take(event):
            if answer.query != asked or answer.stamp - last < APART:
                continue
            last = answer.stamp
            panorama = waiting.take(core, last) or panorama
            advance(kept.count)
            # Only what is kept is computed: a recording may be long.
            kept.add(_answered(answer, panorama, place, core, lens) if kept.wants else None)
    if not kept.items:
        raise FormatError(f"{folder} holds no answers about {asked!r}: the run was ended before the first")
    found = Redrawn(
        _scene_of_recording(f"Recording {folder.name}", asked, calibration_of(None, replay.settings.config))
    )
    begun = kept.items[0][0]["stamp"]
    if lens is not None:
        found.scene["lens"] = lens
    shown: bytes | None = None
    for number, (step, picture, pose) in enumerate(kept.items):
        step["stamp"] = rounded(step["stamp"] - begun, 3)
        step["frame"] = {"n": number, "of": len(kept.items), "stamp": step["stamp"]}
        found.steps.append(step)
        if picture is not None and picture != shown:  # the camera may be slower than the answers
            found.pictures[number] = shown = picture
            if pose is not None:
                found.poses[number] = rounded(pose.reshape(9), 6)
    found.scene["targets"] = list(queries)
    return found


def _lens(replay: Replay) -> dict[str, Any] | None:
    """What the scene says of a recording's one ordinary camera; None for panoramas, and for several cameras."""
    frames = (event for event in replay.events(pictures=False) if isinstance(event, FrameCame))
    lenses = {json.dumps(lens_of(frame.grid)) for frame in frames}
    return json.loads(lenses.pop()) if len(lenses) == 1 else None


def _answered(
    answer: Answer, frame: FrameCame | None, place: np.ndarray | None, core: LiveCore, lens: dict[str, Any] | None
) -> tuple[dict[str, Any], bytes | None, np.ndarray | None]:
    """A step, the newest picture, and the camera's orientation there; with a `lens` the picture is shown as it is."""
    estimate = answer.estimate
    step = believed(estimate, answer.stamp, place)
    step["estimate"]["status_words"] = answer.status_words
    step["belief"] = belief_in_json(estimate, answer.stamp, core.config.degree)
    step["look"] = {"age": rounded(answer.look_age, 3), "fresh": False}
    if frame is None or frame.picture is None:
        return step, None, None
    picture = seen_webp(frame, ROWS) if lens is None else shown_jpeg(frame.picture, frame.grid, ORDINARY)
    return step, picture, core.orientation(frame.stamp)


def walked(folder: Path) -> Redrawn:
    """The report of ``eagor robot run``: where it went and what it said; it keeps no pictures and no beliefs.

    Raises `FormatError` if the folder holds none.
    """
    report = report_of(folder)
    samples = report["samples"]
    found = Redrawn(_scene_of_recording(f"Walk {folder.name}", str(report.get("query", "")), None))
    kept = samples[:: max(1, -(-len(samples) // KEPT))]
    for number, sample in enumerate(kept):
        found.steps.append(_sampled(sample) | {"frame": {"n": number, "of": len(kept), "stamp": sample.get("time")}})
    found.scene["words"] = "A robot's report keeps no pictures and no beliefs: its way and its answers are shown."
    return found


def report_of(folder: Path) -> dict[str, Any]:
    """``run.json`` of a robot's walk. Raises `FormatError`."""
    path = folder / REPORT
    try:
        found = parsed(path.read_bytes())
    except (OSError, ValueError) as error:
        raise FormatError(f"{path} cannot be read ({error}); name the report of eagor robot run") from None
    if not isinstance(found, dict) or not isinstance(found.get("samples"), list) or not found["samples"]:
        raise FormatError(f"{path} holds no samples; name the report of eagor robot run")
    return found


def _sampled(sample: dict[str, Any]) -> dict[str, Any]:
    azimuth, yaw = sample.get("azimuth"), float(sample.get("yaw") or 0.0)
    xy = sample.get("true_xy") or sample.get("xy")
    error = sample.get("error")
    told = {
        "direction": None if azimuth is None else rounded(direction(np.array(float(azimuth)), np.array(0.0))),
        "azimuth": azimuth,
        "elevation": None if azimuth is None else 0.0,
        "credible_angle": sample.get("cone"),
        "presence": sample.get("presence"),
        "entropy": None,
        "distance": sample.get("distance"),
        "distance_spread": None,
        "moving": None,
        "status": sample.get("status"),
        "words": f"{sample.get('words', '')} ({sample.get('mode', '')})",
    }
    return {
        "stamp": sample.get("time"),
        "world_R_camera": rounded(world_R_body(yaw).reshape(9), 6),
        "position": None if xy is None else [*xy, 0.0],
        "look": {"age": None, "fresh": False},
        "estimate": told,
        "modes": [],
        "truth": {"direction": None},
        "error_deg": None if error is None else rounded(math.degrees(error), 2),
        "rivals": {},
        "methods": {},
    }


def _scene_of_recording(title: str, query: str, calibrated: dict[str, Any] | None) -> dict[str, Any]:
    methods = [{"name": "eagor", "words": "our tracker"}]
    return scene_of("run", title, query, calibration=calibrated, methods=methods, method="eagor", paths={})

"""Episodes as the page shows them: steps with belief, panorama, answers of all methods, in one JSON object.

An episode of a simulated task is played again: the method with a belief sees what it saw in the run. What the other
methods said is in the records. A live recording goes through the live core again.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np

from eagor.drawing.timeline import Thinned
from eagor.errors import EagorError, FormatError
from eagor.lab.agents.methods import DESCRIPTIONS, TrackerEstimator
from eagor.lab.envs.places import load_place
from eagor.lab.eval.episodes import runner_of
from eagor.lab.eval.results import OURS, Run
from eagor.lab.tasks.sim.rollout import Step
from eagor.lab.tasks.task import finished, sample_of
from eagor.live.core import LiveCore
from eagor.live.recording import Replay
from eagor.sphere import direction
from eagor.studio.answers import belief_of, media_type, picture_of, plan_of, scene_of, step_of
from eagor.studio.messages import Message, Opening, rounded
from eagor.studio.stream import StudioSink

__all__ = ["EpisodeReplay", "recorded", "redraw"]

STEPS = 60  # steps with a panorama, at most: the page of an export is to be sent by mail
ROWS = 512  # of panoramas
KEPT = 120  # steps of a recording that are shown
APART = 0.2  # seconds between two of them, at least
ALONE: dict[str, Any] = {"methods": [{"name": OURS, "words": "our tracker"}], "method": OURS, "paths": {}}
Advance = Callable[[int], object]


def data_url(picture: bytes) -> str:
    """A picture as an address that holds it."""
    return f"data:{media_type(picture)};base64,{base64.b64encode(picture).decode('ascii')}"


@dataclass(eq=False)
class EpisodeReplay:
    """An episode for the page: its `scene`, its `steps`, and `pictures` (WebP or JPEG) by the number of their step."""

    scene: dict[str, Any]
    steps: list[dict[str, Any]] = field(default_factory=list)
    pictures: dict[int, bytes] = field(default_factory=dict)

    def as_json(self, address: Callable[[int], str]) -> dict[str, Any]:
        """The EPISODE of the page; `address` says where the picture of a step is."""
        steps = []
        for number, step in enumerate(self.steps):
            if number in self.pictures:
                shown = {"stamp": step["stamp"], "world_R_camera": step["world_R_camera"], **step.get("panorama", {})}
                step = step | {"panorama": shown | {"url": address(number)}}
            steps.append(step)
        return {"scene": self.scene, "steps": steps}

    def add(self, step: dict[str, Any], head: dict[str, Any] | None, heat: bytes) -> None:
        """A step more, with its belief as of `belief_of`."""
        self.steps.append(step | {"belief": head and head | {"url": data_url(heat)}})


def redraw(run: Run, case: str, advance: Advance = lambda _: None) -> EpisodeReplay:
    """Episode `case` of a run of a simulated task, again, with pictures finer than what the perception looked at.

    `advance` is called with the number of each step, and for each picture. Raises `EagorError` for an unknown episode,
    or a run without a tracker.
    """
    traces: dict[str, dict[str, Any]] = {}
    for record in finished(run.records):
        if sample_of(record) == case:
            common = {"pose": record.get("truth", {}).get("pose", [])}  # where all methods were at the same places
            traces |= {name: common | entry.get("trace", {}) for name, entry in record.get("methods", {}).items()}
    trackers = [name for name in traces if name.partition(":")[0] in (OURS, "eagor_paper")]
    if not trackers:
        raise EagorError(
            f"episode {case!r} was played by {', '.join(traces) or 'no method'}: none keeps a belief that could be "
            "shown. Run it with --methods eagor"
        )
    shown = OURS if OURS in trackers else trackers[0]
    listed = [shown, *(name for name in traces if name != shown)]
    runner, spec = runner_of(run, case)
    episode, seen = runner.plan(spec), list[Step]()
    place = load_place(spec.world, spec.seed, runner.camera.radius)
    targets = {thing.name for index, thing in enumerate(place.scene.instances) if index in episode.targets}
    title = f"{run.task.name} {episode.spec.id}: {episode.query}"
    about = {
        "plan": plan_of(place, targets), "perception": str(run.settings.get("perception", "")),
        "methods": [{"name": name, "words": DESCRIPTIONS.get(name.partition(":")[0], name)} for name in listed],
        "paths": {name: [rounded(pose[:2], 3) for pose in traces[name]["pose"]] for name in listed},
    }  # fmt: skip
    found = EpisodeReplay(scene_of(title, str(episode.query), method=shown, **about))

    def watch(each: Step) -> None:
        advance(len(seen))
        seen.append(each)
        assert isinstance(each.method, TrackerEstimator)
        estimate = each.method.estimate
        found.add(step_of(estimate, each.stamp, each.position, each.truth), *belief_of(estimate))

    runner.run_episode(spec, [shown], watch)
    for number in sorted({*np.linspace(0, len(seen) - 1, min(len(seen), STEPS)).round().astype(int).tolist()}):
        advance(number)
        view = seen[number].view
        assert view is not None
        found.pictures[number] = picture_of(view(ROWS).rgb, None, ROWS, "WEBP")
    for step in found.steps:
        step["methods"] = {}
    for name, trace in traces.items():  # what the methods answered, from the records
        answers = (trace.get(part, ()) for part in ("azimuth_deg", "elevation_deg", "error_deg"))
        for step, (azimuth, elevation, error) in zip(found.steps, zip(*answers, strict=True), strict=False):
            step["methods"][name] = {"estimate": _directed(azimuth, elevation), "error_deg": error}
    return found


def _directed(azimuth_deg: float | None, elevation_deg: float | None) -> dict[str, Any]:
    """A direction as an estimate has it."""
    if azimuth_deg is None or elevation_deg is None:
        return {"direction": None, "azimuth_deg": None, "elevation_deg": None}
    toward = direction(np.array(math.radians(azimuth_deg)), np.array(math.radians(elevation_deg)))
    return rounded({"direction": toward, "azimuth_deg": azimuth_deg, "elevation_deg": elevation_deg})


def recorded(replay: Replay, query: str | None = None, advance: Advance = lambda _: None) -> EpisodeReplay:
    """A recording of ``eagor live --record``, played again. `query`: one of its queries (default: the first).

    Raises `FormatError` for an unknown query, or a recording without an answer.
    """
    folder, queries = replay.path, replay.settings.queries
    asked = query or queries[0]
    if asked not in queries:
        raise FormatError(f"{folder} has no query {asked!r}; it has {', '.join(map(repr, queries))}")
    core, kept, last, said = LiveCore(replay.settings), Thinned(KEPT), -math.inf, list[Message]()
    sink = StudioSink(said.append, Opening(str(folder), f"Recording {folder.name}", asked, ""), None, whole=True)
    sink.loop = SimpleNamespace(core=core)
    for event in replay.events(pictures=True):
        answers = [each for each in core.take(event) if each.query == asked and each.stamp - last >= APART]
        sink.take(event, answers if kept.wants else ())  # only what is kept is computed: a recording may be long
        for answer in answers:
            last = answer.stamp
            advance(kept.count)
            kept.add(said[-1] if kept.wants else None)
    if not kept.items:
        raise FormatError(f"{folder} holds no answers about {asked!r}: the run was ended before the first")
    scene = next(each.header for each in reversed(said) if each.header["type"] == "scene")
    found = EpisodeReplay(scene | {"targets": list(queries), **ALONE})
    begun = kept.items[0].header["stamp"]
    for number, message in enumerate(kept.items):
        step = {name: part for name, part in message.header.items() if name not in ("evidence", "sent", "type")}
        step["stamp"] = rounded(step["stamp"] - begun, 3)
        found.add(step, step["belief"], message.blobs.get("belief", b""))
        if "panorama" in message.blobs:
            found.pictures[number] = message.blobs["panorama"]
    return found

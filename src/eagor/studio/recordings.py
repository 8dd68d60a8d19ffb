"""Recordings of the live loop, and reports of a robot's walk, as episodes of the page."""

from __future__ import annotations

import base64
import math
from pathlib import Path
from typing import Any

import numpy as np

from eagor._json import parsed
from eagor.drawing.timeline import Thinned
from eagor.errors import FormatError
from eagor.live.core import LiveCore
from eagor.live.events import FrameCame, PoseCame
from eagor.live.recording import Replay
from eagor.sphere import direction, world_R_body
from eagor.studio.pictures import jpeg
from eagor.studio.replays import Advance, Redrawn
from eagor.studio.steps import belief_of, calibration_of, estimate_json, modes_json, stage
from eagor.studio.wire import rounded
from eagor.worlds.photograph import Photograph

__all__ = ["REPORT", "recorded", "walked"]

REPORT = "run.json"  # of a robot's walk
KEPT = 120  # steps of a recording or of a walk that are shown
APART = 0.2  # seconds between two of them, at least
ROWS = 256  # of panoramas
STILL = (0.0, 0.0, 0.0)


def recorded(replay: Replay, query: str | None = None, advance: Advance = lambda _: None) -> Redrawn:
    """A recording of ``eagor live --record``, played again. `query`: one of its queries (default: the first).

    Raises `FormatError` for an unknown query, or a recording without an answer.
    """
    folder, queries = replay.path, replay.settings.queries
    asked = query or queries[0]
    if asked not in queries:
        raise FormatError(f"{folder} has no query {asked!r}; it has {', '.join(map(repr, queries))}")
    core, kept = LiveCore(replay.settings), Thinned(KEPT)
    panorama: FrameCame | None = None
    place: np.ndarray | None = None
    last = -math.inf
    for event in replay.events(pictures=True):
        if isinstance(event, FrameCame) and event.panorama is not None:
            panorama = event
        elif isinstance(event, PoseCame) and event.pose.position is not None:
            place = event.pose.position
        for answer in core.take(event):
            if answer.query != asked or answer.stamp - last < APART:
                continue
            last = answer.stamp
            advance(kept.count)
            # Only what is kept is computed: a recording may be long.
            kept.add(_answered(answer, panorama, place, core) if kept.wants else None)
    if not kept.items:
        raise FormatError(f"{folder} holds no answers about {asked!r}: the run was ended before the first")
    found = Redrawn(_scene(f"Recording {folder.name}", asked, calibration_of(None, replay.settings.config)))
    begun = kept.items[0][0]["stamp"]
    shown: bytes | None = None
    for number, (step, picture) in enumerate(kept.items):
        step["stamp"] = rounded(step["stamp"] - begun, 3)
        step["frame"] = {"n": number, "of": len(kept.items), "stamp": step["stamp"]}
        found.steps.append(step)
        if picture is not None and picture != shown:  # the camera may be slower than the answers
            found.pictures[number] = shown = picture
    found.scene["targets"] = list(queries)
    return found


def _answered(answer: Any, panorama: FrameCame | None, place: np.ndarray | None, core: LiveCore) -> Any:
    estimate = answer.estimate
    header, coefficients = belief_of(estimate, answer.stamp, core.config.degree)
    header["coefficients"] = base64.b64encode(coefficients).decode("ascii")
    step = {
        **stage(estimate, answer.stamp, place),
        "estimate": estimate_json(estimate, estimate.posterior.entropy()) | {"status_words": answer.status_words},
        "modes": modes_json(estimate),
        "belief": header,
        "truth": {"direction": None},
        "error_deg": None,
    }
    step["look"] = {"age": rounded(answer.look_age, 3), "fresh": False}
    picture = None
    if panorama is not None and panorama.panorama is not None:
        rows = min(ROWS, panorama.panorama.shape[0])
        small = Photograph(panorama.panorama).panorama(STILL, np.eye(3), rows).rgb
        assert small is not None
        picture = jpeg(small)
    return step, picture


def walked(folder: Path) -> Redrawn:
    """The report of ``eagor robot run``: where it went and what it said; it keeps no pictures and no beliefs.

    Raises `FormatError` if the folder holds none.
    """
    report = report_of(folder)
    samples = report["samples"]
    found = Redrawn(_scene(f"Walk {folder.name}", str(report.get("query", "")), None))
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


def _scene(title: str, query: str, calibrated: dict[str, Any] | None) -> dict[str, Any]:
    return {
        "view": "run", "title": title, "query": query, "targets": [], "plan": None, "degree": 15,
        "calibration": calibrated, "perception": "", "methods": [{"name": "eagor", "words": "our tracker"}],
        "method": "eagor", "region": 0.9, "paths": {},
    }  # fmt: skip

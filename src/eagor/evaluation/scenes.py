"""Single episodes to look at: from above, and through the camera at six moments.

The world is made again from its seed; nothing of it is in the records but its hash, which has to agree.
"""

from __future__ import annotations

import base64
import html
import io
import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from eagor.conventions import rotation_from_wxyz
from eagor.errors import WorldError
from eagor.evaluation.charts import look_of, mark, style_of, svg
from eagor.evaluation.published import OURS, is_rival, ordered
from eagor.evaluation.samples import Record, finished

if TYPE_CHECKING:
    from eagor.tasks.places import Place
    from eagor.tasks.task import Task

MOMENTS = 6
ROWS = 270  # of the panoramas, of which the belt between these elevations (degrees) is shown
TOP, BOTTOM = 50, -65
SCALE = 40  # pixels of a map per metre

OpenPlace = Callable[[str, int, float], "Place"]


def chosen(records: Sequence[Record], task: Task) -> dict[str, Record]:
    """The best, the median and the worst episode of our default method (fewer, where there are fewer)."""
    ranked = sorted((record for record in finished(records) if OURS in record["methods"]), key=lambda r: _rank(r, task))
    if not ranked:
        return {}
    places = {"best": 0, "median": len(ranked) // 2, "worst": len(ranked) - 1}
    found: dict[str, Record] = {}
    for name, place in places.items():
        if ranked[place] not in found.values():
            found[name] = ranked[place]
    return found


def _rank(record: Record, task: Task) -> tuple[float, ...]:
    """Lower is better."""
    entry = record["methods"][OURS]
    if task.walked:
        metrics = entry["metrics"]
        return -metrics["success"], -metrics["spl"], metrics["mae"]
    return (float(np.mean([error for error in entry["trace"]["error_deg"] if error is not None])),)


def open_episode(record: Record, radius: float, open_place: OpenPlace) -> Place:
    """The world of an episode. Raises `WorldError` if it is not the one in which the episode was played."""
    episode = record["episode"]
    place = open_place(episode.get("world", "apartment"), episode["seed"], radius)
    if place.scene.hash != episode["scene_hash"]:
        raise WorldError(
            f"{episode['scene']} is made differently now (its hash is {place.scene.hash}, it was "
            f"{episode['scene_hash']}); pictures need the version that the run was made with"
        )
    return place


def moments_of(record: Record) -> list[int]:
    """Six steps, evenly spread, the first and the last among them."""
    count = len(_poses(record))
    return sorted({round(k * (count - 1) / (MOMENTS - 1)) for k in range(MOMENTS)})


def floor_map(place: Place, record: Record, others: Sequence[Record]) -> str:
    """The episode from above: free floor, the target, and the way; in navigation each method's own (`others`)."""
    ground = place.ground
    rows, cols = np.nonzero(ground.free | ground.structure)
    low = ground.origin + ground.cell * np.array([cols.min(), rows.min()])
    high = ground.origin + ground.cell * np.array([cols.max() + 1, rows.max() + 1])
    width, height = (high - low) * SCALE

    def at(points: np.ndarray) -> np.ndarray:
        return np.stack([(points[..., 0] - low[0]) * SCALE, (high[1] - points[..., 1]) * SCALE], axis=-1)

    box = slice(rows.min(), rows.max() + 1), slice(cols.min(), cols.max() + 1)
    parts = [
        f'<image href="{_plan(ground.free[box], ground.structure[box])}" width="{width:.1f}" height="{height:.1f}" '
        'preserveAspectRatio="none" class="plan"/>'
    ]
    for target in record["episode"]["targets"]:
        if target < len(place.scene.instances):
            thing = place.scene.instances[target]
            (x0, y1), (x1, y0) = at(thing.low[:2]), at(thing.high[:2])
            parts.append(
                f'<rect class="target" x="{x0:.1f}" y="{y0:.1f}" width="{x1 - x0:.1f}" height="{y1 - y0:.1f}"/>'
            )
    balls = [ball for ball in record["episode"].get("balls") or [] if ball is not None]
    if balls:
        parts.append(f'<polyline class="ball" points="{_points(at(np.array(balls)))}"/>')
        parts += [f'<circle class="target" cx="{x:.1f}" cy="{y:.1f}" r="7"/>' for x, y in at(np.array(balls))[[0, -1]]]
    for other in others:
        name = next(iter(other["methods"]))
        dashes, _ = style_of(look_of(name))
        parts.append(
            f'<g class="s-{look_of(name)}"><title>{html.escape(name)}</title><polyline class="line" '
            f'stroke-dasharray="{dashes or "none"}" points="{_points(at(_poses(other, name)[:, :2]))}"/></g>'
        )
    way = at(_poses(record)[:, :2])
    parts.append(f'<g class="s-{OURS}"><polyline class="line strong" points="{_points(way)}"/></g>')
    for label, (x, y) in _stops(way, moments_of(record)):
        wide = 9.0 + 7.0 * (len(label) > 1)
        parts.append(
            f'<rect class="stop" x="{x - wide:.1f}" y="{y - 9:.1f}" width="{2 * wide:.1f}" height="18" rx="9"/>'
            f'<text class="stop" x="{x:.1f}" y="{y + 4:.1f}" text-anchor="middle">{label}</text>'
        )
    words = f"{len(way)} steps; the target is outlined; the numbers are the moments shown beside"
    return svg("".join(parts), width, height, f"From above: {record['episode']['query']}", words)


def strip(place: Place, record: Record) -> list[tuple[str, str]]:
    """Six moments through the camera, each an SVG and its caption: what was true, and what each method said."""
    truth, traces = _truth(record), {name: entry["trace"] for name, entry in record["methods"].items()}
    names = [name for name in ordered(traces) if is_rival(name)]
    poses, found = _poses(record), []
    for number, step in enumerate(moments_of(record), start=1):
        pose = poses[step]
        image = _panorama(place, record, pose, step)
        parts = [f'<image href="{image}" width="360" height="{TOP - BOTTOM}" preserveAspectRatio="none"/>']
        azimuth, elevation = truth["azimuth_deg"][step], truth["elevation_deg"][step]
        there = truth.get("present", [True] * len(poses))[step]
        for kind in ("truth below", "truth") if there else ():  # a dark ring below the white one
            rings = _places(azimuth, elevation)
            parts += [f'<circle class="{kind}" cx="{x:.1f}" cy="{y:.1f}" r="9"/>' for x, y in rings]
        for name in sorted(names, key=lambda name: name == OURS):
            trace = traces[name]
            _, shape = style_of(look_of(name))
            for x, y in _places(trace["azimuth_deg"][step], trace["elevation_deg"][step]):
                drawn = mark(shape, x, y, 5.0 if name == OURS else 3.8)
                look = f'<g class="said s-{look_of(name)}"><title>{html.escape(name)}</title>'
                parts.append(f'<g class="below">{drawn}</g>{look}{drawn}</g>')
        error = traces[OURS]["error_deg"][step]
        state = "in sight" if truth["visible"][step] else "out of sight" if there else "gone"
        off = "" if error is None else f"; off by {error:.0f}°"
        caption = f"{number}. step {step}: target {state}{off}"
        words = f"true azimuth {azimuth:.0f} degrees" if there else "no target"
        words += f"; {OURS} says {traces[OURS]['azimuth_deg'][step]:.0f} degrees; positive is to the left"
        found.append((svg("".join(parts), 360, TOP - BOTTOM, f"Panorama at step {step}", words), caption))
    return found


def _poses(record: Record, name: str = OURS) -> np.ndarray:
    """x, y, z, qw, qx, qy, qz of the camera at each step ``(n, 7)``."""
    source = record["truth"] if "truth" in record else record["methods"][name]["trace"]
    return np.array(source["pose"], dtype=float)


def _truth(record: Record) -> Mapping[str, Any]:
    """The true directions by step, under the same names for every task."""
    if "truth" in record:
        return record["truth"]
    trace = record["methods"][OURS]["trace"]
    flat = [0.0] * len(trace["true_azimuth_deg"])
    return {
        "azimuth_deg": trace["true_azimuth_deg"],
        "elevation_deg": trace.get("true_elevation_deg", flat),
        "visible": trace["visible"],
    }


def _stops(way: np.ndarray, moments: Sequence[int]) -> list[tuple[str, np.ndarray]]:
    """The numbers of the moments and where they go (pixels); moments at nearly the same place share a label."""
    runs: list[list[int]] = []
    for index, step in enumerate(moments):
        if runs and np.linalg.norm(way[step] - way[moments[runs[-1][0]]]) < 16:
            runs[-1].append(index)
        else:
            runs.append([index])
    return [(f"{run[0] + 1}–{run[-1] + 1}" if len(run) > 1 else f"{run[0] + 1}", way[moments[run[0]]]) for run in runs]


def _panorama(place: Place, record: Record, pose: np.ndarray, step: int) -> str:
    """What the camera saw, as a data address of a PNG."""
    turn = rotation_from_wxyz(pose[3:] / np.linalg.norm(pose[3:]))
    episode = record["episode"]
    ball = (episode.get("balls") or {step: None})[step]
    frame = place.renderer.panorama(pose[:3], turn, ROWS, ids=False, range=ball is not None)
    if ball is not None:
        from eagor.worlds.ball import Ball, with_ball

        painted = Ball(np.array(ball), float(episode["radius"]), str(episode["colour"]))
        frame = with_ball(frame, pose[:3], turn, painted, len(place.scene.instances))
    assert frame.rgb is not None
    first, last = (round(ROWS * (90 - elevation) / 180) for elevation in (TOP, BOTTOM))
    return _png(frame.rgb[first:last], colours=160)


def _places(azimuth: float, elevation: float) -> list[tuple[float, float]]:
    """Where a direction (degrees) is in the belt; twice near the seam, at the edge where it is above or below."""
    x, y = 180 - azimuth, min(max(TOP - elevation, 3.0), TOP - BOTTOM - 3.0)
    near = [(x + side * 360, y) for side in (-1, 1) if -8 < x + side * 360 < 368]
    return [(x, y), *near]


def _plan(free: np.ndarray, structure: np.ndarray) -> str:
    """The floor as a small picture, north up: walls dark, furniture lighter, free floor transparent."""
    picture = np.zeros((*free.shape, 4), dtype=np.uint8)
    picture[~free] = (128, 132, 140, 70)
    picture[structure] = (110, 114, 122, 255)
    return _png(picture[::-1])


def _png(pixels: np.ndarray, colours: int | None = None) -> str:
    from PIL import Image

    image = Image.fromarray(np.ascontiguousarray(pixels))
    if colours is not None:
        image = image.quantize(colours)
    buffer = io.BytesIO()
    image.save(buffer, format="PNG", optimize=True)
    return f"data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode('ascii')}"


def _points(pixels: np.ndarray) -> str:
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in pixels if math.isfinite(x) and math.isfinite(y))

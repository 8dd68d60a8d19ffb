"""Single episodes of a run of a simulated task: played again, and looked at from above and through the camera.

Every method sees again what it saw in the run. The map of a search also has the floor that its looks showed, and in
which steps nothing was believed yet. A record holds no looks: they are made again from its poses
(`eagor.lab.agents.search_space`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import ndimage

from eagor.conventions import rotation_from_wxyz
from eagor.errors import EagorError, WorldError
from eagor.lab.agents.methods import TrackerEstimator
from eagor.lab.agents.search_space import CELL, FLOOR, FloorMap, explored_floor
from eagor.lab.envs.episodes import PER_PLACE, EpisodeSpec, spec_from_json
from eagor.lab.envs.rules import Camera
from eagor.lab.eval.page import Part, Pictures, Text, address_of, blank, colour_of, legend, look_of, style_of, svg_of
from eagor.lab.eval.results import OURS, Result, Run, is_rival, is_variant, ordered, rank
from eagor.lab.eval.steps import truth_of
from eagor.lab.eval.tables import shown
from eagor.lab.tasks.sim.play import Runner, StepInfo
from eagor.lab.tasks.task import Record, Task, config_of, finished, sample_of

if TYPE_CHECKING:
    from eagor.lab.envs.places import Place
    from eagor.lab.worlds.navmesh import NavMesh

LOGGED_ROWS = 256  # of panoramas of an episode that is logged
BLUE = (36, 146, 232)  # red, green, blue: one for a light and a dark page, as the greys of the plan are
FAINT, STRONG = 0.17, 0.4  # how much it covers: floor that was seen from afar, and where looks surely find a thing
HALF = 0.5  # of what is about a point is floor that was seen: the edge of what is shaded
DASHES = (0, (1.5, 1.0))  # of steps in which the body searched, in widths of the line
WIDTH = 3.2  # of the line of our default method
MOMENTS = 6
ROWS = 270  # of the panoramas, of which the belt between these elevations (degrees) is shown
TOP, BOTTOM = 50, -65
SCALE = 40  # pixels of a map per metre
APART = 0.6  # metres between two moments that have a label each

OpenPlace = Callable[[str, int, float], "Place"]


# --- played again -----------------------------------------------------------------------------------------------------


def runner_of(run: Run, case: str) -> tuple[Runner, EpisodeSpec]:
    """What plays a case of a run again, and its spec. Raises as `spec_in`."""
    spec = spec_in(run, case)
    return Runner(dict(run.settings)), spec


def spec_in(run: Run, case: str) -> EpisodeSpec:
    """The spec of a case of a run. Raises `EagorError` for answers to published data, or an unknown case."""
    if not run.simulated:
        raise EagorError(f"only episodes of simulated tasks can be played again, and {run.task.name} has none")
    record = next((record for record in finished(run.records) if sample_of(record) == case), None)
    if record is None:
        names = ", ".join(dict.fromkeys(sample_of(record) for record in finished(run.records)))
        raise EagorError(f"the run has no case {case!r}; it has {names[:200] or 'none'}")
    episode, first = record["episode"], run.settings.get("seed")
    if "slot" in episode:  # of an episode that a file lists
        return spec_from_json(episode["slot"])
    world, seed, index = (episode.get(key) for key in ("world", "seed", "index"))
    if not (isinstance(world, str) and all(isinstance(value, int) for value in (first, seed, index))):
        raise EagorError(f"the record {record['key']!r} does not say which episode it is of; it cannot be played again")
    number = (seed - first) * PER_PLACE + index  # by which some tasks deal their scenarios
    return EpisodeSpec(run.task.name, world, seed, index, number)


def log_case(run: Run, method: str, case: str | None, path: str | Path) -> str:
    """Play a case of a run (None: the worst one) again and log it for the Rerun viewer; returns its name.

    Raises `EagorError` as `runner_of`, or for a method that has no belief (ours and its variants have one).
    """
    from eagor.drawing.rerun_log import RerunLog

    ranked = [sample_of(result.record) for result in rank(run, method)] if run.simulated else []
    name = case or (ranked[-1] if ranked else "")
    runner, spec = runner_of(run, name)
    if not isinstance(runner.method(method, spec), TrackerEstimator):
        raise EagorError(f"{method} keeps no belief that could be logged; give --method eagor, or a variant of it")
    query = str(runner.plan(spec).query)
    with RerunLog(path, f"{run.task.name} {name}: {query}") as log:

        def add(step: StepInfo) -> Any:
            assert isinstance(step.method, TrackerEstimator)
            log.add(
                step.picture(LOGGED_ROWS), step.method.estimate, stamp=step.stamp, query=query, position=step.position,
                truth=step.truth,
            )  # fmt: skip

        runner.run_episode(spec, [method], add)
    return name


# --- looked at --------------------------------------------------------------------------------------------------------


def three(run: Run, open_place: OpenPlace | None) -> list[Part]:
    """The best, the median and the worst episode of our default method: a map, and six moments."""
    ranked = [result.record for result in rank(run, OURS)]
    if not ranked:
        return [Text(f"There is no episode with a result of {OURS}.")]
    if open_place is None:
        from eagor.lab.envs.places import load_place as open_place
    try:
        camera = config_of(run.task, run.settings).camera
    except EagorError:  # a run of another version
        camera = None
    parts: list[Part] = [Text(f"Chosen by the metrics of {OURS}.", "note")]
    chosen: list[Record] = []
    for kind, record in (("best", ranked[0]), ("median", ranked[len(ranked) // 2]), ("worst", ranked[-1])):
        if record in chosen:
            continue
        chosen.append(record)
        parts.append(Text(f"The {kind}: {record['episode']['query']}, episode {record['episode']['id']}", "h3"))
        parts.append(Text(figures_of(record, run.task)))
        try:
            place = open_episode(record, (camera or Camera()).radius, open_place)
            parts += _pictures(place, record, finished(run.records), camera)
        except (EagorError, ImportError, OSError) as error:
            parts.append(Text(f"No pictures: {error}", "note"))
        except (KeyError, IndexError) as error:  # only pictures need it: its place, its balls
            lacks = f"the record {record['key']!r} does not hold all that they need ({type(error).__name__}: {error})"
            parts.append(Text(f"No pictures: {lacks}", "note"))
    return parts


def figures_of(record: Record, task: Task, method: str = OURS) -> str:
    """The figures of a method in an episode, in words."""
    values = [(metric, metric.of(record["methods"][method])) for metric in task.metrics]
    figures = ", ".join(f"{m.title} {shown(value, m)}{m.unit}" for m, value in values if value is not None)
    return f"{method}: {figures}."


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


def _pictures(place: Place, record: Record, records: Sequence[Record], camera: Camera | None) -> list[Part]:
    """The map and the strip of one episode, with a legend."""
    others = []
    if "truth" not in record:  # each method went its own way
        same = [r for r in records if r["episode"]["id"] == record["episode"]["id"]]
        others = [r for r in same if (name := next(iter(r["methods"]))) != OURS and not is_variant(name)]
    names = ordered([*(next(iter(r["methods"])) for r in others), *(n for n in record["methods"] if is_rival(n))])
    above = [
        floor_map(place, record, others, camera),
        (legend(names, OURS, str(record["key"])), "Each method's line and mark."),
    ]
    caption = "White ring: the truth. Marks: what each method says. The middle is straight ahead, the edges are behind."
    return [Pictures(above, "map"), Pictures(strip(place, record), "strip"), Text(caption, "note")]


def moments_of(record: Record) -> list[int]:
    """Six steps, evenly spread, the first and the last among them."""
    return np.unique(np.linspace(0, len(_poses(record)) - 1, MOMENTS).round().astype(int)).tolist()


def floor_map(place: Place, record: Record, others: Sequence[Record], camera: Camera | None) -> tuple[str, str]:
    """The episode from above, and a caption: free floor, the target, and the way; each method's own way of `others`.

    Of a search also in which steps the body searched, and did not go to where it believed the thing; and, by its
    `camera`, the floor that its looks had shown.
    """
    from matplotlib.patches import Rectangle
    from PIL import Image

    ground = place.ground
    rows, cols = np.nonzero(ground.free | ground.structure)
    low = ground.origin + ground.cell * np.array([cols.min(), rows.min()])
    high = ground.origin + ground.cell * np.array([cols.max() + 1, rows.max() + 1])
    figure, axes = blank(*(high - low) * SCALE)
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    target = colour_of("target")
    for index in record["episode"]["targets"]:
        if index < len(place.scene.instances):
            thing = place.scene.instances[index]
            axes.add_patch(
                Rectangle(thing.low[:2], *(thing.high[:2] - thing.low[:2]), fill=False, ec=target, lw=3, clip_on=False)
            )
    balls = np.array([ball for ball in record["episode"].get("balls") or [] if ball is not None])
    if len(balls):
        axes.plot(balls[:, 0], balls[:, 1], color=target, linestyle=(0, (2, 2)), linewidth=2, clip_on=False)
        axes.plot(*balls[[0, -1], :2].T, "o", color=target, fillstyle="none", markersize=14, mew=3, clip_on=False)
    for other in others:
        name = next(iter(other["methods"]))
        axes.plot(*_poses(other, name)[:, :2].T, linewidth=1.7, **style_of(look_of(name), marker=""))
    way = _poses(record)[:, :2]
    searching = np.array(record["methods"][OURS]["trace"].get("searching", [False] * len(way)), dtype=bool)
    turns = np.flatnonzero(np.diff(searching[: len(way) - 1])) + 1
    for first, last in zip([0, *turns], [*turns, len(way) - 1], strict=True):  # step k leads from point k of the way
        dashed = {"linestyle": DASHES, "dash_capstyle": "butt"} if searching[first] else {}
        axes.plot(*way[first : last + 1].T, **style_of(OURS, marker="", linewidth=WIDTH) | dashed)
    frame = {
        "boxstyle": "round,pad=0.25,rounding_size=0.6",
        "fc": colour_of("paper"),
        "ec": colour_of("ink"),
        "lw": 1.5,
    }
    for label, at in _stops(way, moments_of(record)):
        axes.text(*at, label, ha="center", va="center", fontsize=12, weight="bold", color=colour_of("ink"), bbox=frame)
    words = f"{len(way)} steps; the target is outlined; the numbers are the moments shown beside"
    caption, plan = "From above; numbers: the moments.", _plan(ground.free, ground.structure)
    if "searching" in record["methods"][OURS]["trace"]:
        words += f"; {OURS} searched in {np.count_nonzero(searching)} of its steps, whose line is dashed"
        caption += f" Dashed: {OURS} searched; solid: it went to where it believed the thing."
        if camera is not None:
            floor = _on_plan(explored_floor(place, _poses(record), camera), ground)
            seen = 100 * np.mean(np.isfinite(floor[ground.free]))
            words += f"; its looks showed {seen:.0f} % of the free floor, which is shaded"
            caption += " Blue: floor that its looks had shown by the end; stronger where they would have found it."
            plan = _shaded(plan, floor)
    title = f"From above: {record['episode']['query']}, episode {record['episode']['id']}"
    box = slice(rows.min(), rows.max() + 1), slice(cols.min(), cols.max() + 1)
    return svg_of(figure, title, words, address_of(Image.fromarray(np.ascontiguousarray(plan[box][::-1])))), caption


def _on_plan(known: FloorMap, ground: NavMesh) -> np.ndarray:
    """The probability that the looks would have found a thing that stands there; NaN where none showed the floor.

    For the cells of the plan ``(rows, cols)``, which are smaller than those of the looks: it goes evenly between them.
    """
    rows, cols = np.indices(ground.free.shape)
    points = ground.origin + ground.cell * (np.stack([cols, rows], axis=-1) + 0.5)
    at = np.moveaxis((points - known.origin) / CELL - 0.5, -1, 0)[::-1]
    floor = (known.state == FLOOR).astype(float)
    shown = ndimage.map_coordinates(floor, at, order=1, mode="constant")
    found = ndimage.map_coordinates(floor * (1.0 - known.miss_cost), at, order=1, mode="constant")
    seen = (shown >= HALF) & ~ground.structure  # cells of looks are larger than walls, and reach behind them:
    pieces = np.zeros(seen.shape, dtype=np.int32)
    ndimage.label(seen, output=pieces)
    seen &= np.isin(pieces, pieces[seen & ground.free])  # such slivers touch no free ground
    return np.where(seen, found / np.maximum(shown, HALF), np.nan)


def _shaded(plan: np.ndarray, shown: np.ndarray) -> np.ndarray:
    """A plan ``(rows, cols, 4)`` with blue over the floor that was `shown` ``(rows, cols)``, as of `_on_plan`."""
    from PIL import Image

    cover = np.where(np.isfinite(shown), FAINT + (STRONG - FAINT) * np.nan_to_num(shown), 0.0)
    blue = np.dstack([np.broadcast_to(np.array(BLUE), (*shown.shape, 3)), 255 * cover]).round().astype(np.uint8)
    return np.array(Image.alpha_composite(Image.fromarray(plan), Image.fromarray(blue)))


def strip(place: Place, record: Record) -> list[tuple[str, str]]:
    """Six moments through the camera, each an SVG and its caption: what was true, and what each method said."""
    truth = truth_of(Result(record, record["methods"][OURS]))
    traces = {name: entry["trace"] for name, entry in record["methods"].items()}
    names = [name for name in ordered(traces) if is_rival(name)]
    poses, found = _poses(record), []
    for number, step in enumerate(moments_of(record), start=1):
        figure, axes = blank(360, TOP - BOTTOM)
        axes.set_xlim(0, 360)
        axes.set_ylim(TOP - BOTTOM, 0)
        azimuth, elevation = truth["azimuth_deg"][step], truth["elevation_deg"][step]
        there = truth.get("present", [True] * len(poses))[step]
        for colour, width in (("#111", 5), ("#fff", 2.6)) if there else ():  # a dark ring below the white one
            for at in _places(azimuth, elevation):
                axes.plot(*at, "o", color=colour, fillstyle="none", markersize=18, mew=width, clip_on=False)
        for name in sorted(names, key=lambda name: name == OURS):
            look = style_of(look_of(name), markersize=10 if name == OURS else 7.6)
            for at in _places(traces[name]["azimuth_deg"][step], traces[name]["elevation_deg"][step]):
                axes.plot(*at, **look | {"color": "#fff", "mew": 4.5})
                axes.plot(*at, **look, mew=1.5)
        error = traces[OURS]["error_deg"][step]
        state = "in sight" if truth["visible"][step] else "out of sight" if there else "gone"
        off = "" if error is None else f"; off by {error:.0f}°"
        words = f"true azimuth {azimuth:.0f} degrees" if there else "no target"
        words += f"; {OURS} says {traces[OURS]['azimuth_deg'][step]:.0f} degrees; positive is to the left"
        title = f"Panorama at step {step} of episode {record['episode']['id']}"
        drawn = svg_of(figure, title, words, _panorama(place, record, poses[step], step))
        found.append((drawn, f"{number}. step {step}: target {state}{off}"))
    return found


def _poses(record: Record, name: str = OURS) -> np.ndarray:
    """x, y, z, qw, qx, qy, qz of the camera at each step ``(n, 7)``."""
    source = record["truth"] if "truth" in record else record["methods"][name]["trace"]
    return np.array(source["pose"], dtype=float)


def _stops(way: np.ndarray, moments: Sequence[int]) -> list[tuple[str, np.ndarray]]:
    """The numbers of the moments and where they go; moments at nearly the same place share a label."""
    runs: list[list[int]] = []
    for index, step in enumerate(moments):
        if runs and np.linalg.norm(way[step] - way[moments[runs[-1][0]]]) < APART:
            runs[-1].append(index)
        else:
            runs.append([index])
    return [(f"{run[0] + 1}–{run[-1] + 1}" if len(run) > 1 else f"{run[0] + 1}", way[moments[run[0]]]) for run in runs]


def _panorama(place: Place, record: Record, pose: np.ndarray, step: int) -> str:
    """What the camera saw, as a data address of a PNG."""
    from PIL import Image

    turn = rotation_from_wxyz(pose[3:] / np.linalg.norm(pose[3:]))
    episode = record["episode"]
    ball = (episode.get("balls") or {step: None})[step]
    frame = place.renderer.panorama(pose[:3], turn, ROWS, ids=False, range=ball is not None)
    if ball is not None:
        from eagor.lab.worlds.render import Ball, with_ball

        painted = Ball(np.array(ball), float(episode["radius"]), str(episode["colour"]))
        frame = with_ball(frame, pose[:3], turn, painted, len(place.scene.instances))
    assert frame.rgb is not None
    first, last = (round(ROWS * (90 - elevation) / 180) for elevation in (TOP, BOTTOM))
    return address_of(Image.fromarray(frame.rgb[first:last]).quantize(160))


def _places(azimuth: float, elevation: float) -> list[tuple[float, float]]:
    """Where a direction (degrees) is in the belt; twice near the seam, at the edge where it is above or below."""
    x, y = 180 - azimuth, min(max(TOP - elevation, 3.0), TOP - BOTTOM - 3.0)
    near = [(x + side * 360, y) for side in (-1, 1) if -8 < x + side * 360 < 368]
    return [(x, y), *near]


def _plan(free: np.ndarray, structure: np.ndarray) -> np.ndarray:
    """The floor as a picture ``(rows, cols, 4)``: walls dark, furniture lighter, free floor transparent."""
    picture = np.zeros((*free.shape, 4), dtype=np.uint8)
    picture[~free] = (128, 132, 140, 70)
    picture[structure] = (110, 114, 122, 255)
    return picture

"""Single episodes to look at, in a world made again: from above, and through the camera at six moments.

The map of a search also has the floor that its looks showed, and in which steps nothing was believed yet. A record
holds no looks: they are made again from its poses (`eagor.lab.agents.search_space`).
"""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import ndimage

from eagor.conventions import rotation_from_wxyz
from eagor.errors import EagorError, WorldError
from eagor.lab.agents.search_space import CELL, FLOOR, FloorMap, explored_floor
from eagor.lab.envs.rules import Camera
from eagor.lab.eval.charts import blank, colour_of, legend, look_of, style_of, svg_of
from eagor.lab.eval.page import Part, Pictures, Text
from eagor.lab.eval.results import OURS, Result, Run, is_rival, is_variant, ordered, rank
from eagor.lab.eval.steps import truth_of
from eagor.lab.eval.tables import shown
from eagor.lab.tasks.task import Record, Task, config_of

if TYPE_CHECKING:
    from eagor.lab.envs.places import Place
    from eagor.lab.worlds.navmesh import NavMesh

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


@dataclass(frozen=True, eq=False)
class Search:
    """An episode of our default method that was played with the policy `search`.

    `searching` ``(n,)`` bool: in which steps the body searched, and did not go to where it believed the thing. `found`
    ``(rows, cols)`` of the place's plan: the probability that the looks would have found a thing that stands there, NaN
    where none showed the floor; None if nobody can tell: the record does not name its camera.
    """

    searching: np.ndarray
    found: np.ndarray | None

    @property
    def caption(self) -> str:
        """What to say below a map of it."""
        said = f"How {OURS} searched."
        if self.found is not None:
            said += " Blue: floor that its looks had shown by the end; stronger where they would have found the thing."
        return said

    def in_words(self, free: np.ndarray) -> str:
        """What a map shows of it; `free` ``(rows, cols)`` bool: the floor of the plan on which a body can stand."""
        steps = f"{OURS} searched in {np.count_nonzero(self.searching)} of its steps, whose line is dashed"
        if self.found is None:
            return steps
        seen = 100 * np.mean(np.isfinite(self.found[free]))
        return f"{steps}; its looks showed {seen:.0f} % of the free floor, which is shaded"


def search_of(place: Place, record: Record, camera: Camera | None) -> Search | None:
    """How our default method searched in an episode; None if its body only followed the estimate.

    Without a `camera`, nobody knows what a look showed.
    """
    trace = record["methods"][OURS]["trace"]
    if "searching" not in trace:
        return None
    poses = np.array(trace["pose"], dtype=float)
    found = None if camera is None else _on_plan(explored_floor(place, poses, camera), place.ground)
    return Search(np.array(trace["searching"], dtype=bool), found)


def _on_plan(known: FloorMap, ground: NavMesh) -> np.ndarray:
    """`Search.found`, for the cells of the plan ``(rows, cols)``: smaller ones, between which it goes evenly."""
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


def shaded(picture: np.ndarray, found: np.ndarray) -> np.ndarray:
    """A plan ``(rows, cols, 4)`` (red, green, blue, cover; uint8) with the blue of `Search.found` over it."""
    cover = np.where(np.isfinite(found), FAINT + (STRONG - FAINT) * np.nan_to_num(found), 0.0)[..., None]
    below = picture[..., 3:] / 255 * (1 - cover)
    total = cover + below
    colour = (cover * np.array(BLUE) + below * picture[..., :3]) / np.maximum(total, 1e-9)
    return np.concatenate([colour, 255 * total], axis=-1).round().astype(np.uint8)


def draw_way(axes: Any, way: np.ndarray, searching: np.ndarray) -> None:
    """The way ``(n, 2)`` of our default method; step k leads from its point k, dashed where `searching` ``(n,)``."""
    turns = np.flatnonzero(np.diff(searching[: len(way) - 1])) + 1
    for first, last in zip([0, *turns], [*turns, len(way) - 1], strict=True):
        style = style_of(OURS, marker="", linewidth=WIDTH)
        if searching[first]:
            style |= {"linestyle": DASHES, "dash_capstyle": "butt"}
        axes.plot(*way[first : last + 1].T, **style)


def key_to_search(search: Search, of: str) -> str:
    """What dashes and shades mean, as a picture of its own; `of`: what it belongs to."""
    from matplotlib.patches import Rectangle

    shades = 5 if search.found is not None else 0
    height = 40 if shades else 18
    figure, axes = blank(480, height)
    axes.set_xlim(0, 480)
    axes.set_ylim(0, height)
    text = {"va": "center", "fontsize": 12, "color": colour_of("ink")}
    left, middle = 14, 198
    for x, dashes, words in ((left, DASHES, "searching"), (middle, "-", "going to where it believed the thing")):
        axes.plot([x, x + 36], [height - 9] * 2, **style_of(OURS, marker="", linewidth=WIDTH, linestyle=dashes))
        axes.text(x + 44, height - 9, words, **text)
    for k in range(shades):
        cover = FAINT + (STRONG - FAINT) * k / (shades - 1)
        colour = tuple(part / 255 for part in BLUE)
        axes.add_patch(Rectangle((middle + 22 * k, 3), 22, 13, fc=colour, alpha=cover, lw=0))
    if shades:
        axes.text(left, 9, "looks may miss the thing", **text)
        axes.text(middle + 22 * shades + 8, 9, "looks would find it", **text)
    words = "dashed where it searched, solid where it went to where the thing should be"
    words += "; shaded where looks showed the floor, the stronger the surer they find a thing there" if shades else ""
    return svg_of(figure, f"Key to the search of {of}", words)


def chosen(ranked: Sequence[Result]) -> dict[str, Record]:
    """The best, the median and the worst of ranked episodes (fewer, where there are fewer)."""
    places = {"best": 0, "median": len(ranked) // 2, "worst": len(ranked) - 1} if ranked else {}
    found: dict[str, Record] = {}
    for name, place in places.items():
        if ranked[place].record not in found.values():
            found[name] = ranked[place].record
    return found


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


def floor_map(place: Place, record: Record, others: Sequence[Record], search: Search | None = None) -> str:
    """The episode from above: free floor, the target, and the way; in navigation each method's own (`others`).

    With a `search`: also where it had looked, and in which steps it searched.
    """
    from matplotlib.patches import Rectangle

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
        look = style_of(look_of(name), marker="")
        axes.plot(*_poses(other, name)[:, :2].T, linewidth=1.7, **look)
    way = _poses(record)[:, :2]
    if search is None:
        axes.plot(*way.T, linewidth=WIDTH, **style_of(OURS, marker=""))
    else:
        draw_way(axes, way, search.searching)
    frame = {
        "boxstyle": "round,pad=0.25,rounding_size=0.6",
        "fc": colour_of("paper"),
        "ec": colour_of("ink"),
        "lw": 1.5,
    }
    for label, at in _stops(way, moments_of(record)):
        axes.text(*at, label, ha="center", va="center", fontsize=12, weight="bold", color=colour_of("ink"), bbox=frame)
    box = slice(rows.min(), rows.max() + 1), slice(cols.min(), cols.max() + 1)
    words = f"{len(way)} steps; the target is outlined; the numbers are the moments shown beside"
    title = f"From above: {record['episode']['query']}, episode {record['episode']['id']}"
    plan = _plan(ground.free, ground.structure)
    if search is not None:
        words += f"; {search.in_words(ground.free)}"
        plan = plan if search.found is None else shaded(plan, search.found)
    return svg_of(figure, title, words, _png(plan[box][::-1]))


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
        caption = f"{number}. step {step}: target {state}{off}"
        words = f"true azimuth {azimuth:.0f} degrees" if there else "no target"
        words += f"; {OURS} says {traces[OURS]['azimuth_deg'][step]:.0f} degrees; positive is to the left"
        title = f"Panorama at step {step} of episode {record['episode']['id']}"
        found.append((svg_of(figure, title, words, _panorama(place, record, poses[step], step)), caption))
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
    return _png(frame.rgb[first:last], colours=160)


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


def _png(pixels: np.ndarray, colours: int | None = None) -> str:
    from PIL import Image

    image = Image.fromarray(np.ascontiguousarray(pixels))
    if colours is not None:
        image = image.quantize(colours)
    buffer = io.BytesIO()
    image.save(buffer, format="PNG", optimize=True)
    return f"data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode('ascii')}"


def three(run: Run, results: Mapping[str, Sequence[Result]], open_place: OpenPlace | None) -> list[Part]:
    """The best, the median and the worst episode of our default method: a map, and six moments."""
    found = chosen(rank(run, OURS))
    if not found:
        return [Text(f"There is no episode with a result of {OURS}.")]
    if open_place is None:
        from eagor.lab.envs.places import load_place as open_place
    camera = _camera(run)
    parts: list[Part] = [Text(f"Chosen by the metrics of {OURS}.", "note")]
    others = [result.record for each in results.values() for result in each]
    for kind, record in found.items():
        episode = record["episode"]
        parts.append(Text(f"The {kind}: {episode['query']}, episode {episode['id']}", "h3"))
        parts.append(Text(figures_of(record, run.task)))
        try:
            place = open_episode(record, (camera or Camera()).radius, open_place)
            parts += _pictures(place, record, others, search_of(place, record, camera))
        except (EagorError, ImportError, OSError) as error:
            parts.append(Text(f"No pictures: {error}", "note"))
        except (KeyError, IndexError) as error:  # only pictures need it: its place, its balls
            lacks = f"the record {record['key']!r} does not hold all that they need ({type(error).__name__}: {error})"
            parts.append(Text(f"No pictures: {lacks}", "note"))
    return parts


def _camera(run: Run) -> Camera | None:
    """The camera of a run; None if it is one of another version."""
    try:
        return config_of(run.task, run.settings).camera
    except EagorError:
        return None


def _pictures(place: Any, record: Record, records: Sequence[Record], search: Search | None) -> list[Part]:
    """The map and the strip of one episode, with a legend; with a key to its `search`, if it was one."""
    others = []
    if "truth" not in record:  # each method went its own way
        same = [r for r in records if r["episode"]["id"] == record["episode"]["id"]]
        others = [r for r in same if (name := next(iter(r["methods"]))) != OURS and not is_variant(name)]
    names = ordered([*(next(iter(r["methods"])) for r in others), *(n for n in record["methods"] if is_rival(n))])
    above = [
        (floor_map(place, record, others, search), "From above; numbers: the moments."),
        *([(key_to_search(search, str(record["key"])), search.caption)] if search is not None else []),
        (legend(names, OURS, str(record["key"])), "Each method's line and mark."),
    ]
    caption = "White ring: the truth. Marks: what each method says. The middle is straight ahead, the edges are behind."
    return [Pictures(above, "map"), Pictures(strip(place, record), "strip"), Text(caption, "note")]


def figures_of(record: Record, task: Task, method: str = OURS) -> str:
    """The figures of a method in an episode, in words."""
    values = [(metric, metric.of(record["methods"][method])) for metric in task.metrics]
    figures = ", ".join(f"{m.title} {shown(value, m)}{m.unit}" for m, value in values if value is not None)
    return f"{method}: {figures}."

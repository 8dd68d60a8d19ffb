"""The search of ``eagor demo``: every method in a furnished apartment; the report is one HTML file, with pictures."""

from __future__ import annotations

import base64
import io
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eagor._files import written
from eagor.cli import terminal
from eagor.cli.checks import keep_picture
from eagor.conventions import rotation_from_wxyz
from eagor.drawing import draw_errors, draw_map, draw_strip
from eagor.evaluation.page import rendered
from eagor.evaluation.published import OURS, PAPERS
from eagor.perception import load, rows_of
from eagor.sphere import direction
from eagor.tasks.episodes import Slot
from eagor.tasks.methods import DESCRIPTIONS, NAMES, TrackerMethod
from eagor.tasks.models import is_privileged
from eagor.tasks.places import APARTMENT, Place, load_place
from eagor.tasks.play import Player, Seen
from eagor.tasks.rules import Camera, Disturbances, NavigationRules, as_dict
from eagor.tracking.estimate import Estimate

if TYPE_CHECKING:
    from PIL.Image import Image


PICTURE_ROWS = 320  # of a panorama
# The order gives the methods their colours, the same in both pictures.
SHOWN = (OURS, PAPERS, *(name for name in NAMES if name not in (OURS, PAPERS)))


def as_text(search: Search) -> list[str]:
    """One line per method."""
    lines = [f"{'':18}{'found':>7}{'steps':>7}{'walked':>9}{'SPL':>6}{'error':>9}"]
    for name in sorted(search.methods, key=NAMES.index):
        m = search.methods[name]["metrics"]
        lines.append(
            f"{name:18}{'yes' if m['success'] else 'no':>7}{m['steps']:>7}{m['path_m']:>7.1f} m{100 * m['spl']:>6.0f}"
            f"{m['mae']:>7.1f} °"
        )
    return lines


def as_json(search: Search) -> dict[str, Any]:
    """The result for ``--json``."""
    return {
        "query": search.thing,
        "scene": search.episode["scene"],
        "seed": search.slot.seed,
        "episode": search.slot.index,
        "perception": search.perception,
        "methods": {name: part["metrics"] for name, part in search.methods.items()},
        "what": {name: DESCRIPTIONS[name] for name in search.methods},
        "summary": summary(search),
    }


def write_report(search: Search, folder: Path) -> Path:
    """Draw the pictures into `folder` and write report.html there; returns its path. Raises `StorageError`."""
    place = load_place(search.slot.world, search.slot.seed, Camera().radius)
    pictures = {"beliefs": _strip(search, place), "errors": _errors(search), "map": _map(search, place)}
    for name, picture in pictures.items():
        keep_picture(picture, folder / f"{name}.png")
    rows = [(name, search.methods[name]["metrics"], DESCRIPTIONS[name]) for name in NAMES]
    shown = {name: _as_address(picture) for name, picture in pictures.items()}
    page = rendered(
        "demo.html", search=search, words=" ".join(summary(search)), rows=rows, ours=OURS, step=Camera().step,
        collisions=collisions(search), mistakes=mistakes(search), **shown,
    )  # fmt: skip
    return written(folder / "report.html", page)


def _strip(search: Search, place: Place) -> Image:
    """Our camera's panoramas and beliefs at six moments."""
    trace, panels = search.methods[OURS]["trace"], []
    for index, what in _highlights(trace):
        pose = trace["pose"][index]
        turned = rotation_from_wxyz(np.array(pose[3:]))
        seen = place.renderer.panorama(np.array(pose[:3]), turned, PICTURE_ROWS, range=False, ids=False)
        estimate = search.estimates[index]
        true = direction(*(math.radians(trace[f"true_{part}_deg"][index]) for part in ("azimuth", "elevation")))
        off, range_m = trace["error_deg"][index], trace["true_range_m"][index]
        panels.append(
            {
                "panorama": seen.rgb,
                "belief": estimate,
                "modes": (),
                "truth": true,
                "title": f"step {index}  {what}: {estimate.status}, off by {off:.0f}°, {range_m:.1f} m away",
            }
        )
    return draw_strip(panels)


def _highlights(trace: dict[str, list[Any]]) -> list[tuple[int, str]]:
    """At most six moments for pictures, in order of time."""
    last = len(trace["error_deg"]) - 1
    chosen = {0: "first look", min(3, last): "a few looks later", min(last, max(1, last // 3)): "on the way"}
    hidden = [i for i, seen in enumerate(trace["visible"]) if not seen]
    if hidden:
        chosen[hidden[len(hidden) // 2]] = "out of sight"
    chosen[max(1, 2 * last // 3)] = "on the way"
    chosen[last] = "last look"
    return sorted(chosen.items())[:6]


def _errors(search: Search) -> Image:
    errors = {name: search.methods[name]["trace"]["error_deg"] for name in SHOWN}
    longest = max(len(values) for values in errors.values())
    return draw_errors([step * Camera().seconds for step in range(longest)], errors)


def _map(search: Search, place: Place) -> Image:
    ground = place.ground
    rows, cols = ground.free.shape
    x0, y0 = ground.origin
    paths = {name: np.array(search.methods[name]["trace"]["pose"])[:, :2] for name in SHOWN}
    target = place.scene.instances[search.episode["targets"][0]].centre
    extent = (float(x0), float(x0 + cols * ground.cell), float(y0), float(y0 + rows * ground.cell))
    return draw_map(ground.structure, ground.free, extent, paths, target)


def _as_address(picture: Image) -> str:
    """A picture as a data URL of a PNG."""
    buffer = io.BytesIO()
    picture.save(buffer, format="PNG", optimize=True)
    return f"data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode('ascii')}"


SPOKEN = {
    "centroid": "the plain centroid",
    "cent_circ": "the circular centroid",
    "grid": "the published pixel grid",
    "eagor_paper": "EAGOR as published",
    "best_detection": "the best detection so far",
    "last_detection": "the last detection",
    "vmf": "the von Mises-Fisher filter",
    "grid_filter": "the grid filter",
    "particle_filter": "the particle filter",
    "eagor": "our tracker",
}


@dataclass(frozen=True, eq=False)
class Search:
    """The episode's record, each method's part of it, and our estimates step by step.

    `perception`: its name; `drawn`: whether its mistakes are random, drawn from the episode's seed.
    """

    slot: Slot
    rules: NavigationRules
    episode: dict[str, Any]
    methods: dict[str, dict[str, Any]]
    estimates: list[Estimate]
    perception: str
    drawn: bool

    @property
    def thing(self) -> str:
        """The query."""
        return self.episode["query"]


def play(seed: int, index: int, perception: str, say: bool = False) -> Search:
    """Play one episode of navigation with every method."""
    rules, seeing = NavigationRules(), load(perception)
    config = {
        "task": "navigation",
        "perception": perception,
        "rules": as_dict(rules),
        "camera": as_dict(Camera()),
        "disturbances": as_dict(Disturbances()),
        "rows": rows_of(seeing),
    }
    slot = Slot("navigation", APARTMENT, seed, index, index)
    estimates: list[Estimate] = []
    player = Player(config, seeing)
    if say:
        print(f"Building {APARTMENT} {seed} and looking for something to search ...", flush=True)
    episode = player.plan(slot)
    if say:
        print(
            f"A camera stands in {episode.scene}, {episode.shortest:.1f} m of walking from the {episode.query}, with "
            f"its back to it. Each of {len(NAMES)} methods walks on its own, seeing through the same perception "
            f"({perception}).",
            flush=True,
        )
    found: dict[str, dict[str, Any]] = {}
    record: dict[str, Any] = {}

    def keep(seen: Seen) -> None:
        if isinstance(seen.method, TrackerMethod):
            estimates.append(seen.method.estimate)

    with terminal.progress("searching", len(NAMES)) as advance:
        for name in NAMES:
            record = player.play(slot, [name], keep if name == OURS else None)
            found |= record["methods"]
            advance()
    return Search(slot, rules, record["episode"], found, estimates, perception, is_privileged(seeing))


def summary(search: Search) -> list[str]:
    """The result in sentences, generated from the numbers."""
    metrics = {name: part["metrics"] for name, part in search.methods.items()}
    lines = [f"{_told(OURS, metrics, search)}; {_told('centroid', metrics, search, short=True)}."]
    lines[0] = lines[0][0].upper() + lines[0][1:]
    published = _told(PAPERS, metrics, search, short=True)
    lines.append(f"{published[0].upper()}{published[1:]}, off by {metrics[PAPERS]['mae']:.0f} degrees on average; "
                 f"ours by {metrics[OURS]['mae']:.0f}.")  # fmt: skip
    faster = [n for n, m in metrics.items() if m["success"] and n != OURS and m["steps"] < metrics[OURS]["steps"]]
    if metrics[OURS]["success"] and faster:
        best = min(faster, key=lambda name: metrics[name]["steps"])
        lines.append(f"The quickest was {SPOKEN[best]}, with {metrics[best]['steps']} steps.")
    found = sum(bool(m["success"]) for m in metrics.values())
    lines.append(
        f"{found} of {len(metrics)} methods found it. One episode shows how it works, not who is better: for that, "
        "see eagor bench."
    )
    return lines


def collisions(search: Search) -> str:
    """What a collision is, and how many there were."""
    numbers = {name: part["metrics"]["collisions"] for name, part in search.methods.items()}
    steps = search.methods[OURS]["metrics"]["steps"]
    return (
        "A collision is a step that a wall or a piece of furniture cut short; the body slides on along it. No method "
        "has a map: each walks by the floor that its looks have shown, and learns by touching of what reaches over it. "
        f"So collisions are part of the ways here: {numbers[OURS]} in the {steps} steps of our tracker, "
        f"{min(numbers.values())} to {max(numbers.values())} over all methods."
    )


def mistakes(search: Search) -> str:
    """Where the mistakes of the perception come from."""
    told = f"All methods see through the same perception, {search.perception}."
    if search.drawn:
        return f"{told} Its mistakes are drawn from one seed."
    return f"{told} What it gets wrong depends on the picture, so methods that walk elsewhere meet other mistakes."


def _told(name: str, metrics: dict[str, Any], search: Search, short: bool = False) -> str:
    m = metrics[name]
    thing = "it" if short else f"the {search.thing}"
    if m["success"]:
        return f"{SPOKEN[name]} found {thing} in {m['steps']} steps"
    return f"{SPOKEN[name]} gave up on {thing} after {m['steps']} steps" if not short else (
        f"{SPOKEN[name]} gave up after {m['steps']}"
    )  # fmt: skip

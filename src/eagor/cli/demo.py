"""``eagor demo``: every method searches a furnished apartment; the report is one HTML file, with pictures."""

from __future__ import annotations

import base64
import io
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eagor._files import written
from eagor.cli import terminal
from eagor.cli.demo_search import Search, collisions, mistakes, play, summary
from eagor.cli.looking import check_looks, checked_folder, keep_picture
from eagor.cli.options import Demo
from eagor.conventions import rotation_from_wxyz
from eagor.drawing import draw_errors, draw_map, draw_strip
from eagor.evaluation.page import rendered
from eagor.evaluation.published import OURS, PAPERS
from eagor.sphere import direction
from eagor.tasks.episodes import PER_PLACE
from eagor.tasks.methods import DESCRIPTIONS, NAMES
from eagor.tasks.places import SEEDS, Place, load_place
from eagor.tasks.rules import Camera

if TYPE_CHECKING:
    from PIL.Image import Image

PICTURE_ROWS = 320  # of a panorama
# The order gives the methods their colours, the same in both pictures.
SHOWN = (OURS, PAPERS, *(name for name in NAMES if name not in (OURS, PAPERS)))


def demo(options: Demo) -> int:
    """Run the command; returns its exit code."""
    if not 0 <= options.seed < SEEDS:
        raise terminal.UsageError(f"--seed {options.seed}; wanted an apartment, 0 to {SEEDS - 1}")
    if not 0 <= options.episode < PER_PLACE:
        raise terminal.UsageError(f"--episode {options.episode}; wanted 0 to {PER_PLACE - 1}")
    checked_folder(options.out)
    check_looks(options.perception)
    search = play(options.seed, options.episode, options.perception, say=not options.json)
    report = write_report(search, options.out)
    if options.json:
        terminal.emit(_as_json(search, options, report))
    else:
        print("\n" + "\n".join(as_text(search)) + "\n\n" + "\n".join(summary(search)))
        print(f"\nThe report with pictures: {report}")
    return terminal.OK


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


def _as_json(search: Search, options: Demo, report: Path) -> dict[str, Any]:
    return {
        "query": search.thing,
        "scene": search.episode["scene"],
        "seed": options.seed,
        "episode": options.episode,
        "perception": options.perception,
        "methods": {name: part["metrics"] for name, part in search.methods.items()},
        "what": {name: DESCRIPTIONS[name] for name in search.methods},
        "summary": summary(search),
        "report": str(report),
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

"""The demo's report: one HTML file that needs nothing else, and its pictures as files beside it."""

from __future__ import annotations

import base64
import html
import io
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eagor._files import written
from eagor._version import __version__
from eagor.cli.demo_search import Search, summary
from eagor.cli.looking import keep_picture
from eagor.conventions import rotation_from_wxyz
from eagor.drawing import draw_errors, draw_map, draw_strip
from eagor.evaluation.published import OURS, PAPERS
from eagor.sphere import direction
from eagor.tasks.methods import DESCRIPTIONS, NAMES
from eagor.tasks.places import Place, load_place
from eagor.tasks.rules import Camera

if TYPE_CHECKING:
    from PIL.Image import Image

# Light or dark as the reader has it. On a phone tables and pictures keep a width that can be read, and scroll.
STYLE = """
:root{color-scheme:light dark;--ink:#1f2430;--quiet:#5b6472;--paper:#fff;--rule:#e3e6ec;--ours:#e8f6f8}
@media (prefers-color-scheme:dark){:root{--ink:#e6e9ef;--quiet:#a3acba;--paper:#14171d;--rule:#333a46;--ours:#17303f}}
body{font:16px/1.55 system-ui,sans-serif;color:var(--ink);background:var(--paper);max-width:1120px;margin:2.5rem auto;
padding:0 1.2rem}h1{font-size:1.7rem;margin-bottom:.2rem}h2{font-size:1.2rem;margin-top:2.2rem}
.scroll{overflow-x:auto}img{display:block;max-width:100%;height:auto;border-radius:6px}
table{border-collapse:collapse;width:100%}
th,td{padding:.4rem .7rem;border-bottom:1px solid var(--rule);text-align:right}
th:first-child,td:first-child,th:last-child,td:last-child{text-align:left}
td:last-child{color:var(--quiet);font-size:.92em;min-width:14rem}
tr.ours{background:var(--ours)}.note{color:var(--quiet);font-size:.92em}
@media (max-width:45rem){img{max-width:none;width:45rem}}
"""
PICTURE_ROWS = 320  # of a panorama
# In this order the methods have their colours, the same in both pictures.
SHOWN = (OURS, PAPERS, *(name for name in NAMES if name not in (OURS, PAPERS)))


def write_report(search: Search, folder: Path) -> Path:
    """Draw the pictures into `folder` and write report.html there; returns its path. Raises `StorageError`."""
    place = load_place(search.slot.world, search.slot.seed, Camera().radius)
    pictures = {"beliefs": _strip(search, place), "errors": _errors(search), "map": _map(search, place)}
    for name, picture in pictures.items():
        keep_picture(picture, folder / f"{name}.png")
    return written(folder / "report.html", _page(search, pictures))


def _strip(search: Search, place: Place) -> Image:
    """What our camera saw at six moments, and what we believed."""
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
    """At most six moments worth a picture, in time."""
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


def _page(search: Search, pictures: dict[str, Image]) -> str:
    rows = []
    for name in NAMES:
        m = search.methods[name]["metrics"]
        kind = " class=ours" if name == OURS else ""
        cells = f"<td>{'yes' if m['success'] else 'no'}</td><td>{m['steps']}</td><td>{m['path_m']:.1f}</td>"
        cells += f"<td>{100 * m['spl']:.0f}</td><td>{m['mae']:.1f}</td><td>{m['collisions']}</td>"
        rows.append(f"<tr{kind}><td>{name}</td>{cells}<td>{html.escape(DESCRIPTIONS[name])}</td></tr>")
    words = " ".join(html.escape(line) for line in summary(search))
    rules, thing = search.rules, html.escape(search.thing)
    heads = ("found", "steps", "walked (m)", "SPL", "mean error (°)", "collisions", "what it is")
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>Where is the {thing}?</title><style>{STYLE}</style></head><body>
<h1>Where is the {thing}?</h1>
<p>A camera stands in {html.escape(search.episode["scene"])} with its back to the {thing},
{search.episode["shortest"]:.1f} m of walking away. {words}</p>
<div class="scroll"><table><tr><th>method</th>{"".join(f"<th>{head}</th>" for head in heads)}</tr>
{"".join(rows)}</table></div>
<p class="note">Each step goes {Camera().step} m along the estimate, sliding along walls; the search is over within
{rules.success_distance} m (of walking) of the target, or after {rules.max_steps} steps. All methods see through the
same perception, whose mistakes are drawn from the same seed.</p>
<h2>What our camera saw, and what we believed</h2>
{_embedded(pictures["beliefs"], "Panoramas along our way with the belief as heat and its 90 percent region")}
<h2>The ways from above</h2>
{_embedded(pictures["map"], "Floor plan with the way of each method from the start to where it ended")}
<h2>Error over time</h2>
{_embedded(pictures["errors"], "Direction error of each method over time")}
<p class="note">Made by eagor {__version__}.</p>
</body></html>
"""


def _embedded(picture: Image, text: str) -> str:
    buffer = io.BytesIO()
    picture.save(buffer, format="PNG", optimize=True)
    data = base64.b64encode(buffer.getvalue()).decode("ascii")
    return f'<div class="scroll"><img alt="{html.escape(text)}" src="data:image/png;base64,{data}"></div>'

"""The demo's report: one HTML file that needs nothing else, and its pictures as files beside it."""

from __future__ import annotations

import base64
import html
import io
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from eagor._version import __version__
from eagor.cli.demo import OURS, STAGES, Run, stretch, summary
from eagor.cli.walk import LOOK_ROWS, QUERY, TARGET
from eagor.drawing import draw_errors, draw_map, draw_strip

if TYPE_CHECKING:
    from PIL.Image import Image

METHODS = {
    "ours": "belief over direction and distance, degree 15, read at its mode",
    "ours, turning only": "the same without distance: the camera's turns count, its steps do not",
    "centroid": "mean pixel of the response, frame by frame",
    "cent-circ": "the same, with a circular mean of the azimuth",
    "grid": "log-responses on a pixel grid, resampled at each turn",
    "published": "the paper's recursion: degree 7, spherical mean",
    "vmf": "von Mises-Fisher filter: one direction and one concentration",
    "histogram": "Bayes filter on a grid of probabilities",
    "particles": "particle filter",
}
STYLE = """
body{font:16px/1.55 system-ui,sans-serif;color:#1f2430;background:#fff;max-width:1120px;margin:2.5rem auto;padding:0
1.2rem} h1{font-size:1.7rem;margin-bottom:.2rem}h2{font-size:1.2rem;margin-top:2.2rem}
img{max-width:100%;height:auto;border-radius:6px}
table{border-collapse:collapse;width:100%}th,td{padding:.4rem .7rem;border-bottom:1px solid #e3e6ec;text-align:right}
th:first-child,td:first-child,th:last-child,td:last-child{text-align:left}td:last-child{color:#5b6472;font-size:.92em}
tr.ours{background:#e8f6f8}td.best{font-weight:700}.note{color:#5b6472;font-size:.92em}
"""


def write_report(run: Run, folder: Path) -> Path:
    """Draw the pictures into `folder` and write report.html there; returns its path. Raises OSError."""
    pictures = {"beliefs": _strip(run), "errors": _errors(run), "map": _map(run)}
    for name, picture in pictures.items():
        picture.save(folder / f"{name}.png")
    path = folder / "report.html"
    path.write_text(_page(run, pictures), encoding="utf-8")
    return path


def _strip(run: Run) -> Image:
    panels = []
    for index, what in _highlights(run):
        moment, estimate = run.moments[index], run.estimates[index]
        panorama = moment.panorama(2 * LOOK_ROWS)
        others = {name: run.directions[name][index] for name in ("centroid", "published")}
        panels.append(
            {
                "panorama": panorama // 4 if moment.covered else panorama,
                "belief": run.beliefs[index],
                "estimate": estimate,
                "modes": (),
                "truth": moment.truth,
                "others": others,
                "title": f"{moment.stamp:.1f} s  {what}: {estimate.status}, off by {run.errors[OURS][index]:.0f}°",
            }
        )
    return draw_strip(panels)


def _highlights(run: Run) -> list[tuple[int, str]]:
    """Six moments worth a picture, in time."""
    covered, count = np.flatnonzero(run.covered), len(run.moments)
    seen = [i for i in range(count) if not run.moments[i].covered]
    seam = min(seen[8:-1] or seen, key=lambda i: run.moments[i].truth[0])
    chosen = {seen[0]: "first look", min(count - 1, 5): "a few looks later", seam: "behind the camera"}
    chosen |= {int(covered[0]) - 1: "before the cover", int(covered[-1]): "end of the cover", count - 1: "last look"}
    return sorted(chosen.items())


def _errors(run: Run) -> Image:
    stamps = [moment.stamp for moment in run.moments]
    return draw_errors(stamps, {n: e.tolist() for n, e in run.errors.items()}, [(*stretch(run), "camera covered")])


def _map(run: Run) -> Image:
    found = [
        moment.position + (estimate.distance or 0.0) * (moment.world_R_body @ estimate.direction)
        for moment, estimate in zip(run.moments, run.estimates, strict=True)
    ]
    return draw_map(
        np.array([moment.position for moment in run.moments]),
        np.array([moment.world_R_body[:, 0] for moment in run.moments]),
        np.array(found),
        target=np.array(TARGET.position),
        distractor=np.array([moment.room.balls[1].position for moment in run.moments]),
        hidden=run.covered,
        size=run.moments[0].room.size[:2],
    )


def _page(run: Run, pictures: dict[str, Image]) -> str:
    table = run.table()
    best = {stage: min(row[stage] for row in table.values()) for stage in STAGES}
    rows = []
    for name, row in table.items():
        cells = "".join(f"<td{' class=best' if row[s] == best[s] else ''}>{row[s]:.1f}</td>" for s in STAGES)
        kind = " class=ours" if name == OURS else ""
        rows.append(f"<tr{kind}><td>{html.escape(name)}</td>{cells}<td>{html.escape(METHODS[name])}</td></tr>")
    words = " ".join(html.escape(line) for line in summary(run))
    count, covered, missed = len(run.moments), int(run.covered.sum()), sum(m.missed for m in run.moments)
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>Where is the {QUERY}?</title><style>{STYLE}</style></head><body>
<h1>Where is the {QUERY}?</h1>
<p>A camera walks and turns in a painted room and takes {count} panoramas. Another red ball, smaller, rolls about;
{missed} looks miss everything; during {covered} steps the camera is covered. {words}</p>
<h2>Mean direction error, degrees</h2>
<table><tr><th>method</th><th>all steps</th><th>last third</th><th>covered</th><th>what it is</th></tr>
{"".join(rows)}</table>
<p class="note">Every method had the same evidence: the colour that the query names, found in the pixels. Bold: the
best of its column. Per-frame methods keep their last answer while the camera is covered.</p>
<h2>What the camera saw, and what we believed</h2>
{_embedded(pictures["beliefs"], "Six panoramas with the belief as heat, its 90 percent region, and the answers")}
<h2>Error over time</h2>
{_embedded(pictures["errors"], "Direction error of each method over time")}
<h2>From above</h2>
{_embedded(pictures["map"], "The camera's path, the target, and where we took the target to be")}
<p class="note">Made by eagor {__version__}.</p>
</body></html>
"""


def _embedded(picture: Image, text: str) -> str:
    buffer = io.BytesIO()
    picture.save(buffer, format="PNG", optimize=True)
    data = base64.b64encode(buffer.getvalue()).decode("ascii")
    return f'<img alt="{html.escape(text)}" src="data:image/png;base64,{data}">'

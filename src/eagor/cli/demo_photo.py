"""``eagor demo``: with ``--photo`` a virtual camera turns in a photograph of yours, else it walks in an apartment."""

from __future__ import annotations

import base64
import html
import io
import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eagor._extras import need
from eagor._files import written
from eagor.cli import terminal
from eagor.cli.looking import (
    ShapeError,
    check_looks,
    checked_folder,
    checked_query,
    keep_picture,
    make_perception,
    perception_for,
    read_frame,
)
from eagor.cli.options import Demo
from eagor.cli.shared_options import given
from eagor.drawing.words import in_words
from eagor.perception import short_name
from eagor.sphere import azimuth_elevation

if TYPE_CHECKING:
    from PIL.Image import Image

    from eagor.cli.photo_looks import Looks

AUTO = "auto"  # the default of --perception
NEAR = 15  # degrees
RIVALS = ("centroid", "eagor_paper", "vmf", "particle_filter")  # in the picture, whose legend has no room for more
_HEADS = ("method", "mean angle (°)", "last look (°)", f"within {NEAR}° (%)", "what it is")


def demo(options: Demo) -> int:
    """Run the command; returns its exit code."""
    if options.photo is not None:
        return _photo(options, options.photo)
    if options.query is not None:
        raise terminal.UsageError("--query is for --photo PICTURE; in the apartment the search is chosen by --episode")
    from eagor.cli.demo import demo as walk

    return walk(replace(options, perception="scout" if options.perception == AUTO else options.perception))


def _photo(options: Demo, path: Path) -> int:
    if mistaken := given(options, ("seed", "episode")):
        raise terminal.UsageError(f"--{mistaken[0]} chooses an apartment; leave it out with --photo")
    checked_folder(options.out)
    need("eagor demo --photo", "sim", "jinja2")
    spec = options.perception
    if spec == AUTO:  # without a query the detector chooses one, so it has to be one that knows things
        spec = "coco" if options.query is None else perception_for(checked_query(options.query), None)
    check_looks(spec)
    image = _read(path)
    perception = make_perception(spec)
    from eagor.cli import photo_looks

    query = options.query or photo_looks.best_query(perception, image)
    say = not options.json
    if say:
        print(
            f"A camera turns in {path.name} and looks {photo_looks.LOOKS} times for the {query}, with the perception "
            f"{short_name(spec)}.",
            flush=True,
        )
    with terminal.progress("looking", photo_looks.LOOKS, shown=say) as advance:
        looks = photo_looks.play(image, perception, spec, query, advance)
    report = write_report(looks, spec, path.name, options.out)
    if options.json:
        terminal.emit(as_json(looks, spec, path.name) | {"report": str(report)})
    else:
        print("\n" + "\n".join(as_text(looks)) + "\n\n" + "\n".join(summary(looks)))
        print(f"\nThe report with pictures: {report}")
    return terminal.OK


def _read(path: Path) -> np.ndarray:
    try:
        return read_frame(path).panorama
    except ShapeError as error:
        raise ShapeError(f"{str(error).partition(';')[0]}; wanted a whole panorama: pad it to 2:1 first") from None


def figures(looks: Looks, name: str) -> dict[str, float]:
    """A method's angles (degrees) to our last answer: their mean, the last, and the share (%) within `NEAR` degrees."""
    angles = looks.angles(name)
    return {
        "mean_deg": float(angles.mean()),
        "last_deg": float(angles[-1]),
        f"within_{NEAR}_deg": 100 * float((angles < NEAR).mean()),
    }


def as_text(looks: Looks) -> list[str]:
    """One line per method."""
    lines = [f"{'angle to our last answer':25}{'mean':>8}{'last':>8}{f'within {NEAR}°':>13}"]
    for name in looks.directions:
        mean, last, near = figures(looks, name).values()
        lines.append(f"{name:25}{mean:>6.1f} °{last:>6.1f} °{near:>11.0f} %")
    return lines


def summary(looks: Looks) -> list[str]:
    """The result in sentences."""
    last = looks.estimates[-1]
    azimuth, elevation = map(float, azimuth_elevation(looks.answer))
    seen = sum(count != 0 for count in looks.found)
    found = "a map each time" if looks.found[0] is None else f"it in {seen} of {len(looks.found)} looks"
    turns = f"{looks.crossings} times" if looks.crossings != 1 else "once"
    return [
        f"With the photograph's centre ahead, the {looks.query} is {in_words(azimuth, elevation)} (90 % within "
        f"{math.degrees(last.credible_angle):.0f} degrees); presence {100 * last.presence:.0f} %, {last.status}.",
        f"The detector saw {found}. The camera turned, pitched and rolled; the {looks.query} crossed the seam of the "
        f"picture {turns}.",
        "Nobody has measured where it is. The angles are to our own answer after all looks: they show how steady a "
        "method is, not how right.",
    ]


def as_json(looks: Looks, spec: str, photo: str) -> dict[str, Any]:
    """The result for ``--json``; azimuth and elevation are those in the photograph."""
    azimuth, elevation = np.degrees(azimuth_elevation(looks.answer))
    last = looks.estimates[-1]
    return {
        "query": looks.query,
        "photo": photo,
        "perception": spec,
        "looks": len(looks.poses),
        "seen": list(looks.found),
        "azimuth_deg": round(float(azimuth), 4),
        "elevation_deg": round(float(elevation), 4),
        "credible_angle_deg": round(math.degrees(last.credible_angle), 4),
        "presence": round(last.presence, 6),
        "status": last.status,
        "seam_crossings": looks.crossings,
        "methods": {name: {k: round(v, 4) for k, v in figures(looks, name).items()} for name in looks.directions},
        "summary": summary(looks),
    }


def write_report(looks: Looks, spec: str, photo: str, folder: Path) -> Path:
    """Draw the pictures into `folder` and write report.html there; returns its path. Raises `StorageError`."""
    from eagor.cli.photo_looks import SECONDS
    from eagor.drawing import draw_belief, draw_errors
    from eagor.evaluation.page import Box, Pictures, Row, Section, Sheet, Text, document
    from eagor.evaluation.published import OURS
    from eagor.tasks.methods import DESCRIPTIONS

    names = sorted(looks.directions, key=lambda name: name != OURS)  # ours first: it is drawn on top
    moments = []
    for index, what in highlights(looks):
        estimate, answer = looks.estimates[index], looks.poses[index].T @ looks.answer
        title = f"Look {index + 1}, {what}: {estimate.status}"
        drawn = draw_belief(looks.panorama(index), estimate, others={"last answer": answer}, title=title, width=900)
        keep_picture(drawn, folder / f"look-{index + 1:02}.jpg")
        moments.append((_as_image(drawn, title), f"{title}, {looks.angles(OURS)[index]:.0f}° from the last answer"))
    times = [SECONDS * index for index in range(len(looks.poses))]
    errors = draw_errors(times, {name: looks.angles(name).tolist() for name in names}, title="Angle to our last answer")
    pose = looks.poses[-1]
    rivals = {name: pose.T @ looks.directions[name][-1] for name in RIVALS}
    every = draw_belief(looks.panorama(-1), looks.estimates[-1], others=rivals, title="Methods after the last look")
    keep_picture(errors, folder / "angles.png")
    keep_picture(every, folder / "methods.jpg")
    sheet = Sheet(
        f"Angles to our last answer, over {len(looks.poses)} looks",
        _HEADS,
        tuple(
            Row(name, tuple(_boxes(figures(looks, name), DESCRIPTIONS[name], Box)), "ours" if name == OURS else "")
            for name in looks.directions
        ),
    )
    both = [
        (
            _as_image(errors, "Angle of each method to our last answer, over time"),
            "How steady each method is: no truth is known, so an error here is the angle to our last answer",
        ),
        (
            _as_image(every, "The last look with the direction of each method"),
            "Our estimate at the end, and those of four others",
        ),
    ]
    sections = [
        Section("looks", "What the camera saw, and what we believed", [Pictures(moments, "strip")]),
        Section("methods", "Each method side by side", [sheet, Pictures(both)]),
    ]
    lead = [Text(f"{photo}, seen by {short_name(spec)}. {summary(looks)[0]}"), *map(Text, summary(looks)[1:])]
    return written(folder / "report.html", document(f"Where is the {looks.query}?", lead, sections))


def highlights(looks: Looks) -> list[tuple[int, str]]:
    """At most six looks for pictures, in order of time, each with what is special about it."""
    tilt = [float(pose[2, 2]) for pose in looks.poses]  # cosine of the angle between the body's up and the world's
    azimuth = [abs(float(azimuth_elevation(pose.T @ looks.answer)[0])) for pose in looks.poses]
    chosen = {int(np.argmin(tilt)): "the most tilted", int(np.argmax(azimuth)): "at the seam"}
    missed = [index for index, count in enumerate(looks.found) if count == 0]
    if missed:
        chosen.setdefault(missed[len(missed) // 2], "nothing detected")
    last = len(looks.poses) - 1
    return sorted(({3: "a few looks later"} | chosen | {0: "the first", last: "the last"}).items())[:6]


def _boxes(values: dict[str, float], what: str, box: Any) -> list[Any]:
    mean, last, near = values.values()
    return [box(f"{mean:.1f}"), box(f"{last:.1f}"), box(f"{near:.0f}"), box(what)]


def _as_image(picture: Image, text: str) -> str:
    """An element of a page with the picture in it, as JPEG."""
    buffer = io.BytesIO()
    picture.convert("RGB").save(buffer, format="JPEG", quality=88)
    data = base64.b64encode(buffer.getvalue()).decode("ascii")
    return f'<img alt="{html.escape(text)}" src="data:image/jpeg;base64,{data}" style="width:100%;height:auto">'

"""``eagor camera``: fit lenses, show how they fit, estimate the latency."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import Positional, arg

from eagor.cli import checks, terminal
from eagor.cli.answers import save_image
from eagor.cli.options import Common, Flag, bare, grouped

if TYPE_CHECKING:
    import numpy as np


@dataclass(frozen=True, kw_only=True)
class CameraCalibrate(Common):
    """Fit the lenses of a dual fisheye camera from its pictures, for --rig.

    The lenses are tied together where both see the same. Pictures of a camera that turned in place (--turned) also fix
    the inside of each lens: put it on a tripod, and take 8 or more pictures, 45 degrees apart.
    """

    pictures: Annotated[tuple[str, ...], Positional, arg(metavar="PICTURE ...", help_behavior_hint="(required)")]
    """Pictures with both circles side by side, or FRONT.jpg,BACK.jpg with one each; or one video (--every)."""
    out: Annotated[Path, arg(metavar="FILE.yaml")] = Path("rig.yaml")
    """File for the lenses; other commands take it as --rig."""
    turned: Flag = False
    """The camera turned in place from each picture to the next (on a tripod; things two metres away or farther)."""
    rig: Annotated[Path | None, bare("FILE.yaml")] = None
    """Lenses to begin with, for other layouts than two circles side by side."""
    every: Annotated[float, arg(metavar="SECONDS")] = 2.0
    """Of a video, a picture each so many seconds."""


@dataclass(frozen=True, kw_only=True)
class CameraView(Common):
    """Show a stitched picture, and how far the lenses disagree where both see the same."""

    picture: Annotated[str, Positional, arg(metavar="PICTURE")]
    """A picture of the lenses, FRONT.jpg,BACK.jpg, or a video, of which the first is taken."""
    rig: Annotated[Path | None, bare("FILE.yaml")] = None
    """The lenses (default: two ideal ones of 200 degrees, side by side)."""
    out: Annotated[Path | None, bare("FILE.png")] = None
    """Draw the panorama, above a map of the lenses' difference."""


@dataclass(frozen=True, kw_only=True)
class CameraLatency(Common):
    """Estimate how late a camera's stamps are, from the turns that its pictures and odometry show.

    Turn the robot or camera left and right, briskly, for half a minute.
    """

    source: Annotated[str, Positional, arg(metavar="SOURCE")]
    """A live camera (as for `eagor live`), a video or a folder."""
    poses: Annotated[Path, arg(metavar="CSV")]
    """Odometry of the same time, on the clock of the pictures; of a live camera it is read at the end."""
    rig: Annotated[Path | None, bare("FILE.yaml")] = None
    """The lenses, if the pictures are not panoramas."""
    rate: Annotated[float, arg(metavar="HZ")] = 10.0
    """Pictures per second to look at; of a folder, how many per second were taken."""
    seconds: Annotated[float, arg(metavar="SECONDS")] = 30.0
    """How long to look at a live camera."""
    most: Annotated[float, arg(metavar="SECONDS")] = 1.0
    """The largest latency to consider."""


Camera = grouped("Camera", "Lenses and latency of a camera.", CameraCalibrate, CameraView, CameraLatency)

APART = 1.0  # degrees: a median gap in the overlap above it means that the rig does not fit
IDEAL = 200.0  # degrees across the circles of a camera of which nothing is known


def camera_calibrate(options: CameraCalibrate) -> int:
    """``eagor camera calibrate``."""
    from eagor.sources.calibration import calibrate as fit
    from eagor.sources.rigs import read_rig, write_rig

    out, rig = options.out, options.rig and read_rig(options.rig)
    checks.check_outputs(options, [part for text in options.pictures for part in text.split(",")])
    first, *others = options.pictures
    moments = [next(_pictures(text)) for text in options.pictures] if others else [*_pictures(first, 1 / options.every)]
    with terminal.progress("looking", 2 * len(moments), shown=not options.json) as advance:
        found = fit(moments, rig=rig, turned=options.turned, on_step=advance)
    gap, before = (round(math.degrees(angle), 4) for angle in (found.gap, found.before))
    both, later = found.pairs
    text = f"{both} + {later} pairs, median gap {gap:.3f} degrees (before: {before:.3f})"
    write_rig(found.rig, out, [f"By eagor camera calibrate, from {len(moments)} pictures: {text}."])
    fitted = {"moments": len(moments), "pairs": [both, later], "gap_deg": gap, "before_deg": before}
    terminal.give(
        options.json,
        {"out": str(out), "turned": options.turned} | fitted,
        f"{len(moments)} pictures; seen twice: {both} things by both lenses, {later} in two pictures",
        f"gap between their rays, median: {gap:.3f} deg (before the fit {before:.3f})",
        *(f"  {lens.name:6s} centre {lens.centre[0]:.1f}, {lens.centre[1]:.1f}, {2 * math.degrees(lens.reach):.1f} deg "
          "from rim to rim" for lens in found.rig.lenses),
        f"Written to {out}; other commands take it as --rig {out}",
    )  # fmt: skip
    if not options.turned:
        terminal.warning(
            "the overlap does not tell what is inside the circles, where the lenses are taken to be nearly equidistant "
            "and alike: directions there may be off by degrees. Pictures of a camera that turns in place tell: --turned"
        )
    return terminal.OK


def camera_view(options: CameraView) -> int:
    """``eagor camera view``."""
    import numpy as np
    from PIL import Image

    from eagor.cameras import dual_fisheye
    from eagor.sources.calibration import overlap_of
    from eagor.sources.rigs import read_rig
    from eagor.sources.stitching import sizes_of

    checks.check_outputs(options, options.picture.split(","), picture="", out="picture")
    pictures = next(_pictures(options.picture))
    if options.rig is not None:
        rig = read_rig(options.rig)
    elif len(pictures) > 1:
        raise terminal.UsageError("several pictures of one moment need --rig FILE.yaml, which says where they look")
    else:
        rig = dual_fisheye(*sizes_of(pictures)[0], math.radians(IDEAL))
        terminal.log(f"no --rig: two ideal lenses of {IDEAL:g} degrees are taken, side by side")
    share, gaps, grey, drawn = overlap_of(rig, pictures)
    median, ninety = np.degrees(np.quantile(gaps, [0.5, 0.9])).round(4).tolist() if len(gaps) else (None, None)
    facts = {"overlap": f"{100 * share:.1f} % of the sphere is seen by two lenses"}
    facts["directions"] = "nothing was found that both lenses see"
    if median is not None:
        facts["directions"] = f"{median:.2f} deg apart (median of {len(gaps)} things; 90 % within {ninety:.2f})"
    if grey is not None:
        facts["brightness"] = f"{grey:.1f} grey levels of 255 apart, on average"
    if options.out is not None:
        save_image(Image.fromarray(drawn), options.out)
        facts["drawn"] = f"in {options.out}: the panorama, and below it where the lenses differ"
    told = {"picture": options.picture, "overlap_share": round(share, 5), "points": len(gaps)}
    told |= {"median_deg": median, "ninety_deg": ninety, "grey_levels": grey}
    terminal.give(options.json, told, *terminal.facts(facts))
    if median is not None and median > APART:
        terminal.warning(
            f"the lenses disagree by {median:.1f} degrees: this rig does not fit the camera, or things in the overlap "
            "are nearer than a metre. Fit one: eagor camera calibrate"
        )
    return terminal.OK


def camera_latency(options: CameraLatency) -> int:
    """``eagor camera latency``."""
    from eagor.sources.calibration import check_turning, latency_between, steps_of
    from eagor.sources.camera_sources import open_source
    from eagor.sources.odometry import open_poses

    poses: Any = partial(open_poses, str(options.poses))  # of a live camera they are read at the end
    with closing(open_source(options.source, rig=options.rig, rate=options.rate, rows=512)) as source:
        end = math.inf
        if not source.live:
            check_turning([*poses()])  # what is wrong with it is told before the work
        else:
            terminal.log(f"looking for {options.seconds:g} s: turn the camera left and right, briskly")
            end = time.monotonic() + options.seconds
        with terminal.progress("looking", None) as advance:
            steps = steps_of(takewhile(lambda _: advance() or time.monotonic() <= end, source))
    found = latency_between(steps, [*poses()], most=options.most)
    low, high = found.interval
    values = {"latency_s": found.seconds, "low_s": low, "high_s": high, "correlation": found.correlation}
    rounded: dict[str, Any] = {key: round(value, 5) for key, value in values.items()}
    facts = {
        "latency": f"{found.seconds:.3f} s, with 95 % from {low:.3f} to {high:.3f}",
        "correlation": f"{found.correlation:.2f}, over {found.steps} steps from picture to picture",
    }
    if found.seconds >= 0:
        facts["use"] = f"other commands take it as --latency {found.seconds:.3f}"
    terminal.give(options.json, rounded | {"steps": found.steps}, *terminal.facts(facts))
    if high < 0:
        terminal.warning("pictures come before odometry: it is odometry that is late, or their clocks differ")
    return terminal.OK


def _pictures(text: str, rate: float | None = None) -> Iterator[Sequence[np.ndarray]]:
    """The lenses' pictures of each moment of a video, or of the one moment of PICTURE or FRONT,BACK."""
    from eagor.sources.camera_sources import is_video
    from eagor.sources.panorama import read_stored
    from eagor.sources.video import lens_videos

    paths = [Path(part) for part in ([text] if Path(text).exists() else text.split(","))]
    if is_video(paths, True):
        yield from lens_videos(paths, rate)
    else:
        yield [read_stored(path).picture for path in paths]

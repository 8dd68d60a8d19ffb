"""``eagor camera``: fit lenses, show how they fit, estimate the latency."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from tyro.conf import Positional, arg, subcommand

from eagor.cli import terminal
from eagor.cli.checks import check_not_read, checked_number, checked_out, checked_picture, keep_picture, rig_of
from eagor.cli.options import Common, Flag, bare
from eagor.errors import DeviceError, ImageError

if TYPE_CHECKING:
    import numpy as np

    from eagor.media import Frame
    from eagor.media.rigs import Rig


@dataclass(frozen=True, kw_only=True)
class CameraCalibrate(Common):
    """Fit the lenses of a dual fisheye camera from its pictures, for --rig.

    The lenses are tied together where both see the same. Pictures of a camera that turned in place (--turned) also fix
    the inside of each lens: put it on a tripod, and take 8 or more pictures, 45 degrees apart.
    """

    runs: ClassVar[str] = "calibrate"

    pictures: Annotated[tuple[str, ...], Positional, arg(metavar="PICTURE ...", help_behavior_hint="(required)")]
    (
        "Two or more pictures with both circles, side by side; for a camera that writes one picture per lens, "
        "FRONT.jpg,BACK.jpg with a comma between. Or one video; --every takes pictures of it."
    )
    out: Annotated[Path, arg(metavar="FILE.yaml")] = Path("rig.yaml")
    """File for the lenses; other commands take it as --rig."""
    turned: Flag = False
    """The camera turned in place between the pictures (on a tripod; things two metres away or farther)."""
    field: Annotated[float | None, bare("DEG")] = None
    """The angle across a lens' circle (default: what fits best of 180 to 220)."""
    rig: Annotated[Path | None, bare("FILE.yaml")] = None
    """Lenses to begin with, for other layouts than two circles side by side."""
    every: Annotated[float, arg(metavar="SECONDS")] = 2.0
    """Of a video, a picture each so many seconds."""


@dataclass(frozen=True, kw_only=True)
class CameraView(Common):
    """Show a stitched picture, and how far the lenses disagree where both see the same."""

    runs: ClassVar[str] = "view"

    picture: Annotated[str, Positional, arg(metavar="PICTURE")]
    """A picture of the lenses, FRONT.jpg,BACK.jpg, or a video."""
    rig: Annotated[Path | None, bare("FILE.yaml")] = None
    """The lenses (default: two ideal ones of 200 degrees, side by side)."""
    out: Annotated[Path | None, bare("FILE.png")] = None
    """Draw the panorama with the rims of the lenses, above a map of their difference."""
    stitched: Annotated[Path | None, bare("FILE.png")] = None
    """Write the panorama alone."""
    stamp: Annotated[float, arg(metavar="SECONDS")] = 0.0
    """Of a video, which picture."""
    rows: Annotated[int | None, bare("N")] = None
    """Rows of the panorama (default: as fine as the pictures)."""


@dataclass(frozen=True, kw_only=True)
class CameraLatency(Common):
    """Estimate how late a camera's stamps are, from the turns that its pictures and odometry show.

    Turn the robot or camera left and right, briskly, for half a minute.
    """

    runs: ClassVar[str] = "latency"

    source: Annotated[str, Positional, arg(metavar="SOURCE")]
    """A live camera (as for `eagor live`), a video or a folder."""
    poses: Annotated[Path, arg(metavar="CSV")]
    """Odometry of the same time, on the clock of the pictures (as for `eagor track`); of a live camera it is read at
    the end."""
    rig: Annotated[Path | None, bare("FILE.yaml")] = None
    """The lenses, if the pictures are not panoramas."""
    rate: Annotated[float, arg(metavar="HZ")] = 10.0
    """Pictures per second to look at; of a folder, how many per second were taken."""
    seconds: Annotated[float, arg(metavar="SECONDS")] = 30.0
    """How long to look at a live camera."""
    most: Annotated[float, arg(metavar="SECONDS")] = 1.0
    """The largest latency to consider."""
    level: Flag = False
    """The camera keeps its pictures level; only the heading turns."""


@dataclass(frozen=True, kw_only=True)
class Camera:
    """Lenses and latency of a camera."""

    action: Annotated[
        Annotated[CameraCalibrate, subcommand("calibrate")]
        | Annotated[CameraView, subcommand("view")]
        | Annotated[CameraLatency, subcommand("latency")],
        arg(name=""),
    ]


WANTED = 0.3  # degrees: a lens that is known so well everywhere needs no more pictures
APART = 1.0  # degrees: a median gap in the overlap above it means that the rig does not fit
IDEAL = 200.0  # degrees across the circles of a camera of which nothing is known
LONGEST = 120.0  # seconds between two pictures of a live camera before it is given up


def calibrate(options: CameraCalibrate) -> int:
    """``eagor camera calibrate``."""
    from eagor.media.lens_calibration import ROUNDS
    from eagor.media.lens_calibration import calibrate as fit
    from eagor.media.rigs import write_rig

    if options.field is not None and not 100 <= options.field <= 280:
        raise terminal.UsageError(f"--field {options.field:g}; wanted degrees from rim to rim, 100 to 280")
    if options.field is not None and options.rig is not None:
        raise terminal.UsageError("--field and --rig exclude each other: the rig has a field")
    if not (math.isfinite(options.every) and options.every > 0):
        raise terminal.UsageError(f"--every {options.every:g}; wanted seconds above 0")
    out = checked_out(options.out)
    check_not_read(out, "--out", [Path(part) for text in options.pictures for part in text.split(",")])
    rig = rig_of(options.rig)
    moments = _moments(options.pictures, options.every)
    fov = None if options.field is None else math.radians(options.field)
    with terminal.progress("looking", ROUNDS * len(moments), shown=not options.json) as advance:
        found = fit(moments, rig=rig, fov=fov, turned=options.turned, on_step=advance)
    how = "a camera that turned in place" if options.turned else "the overlap of the lenses alone"
    pairs, gap, before, worst = found.pairs, *(math.degrees(a) for a in (found.gap, found.before, found.worst))
    notes = [
        "The lenses of a camera, by eagor camera calibrate: pixels and degrees.",
        f"From {found.used} pictures of {how}: {pairs[0]} + {pairs[1]} pairs, median gap {gap:.3f} degrees (before: "
        f"{before:.3f}); known to {worst:.2f} degrees.",
    ]
    write_rig(found.rig, out, notes)
    angles = [round(math.degrees(angle), 1) for angle in found.angles]
    named = zip((lens.name for lens in found.rig.lenses), found.spreads, strict=True)
    spreads = {name: [round(math.degrees(value), 4) for value in each] for name, each in named}
    if options.json:
        fitted = {"moments": found.used, "pairs": list(pairs), "gap_deg": round(gap, 5), "before_deg": round(before, 5)}
        known = {"angles_deg": angles, "spreads_deg": spreads, "worst_deg": round(worst, 4)}
        terminal.emit({"out": str(out), "turned": options.turned} | fitted | known)
    else:
        print(f"{found.used} pictures; seen twice: {pairs[0]} things by both lenses, {pairs[1]} in two pictures")
        print(f"gap between their rays, median: {gap:.3f} deg (before the fit {before:.3f})")
        for lens in found.rig.lenses:
            wide = 2 * math.degrees(lens.reach)
            print(f"  {lens.name:6s} centre {_numbers(lens.centre)}, {wide:.1f} deg from rim to rim")
        print("how far directions may be off (standard deviation, degrees) at degrees off the axis:")
        print("  " + f"{'':6s}" + "".join(f"{angle:8.0f}" for angle in angles))
        for name, each in spreads.items():
            print(f"  {name:6s}" + "".join(f"{value:8.3f}" for value in each))
        print(f"Written to {out}; other commands take it as --rig {out}")
    if worst > WANTED:
        advice = (
            "give more pictures, at more headings"
            if options.turned
            else "the overlap does not tell what is inside the circles, where the lenses are taken to be nearly "
            "equidistant and alike. Pictures of a camera that turns in place do: --turned"
        )
        terminal.warning(f"the lenses are known to {worst:.2f} degrees only, wanted {WANTED:g}: {advice}")
    return terminal.OK


def view(options: CameraView) -> int:
    """``eagor camera view``."""
    import numpy as np
    from PIL import Image

    from eagor.media.footage import is_video
    from eagor.media.lens_calibration import overlap_of, with_seam
    from eagor.media.rigs import dual_fisheye
    from eagor.media.stitching import Stitcher

    inputs = [Path(part) for part in options.picture.split(",")]
    for option, path in (("--out", options.out), ("--stitched", options.stitched)):
        if path is not None:
            check_not_read(path, option, inputs)
            checked_picture(path)
    checked_number(options.rows, "--rows")
    rig = rig_of(options.rig)
    pictures = list(next(_film(inputs, rig, options.stamp))) if is_video(inputs, True) else _read(options.picture)
    if rig is None:
        if len(pictures) > 1:
            raise terminal.UsageError("several pictures of one moment need --rig FILE.yaml, which says where they look")
        rig = dual_fisheye(pictures[0].shape[1], pictures[0].shape[0], math.radians(IDEAL))
        terminal.log(f"no --rig: two ideal lenses of {IDEAL:g} degrees are taken, side by side")
    found = overlap_of(rig, pictures, options.rows)
    if options.out is not None:
        keep_picture(Image.fromarray(with_seam(rig, pictures, options.rows)), options.out)
    if options.stitched is not None:
        sizes = tuple((picture.shape[1], picture.shape[0]) for picture in pictures)
        own = rig.scaled(rig.factor_of(sizes, options.picture))
        keep_picture(Image.fromarray(Stitcher(own, options.rows).stitch(*pictures)), options.stitched)
    gaps = np.degrees(found.gaps)
    median, ninety = (None, None) if len(gaps) == 0 else (float(q) for q in np.quantile(gaps, [0.5, 0.9]))
    if options.json:
        fields = {"points": len(gaps), "median_deg": median, "ninety_deg": ninety, "grey_levels": found.grey}
        told = {key: round(value, 4) if isinstance(value, float) else value for key, value in fields.items()}
        terminal.emit({"picture": options.picture, "overlap_share": round(found.share, 5)} | told)
        return terminal.OK
    print(f"overlap      {100 * found.share:.1f} % of the sphere is seen by two lenses")
    if median is None:
        print("directions   nothing was found that both lenses see")
    else:
        print(f"directions   {median:.2f} deg apart (median of {len(gaps)} things; 90 % within {ninety:.2f})")
    if found.grey is not None:
        print(f"brightness   {found.grey:.1f} grey levels of 255 apart, on average")
    if options.out is not None:
        print(f"Drawn in {options.out}: the rims of the lenses, and below where they differ")
    if median is not None and median > APART:
        terminal.warning(
            f"the lenses disagree by {median:.1f} degrees: this rig does not fit the camera, or things in the overlap "
            "are nearer than a metre. Fit one: eagor camera calibrate"
        )
    return terminal.OK


def latency(options: CameraLatency) -> int:
    """``eagor camera latency``."""
    from eagor.media.camera_sources import open_source
    from eagor.media.latency import check_turning, latency_between, steps_of
    from eagor.media.odometry import open_poses

    for name in ("rate", "seconds", "most"):
        if not (math.isfinite(value := getattr(options, name)) and value > 0):
            raise terminal.UsageError(f"--{name} {value:g}; wanted a number above 0")
    given: Any = open_poses(str(options.poses))
    poses = [*given]
    source = open_source(options.source, rig=options.rig, rate=options.rate, rows=512, stitched=True)
    try:
        if not source.live:
            check_turning(poses)  # what is wrong with it is told before the work
        else:
            terminal.log(f"looking for {options.seconds:g} s: turn the camera left and right, briskly")
        steps = steps_of(_for_a_while(source, options.seconds), level=options.level)
    finally:
        source.close()
    found = latency_between(steps, poses, most=options.most)
    low, high = found.interval
    if options.json:
        told = {"latency_s": found.seconds, "low_s": low, "high_s": high, "correlation": found.correlation}
        rounded: dict[str, Any] = {key: round(value, 5) for key, value in told.items()}
        terminal.emit(rounded | {"steps": found.steps, "mirrored": found.mirrored})
    else:
        print(f"latency      {found.seconds:.3f} s, with 95 % from {low:.3f} to {high:.3f}")
        print(f"correlation  {found.correlation:.2f}, over {found.steps} steps from picture to picture")
        if found.seconds >= 0:
            print(f"Other commands take it as --latency {found.seconds:.3f}")
    if found.mirrored:
        terminal.warning(
            "the pictures turn the other way than odometry: the camera is upside down, its pictures are mirrored, or "
            "odometry's yaw is positive to the right"
        )
    if found.seconds < 0 and high < 0:
        terminal.warning("pictures come before odometry: it is odometry that is late, or their clocks differ")
    return terminal.OK


def _for_a_while(source: Any, seconds: float) -> Iterator[Frame]:
    """The frames; of a live source, those of so many seconds. Shows progress."""
    begin = time.monotonic()
    with terminal.progress("looking", None) as advance:
        for frame in source:
            yield frame
            advance()
            if source.live and time.monotonic() - begin > seconds:
                return
            if source.live and source.problem is not None and time.monotonic() - begin > LONGEST:
                raise DeviceError(source.problem)


def _moments(texts: Sequence[str], every: float) -> list[tuple[np.ndarray, ...]]:
    """The pictures of each moment: of files, or of one video every so many seconds."""
    from eagor.media.footage import is_video

    first = [Path(part) for part in texts[0].split(",")]
    if len(texts) == 1 and is_video(first, True):
        return list(_film(first, None, 0.0, 1 / every))
    return [tuple(_read(text)) for text in texts]


def _film(
    paths: Sequence[Path], rig: Rig | None, start: float, rate: float | None = None
) -> Iterator[tuple[np.ndarray, ...]]:
    """The lenses' pictures of a video, from `start` on."""
    from eagor.media.rig_videos import lens_videos

    count = 0
    for frames in lens_videos(paths, None if rig is None else len(rig.sizes), rate=rate, start=start):
        count += 1
        yield tuple(frame.picture for frame in frames)
    if not count:
        raise ImageError(f"{paths[0]} has no picture from {start:g} s on")


def _read(text: str) -> list[np.ndarray]:
    """The picture in a file, or those of FRONT,BACK."""
    import warnings

    from eagor.media.panorama import read_panorama

    paths = [text] if Path(text).exists() else text.split(",")
    with warnings.catch_warnings():  # of shapes: they are no panoramas
        warnings.simplefilter("ignore")
        return [read_panorama(path) for path in paths]


def _numbers(values: Sequence[float]) -> str:
    return ", ".join(f"{value:.1f}" for value in values)

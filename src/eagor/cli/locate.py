"""``eagor locate``: one picture, one look, one answer."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from tyro.conf import Positional, arg

from eagor.cli import terminal
from eagor.cli.answers import table
from eagor.cli.checks import (
    check_not_read,
    checked_number,
    checked_picture,
    checked_query,
    keep_picture,
    make_perception,
    mask_of,
    ordinary,
    perception_for,
    places_of,
    rig_of,
    say_of_replay,
    say_of_video,
    tracker_config,
    warn_of_detector,
)
from eagor.cli.options import (
    CameraFile,
    Common,
    Detector,
    Eyes,
    Floor,
    Force,
    Hfov,
    Mask,
    Modes,
    Out,
    RigFile,
    Whole,
    bare,
)

if TYPE_CHECKING:
    from eagor.media.panorama import Picture
    from eagor.perception import Perception
    from eagor.tracking.estimate import Estimate


@dataclass(frozen=True, kw_only=True)
class Locate(Common):
    """Find the direction of an object in one picture: a panorama, or one of an ordinary camera."""

    runs: ClassVar[str] = "locate"

    file: Annotated[str, Positional, arg(metavar="PICTURE")]
    (
        "An equirectangular image, an ordinary picture (--hfov, --camera), or a video; its centre is forward. Of a rig "
        "with several cameras FRONT,BACK: a picture or a video of each."
    )
    query: Annotated[str, Positional, arg(metavar="QUERY")]
    """What to look for, in words."""
    perception: Annotated[str | None, bare("NAME")] = None
    (
        "The detector (default: coco, or colour for a bare colour such as 'red'): colour (the colour that the query "
        "names; colour:rows=512 for things of 1 degree), "
        "coco (a small network for everyday things, `eagor models get coco`), "
        "replay:FILE.jsonl (output of any detector), onnx:MODEL.onnx (a detector's file, options after ?), "
        "my.py:FUNCTION (a function of yours), a model "
        "(FOLDER, Qwen/Qwen2.5-VL-7B-Instruct, endpoint:MODEL@http://HOST:PORT/v1, options after ?), or an installed "
        "one; `eagor doctor` lists them."
    )
    modes: Modes = 10
    floor: Floor = None
    degree: Whole = 15
    """Degree of the spherical harmonics, 1 to 63; the resolution is about 180 / N degrees."""
    calibration: Annotated[Path | None, bare("FILE.json")] = None
    """Calibration of the perception, from `eagor calibrate`."""
    detector: Detector = None
    stamp: Annotated[float | None, bare("SECONDS")] = None
    """Time of the replay record to use (default: the first record for this query), or of a video's frame."""
    picture: Annotated[Path | None, bare("FILE.png")] = None
    """Draw the belief over the picture."""
    out: Out = None
    hfov: Hfov = None
    camera: CameraFile = None
    eyes: Eyes = None
    mask: Mask = None
    rig: RigFile = None
    force: Force = False


NEAR = 15  # degrees: the error that still leads a person to the object


def locate(options: Locate) -> int:
    """Run the command; returns its exit code."""
    import numpy as np

    from eagor.perception.recordings import HiddenParts
    from eagor.perception.replay import ReplayPerception, look
    from eagor.tracking.follower import Follower

    query = checked_query(options.query)
    spec = perception_for([query], options.perception)
    checked_number(options.modes, "--modes")
    places = places_of([options.file], options.rig is not None)
    check_not_read(options.picture, "--picture", places)
    check_not_read(options.out, "--out", places)
    config = tracker_config(options.degree, spec, options.calibration, options.detector, options.force)
    config = replace(config, floor_height=_checked_floor(options.floor))
    if options.picture is not None:
        checked_picture(options.picture)
    with table(options.out) if options.out is not None else nullcontext() as write:
        perception, stamp = make_perception(spec, busy=True), options.stamp
        masks = [] if (mask := mask_of(options.mask)) is None else [mask]
        if stamp is None:  # a replay answers at its own times
            records = perception.records if isinstance(perception, ReplayPerception) else ()
            stamp = next((record.stamp for record in records if record.answers(query)), 0.0)
        frame, hidden = _frame(options, places, perception), HiddenParts(masks, terminal.log)
        looks = hidden.covered(look(perception, frame.picture, query, stamp, frame.level_R_body, frame.grid), frame)
        warn_of_detector(options.detector, looks)
        follower, stamps = Follower(config), sorted({float(evidence.stamp or 0.0) for evidence in looks})
        if options.floor is not None:  # the camera is where heights are counted from
            for at in stamps:
                follower.move(at, np.eye(3), np.zeros(3))
        for evidence in looks:
            follower.look(evidence)
        estimate = follower.estimate(stamps[-1])
        if options.picture is not None:
            _draw(options, frame, estimate)
        found = {
            "query": options.query, "perception": spec, "frame": _name(places),
            **estimate.as_dict(options.modes, NEAR),
        }  # fmt: skip
        if write is not None:
            write(found)
    say_of_replay(perception, query, len(looks))
    if options.json:  # with the source that the looks name (model, pixels, tokens, milliseconds), if any
        source = next((evidence.source for evidence in looks if evidence.source is not None), None)
        terminal.emit(found | ({} if source is None else {"source": dict(source)}))
    else:
        _print(options, _name(places), spec, estimate)
    return terminal.OK


def _frame(options: Locate, places: Sequence[Path], perception: Perception) -> Picture:
    """The photograph, or the frame of a video at ``--stamp`` seconds."""
    from eagor.media.films import open_video
    from eagor.media.footage import LEAST_ROWS, FrameCheck, is_video
    from eagor.media.panorama import Picture
    from eagor.perception import rows_of

    rig, camera = rig_of(options.rig), ordinary(options.hfov, options.camera, options.rig, eyes=options.eyes)
    check = FrameCheck(options.force, terminal.log, camera, rig)
    if not is_video(places, rig is not None):
        return check.read(*places)
    rows = max(rows_of(perception), LEAST_ROWS)
    video = open_video(places, rig, start=options.stamp or 0.0, rows=rows)
    say_of_video(places[0].name, video.facts, video.duration)
    first = next(iter(video))
    return check(Picture(first.picture, video.unseen, video.level_R_body), first.name, video.hint)


def _name(places: Sequence[Path]) -> str:
    return ", ".join(place.name for place in places)


def _checked_floor(floor: float | None) -> float | None:
    """``--floor``, if it is below the camera; else raises `UsageError`."""
    if floor is not None and not (math.isfinite(floor) and floor < 0):
        raise terminal.UsageError(
            f"--floor {floor:g}: the camera of locate is at height 0; wanted a floor below it, such as -1.3"
        )
    return floor


def _print(options: Locate, name: str, spec: str, estimate: Estimate) -> None:
    from eagor.drawing.style import answer_in_words, far_in_words, signed, status_in_words
    from eagor.perception import short_name

    known = estimate.direction is not None
    print(f"{options.query}, in {name}, as {short_name(spec)} sees it")
    print(f"  status          {estimate.status}: {status_in_words(estimate.status, estimate.presence)}")
    print(f"  direction       {answer_in_words(estimate).removeprefix('direction ')}")
    if known:
        print(f"  azimuth         {signed(estimate.azimuth)} deg (positive to the left)")
        print(f"  elevation       {signed(estimate.elevation)} deg")
        cone = f"{math.degrees(estimate.credible_angle):.1f} deg"
        several = estimate.status == "ambiguous" and len(estimate.modes) > 1
        why = "it reaches from one candidate to others" if several else "looks that agree narrow it"
        print(f"  credible angle  {cone} (a cone about it that holds 90 %; {why})")
    if options.floor is not None:
        print(f"  distance        {far_in_words(estimate) or '-'} (90 %, if it stands on the floor)")
    print(f"  presence        {100 * estimate.presence:.0f} %")
    if known:
        near = f"{100 * estimate.within(math.radians(NEAR)):.0f} %"
        print(f"  how sure        {near} (that it is here, and within {NEAR} degrees of that direction)")
        _print_modes(estimate, options.modes)


def _print_modes(estimate: Estimate, count: int) -> None:
    """Print the candidates and the remaining probability."""
    from eagor.drawing.style import in_words, signed

    shown = estimate.modes[:count]
    print("  candidates      azimuth elevation  weight (probability that it is thereabouts, if it is here)")
    for mode in shown:
        angles, words = f"{signed(mode.azimuth):>7} {signed(mode.elevation):>9}", in_words(mode.azimuth, mode.elevation)
        print(f"                  {angles} {100 * mode.weight:5.0f} %  {words}")
    elsewhere = max(0.0, 1 - sum(mode.weight for mode in shown))
    print(f"                  {'':17} {100 * elsewhere:5.0f} %  elsewhere")


def _draw(options: Locate, frame: Picture, estimate: Estimate) -> None:
    from eagor.drawing import draw_belief
    from eagor.drawing.style import answer_in_words

    assert options.picture is not None
    title = f"“{options.query}”: {answer_in_words(estimate)} ({estimate.status})"
    modes = [mode.direction for mode in estimate.modes[: options.modes]]
    drawn = draw_belief(frame.picture, estimate, modes=modes, title=title, grid=frame.grid)
    keep_picture(drawn, options.picture)

"""An estimate as a step of the page: JSON, and the coefficients of its belief."""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
from PIL import Image

from eagor.drawing.style import answer_in_words, far_in_words, status_in_words
from eagor.drawing.view import Mosaic
from eagor.evidence import Calibration, Evidence
from eagor.grids import PerspectiveGrid
from eagor.harmonics import RealHarmonics
from eagor.lab.worlds.render import Photograph
from eagor.live.events import FrameCame
from eagor.sphere import angular_distance
from eagor.studio.density import DEGREE, MASS, Density, density_of
from eagor.studio.messages import Blob, jpeg, rounded, webp
from eagor.tracking import Estimate, Surroundings, TrackerConfig

__all__ = [
    "FLOATS", "LISTED", "Listing", "belief_in_json", "belief_of", "believed", "calibration_of", "error_deg",
    "estimate_json", "evidence_of", "lens_of", "scene_of", "seen_webp", "shown_jpeg", "small_jpeg",
]  # fmt: skip

FLOATS = "float32"


def estimate_json(estimate: Estimate, entropy: float) -> dict[str, Any]:
    """The answer, in the body frame; angles in radians."""
    e = estimate
    known = e.direction is not None
    near = known and e.status != "searching"
    return rounded(
        {
            "direction": e.direction,
            "azimuth": e.azimuth,
            "elevation": e.elevation,
            "credible_angle": e.credible_angle if known else None,
            "presence": e.presence,
            "entropy": entropy,
            "sure": e.sureness if known else None,
            "distance": e.distance if near else None,
            "distance_spread": e.distance_spread if near else None,
            "moving": e.moving,
            "status": e.status,
            "words": in_words(e),
            **({"looked_for": e.looked_for} if e.looked_for else {}),
        }
    )


def in_words(estimate: Estimate) -> str:
    """The answer in a sentence: where, how far, how sure."""
    e = estimate
    where, far = answer_in_words(e), far_in_words(e)
    cone = [] if e.direction is None else [e.certainty]
    parts = [where, *([f"{far} away"] if far else []), *cone]
    meaning = status_in_words(e.status, e.presence)
    said = f"{', '.join(parts)}. Presence {100 * e.presence:.0f} %, {e.status}: {meaning}."
    return said[0].upper() + said[1:]


def modes_json(estimate: Estimate) -> list[dict[str, Any]]:
    """The candidates, heaviest first, in the body frame."""
    return [{"direction": rounded(mode.direction), "weight": rounded(mode.weight)} for mode in estimate.modes]


def belief_of(estimate: Estimate, stamp: float, degree: int = DEGREE) -> tuple[dict[str, Any], bytes]:
    """The belief of an estimate in world axes: what the header says of it, and its coefficients."""
    density = density_of(estimate.posterior, degree)
    mode = estimate.world_R_body @ estimate.modes[0].direction if estimate.modes else None
    return belief_json(density, stamp, mode), density.blob


def belief_json(density: Density, stamp: float, mode: np.ndarray | None) -> dict[str, Any]:
    """What the header says of a density; `mode` ``(3,)``: its heaviest candidate, in world axes."""
    return {
        "frame": "world",
        "stamp": rounded(stamp),
        "mass": MASS,
        "level": float(f"{density.level:.6g}"),
        "undrawn": density.undrawn,
        "mode": rounded(mode),
        "terms": [{"weight": float(f"{term.weight:.6g}"), "degree": term.degree} for term in density.terms],
    }


def evidence_of(
    evidence: Evidence, world_R_body: np.ndarray, stamp: float, degree: int = DEGREE
) -> tuple[dict[str, Any], Blob]:
    """A look's log-likelihood ratio in world axes: what the header says of it, and its coefficients."""
    basis = RealHarmonics(degree)
    turned = np.asarray(basis.rotate(np.asarray(evidence.coefficients(degree)), world_R_body))
    header = {"degree": degree, "frame": "world", "stamp": rounded(stamp)}
    return header, Blob(FLOATS, turned.astype("<f4").tobytes())


def believed(
    estimate: Estimate,
    stamp: float,
    position: np.ndarray | None,
    truth: np.ndarray | None = None,
    entropy: float | None = None,
) -> dict[str, Any]:
    """The part of a step that says what is believed from where. `truth`: the true direction ``(3,)``, body frame.

    `entropy` of the belief, where it has been computed already.
    """
    entropy = estimate.posterior.entropy() if entropy is None else entropy
    return {
        "stamp": rounded(stamp),
        "world_R_camera": rounded(estimate.world_R_body.reshape(9), 6),
        "position": rounded(position, 4),
        "look": {"age": rounded(estimate.age, 3), "fresh": False},
        "estimate": estimate_json(estimate, entropy),
        "modes": modes_json(estimate),
        "truth": {"direction": rounded(truth)},
        "error_deg": error_deg(estimate.direction, truth),
    }


def belief_in_json(estimate: Estimate, stamp: float, degree: int) -> dict[str, Any]:
    """The belief as `belief_of`, with its coefficients in the header."""
    header, coefficients = belief_of(estimate, stamp, degree)
    return header | {"coefficients": base64.b64encode(coefficients).decode("ascii")}


LISTED = 12  # things, the surest


class Listing:
    """What else is here, in JSON, with directions in world axes. A call makes one row anew: each takes a moment."""

    def __init__(self) -> None:
        self.rows: list[dict[str, Any]] = []  # the surest first
        self._turn = 0

    def renew(self, around: Surroundings, now: float) -> list[dict[str, Any]]:
        """The `LISTED` surest rows, after the next in turn is that of the time `now`."""
        names = around.names
        kept = {row["query"]: row for row in self.rows if row["query"] in names}
        if names:
            self._turn = (self._turn + 1) % len(names)
            thing = around.thing(names[self._turn], now)
            e = thing.estimate
            kept[thing.query] = {
                "query": thing.query,
                "direction": None if e.direction is None else rounded(e.world_R_body @ e.direction),
                "sure": rounded(thing.sure, 3),
                "seen": thing.looks,
                "of": thing.among,
            }
        self.rows = sorted(kept.values(), key=lambda row: -row["sure"])
        return self.rows[:LISTED]


def scene_of(view: str, title: str, query: str, **about: Any) -> dict[str, Any]:
    """What is shown, as the page is told before the steps; `about`: what is not as in most scenes."""
    most = {"question": 0, "targets": [], "plan": None, "degree": DEGREE, "calibration": None, "perception": ""}
    return {"view": view, "title": title, "query": query, **most, "methods": [], "region": MASS, **about}


def small_jpeg(panorama: np.ndarray, rows: int) -> bytes:
    """A panorama ``(H, W, 3)`` uint8 as JPEG, shrunk to so many rows if it has more."""
    return jpeg(_small(panorama, rows))


def _small(panorama: np.ndarray, rows: int) -> np.ndarray:
    small = Photograph(panorama).panorama((0.0, 0.0, 0.0), np.eye(3), min(rows, panorama.shape[0])).rgb
    assert small is not None
    return small


def lens_of(grid: PerspectiveGrid | None) -> dict[str, Any] | None:
    """What a scene says of an ordinary camera: tangents of its half fields, and where it looks; None for a panorama."""
    if grid is None:
        return None
    wide = math.tan(grid.hfov / 2)
    return rounded({"plane": [wide, wide * grid.height / grid.width], "body_R_view": grid.body_R_view.reshape(9)}, 6)


def shown_jpeg(picture: np.ndarray, grid: PerspectiveGrid | None, rows: int) -> bytes:
    """A picture as JPEG, with so many rows at most: an ordinary camera's as the ideal lens of `lens_of` shows it.

    `grid`: its pixels; None: it is a panorama.
    """
    if grid is None:
        return small_jpeg(picture, rows)
    height = min(rows, grid.height)
    width = max(1, round(grid.width * height / grid.height))
    small = np.asarray(Image.fromarray(np.ascontiguousarray(picture)).resize((width, height), Image.Resampling.BOX))
    if grid.optics is not None:  # the page knows no distortion
        ideal = PerspectiveGrid(height, width, grid.hfov, grid.body_R_view)
        x, y, inside = grid.resized(height, width).project(ideal.directions)
        row, column = y.astype(int).clip(0, height - 1), x.astype(int).clip(0, width - 1)
        small = np.where(inside[..., None], small[row, column], 0).astype(np.uint8)
    return jpeg(small)


def seen_webp(event: FrameCame, rows: int) -> bytes:
    """What a camera saw, as a panorama in its own axes, WebP; around an ordinary camera's picture nothing is seen."""
    assert event.picture is not None
    if event.grid is None:
        return webp(_small(event.picture, rows))
    around = Mosaic(rows)
    around.add(event.picture, event.grid, np.eye(3))
    return webp(around.colours)


def error_deg(direction: np.ndarray | None, truth: np.ndarray | None) -> float | None:
    """The angle between an answer and the truth, degrees; None where either is not known."""
    if direction is None or truth is None:
        return None
    return round(math.degrees(float(angular_distance(direction, truth))), 2)


def calibration_of(perception: Any, config: TrackerConfig) -> dict[str, Any]:
    """How looks are read, in words and numbers: by the tracker's settings, else as the perception reads itself."""
    detector = config.detector or getattr(perception, "detector", None)
    calibration = config.calibration or getattr(perception, "calibration", None)
    source = "from the settings of this run" if config.detector or config.calibration else "the perception's own"
    if detector is not None:
        return {"words": f"Detections, read with a model of the detector ({source}).", "numbers": _numbers(detector)}
    if calibration is None:
        calibration, source = Calibration(), "the default"
    words = (
        f"Response maps, read with a calibration ({source}): evidence is temperature x log((response + floor) / "
        "(neutral + floor))."
    )
    return {"words": words, "numbers": _numbers(calibration)}


def _numbers(settings: Any) -> dict[str, Any]:
    found: Mapping[str, Any] = asdict(settings)
    return {
        key.replace("_", " "): rounded(value) if isinstance(value, float | int) else str(value)
        for key, value in found.items()
        if value is not None
    }

"""What a page is told of an answer: numbers, the belief as an 8-bit picture with the border of its region, pictures."""

from __future__ import annotations

import io
import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from PIL import Image

from eagor.drawing.heat import heat_of
from eagor.evidence import Evidence
from eagor.grids import PatchGrid, PerspectiveGrid
from eagor.harmonics import RealHarmonics
from eagor.sources.panorama import shrunk
from eagor.sphere import angular_distance
from eagor.studio.messages import rounded
from eagor.tracking import Estimate

__all__ = [
    "belief_of", "evidence_of", "lens_of", "media_type", "picture_of", "plan_of", "scene_of", "step_of",
]  # fmt: skip

MASS = 0.9  # of the region that is drawn
BINS = 64  # of azimuth
HEAT_ROWS, FINE_ROWS, SMALL = 180, 360, 0.008  # the latter for a region of so few steradians
LONGEST = 240  # points of a line
DEGREE, EVIDENCE_ROWS = 15, 64  # of what one look says
QUALITY = 80  # of JPEG and WebP


def step_of(
    estimate: Estimate, stamp: float, position: np.ndarray | None = None, truth: np.ndarray | None = None
) -> dict[str, Any]:
    """What is believed from where. `truth`: the true direction ``(3,)``, body frame.

    The estimate is as it is written everywhere, and has its entropy, how sure it is, and the chance that it moves.
    `around`: the share of the belief about each of `BINS` azimuths, body frame, from ahead to the left.
    """
    e, belief = estimate, estimate.posterior
    unknown = e.direction is None
    more = {"entropy": belief.entropy(), "sure": None if unknown else e.confidence, "moving": e.moving}
    return rounded(
        {
            "stamp": stamp,
            "world_R_camera": e.world_R_body.reshape(9),
            "position": position,
            "look": {"age": e.age, "fresh": False},
            "estimate": e.as_dict() | more,
            "around": _around(belief.parts[2] @ e.world_R_body, belief.mass),
            "truth": truth,
            "error_deg": None
            if unknown or truth is None
            else math.degrees(float(angular_distance(e.direction, truth))),
        }
    )


def _around(directions: np.ndarray, mass: np.ndarray) -> np.ndarray:
    """Probabilities ``(n,)`` at directions ``(n, 3)`` by azimuth ``(BINS,)``: each shared between the two nearest."""
    place = np.arctan2(directions[:, 1], directions[:, 0]) % math.tau * (BINS / math.tau)
    first = place.astype(np.intp)
    low = np.bincount(first % BINS, mass * (1 - place + first), BINS)
    return low + np.bincount((first + 1) % BINS, mass * (place - first), BINS)


def belief_of(estimate: Estimate) -> tuple[dict[str, Any] | None, bytes]:
    """The belief in world axes: what the header says of it, and the heat, 0 to 255, as PNG; None while uniform.

    The header has the border of the region that holds `MASS` as lines of azimuth and elevation, degrees, and
    `undrawn`: why there is none, empty if there is.
    """
    rows = FINE_ROWS if estimate.region(MASS)[1] < SMALL else HEAT_ROWS
    heat = heat_of(estimate.turned(estimate.stamp, np.eye(3), estimate.spread), rows)
    if heat is None:
        return None, b""
    glow = heat.contrast**2 * heat.share  # a belief that is nearly uniform hardly glows
    lines = [line[:: max(1, len(line) // LONGEST)] for line in heat.border]
    return {"border": rounded(lines, 2), "undrawn": heat.missing}, _grey(255 * glow)


def evidence_of(evidence: Evidence, world_R_body: np.ndarray) -> bytes:
    """What one look says, in world axes, as PNG: 127.5 where it says nothing, more where the target is likelier."""
    basis = RealHarmonics(DEGREE)
    turned = basis.rotate(np.asarray(evidence.coefficients(DEGREE)), world_R_body)
    values = np.asarray(basis.synthesise(turned, PatchGrid(EVIDENCE_ROWS, 2 * EVIDENCE_ROWS)))
    return _grey(127.5 + 127.5 * np.sign(values) * np.sqrt(np.abs(values) / max(float(np.abs(values).max()), 1e-3)))


def _grey(values: np.ndarray) -> bytes:
    return _encoded(np.rint(values).astype(np.uint8), "PNG")


def picture_of(picture: np.ndarray, grid: PerspectiveGrid | None, rows: int, kind: str = "JPEG") -> bytes:
    """A picture as JPEG or WEBP (half the bytes, and more time), with so many rows at most.

    An ordinary camera's, whose pixels are `grid`, is as the ideal lens of `lens_of` shows it; None: a panorama.
    """
    if grid is None:
        return _encoded(shrunk(picture, min(rows, len(picture))), kind)
    height = min(rows, grid.height)
    width = max(1, round(grid.width * height / grid.height))
    small = np.asarray(Image.fromarray(np.ascontiguousarray(picture)).resize((width, height), Image.Resampling.BOX))
    if grid.optics is not None:  # the page knows no distortion
        ideal = PerspectiveGrid(height, width, grid.hfov, grid.body_R_view)
        x, y, inside = grid.resized(height, width).project(ideal.directions)
        row, column = y.astype(int).clip(0, height - 1), x.astype(int).clip(0, width - 1)
        small = np.where(inside[..., None], small[row, column], 0).astype(np.uint8)
    return _encoded(small, kind)


def _encoded(picture: np.ndarray, kind: str) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, kind, quality=QUALITY)
    return buffer.getvalue()


def media_type(picture: bytes) -> str:
    """The media type of a picture by its first bytes."""
    return {b"RIFF": "image/webp", b"\x89PNG": "image/png"}.get(picture[:4], "image/jpeg")


def lens_of(grid: PerspectiveGrid | None) -> dict[str, Any] | None:
    """What a scene says of an ordinary camera: tangents of its half fields, and where it looks; None for a panorama."""
    if grid is None:
        return None
    wide = math.tan(grid.hfov / 2)
    return rounded({"plane": [wide, wide * grid.height / grid.width], "body_R_view": grid.body_R_view.reshape(9)}, 6)


def scene_of(title: str, query: str, **about: Any) -> dict[str, Any]:
    """What is shown, as the page is told before the steps; `about`: what is not as in most scenes."""
    return {"title": title, "query": query, "question": 0, "targets": [], "plan": None, "methods": [], "region": MASS,
            "perception": "", **about}  # fmt: skip


def plan_of(place: Any, targets: Iterable[str]) -> dict[str, Any]:
    """The plan of an `eagor.lab.envs.places.Place`, metres: walls and floor as closed lines, things as boxes.

    `targets`: the names of things that are looked for.
    """
    from eagor.lab.worlds.scene import STRUCTURE

    ground, names, unshown = place.ground, set(targets), (*STRUCTURE, "ceiling lamp", "rug", "curtain")
    things = [
        {"low": rounded(each.low[:2], 3), "high": rounded(each.high[:2], 3), "target": each.name in names}
        for each in place.scene.instances
        if each.category not in unshown
    ]
    return {"walls": _outlines(ground.structure, ground), "floor": _outlines(ground.free, ground), "things": things}


def _outlines(mask: np.ndarray, ground: Any) -> list[Any]:
    """The borders of the True cells of a mask ``(rows, cols)`` of the ground, metres, without points on the way."""
    from contourpy import contour_generator

    lines = []
    for line in map(np.asarray, contour_generator(z=np.pad(np.asarray(mask, dtype=float), 1)).lines(0.5)):
        steps = np.diff(line, axis=0)
        corners = np.any(np.abs(steps - np.roll(steps, 1, axis=0)) > 1e-9, axis=1)
        lines.append(rounded(ground.origin + (np.append(line[:-1][corners], line[:1], axis=0) - 0.5) * ground.cell, 3))
    return lines

"""Metrics of a run: direction errors, consistency over time, navigation success, calibration of the uncertainty.

Directions are unit vectors in the body frame (x forward, y left, z up), step k in the frame of step k. Errors are in
degrees, as in reports; everything else is in radians and metres. A mean over no cases is None, never NaN.
All functions raise `DirectionError` or `RotationError` for bad vectors and matrices, and `EagorError` for other input
that is empty, not finite, or does not fit. Intervals and tests are in `eagor.statistics`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from eagor.errors import DirectionError, EagorError
from eagor.sphere import angular_distance, check_rotation, unit
from eagor.statistics import finite_values, outcomes, same_length

__all__ = [
    "angular_error_deg", "ego_motion", "mean_error", "seam_crossings", "soft_spl", "spl", "success",
    "temporal_consistency",
]  # fmt: skip


def angular_error_deg(estimates: ArrayLike, truths: ArrayLike) -> np.ndarray:
    """Great-circle angle in degrees between `estimates` and `truths` ``(..., 3)``, broadcast."""
    a, b = _directions(estimates, "estimates"), _directions(truths, "truths")
    try:
        np.broadcast_shapes(a.shape, b.shape)
    except ValueError:
        raise DirectionError(
            f"estimates {a.shape} and truths {b.shape} do not fit; pass one truth for each, or one (3,) for all"
        ) from None
    return np.degrees(angular_distance(a, b))


def mean_error(errors: ArrayLike, where: ArrayLike | None = None) -> float | None:
    """Mean of `errors` ``(n,)`` over the steps at which the mask `where` ``(n,)`` is true; None if there are none."""
    errors = finite_values(errors, "errors")
    if where is None:
        return float(errors.mean())
    mask = outcomes(where, "where")
    same_length(errors=errors, where=mask)
    return float(errors[mask].mean()) if mask.any() else None


def seam_crossings(true_directions: ArrayLike) -> np.ndarray:
    """Mask ``(n,)`` of the steps at which the true bearing crosses the seam of the panorama, azimuth +-pi.

    `true_directions` ``(n, 3)`` are the target's, in the body frame. Step k is a crossing if the short arc from the
    bearing of step k - 1 to that of step k cuts the half-plane behind (y = 0, x < 0): y changes sign, and x is negative
    there. Changing sides in front does not count. Exactly behind counts as left (azimuth pi), so a walk that stops on
    the seam counts once. The first step is never a crossing.
    """
    directions = _directions(true_directions, "true_directions", "(n, 3)")
    left = directions[:, 1] >= 0
    x, y = directions[:, 0], directions[:, 1]
    # The chord cuts y = 0 at x = (y0 x1 - x0 y1) / (y0 - y1). The numerator is that of the sine of the azimuth's
    # change, so the answer is that of the short way round in azimuth, at any elevation.
    above = y[:-1] * x[1:] - x[:-1] * y[1:]
    behind = np.where(left[:-1], above < 0, above > 0)
    return np.concatenate([[False], (left[1:] != left[:-1]) & behind])


def ego_motion(world_R_body: ArrayLike, positions: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """The motions between n poses, as input of `temporal_consistency`.

    `world_R_body` is ``(n, 3, 3)`` and `positions` ``(n, 3)``, metres, world frame. Returns new_R_old ``(n - 1, 3, 3)``
    and the body's displacement in the NEW body frame ``(n - 1, 3)``, metres.
    """
    poses = check_rotation(np.asarray(world_R_body, dtype=np.float64), "world_R_body")
    places = finite_values(positions, "positions")
    if poses.ndim != 3 or places.shape != (len(poses), 3):
        raise EagorError(f"got poses {poses.shape} and positions {places.shape}; wanted (n, 3, 3) and (n, 3)")
    body_R_world = np.swapaxes(poses[1:], -1, -2)
    return body_R_world @ poses[:-1], (body_R_world @ np.diff(places, axis=0)[..., None])[..., 0]


def temporal_consistency(
    estimates: ArrayLike,
    new_R_old: ArrayLike,
    translations: ArrayLike | None = None,
    true_ranges: ArrayLike | None = None,
) -> float | None:
    """TC (deg/step): mean angle between each estimate and the previous one, moved along by the true motion.

    The previous estimate, put at the target's true range, becomes the point ``new_R_old @ (direction * range) -
    translation`` of the new body frame. So a perfect estimate of a static target scores 0; while the body only turns,
    so does any estimate that is fixed in the world. Lower is smoother, not always better. Without translations and
    ranges it is moved by the rotation alone, our reading of the paper: a perfect one scores above 0 while the body
    walks.

    Args:
        estimates: ``(n, 3)``, body frame of each step.
        new_R_old: ``(n - 1, 3, 3)``, the true rotation from each step to the next.
        translations: ``(n - 1, 3)``, the body's displacement over the same step, metres, in the NEW body frame.
        true_ranges: ``(n,)``, distance to the target at each step, metres (the last is not used).

    Returns:
        Degrees per step; None if there is only one step.

    Raises:
        EagorError: also if a moved point falls on the camera itself, where it has no direction.
    """
    directions = _directions(estimates, "estimates", "(n, 3)")
    if (translations is None) != (true_ranges is None):
        raise EagorError("translations and true_ranges go together; give both, or neither for the rotation alone")
    if len(directions) == 1:
        return None
    points = _turned(directions, new_R_old)
    if translations is None or true_ranges is None:
        return float(angular_error_deg(directions[1:], points).mean())
    moved = np.asarray(translations, dtype=np.float64)
    ranges = finite_values(true_ranges, "true_ranges")
    if moved.shape != (len(directions) - 1, 3) or not np.isfinite(moved).all():
        raise EagorError(f"translations {moved.shape} do not fit; wanted {(len(directions) - 1, 3)}, finite, metres")
    if ranges.shape != (len(directions),) or ranges.min() < 0:
        raise EagorError(f"true_ranges {ranges.shape} do not fit; wanted {(len(directions),)}, metres, none negative")
    points = points * ranges[:-1, None] - moved
    if (np.linalg.norm(points, axis=-1) == 0).any():
        raise EagorError("a moved estimate falls on the camera itself; end the episode before the target is reached")
    return float(angular_error_deg(directions[1:], points).mean())


def success(distance: float, stopped: bool, success_distance: float) -> bool:
    """Habitat's Success: the agent called stop AND is nearer to the target than `success_distance` (metres, strict).

    `distance` is the one at the end, inf without a path.
    """
    if not success_distance > 0:
        raise EagorError(f"success_distance is {success_distance}; wanted metres above 0, such as 1.0")
    near = _metres("distance", distance, endless=True) < success_distance
    return _told("stopped", stopped) and near


def spl(succeeded: bool, shortest: float, path: float) -> float:
    """Success weighted by path length: ``S * shortest / max(shortest, path)``.

    Anderson et al., On Evaluation of Embodied Navigation Agents, 2018. `shortest` is the shortest path from start to
    target, `path` the agent's path, metres. An episode that starts on the target (shortest = 0) scores S if
    the agent stayed there, and 0 if it walked: the limits of the formula, where it would divide by zero.
    """
    shortest, path = _metres("shortest", shortest), _metres("path", path)
    longer = max(shortest, path)
    return _told("succeeded", succeeded) * (shortest / longer if longer > 0 else 1.0)


def soft_spl(distance: float, shortest: float, path: float) -> float:
    """SoftSPL: ``max(0, 1 - distance / shortest) * shortest / max(shortest, path)``, Habitat's definition.

    `distance` is the remaining one at the end (metres, inf without a path). If shortest = 0, the progress is 1 for an
    agent that ends on the target and 0 for any other.
    """
    distance, efficiency = _metres("distance", distance, endless=True), spl(True, shortest, path)
    return efficiency * (max(0.0, shortest - distance) / shortest if shortest > 0 else float(distance == 0))


def _directions(vectors: ArrayLike, name: str, wanted: str = "(..., 3)") -> np.ndarray:
    array = np.asarray(vectors, dtype=np.float64)
    if array.size == 0 or (wanted == "(n, 3)" and array.ndim != 2):
        raise DirectionError(f"{name} has shape {array.shape}; wanted {wanted}, at least one direction")
    return unit(array)


def _turned(directions: np.ndarray, new_R_old: ArrayLike) -> np.ndarray:
    """All but the last of `directions` ``(n, 3)``, each turned into the frame of the step after it."""
    turns = check_rotation(np.asarray(new_R_old, dtype=np.float64))
    if turns.shape != (len(directions) - 1, 3, 3):
        raise EagorError(f"new_R_old {turns.shape} does not fit; wanted {(len(directions) - 1, 3, 3)}: one per move")
    return (turns @ directions[:-1, :, None])[..., 0]


def _told(name: str, value: bool) -> bool:
    """`value`, once it is a boolean, or 0 or 1."""
    return bool(outcomes([value], name)[0])


def _metres(name: str, value: float, endless: bool = False) -> float:
    """`value`, once it is metres; only an `endless` one may be infinite."""
    if not (value >= 0 and (endless or np.isfinite(value))):
        raise EagorError(f"{name} is {value}; wanted metres, not negative{', NaN' if endless else ', NaN or infinite'}")
    return float(value)

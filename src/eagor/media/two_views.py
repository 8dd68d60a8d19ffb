"""How the camera turned between two pictures, from matched directions, and how sure that is.

A matched pair (u, v), unit vectors in the old and the new body frame, is right with probability w; then `old_R_new` v
lies about u. Otherwise it is a mistake, and v can be anywhere in the field (density 1 / area).

- A camera that stood: the error is Gaussian with deviation sigma on both axes of the tangent plane.
- One that moved along t: things shift away from t by an angle that depends on their distance. The shift is exponential
  with mean lambda sin(angle between u and t); lambda is the baseline times the mean inverse distance. The Gaussian
  error is added: the density is Gaussian across the shift and an exponentially modified Gaussian along it (Grushka,
  Analytical Chemistry 44, 1972). For lambda = 0 it is the first model.

Pairs in crowded parts of the sphere weigh less (`Parts.weights`). Weak priors, each worth about one pair, keep sigma, w
and lambda finite.

The curvature about the best fit tells how sure a turn is if its model is true. In the narrow field of an ordinary
camera a wrong model may fit as well, and all pairs err in the same way. `Turn.doubt` tells that. It adds what
single pairs are off by, how far a standing camera would have turned instead, and another turn on which pairs agree that
are left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import expit, log_expit, log_ndtr

from eagor.media.consensus import SPHERE, Agreement, Inertia, Parts, agreeing_motion, agreeing_rotation

FALSE_ALARM = 1e-5  # expected number of agreements among unrelated pairs; above it an agreement counts as chance

_STEP = 1e-5  # of numerical derivatives: radians, or in logarithms
_ROUNDS = 60
_ENOUGH = 1e-2  # nats: what a step gains when the rest moves a turn by a small part of its uncertainty
_USUAL_NOISE = math.radians(0.2)  # of a SIFT point in a view of 320 pixels; half a pixel
_LEAST_NOISE = math.radians(0.05)  # points that are drawn, or fixed to the camera, may seem exact
_USUAL_SHIFT = 0.1  # radians: a step of 0.2 m, things at 2 m
# Degrees by which a turn is off for each degree that single pairs are off, in a narrow field: what is left there is
# parallax or distortion, which neighbours share. In rendered walks and photographs, at 60 to 120 degrees, 2 to 8.
_SHARED = 4.0


@dataclass(frozen=True, eq=False)
class Turn:
    """`old_R_new` ``(3, 3)`` with the `covariance` ``(3, 3)`` of its error (radians squared, axes of the old frame).

    `direction`: unit vector ``(3,)`` of the camera's motion in the old frame, or None if it stood still as far as the
    pictures tell. `inliers`: booleans ``(n,)``. `noise`: deviation of one pair, radians per axis. `doubt`: deviation of
    the angle (radians, all axes) by which the turn is off because its model may be wrong; 0 where the whole sphere is
    seen. It is not part of the covariance, since turns one after the other err alike.
    """

    old_R_new: np.ndarray
    covariance: np.ndarray
    direction: np.ndarray | None
    inliers: np.ndarray
    noise: float
    doubt: float = 0.0


def turn_between(
    old: np.ndarray,
    new: np.ndarray,
    *,
    level: bool = False,
    moves: bool = True,
    area: float = SPHERE,
    inertia: Inertia | None = None,
) -> Turn | None:
    """The turn from matched unit vectors `old` and `new` ``(n, 3)``; None if they agree no better than by chance.

    A camera that stood still and one that moved are both fitted; the Bayesian information criterion decides. `level`:
    turns are about z only. `moves`: False leaves out the second model. `area`: steradians that the camera sees. The
    same input gives the same result: the random samples have a fixed seed.

    In a narrow field a turn looks much like a step to the side, all the more if something moves on its own. So with
    `inertia` only turns that it allows count.
    """
    random = np.random.default_rng(0)
    still = agreeing_rotation(old, new, random, level, area, inertia)
    if still is None:
        return None
    moved = agreeing_motion(old, new, still.rotation, random, area) if moves else None
    if min(each.log_chance for each in (still, moved) if each is not None) > math.log(FALSE_ALARM):
        return None
    axes = np.array([[0.0, 0.0, 1.0]]) if level else np.eye(3)
    parts = Parts(old, area)
    found = [_fitted(Model(old, new, still.rotation, axes, parts), still)]
    if moved is not None:
        guess = _yaw_of(moved.rotation) if level else moved.rotation
        found.append(_fitted(Model(old, new, guess, axes, parts, moved.direction), moved))
    found = [each for each in found if inertia is None or inertia.allows(each[1].rotation)]
    if not found:
        return None
    _, model, parameters = max(found, key=lambda each: each[0])
    d = len(axes)
    spread = covariance(model, parameters)
    if spread is None:
        return None
    inliers = right(model, parameters) > 0.5
    noise, doubt = math.exp(parameters[d]), 0.0
    if area < SPHERE:
        stood = found[0][1].rotation if model.direction is not None else model.rotation
        second = _runner_up(model, inliers, level, inertia)
        doubt = math.sqrt((_SHARED * noise) ** 2 + angle_between(model.rotation, stood) ** 2 + second)
    return Turn(model.rotation, axes.T @ spread @ axes, model.direction, inliers, noise, doubt)


def _runner_up(model: Model, inliers: np.ndarray, level: bool, inertia: Inertia | None) -> float:
    """The square (radians) of how far off the turn is if what is left out has it right: large things that move.

    Weighed by the share of the field's parts in which they are. 0 where those pairs agree no better than by chance.
    """
    here, there, area = model.here[~inliers], model.there[~inliers], model.parts.area
    other = agreeing_rotation(here, there, np.random.default_rng(0), level, area, inertia)
    if other is None or other.log_chance > math.log(FALSE_ALARM):
        return 0.0
    won, lost = (Parts(each, area).count for each in (model.here[inliers], here[other.inliers]))
    return lost / (won + lost) * angle_between(model.rotation, other.rotation) ** 2


def angle_between(a: np.ndarray, b: np.ndarray) -> float:
    """Radians between two rotations ``(3, 3)``."""
    return float(Rotation.from_matrix(a.T @ b).magnitude())


def _fitted(model: Model, agreement: Agreement) -> tuple[float, Model, np.ndarray]:
    """Evidence for the model, the model about its most likely pose, its parameters."""
    parameters = maximise(model, model.start(agreement.inliers))
    centred, left = model.at(parameters)
    return evidence(model, parameters), centred, left


def _yaw_of(rotation: np.ndarray) -> np.ndarray:
    """The rotation about z that is nearest."""
    yaw = math.atan2(rotation[1, 0] - rotation[0, 1], rotation[0, 0] + rotation[1, 1])
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


# --- how likely a motion of the camera is ---


@dataclass(frozen=True, eq=False)
class Model:
    """Unit vectors `here` and `there` ``(n, 3)``, seen by a camera that turned, near `rotation`.

    `direction`: None for one that stood; near this unit vector ``(3,)`` in the old frame it moved. Parameters: turns
    about `axes` ``(d, 3)`` (radians), log sigma, logit w; of one that moved also log lambda and two tilts of the
    direction (radians).
    """

    here: np.ndarray
    there: np.ndarray
    rotation: np.ndarray
    axes: np.ndarray
    parts: Parts
    direction: np.ndarray | None = None

    def start(self, inliers: np.ndarray) -> np.ndarray:
        """First parameters ``(k,)``, from the pairs that agree."""
        if self.direction is None:
            gaps = self.here[inliers] - self.there[inliers] @ self.rotation.T
            sigma, rest = math.sqrt(float(np.mean(gaps**2)) * 1.5), []  # two of three components vary
        else:
            turned = (self.there @ self.rotation.T)[None]
            along, across, sine = _shifts(self.here, turned, self.direction[None])
            sigma = 1.5 * float(np.median(np.abs(across[0, inliers])))  # of a Gaussian
            mean = 1.5 * float(np.median(np.abs(along / sine)[0, inliers])) + 1e-5  # of an exponential
            rest = [math.log(mean), 0.0, 0.0]
        right = inliers.sum()
        logit = math.log((right + 1) / (len(inliers) - right + 1))  # a little off certainty
        return np.array([*np.zeros(len(self.axes)), math.log(sigma + 1e-5), logit, *rest])

    def log_inlier(self, parameters: np.ndarray) -> np.ndarray:
        """Log-density ``(p, n)`` of right pairs under parameters ``(p, k)``."""
        d = len(self.axes)
        turned = self.there @ (_rotations(parameters[:, :d] @ self.axes) @ self.rotation).swapaxes(1, 2)  # (p, n, 3)
        variance = np.exp(2 * parameters[:, d, None]) + _LEAST_NOISE**2
        if self.direction is None:
            squared = np.sum((turned - self.here) ** 2, axis=-1)
            return -squared / (2 * variance) - np.log(variance) - math.log(2 * math.pi)
        along, across, sine = _shifts(self.here, turned, _tilted(self.direction, parameters[:, d + 3 :]))
        sigma = np.sqrt(variance)
        mean = np.maximum(np.exp(parameters[:, d + 2, None]) * sine, 1e-3 * sigma)  # smaller shifts make no difference
        z = sigma / mean - along / sigma
        shift = (z**2 - (along / sigma) ** 2) / 2 + log_ndtr(-z) - np.log(mean)
        return shift - (across / sigma) ** 2 / 2 - np.log(sigma) - math.log(2 * math.pi) / 2

    def log_prior(self, parameters: np.ndarray) -> np.ndarray:
        """Logarithm ``(p,)`` of the weak priors."""
        log_sigma, logit, *rest = parameters[:, len(self.axes) :].T
        found = -(((log_sigma - math.log(_USUAL_NOISE)) / 2) ** 2) / 2 + log_expit(logit) + log_expit(-logit)
        return found - ((rest[0] - math.log(_USUAL_SHIFT)) / 3) ** 2 / 2 if rest else found

    def at(self, parameters: np.ndarray) -> tuple[Model, np.ndarray]:
        """The same model about the pose of these parameters, and what becomes of them."""
        d = len(self.axes)
        rotation = _rotations(parameters[None, :d] @ self.axes)[0] @ self.rotation
        moved = None if self.direction is None else _tilted(self.direction, parameters[None, d + 3 :])[0]
        left = parameters.copy()
        left[:d], left[d + 3 :] = 0, 0
        return replace(self, rotation=rotation, direction=moved), left


def _tilted(direction: np.ndarray, tilts: np.ndarray) -> np.ndarray:
    """Unit vectors ``(p, 3)`` near `direction` ``(3,)``, off by tilts ``(p, 2)``."""
    tilted = direction + tilts @ np.linalg.svd(direction[None])[2][1:]
    return tilted / np.linalg.norm(tilted, axis=1, keepdims=True)


def evidence(model: Model, parameters: np.ndarray) -> float:
    """The Bayesian information criterion (Schwarz, Annals of Statistics 6, 1978), as a logarithm: more is better.

    Each part of the sphere weighs the same. So a tripod with a pattern does not outvote a room with few points.
    """
    values = _log_likelihood(model, parameters[None])[0]
    weights = np.append(model.parts.shares, 1.0)
    return float(values @ weights) - len(parameters) / 2 * math.log(weights.sum())


def maximise(model: Model, parameters: np.ndarray) -> np.ndarray:
    """The most likely parameters ``(k,)`` from a start.

    Scores of single pairs give both gradient and curvature (Berndt, Hall, Hall & Hausman 1974), damped as by
    Levenberg and Marquardt.
    """
    weights = np.append(model.parts.weights, 1.0)
    value, damping = float(_log_likelihood(model, parameters[None])[0] @ weights), 1e-3
    for _ in range(_ROUNDS):
        scores = _scores(model, parameters)
        weighted = scores * weights[:, None]
        gradient, curvature = weighted.sum(axis=0), weighted.T @ scores
        scale = np.diag(curvature) + 1e-9
        gain = 0.0
        while damping < 1e9:
            step = np.linalg.solve(curvature + damping * np.diag(scale), gradient)
            trial = parameters + step / max(1.0, float(np.abs(step).max()))  # a radian or a factor of e at most
            reached = float(_log_likelihood(model, trial[None])[0] @ weights)
            gain = reached - value
            if gain >= 0:  # NaN is not
                parameters, value, damping = trial, reached, max(damping / 10, 1e-7)
                break
            damping *= 10
        else:
            break
        if gain < _ENOUGH:
            break
    return parameters


def covariance(model: Model, parameters: np.ndarray) -> np.ndarray | None:
    """Covariance ``(d, d)`` of the fitted turns about the model's axes, radians squared; None from too few places.

    The larger of the inverse curvature and the sandwich (Huber 1967), which survives a wrong model. Pairs in the same
    part of the sphere may share their errors (a part of the picture is distorted or moves), so their scores are added
    before they are squared (Liang & Zeger, Biometrika 73, 1986).
    """
    k, d = len(parameters), len(model.axes)
    weights = np.append(model.parts.weights, 1.0)
    curvature = np.empty((k, k))
    for index, step in enumerate(np.eye(k) * _STEP):
        up, down = (weights @ _scores(model, parameters + sign * step) for sign in (1, -1))
        curvature[index] = (down - up) / (2 * _STEP)
    bread = np.linalg.pinv((curvature + curvature.T) / 2, hermitian=True)
    order, starts = model.parts.order, model.parts.starts
    scores = (_scores(model, parameters) * weights[:, None])[:-1]
    added = np.add.reduceat(scores[order], starts, axis=0)
    good = right(model, parameters) > 0.5
    places = int(np.logical_or.reduceat(good[order], starts).sum())
    free = k - 2  # of the motion; the others are the noise and the share of mistakes
    if places <= free:
        return None
    both = bread[:d, :d], (bread @ (added.T @ added) @ bread)[:d, :d]
    return max(both, key=np.trace) * places / (places - free)


def right(model: Model, parameters: np.ndarray) -> np.ndarray:
    """The probability ``(n,)`` that each pair is no mistake."""
    good = model.log_inlier(parameters[None])[0]
    return expit(good + math.log(model.parts.area) + parameters[len(model.axes) + 1])


def _log_likelihood(model: Model, parameters: np.ndarray) -> np.ndarray:
    """Log-density ``(p, n + 1)`` of each pair under parameters ``(p, k)``; the priors come last."""
    logit = parameters[:, len(model.axes) + 1, None]
    wrong = log_expit(-logit) - math.log(model.parts.area)
    pairs = np.logaddexp(model.log_inlier(parameters) + log_expit(logit), wrong)
    return np.concatenate([pairs, model.log_prior(parameters)[:, None]], axis=1)


def _scores(model: Model, parameters: np.ndarray) -> np.ndarray:
    """Derivatives ``(n + 1, k)`` of each log-density by each parameter."""
    steps = np.eye(len(parameters)) * _STEP
    values = _log_likelihood(model, np.concatenate([parameters + steps, parameters - steps]))
    return (values[: len(steps)] - values[len(steps) :]).T / (2 * _STEP)


def _shifts(here: np.ndarray, turned: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """How far `turned` ``(p, n, 3)`` lie from `here` ``(n, 3)``: angles away from `directions` ``(p, 3)``, and across.

    And the sine ``(p, n)`` of the angle between `here` and the direction.
    """
    cosine = directions @ here.T
    sine = np.sqrt(np.maximum(1 - cosine**2, 1e-12))
    near = np.einsum("pni,ni->pn", turned, here)
    ahead = np.einsum("pni,pi->pn", turned, directions)
    normals = np.cross(directions[:, None], here)
    along = np.arctan2((cosine * near - ahead) / sine, near)
    return along, np.arcsin(np.clip(np.einsum("pni,pni->pn", turned, normals) / sine, -1, 1)), sine


def _rotations(vectors: np.ndarray) -> np.ndarray:
    """Matrices ``(p, 3, 3)`` of rotation vectors ``(p, 3)``."""
    return Rotation.from_rotvec(vectors).as_matrix()

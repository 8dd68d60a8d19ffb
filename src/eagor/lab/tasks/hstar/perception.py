"""Perception of a view: any perception, or `truth`, a simulated detector of known quality based on the annotations.

It is asked for the target in the task's words, from which also follows what makes a target hard (`tag_of`).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from eagor.errors import EagorError, QueryError
from eagor.evidence import Evidence
from eagor.evidence.calibration import Calibration
from eagor.evidence.detections import resolved
from eagor.evidence.shapes import MIN_SPREAD
from eagor.grids import PerspectiveGrid
from eagor.lab.agents.models import shared
from eagor.lab.tasks.hstar.data import Episode, open_panorama
from eagor.lab.tasks.hstar.rules import HFOV_DEG, View, box_points, inside, render_view, without_cross
from eagor.lab.tasks.published import case_seed
from eagor.perception import Perception
from eagor.perception.partial import look_at_view
from eagor.perception.truth import Noise, Report, displaced, drawn
from eagor.queries import singular
from eagor.sphere import world_R_body

FINE = 4.0  # degrees: a box smaller than this in both directions is fine detail
# Things that any detector knows well: everyday nouns of homes, offices, shops and streets.
COMMON = frozenset(
    """
    air conditioner airplane apple armchair backpack bag ball banana barrel basin basket bathtub bed bench bicycle
    bike bin bird blanket blender blind board boat book bookcase bookshelf bottle bowl box bread broom bucket
    building bus cabinet cake camera candle car carpet cart cat ceiling chair chandelier clock closet coat coffee
    computer cone cooker couch counter cup cupboard curtain cushion desk dishwasher dog door drawer dress dresser
    dryer elevator entrance escalator exit extinguisher fan faucet fence fireplace flag floor flower fork fountain
    frame fridge glass guitar handbag hat headphones heater helmet house jacket jar kettle keyboard kitchen knife
    ladder lamp laptop lid light locker luggage machine magazine man mat mattress microwave mirror monitor
    motorcycle mouse mug newspaper nightstand notebook ottoman oven painting pan paper pen person phone photo piano
    picture pillar pillow pipe plant plate platform pool pot poster printer projector radiator railing refrigerator
    road robot rug scooter screen sculpture seat shampoo shelf ship shirt shoe shop shower sign sink skateboard sky
    sofa speaker spoon staircase stair stand statue stool stove street suitcase sunglasses switch table tablet tap
    teapot telephone television tent tie tile toilet towel toy train trash tray tree truck tub tv umbrella urinal
    vacuum van vase vehicle wall wallet wardrobe washer watch water whiteboard window wine woman
    """.split()  # noqa: SIM905
)
_VERBS = r"(?:please\s+)?(?:find|locate|look for|search for|go to|navigate to|get to|move to|reach|walk to|show me)\s+"
_ARTICLES = r"^(?:the|a|an|some|any|your|my|one of the|way to the|path to the|way to|path to)\s+"
_BREAKS = re.compile(
    r"\s+(?:of|on|in|at|by|with|near|next|under|above|behind|below|beside|between|from|that|which|whose|to|for|along|"
    r"inside|outside|against|across|around|where|labell?ed|named|called|saying|showing|reading)\s+|[,;(]"
)
_TEXT = re.compile(
    r"""["“”«»]|(?<!\w)'[^']+'|\b(?:sign|says?|saying|labell?ed|logo|number|letters?|word|text|reading|written|named|"""
    r"""called|brand)\b|\d"""
)
# Tuned on development apartments (benchmarks/search.py --fit of commit 5a35d191).
CALIBRATION = Calibration(floor=0.125, neutral=0.124, temperature=2.59)
LENS = PerspectiveGrid(27, 48, math.radians(HFOV_DEG))  # the cells of truth's response: 2 degrees in the middle
NARROWEST = resolved(15)  # radians, standard deviation of truth's reports: what a belief of the default degree holds
WHOLE = 0.5  # visible share of a box from which on it is detected as well as a whole one


def thing_of(task: str) -> str:
    """The target of a task such as "Find the red chair by the door.": "red chair by the door"."""
    text = " ".join(task.split()).rstrip(".!? ")
    text = re.sub(f"^{_VERBS}", "", text, flags=re.IGNORECASE)
    text = re.sub(_ARTICLES, "", text, flags=re.IGNORECASE)
    return text or task


def phrase_of(task: str) -> str:
    """The target without its surroundings: "red chair"."""
    return _BREAKS.split(thing_of(task), maxsplit=1)[0].strip() or thing_of(task)


def head_of(task: str) -> str:
    """The noun of the target, singular and lower case: "chair"."""
    words = re.findall(r"[a-z][a-z-]*", phrase_of(task).lower())
    return singular(words[-1]) if words else thing_of(task).lower()


def tag_of(item: Mapping[str, Any], others: Sequence[Mapping[str, Any]] = ()) -> str:
    """The tag of a target; `others` are the scene's other entries. The paper names the tags; the rules are ours.

    ``ocr_fine``: the words quote or name text, numbers or a brand (a capital inside the words), or the box is tiny.
    ``multi_instance``: another entry of the scene has the same noun. ``rare``: the noun is not among `COMMON`.
    """
    task = str(item["task"])
    phrase = phrase_of(task)
    branded = any(word[:1].isupper() for word in phrase.split()) and not phrase.isupper()
    yaw, pitch = item["yaw"], item.get("pitch")
    tiny = pitch is not None and (yaw[1] - yaw[0]) % 360.0 < FINE and pitch[1] - pitch[0] < FINE
    if _TEXT.search(thing_of(task).lower()) or branded or phrase.isupper() or tiny:
        return "ocr_fine"
    head = head_of(task)
    if any(head_of(str(other["task"])) == head for other in others):
        return "multi_instance"
    return "plain" if head in COMMON or singular(head) in COMMON else "rare"


@dataclass(frozen=True, eq=False)
class ViewEvidence:
    """The evidence of one look, and the pose ``(3, 3)`` of its frame."""

    evidence: Evidence
    world_R_capture: np.ndarray


Eye = Callable[[View], ViewEvidence]  # looks at the views of one episode


def open_perception(spec: str) -> Perception | Noise:
    """A perception, or the noise of ``truth``, ``truth:ideal``, ``truth:miss=0.3,spread=4``.

    A perception is made once per process. Raises `EagorError` if it cannot be made, and errors of its server.
    """
    name, _, text = spec.partition(":")
    return Noise.parse(text) if name == "truth" else shared(spec)


def open_eye(
    perception: Any,
    episode: Episode,
    seed: int,
    resolution: int,
    read: Callable[[Evidence], Evidence] = lambda evidence: evidence,
) -> Eye:
    """`perception` (from `open_perception`) for one episode; `seed`: of truth's mistakes, `read`: recalibrates."""
    if isinstance(perception, Noise):
        look = annotated(TruthEye(episode.yaw, episode.pitch, perception, case_seed(seed, episode.id)))
    elif isinstance(perception, Perception):
        look = PixelEye(perception, episode, resolution)
    else:
        raise EagorError(f"the perception is a {type(perception).__name__}; wanted what open_perception returns")

    def read_look(view: View) -> ViewEvidence:
        found = look(view)
        return replace(found, evidence=read(found.evidence))

    return read_look


class PixelEye:
    """A perception that is shown the view as the benchmark draws it, with the cross filled in: it is no evidence.

    It is asked for the target in the task's words; a perception that knows only single nouns gets shorter phrases.
    """

    def __init__(self, perception: Perception, episode: Episode, resolution: int) -> None:
        self._perception, self._episode, self._resolution = perception, episode, resolution
        self._queries = list(dict.fromkeys((thing_of(episode.task), phrase_of(episode.task), head_of(episode.task))))

    def __call__(self, view: View) -> ViewEvidence:
        drawn = render_view(open_panorama(self._episode.panorama), view.yaw, view.pitch, self._resolution)
        image = without_cross(drawn)
        upright = world_R_body(0.0, -math.radians(view.pitch))  # a body that faces where the view does
        grid = PerspectiveGrid(image.shape[0], image.shape[1], math.radians(HFOV_DEG), upright)
        while True:
            try:
                evidence = look_at_view(self._perception, image, grid, self._queries[0])
                return ViewEvidence(evidence, world_R_body(-math.radians(view.yaw)))
            except QueryError:
                if len(self._queries) == 1:
                    raise
                del self._queries[0]


def annotated(eye: TruthEye) -> Eye:
    """`eye` as an agent uses one; nothing is rendered for it."""
    return lambda view: ViewEvidence(eye.look(view), view.world_R_view)


class TruthEye:
    """A detector of known quality in one episode, which remembers its mistakes from look to look.

    The noise is that of simulated worlds (`eagor.perception.truth.Noise`), with two differences. Detection depends on
    the visible fraction of the target's box, and a false alarm lies anywhere in the view and stays there in the world.
    Each look draws the same number of random values: agents that look elsewhere get the same draws.
    """

    def __init__(
        self,
        yaw: tuple[float, float],
        pitch: tuple[float, float] | None,
        noise: Noise,
        seed: int | list[int],
        calibration: Calibration = CALIBRATION,
    ) -> None:
        self._points = box_points(yaw, pitch)
        self._noise, self._calibration = noise, calibration
        self._rng = np.random.default_rng(seed)
        self._started = False
        self._luck = np.zeros((2, 2))  # of the target and of the false alarm: reported or not, and the score
        self._error = np.zeros((2, 3))  # standard normal, in the world's axes
        self._place = np.zeros(2)  # of the false alarm in its view, 0 to 1
        self._alarm: np.ndarray | None = None  # its direction in the world, once a view had it

    def look(self, view: View) -> Evidence:
        """The next look: evidence on `LENS`, in the view's own frame."""
        response = drawn(self.reports(view), LENS, self._noise.floor)
        return Evidence.from_response(response, LENS, self._calibration)

    def reports(self, view: View) -> list[Report]:
        """The next look as a list of reports, in the view's own frame."""
        self._advance()
        noise, found = self._noise, []
        shown = inside(view, self._points)
        seen = min(1.0, float(shown.mean()) / WHOLE)
        if shown.any() and self._luck[0, 0] < (1 - noise.miss) * seen:
            centre, covariance = _moments(self._points[shown] @ view.world_R_view)
            error = view.world_R_view.T @ self._error[0] * noise.spread
            found.append(self._report("found", 0, centre, covariance, error))
        if self._luck[1, 0] < noise.false_alarm:
            if self._alarm is None:
                x, y = self._place * (LENS.width, LENS.height)
                self._alarm = view.world_R_view @ LENS.unproject(np.array(x), np.array(y))
            if inside(view, self._alarm[None])[0]:
                at = self._alarm @ view.world_R_view
                found.append(self._report("false alarm", 1, at, np.zeros((3, 3)), np.zeros(3)))
        return found

    def _advance(self) -> None:
        """Advance by one look: mistakes are kept or drawn anew."""
        drawn_now, error = self._rng.random((2, 5)), self._rng.standard_normal((2, 3))
        anew = drawn_now[:, 0] >= self._noise.persistence if self._started else np.ones(2, dtype=bool)
        self._luck[anew], self._error[anew] = drawn_now[anew, 1:3], error[anew]
        if anew[1]:
            self._place, self._alarm = drawn_now[1, 3:5], None
        self._started = True

    def _report(self, kind: str, row: int, centre: np.ndarray, covariance: np.ndarray, error: np.ndarray) -> Report:
        placed, carry = displaced(centre, error)
        # Narrower, a belief could not hold it, and the report would say less the sharper it is.
        width = max(self._noise.spread**2 + MIN_SPREAD**2, NARROWEST**2)
        covariance = carry @ covariance @ carry.T + width * (np.eye(3) - np.outer(placed, placed))
        score = self._noise.weakest + (1 - self._noise.weakest) * float(self._luck[row, 1])
        return Report(kind, None, placed, covariance, score)


def _moments(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean direction ``(3,)`` of points ``(n, 3)``, and their covariance ``(3, 3)`` in the tangent plane there."""
    centre = points.mean(axis=0)
    centre /= np.linalg.norm(centre)
    offsets = points - (points @ centre)[:, None] * centre
    return centre, offsets.T @ offsets / len(points)

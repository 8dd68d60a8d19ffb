"""The rules of H*Bench and its camera: which submissions succeed, which replies count as actions, what a view shows.

Yaw in degrees: 0 is the middle of the panorama, positive to the RIGHT, 0 to 360. Pitch in degrees, positive up, -90 to
90. It reproduces the published environment (H*Bench, humanoid-vstar/hstar at 7a52247), quirks included, and is tested
against vectors that it produced.

The camera is 100 degrees wide, rendered pixel for pixel like the published one. In two places it is half a pixel off
our conventions: the ray of column j is (j - w / 2) / f, and a panorama's column centres lie at whole numbers.
`render_view` keeps both, since models are shown exactly this; `View.grid` describes the same pixels in our terms.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal, get_args

import numpy as np

from eagor._checks import number, shown
from eagor._values import lazy
from eagor.conventions import direction_from_hstar, hstar_from_direction
from eagor.errors import EagorError, FormatError, ImageError
from eagor.grids import PerspectiveGrid
from eagor.sphere import azimuth_elevation, direction, world_R_body

Scoring = Literal["official", "strict"]
SCORINGS: tuple[Scoring, ...] = get_args(Scoring)
FORMS = ("free_think", "no_think", "grounding")

MAX_TURNS = 10
YAW_TOLERANCE = {"hos": 30, "hps": 10}  # degrees to both sides of the middle, for narrower targets
PITCH_TOLERANCE = 20
SEPARATOR = "|"
FARTHEST = 3600.0  # degrees in an annotation; more is taken for a mistake
FARTHEST_ANSWER = 10**6  # degrees in an answer


@dataclass(frozen=True)
class Window:
    """Where a submission succeeds, degrees: yaw from `yaw[0]` to the right up to `yaw[1]`, both in [0, 360)."""

    yaw: tuple[float, float]
    pitch: tuple[float, float]

    @property
    def wraps(self) -> bool:
        """Whether it runs across yaw 0."""
        return self.yaw[0] > self.yaw[1]

    @property
    def width(self) -> float:
        """Degrees of yaw."""
        return (self.yaw[1] - self.yaw[0]) % 360.0

    @property
    def centre(self) -> tuple[float, float]:
        """(yaw, pitch) of its middle."""
        return (self.yaw[0] + self.width / 2) % 360.0, (self.pitch[0] + self.pitch[1]) / 2

    def contains(self, yaw: float, pitch: float, scoring: Scoring = "official") -> bool:
        """Whether submitting (yaw, pitch) succeeds.

        ``official`` ignores the pitch if the window wraps, as the published environment does; ``strict`` never does.
        """
        yaw = normalised(yaw)
        high_enough = self.pitch[0] <= pitch <= self.pitch[1]
        if self.wraps:
            return (yaw >= self.yaw[0] or yaw <= self.yaw[1]) and (scoring == "official" or high_enough)
        return self.yaw[0] <= yaw <= self.yaw[1] and high_enough


@dataclass(frozen=True)
class Action:
    """An action: ``rotate`` by, or ``submit``, (yaw, pitch) in whole degrees."""

    kind: Literal["rotate", "submit"]
    yaw: int
    pitch: int

    def __str__(self) -> str:
        return f"{self.kind}({self.yaw},{self.pitch})"


@dataclass(frozen=True)
class Reply:
    """A parsed reply: the thought, the actions, whether the form was kept."""

    think_content: str
    actions: list[str]
    format_correct: bool

    @property
    def action(self) -> Action | None:
        """The single action; None if there is not exactly one or it cannot be carried out."""
        return read_action(self.actions[0]) if len(self.actions) == 1 else None


def normalised(yaw: float) -> float:
    """`yaw` (degrees) in [0, 360)."""
    return (yaw + 360) % 360


def window_of(item: Mapping[str, Any]) -> Window:
    """The window of successful submissions for one entry of annotation.json; without ``pitch`` it is one of HPS.

    A target narrower than the tolerances is widened about its middle. Raises `FormatError` if the angles are not pairs
    of finite numbers.
    """
    path = item.get("pitch") is None
    left, right = _pair(item, "yaw")
    right += 360 if left > right else 0
    tolerance = YAW_TOLERANCE["hps" if path else "hos"]
    if right - left < 2 * tolerance:
        middle = (left + right) / 2
        left, right = middle - tolerance, middle + tolerance
    low, high = (-90.0, 90.0) if path else _pair(item, "pitch")
    if high - low < 2 * PITCH_TOLERANCE:
        middle = (low + high) / 2
        low, high = max(-90.0, middle - PITCH_TOLERANCE), min(90.0, middle + PITCH_TOLERANCE)
    return Window((normalised(left), normalised(right)), (low, high))


def submit_succeeds(item: Mapping[str, Any], yaw: float, pitch: float, scoring: str = "official") -> bool:
    """Whether submitting (yaw, pitch), degrees, finds the target of one entry of annotation.json.

    `item` has ``yaw`` [left, right] and, in HOS, ``pitch`` [low, high]. `scoring`: see `Window.contains`. Raises
    `EagorError` for another scoring, `FormatError` for an item without usable angles.
    """
    return window_of(item).contains(yaw, pitch, checked_scoring(scoring))


def checked_scoring(scoring: str) -> Scoring:
    """`scoring`, checked. Raises `EagorError`."""
    if scoring not in SCORINGS:
        raise EagorError(f"scoring = {scoring!r}; wanted {' or '.join(SCORINGS)}")
    return scoring  # type: ignore[return-value]


# The marks between the lazy dots of the published patterns, in order. Searching for one after the other finds the same
# as the whole pattern, in linear time: if the first occurrence of a mark fails, no later one succeeds.
_MARKS = {
    "free_think": ("<think>", r"</think>\s*<answer>"),
    "no_think": ("<answer>",),
    "grounding": (r"<think>\s*<observation>", r"</observation>\s*<reasoning>", r"</reasoning>\s*</think>\s*<answer>"),
}
_THOUGHT = ("<think>", "</think>", "<answer>")
_END = "</answer>"
_STRAY = ("<think>", "</think>", "<answer>", "</answer>")  # taken out of thoughts and answers, in this order


def parse_action(text: str, form: str = "free_think") -> Reply:
    """The parsed reply of a model, in one of the three published forms.

    ``free_think`` takes the first ``<answer>`` anywhere; the other forms are strict. Tags that are left inside of a
    thought or an answer are taken out, so ``<answer><answer>submit(10,0)</answer></answer>`` submits. Of several
    actions (separated by ``|``) the first counts. Raises `EagorError` for an unknown form.
    """
    if form not in FORMS:
        raise EagorError(f"the form of replies is {form!r}; wanted one of {', '.join(FORMS)}")
    text = text.replace("<image>", "")
    whole = text.strip()
    kept = _along(whole, _MARKS[form], at_start=True)
    if kept is not None and not (whole.endswith(_END) and kept[-1].end() <= len(whole) - len(_END)):
        kept = None
    if form == "no_think":
        read = None if kept is None else ("", whole[kept[-1].end() :].partition(_END)[0])
    elif form == "grounding":
        read = _between(text, _along(text, _MARKS[form]), "<observation>", "</reasoning>")
    else:
        read = _between(text, _along(text, _THOUGHT, at_start=True)) or _between(text, _along(text, _THOUGHT[-1:]))
    if read is None:
        return Reply("", [], kept is not None)
    thought, answer = map(_without_tags, read)
    actions = [part.strip() for part in answer.split(SEPARATOR) if part.strip()]
    return Reply(thought, actions[:1], kept is not None)


def _without_tags(text: str) -> str:
    for tag in _STRAY:
        text = text.replace(tag, "").strip()
    return text


def _along(text: str, marks: tuple[str, ...], at_start: bool = False) -> list[re.Match[str]] | None:
    """The first place of each mark after the one before; None if one is missing."""
    places: list[re.Match[str]] = []
    for mark in marks:
        find = re.compile(mark).match if at_start and not places else re.compile(mark).search
        place = find(text, places[-1].end() if places else 0)
        if place is None:
            return None
        places.append(place)
    return places


def _between(text: str, marks: list[re.Match[str]] | None, first: str = "", last: str = "") -> tuple[str, str] | None:
    """Thought and answer; the thought with the tags `first` and `last`, which belong to the outer marks."""
    end = -1 if marks is None else text.find(_END, marks[-1].end())
    if marks is None or end < 0:
        return None
    # In free_think the thought ends at the second of three marks, in grounding at the last.
    close = marks[-1 if last else -2] if len(marks) > 1 else None
    thought = "" if close is None else text[marks[0].end() - len(first) : close.start() + len(last)]
    return thought, text[marks[-1].end() : end]


def read_action(text: str) -> Action | None:
    """The action in `text`, such as ``rotate(-45,0)``; None if the environment could not carry it out.

    Names are case-sensitive and numbers whole; spaces inside the brackets and a plus sign are allowed.
    """
    for kind in ("rotate", "submit"):
        if text.startswith(kind):
            parts = text.replace(kind, "").strip("()").split(",")
            try:
                yaw, pitch = int(parts[0].strip()), int(parts[1].strip())
            except (ValueError, IndexError):
                return None
            if max(abs(yaw), abs(pitch)) > FARTHEST_ANSWER:  # means the same, and a float can hold it
                yaw, pitch = yaw % 360, max(-FARTHEST_ANSWER, min(FARTHEST_ANSWER, pitch))
            return Action(kind, yaw, pitch)
    return None


def _pair(item: Mapping[str, Any], key: str) -> tuple[float, float]:
    value = item.get(key)
    try:
        low, high = map(number, value if isinstance(value, list | tuple) else ())
    except ValueError:  # not two values, or not numbers
        raise FormatError(f"an item has {key} = {shown(value)}; wanted two angles in degrees, finite numbers") from None
    if max(abs(low), abs(high)) > FARTHEST:
        raise FormatError(f"an item has {key} = {shown(value)}; wanted two angles of at most {FARTHEST:g} degrees")
    return low, high


# --- the camera -------------------------------------------------------------------------------------------------------

HFOV_DEG = 100.0
RESOLUTION = 1080  # rows; columns are rows // 9 * 16
CROSS = (0, 255, 0)
ARM = 10  # pixels of the cross to each side of the centre


def size_of(resolution: int = RESOLUTION) -> tuple[int, int]:
    """(rows, columns) of a view of this resolution."""
    return resolution, resolution // 9 * 16


@dataclass(frozen=True)
class View:
    """The camera's direction, degrees."""

    yaw: float
    pitch: float

    @lazy
    def world_R_view(self) -> np.ndarray:
        """The pose ``(3, 3)`` in our world frame: x at yaw 0, y to the left, z up."""
        return world_R_body(-math.radians(self.yaw), -math.radians(self.pitch))

    @classmethod
    def facing(cls, heading: np.ndarray) -> View:
        """The view at a `heading` ``(2,)``: azimuth and elevation, radians, world frame."""
        yaw, pitch = hstar_from_direction(direction(heading[0], heading[1]))
        return cls(round(float(yaw), 6) % 360, round(float(pitch), 6))

    @lazy
    def heading(self) -> np.ndarray:
        """Where the camera looks ``(2,)``: azimuth and elevation, radians, world frame."""
        return headings_of(np.array(self.yaw), np.array(self.pitch))

    def grid(self, rows: int, columns: int) -> PerspectiveGrid:
        """The view's cells in the world frame."""
        return PerspectiveGrid(rows, columns, math.radians(HFOV_DEG), self.world_R_view)

    def after(self, action: Action | None) -> View:
        """The view after `action`; only ``rotate`` changes it: yaw wraps, pitch ends straight up and straight down."""
        if action is None or action.kind != "rotate":
            return self
        return View(float(normalised(self.yaw + action.yaw)), float(max(-90, min(90, self.pitch + action.pitch))))


def headings_of(yaws: np.ndarray, pitches: np.ndarray) -> np.ndarray:
    """Azimuth and elevation ``(..., 2)``, radians, world frame, of views' yaws and pitches ``(...)``, degrees."""
    return np.stack(azimuth_elevation(direction_from_hstar(yaws, pitches)), axis=-1)


def render_view(
    panorama: np.ndarray, yaw: float, pitch: float, resolution: int = RESOLUTION, cross: bool = True
) -> np.ndarray:
    """The camera's view ``(rows, columns, 3)`` uint8 of a panorama ``(H, W, 3)`` uint8 of any proportions.

    Bilinear, wrapped around both axes as published, and rounded, with the green cross at the middle. The published
    environment interpolates with weights in steps of 1/32, so single pixels differ from its own by a few levels.
    Raises `ImageError` for any other array.
    """
    from scipy.ndimage import map_coordinates

    panorama = _checked_picture(panorama, "a panorama")
    rows, columns = size_of(resolution)
    height, width = panorama.shape[:2]
    longitude, latitude = _rays(rows, columns, float(pitch))
    x = longitude * np.float32(width / 360.0) + np.float32((0.5 + (yaw % 360.0) / 360.0) * width)
    places = np.stack([latitude * np.float32(height / 180.0) + np.float32(height / 2), x])
    bands = [map_coordinates(panorama[..., band], places, np.float32, order=1, mode="grid-wrap") for band in range(3)]
    out = (np.stack(bands, axis=-1) + np.float32(0.5)).astype(np.uint8)
    if cross:
        across, along = _cross(rows, columns)
        out[across, columns // 2] = out[rows // 2, along] = CROSS
    return out


def without_cross(picture: np.ndarray) -> np.ndarray:
    """A view ``(rows, columns, 3)`` uint8 with its cross filled in by the mean of the pixels beside each line.

    For perceptions: a query for something green would find the cross. Raises `ImageError` for anything but a picture.
    """
    pixels = _checked_picture(picture, "a view", least=3).astype(np.float64)
    rows, columns = _cross(*pixels.shape[:2])
    row, column = pixels.shape[0] // 2, pixels.shape[1] // 2
    out = pixels.copy()
    out[row, columns] = (pixels[row - 1, columns] + pixels[row + 1, columns]) / 2
    out[rows, column] = (pixels[rows, column - 1] + pixels[rows, column + 1]) / 2
    out[row, column] = pixels[row - 1 : row + 2 : 2, column - 1 : column + 2 : 2].mean(axis=(0, 1))
    return np.rint(out).astype(np.uint8)


def _checked_picture(picture: np.ndarray, what: str, least: int = 1) -> np.ndarray:
    picture = np.asarray(picture)
    if picture.ndim != 3 or picture.shape[2] != 3 or picture.dtype != np.uint8 or min(picture.shape[:2]) < least:
        raise ImageError(f"{what} is (rows, columns, 3) uint8; got shape {picture.shape}, {picture.dtype}")
    return picture


def _cross(rows: int, columns: int) -> tuple[slice, slice]:
    """The rows of the cross's upright line, and the columns of its level one."""
    row, column = rows // 2, columns // 2
    return slice(max(0, row - ARM), row + ARM + 1), slice(max(0, column - ARM), column + ARM + 1)


def visible_share(view: View, yaw: tuple[float, float], pitch: tuple[float, float] | None) -> float:
    """The visible fraction of a box (degrees; without pitch, of a window of 10 degrees at the horizon)."""
    return float(inside(view, box_points(yaw, pitch)).mean())


def level_of(view: View, yaw: tuple[float, float], pitch: tuple[float, float]) -> int:
    """0 if at least half of the box is in the view, 1 if some of it is, 2 if none."""
    share = visible_share(view, yaw, pitch)
    return 0 if share >= 0.5 else 1 if share > 0 else 2


def inside(view: View, directions: np.ndarray) -> np.ndarray:
    """Which directions ``(n, 3)`` of the world the view shows, bool ``(n,)``."""
    return view.grid(*size_of()).project(directions)[2]


def box_points(yaw: tuple[float, float], pitch: tuple[float, float] | None, steps: int = 24) -> np.ndarray:
    """Directions ``(n, 3)`` that sample a box evenly by solid angle."""
    width = (yaw[1] - yaw[0]) % 360.0
    low, high = pitch if pitch is not None else (-10.0, 10.0)
    parts = (np.arange(steps) + 0.5) / steps
    sines = np.sin(np.radians(low)) + parts * (np.sin(np.radians(high)) - np.sin(np.radians(low)))
    yaws, pitches = np.meshgrid(yaw[0] + parts * width, np.degrees(np.arcsin(np.clip(sines, -1, 1))))
    return direction_from_hstar(yaws, pitches).reshape(-1, 3)


@lru_cache(maxsize=8)
def _rays(rows: int, columns: int, pitch: float) -> tuple[np.ndarray, np.ndarray]:
    """Longitude (right of the view's yaw) and latitude (DOWN) of each pixel's ray ``(rows, columns)``, degrees."""
    rays = View(0.0, pitch).grid(rows, columns).unproject(np.arange(columns), np.arange(rows)[:, None])
    longitude, latitude = (-np.degrees(angle).astype(np.float32) for angle in azimuth_elevation(rays))
    return longitude, latitude

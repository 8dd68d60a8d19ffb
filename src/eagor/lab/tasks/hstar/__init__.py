"""H*Bench: look around in a panorama through a perspective camera, and name the direction of the target.

It has two halves, object search (HOS) and path search (HPS). Here is its protocol: which submissions succeed, what
models are told, what their replies mean, what a view shows. It reproduces the published environment
(humanoid-vstar/hstar at 7a52247), quirks included. Yaw in degrees: 0 is the middle of the panorama, positive to the
RIGHT, 0 to 360. Pitch in degrees, positive up.

Of the prompts, all that the protocol defines is verbatim: actions, tags, order of a turn's parts, feedback. The
explanations and the worked example are in our own words (texts.json).

The camera is rendered pixel for pixel like the published one. In two places that is half a pixel off our conventions:
the ray of column j is (j - w / 2) / f, and a panorama's column centres lie at whole numbers. `render_view` keeps both;
`View.grid` describes the same pixels in our terms.
"""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, get_args

import msgspec
import numpy as np
from msgspec import Meta
from PIL import ImageOps

from eagor._checks import shown
from eagor._values import lazy
from eagor.conventions import direction_from_hstar
from eagor.errors import EagorError, FormatError, ImageError
from eagor.grids import PerspectiveGrid
from eagor.lab.tasks.published import answer_in
from eagor.perception.vlm import IMAGE
from eagor.sources.panorama import checked_picture, read_image
from eagor.sphere import azimuth_elevation, world_R_body

__all__ = [
    "Action", "Box", "Episode", "Reply", "View", "box_points", "middle_of", "normalised", "open_panorama",
    "parse_action", "render_view", "submit_succeeds", "succeeded", "system_text", "turn_text", "window_of",
    "without_cross",
]  # fmt: skip

Kind = Literal["hos", "hps"]
Scoring = Literal["official", "strict"]
SCORINGS: tuple[Scoring, ...] = get_args(Scoring)
LEVELS = {"hos": ("easy", "medium", "hard"), "hps": ("easy", "medium", "hard", "extreme")}
# In an annotation, as the file has it; more is taken for a mistake.
Degrees = Annotated[int, Meta(ge=-3600, le=3600)] | Annotated[float, Meta(ge=-3600, le=3600)]

MAX_TURNS = 10
YAW_TOLERANCE = {"hos": 30, "hps": 10}  # degrees to both sides of the middle, for narrower targets
PITCH_TOLERANCE = 20
FARTHEST_ANSWER = 10**6  # degrees in an answer


class Episode(msgspec.Struct, frozen=True):
    """One start for one target; `id` is ``scene/entry/start``, which share all but the start in a `cluster`.

    `item`: the task, and the annotated box in degrees, as written (without pitch in HPS); `others`: those of the rest
    of the scene. `start`: yaw of the first view, whose pitch is 0. `level`: one of `LEVELS`, or "unknown".
    """

    id: str
    cluster: str
    scene: str
    kind: Kind
    item: dict[str, Any]
    others: list[dict[str, Any]]
    start: int | float
    level: str
    panorama: str


class Box(msgspec.Struct):
    """Where a target is: its angles in degrees, without pitch in HPS."""

    yaw: tuple[Degrees, Degrees]
    pitch: tuple[Degrees, Degrees] | None = None


def normalised(yaw: float) -> float:
    """`yaw` (degrees) in [0, 360)."""
    return (yaw + 360) % 360


def window_of(item: Mapping[str, Any]) -> tuple[tuple[float, float], tuple[float, float]]:
    """Where submissions for an entry of annotation.json succeed: yaw from .. to the right up to .., and pitch, degrees.

    Yaws are in [0, 360). A narrow window is widened. Without ``pitch`` the entry is one of HPS. Raises `FormatError` if
    the angles are not pairs of finite numbers.
    """
    try:
        box = msgspec.convert(item, Box)
    except msgspec.ValidationError as error:
        raise FormatError(
            f"an item is {shown(item)}; wanted yaw and pitch as two angles in degrees ({error})"
        ) from None
    left, right = box.yaw
    right += 360 if left > right else 0
    tolerance = YAW_TOLERANCE["hps" if box.pitch is None else "hos"]
    if right - left < 2 * tolerance:
        middle = (left + right) / 2
        left, right = middle - tolerance, middle + tolerance
    low, high = box.pitch or (-90.0, 90.0)
    if high - low < 2 * PITCH_TOLERANCE:
        middle = (low + high) / 2
        low, high = max(-90.0, middle - PITCH_TOLERANCE), min(90.0, middle + PITCH_TOLERANCE)
    return (normalised(left), normalised(right)), (low, high)


def middle_of(item: Mapping[str, Any]) -> tuple[float, float]:
    """(yaw, pitch) of the middle of an item's window."""
    (left, right), pitch = window_of(item)
    return (left + (right - left) % 360.0 / 2) % 360.0, sum(pitch) / 2


def submit_succeeds(item: Mapping[str, Any], yaw: float, pitch: float, scoring: str = "official") -> bool:
    """Whether submitting (yaw, pitch), degrees, finds the target of one entry of annotation.json.

    `item` has ``yaw`` [left, right] and, in HOS, ``pitch`` [low, high]. ``official`` ignores the pitch if the window
    runs across yaw 0, as the published environment does; ``strict`` never does. Raises `EagorError` for another
    scoring, `FormatError` for an item without usable angles.
    """
    if scoring not in SCORINGS:
        raise EagorError(f"scoring = {scoring!r}; wanted {' or '.join(SCORINGS)}")
    (left, right), (low, high) = window_of(item)
    yaw, high_enough = normalised(yaw), low <= pitch <= high
    if left > right:
        return (yaw >= left or yaw <= right) and (scoring == "official" or high_enough)
    return left <= yaw <= right and high_enough


TEXTS = json.loads(Path(__file__).with_name("texts.json").read_text(encoding="utf-8"))
_FORM = "\n".join(["You can take 1 action(s) at a time.", *TEXTS["form"]])  # ends every turn


def system_text(kind: str) -> str:
    """The system message for ``hos`` or ``hps``."""
    lines = [TEXTS["goal"][kind], *TEXTS["actions"], "", "Example:"]
    replies = [f"<think>{thought}</think><answer>{action}</answer>" for thought, action, _ in TEXTS["example"]]
    for index, reply in enumerate(replies):
        feedback = [f"Env_feedback: {succeeded(TEXTS['example'][index - 1][2])}."] if index else []
        lines += [f"Round {index + 1}:", *feedback, f"image_{index + 1}", reply]
    return "\n".join([*lines, "Round 4:", "Env_feedback: Success", _FORM, f"e.g. {replies[0]}"])


def succeeded(pose: str) -> str:
    """The environment's feedback after a successful turn."""
    return f"Last action executed successfully, your current direction (yaw,pitch) is {pose}"


def turn_text(task: str, view: View, reply: Reply | None) -> str:
    """The text with a view: after a `reply` the action as understood, its outcome, and the camera's direction now."""
    instruction = f"{IMAGE}\nHuman Instruction: {task}\nDecide your next action.\n{_FORM}"
    if reply is None:
        return f"[initial observation]:\n{instruction}"
    valid, feedback = "[]", "Last action is not executed successfully."
    if reply.action is not None:
        valid, feedback = f"[{reply.actions[0]!r}]", succeeded(f"({view.yaw:g},{view.pitch:g})")
    return (
        f"After your answer, the extracted valid action is {valid}.\nThe environment feedback is: {feedback}\n"
        f"done: False\nAfter that, the observation is:\n{instruction}"
    )


class Action(NamedTuple):
    """An action: ``rotate`` by, or ``submit``, (yaw, pitch) in whole degrees."""

    kind: str
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
        """The action, such as ``rotate(-45,0)``; None if there is none or the environment could not carry it out."""
        text = "".join(self.actions)
        kind = "rotate" if text.startswith("rotate") else "submit"
        parts = text.replace(kind, "").strip("()").split(",")
        try:
            yaw, pitch = int(parts[0].strip()), int(parts[1].strip())
        except (ValueError, IndexError):
            return None
        if max(abs(yaw), abs(pitch)) > FARTHEST_ANSWER:  # means the same, and a float can hold it
            yaw, pitch = yaw % 360, max(-FARTHEST_ANSWER, min(FARTHEST_ANSWER, pitch))
        return Action(kind, yaw, pitch) if text.startswith(kind) else None


def parse_action(text: str) -> Reply:
    """The parsed reply of a model, in the published form ``free_think``: the first ``<answer>`` anywhere counts.

    Tags that are left inside of a thought or an answer are taken out, so ``<answer><answer>submit(10,0)</answer>``
    submits. Of several actions (separated by ``|``) the first counts.
    """
    # The published patterns without their backtracking, which takes minutes for some replies: where the first place of
    # a tag does not fit, no later one does.
    text = text.replace("<image>", "")
    answer, whole = answer_in(text), text.strip()
    join = re.search(r"</think>\s*<answer>", whole)
    ends = whole.startswith("<think>") and whole.endswith("</answer>")
    kept = ends and join is not None and join.end() <= len(whole) - len("</answer>")
    thought, thinks, after = text.partition("</think>")
    if text.startswith("<think>") and thinks and answer_in(after) is not None:
        answer = answer_in(after)
    else:
        thought = ""
    for tag in ("<think>", "</think>", "<answer>", "</answer>"):
        thought, answer = thought.replace(tag, "").strip(), (answer or "").replace(tag, "").strip()
    return Reply(thought, [part.strip() for part in answer.split("|") if part.strip()][:1], kept)


HFOV_DEG = 100.0
RESOLUTION = 1080  # rows; columns are rows // 9 * 16
ARM = 10  # pixels of the green cross to each side of the centre


@dataclass(frozen=True)
class View:
    """The camera's direction, degrees."""

    yaw: float
    pitch: float

    @lazy
    def world_R_view(self) -> np.ndarray:
        """The pose ``(3, 3)`` in our world frame: x at yaw 0, y to the left, z up."""
        return world_R_body(-math.radians(self.yaw), -math.radians(self.pitch))

    def grid(self, rows: int = RESOLUTION) -> PerspectiveGrid:
        """The view's cells in the world frame."""
        return PerspectiveGrid(rows, rows // 9 * 16, math.radians(HFOV_DEG), self.world_R_view)

    def shows(self, directions: np.ndarray) -> np.ndarray:
        """Which directions ``(n, 3)`` of the world it shows, bool ``(n,)``."""
        return self.grid().project(directions)[2]

    def share(self, item: Mapping[str, Any]) -> float:
        """The visible fraction of an item's box (without pitch, of a window of 10 degrees at the horizon)."""
        return float(self.shows(box_points(item["yaw"], item.get("pitch"))).mean())

    def after(self, action: Action | None) -> View:
        """The view after `action`; only ``rotate`` changes it: yaw wraps, pitch ends straight up and straight down."""
        if action is None or action.kind != "rotate":
            return self
        return View(float(normalised(self.yaw + action.yaw)), float(max(-90, min(90, self.pitch + action.pitch))))


@lru_cache(maxsize=2)
def open_panorama(path: str) -> np.ndarray:
    """The picture ``(H, W, 3)`` uint8, turned by its orientation tag as published. Read-only.

    Raises `ImageError` if it is missing or not a picture.
    """
    try:
        image = read_image(path, os.path.getsize(path), ImageOps.exif_transpose)
    except Exception as error:  # decoders may raise anything for damaged files
        raise ImageError(f"the panorama {path} cannot be read ({type(error).__name__}: {error}); fetch it") from error
    image.setflags(write=False)
    return image


def render_view(
    panorama: np.ndarray, yaw: float, pitch: float, resolution: int = RESOLUTION, cross: bool = True
) -> np.ndarray:
    """The camera's view ``(rows, columns, 3)`` uint8 of a panorama ``(H, W, 3)`` uint8 of any proportions.

    Bilinear, wrapped around both axes as published, with the green cross. The published environment interpolates with
    weights in steps of 1/32, so single pixels differ by a few levels. Raises `ImageError` for any other array.
    """
    from scipy.ndimage import map_coordinates

    panorama = checked_picture(panorama)
    height, width = panorama.shape[:2]
    longitude, latitude = _rays(resolution, float(pitch))
    x = longitude * np.float32(width / 360.0) + np.float32((0.5 + (yaw % 360.0) / 360.0) * width)
    places = np.stack([latitude * np.float32(height / 180.0) + np.float32(height / 2), x])
    bands = [map_coordinates(panorama[..., band], places, np.float32, order=1, mode="grid-wrap") for band in range(3)]
    out = (np.stack(bands, axis=-1) + np.float32(0.5)).astype(np.uint8)
    if cross:
        row, column, upright, level = _cross(out)
        out[upright, column] = out[row, level] = (0, 255, 0)
    return out


@lru_cache(maxsize=8)
def _rays(resolution: int, pitch: float) -> tuple[np.ndarray, np.ndarray]:
    """Longitude (right of the view's yaw) and latitude (DOWN) of each pixel's ray ``(rows, columns)``, degrees."""
    grid = View(0.0, pitch).grid(resolution)
    rays = grid.unproject(np.arange(grid.width), np.arange(grid.height)[:, None])
    longitude, latitude = (-np.degrees(angle).astype(np.float32) for angle in azimuth_elevation(rays))
    return longitude, latitude


def without_cross(picture: np.ndarray) -> np.ndarray:
    """A view ``(rows, columns, 3)`` uint8 with its cross filled in by the mean of the pixels beside each line.

    For perceptions: a query for something green would find the cross. Raises `ImageError` for anything but a picture.
    """
    pixels = checked_picture(picture, "a view").astype(np.float64)
    row, column, upright, level = _cross(pixels)
    out = pixels.copy()
    out[row, level] = (pixels[row - 1, level] + pixels[row + 1, level]) / 2
    out[upright, column] = (pixels[upright, column - 1] + pixels[upright, column + 1]) / 2
    out[row, column] = pixels[row - 1 : row + 2 : 2, column - 1 : column + 2 : 2].mean(axis=(0, 1))
    return np.rint(out).astype(np.uint8)


def _cross(picture: np.ndarray) -> tuple[int, int, slice, slice]:
    """The middle row and column of a view, the rows of the cross's upright line, and the columns of its level one."""
    row, column = picture.shape[0] // 2, picture.shape[1] // 2
    return row, column, slice(max(0, row - ARM), row + ARM + 1), slice(max(0, column - ARM), column + ARM + 1)


def box_points(yaw: tuple[float, float], pitch: tuple[float, float] | None) -> np.ndarray:
    """Directions ``(576, 3)`` that sample a box evenly by solid angle."""
    low, high = np.sin(np.radians(pitch if pitch is not None else (-10.0, 10.0)))
    parts = (np.arange(24) + 0.5) / 24
    pitches = np.degrees(np.arcsin(np.clip(low + parts * (high - low), -1, 1)))
    yaws, pitches = np.meshgrid(yaw[0] + parts * ((yaw[1] - yaw[0]) % 360.0), pitches)
    return direction_from_hstar(yaws, pitches).reshape(-1, 3)

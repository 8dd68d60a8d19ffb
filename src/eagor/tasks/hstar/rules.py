"""The rules of H*Bench: which submissions succeed, which replies count as actions, and how the camera moves.

Yaw in degrees: 0 is the middle of the panorama, positive to the RIGHT, 0 to 360. Pitch in degrees, positive up, -90 to
90. It reproduces the published environment (H*Bench, humanoid-vstar/hstar at 7a52247), quirks included, and is tested
against vectors that it produced.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args

from eagor._json import number, shown
from eagor.errors import EagorError, FormatError

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
class Reply(Mapping[str, Any]):
    """A parsed reply: the thought, the actions, whether the form was kept; also a mapping of these names."""

    think_content: str
    actions: list[str]
    format_correct: bool

    @property
    def action(self) -> Action | None:
        """The single action; None if there is not exactly one or it cannot be carried out."""
        return read_action(self.actions[0]) if len(self.actions) == 1 else None

    def __getitem__(self, key: str) -> Any:
        return vars(self)[key]

    def __iter__(self) -> Iterator[str]:
        return iter(vars(self))

    def __len__(self) -> int:
        return len(vars(self))


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
    found: list[re.Match[str]] = []
    for mark in marks:
        pattern = re.compile(mark)
        place = pattern.match(text) if at_start and not found else pattern.search(text, found[-1].end() if found else 0)
        if place is None:
            return None
        found.append(place)
    return found


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


def turned(yaw: float, pitch: float, action: Action) -> tuple[float, float]:
    """The camera's direction after ``rotate``: yaw wraps, pitch is clamped to straight up and straight down."""
    return normalised(yaw + action.yaw), max(-90, min(90, pitch + action.pitch))


def _pair(item: Mapping[str, Any], key: str) -> tuple[float, float]:
    value = item.get(key)
    try:
        low, high = map(number, value if isinstance(value, list | tuple) else ())
    except ValueError:  # not two values, or not numbers
        raise FormatError(f"an item has {key} = {shown(value)}; wanted two angles in degrees, finite numbers") from None
    if max(abs(low), abs(high)) > FARTHEST:
        raise FormatError(f"an item has {key} = {shown(value)}; wanted two angles of at most {FARTHEST:g} degrees")
    return low, high

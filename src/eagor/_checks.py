"""Checks of the fields of settings classes, with one error text, of time stamps, of panoramas' shape, and of JSON.

The predicates return False for values that are no numbers: settings also come from JSON and the command line. Every
fault of JSON from elsewhere is a `ValueError` with a readable text.
"""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Mapping
from numbers import Integral, Real
from typing import Any, NoReturn

import numpy as np

from eagor.errors import EagorError, ImageError, TimeError

ROUNDING = 2  # columns by which a panorama may fail to be 2:1
LATEST = 1e12  # seconds: a larger stamp counts milliseconds or less


def require(owner: Any, fields: Mapping[str, tuple[bool, str]], error: type[EagorError] = EagorError) -> None:
    """Raise `error` for the first field of `owner` that is wrong; `fields`: name to (is it right, what was wanted)."""
    for name, (fits, wanted) in fields.items():
        if not fits:
            raise error(f"{type(owner).__name__}: {name} = {getattr(owner, name)!r}; wanted {wanted}")


def within(value: Any, lowest: float, highest: float = math.inf) -> bool:
    """Whether `value` is a finite number from `lowest` to `highest`, both included."""
    if isinstance(value, bool) or not isinstance(value, Real):
        return False
    try:
        number = float(value)
    except OverflowError:  # a whole number of more than 308 digits
        return False
    return math.isfinite(number) and lowest <= number <= highest


def above(value: Any, lowest: float, highest: float = math.inf) -> bool:
    """Whether `value` is a finite number greater than `lowest`, and at most `highest`."""
    return within(value, lowest, highest) and value > lowest


def whole(value: Any, lowest: float, highest: float = math.inf) -> bool:
    """Whether `value` is a whole number from `lowest` to `highest`, both included; 2.0 and True are not."""
    return isinstance(value, Integral) and within(value, lowest, highest)


def checked_stamp(stamp: float) -> float:
    """`stamp` as a float, seconds. Raises `TimeError` unless it is finite, and within `LATEST`."""
    try:
        stamp = float(stamp)
    except (TypeError, ValueError) as error:
        raise TimeError(f"stamp = {stamp!r}; wanted the time in seconds, a number such as time.monotonic()") from error
    if not abs(stamp) <= LATEST:
        raise TimeError(
            f"stamp = {stamp!r}; wanted the time (of evidence: of its capture) in seconds, not milliseconds or less: a "
            f"finite number of at most {LATEST:g}"
        )
    return stamp


def is_twice_as_wide(height: int, width: int) -> bool:
    """Whether a picture of this size is 2:1, as a whole panorama is, up to the rounding of a resized one."""
    return abs(width - 2 * height) <= ROUNDING


def warn_unless_whole(picture: Any) -> None:
    """A `UserWarning` if a picture ``(H, W, ...)`` that came for a panorama is not 2:1."""
    height, width = picture.shape[:2]
    if not is_twice_as_wide(height, width):
        warnings.warn(
            f"a picture of {width} x {height} came for a panorama, which is 2:1: all columns are taken for 360 "
            "degrees, all rows for 180. For an ordinary picture, give its lens: perception.view(picture, "
            "eagor.PerspectiveGrid(height, width, hfov), query)",
            UserWarning,
            stacklevel=4,
        )


def checked_picture(image: Any, name: str = "the panorama", grid: Any = None) -> np.ndarray:
    """`image`, checked to be uint8 ``(H, W, 3)``, and of the size of its `grid`, if given. Raises `ImageError`."""
    image = np.asarray(image)
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[-1] != 3 or image.size == 0:
        raise ImageError(
            f"{name} is {image.dtype} of shape {image.shape}; wanted uint8 sRGB (H, W, 3). Files: "
            "eagor.sources.panorama.read_panorama"
        )
    if grid is not None and image.shape[:2] != grid.shape:
        height, width = image.shape[:2]
        raise ImageError(
            f"{name} is {width} x {height}, its grid is for {grid.width} x {grid.height}; wanted the same size: the "
            f"grid of this picture, such as grid.resized({height}, {width})"
        )
    return image


_DEEPEST = 200  # nesting of lists that repr, copy and json can still recurse over


def parsed(text: str | bytes, strict: bool = False) -> Any:
    """The value that `text` holds; `strict`: NaN and Infinity are errors, as in the JSON standard.

    Raises `ValueError` for invalid JSON, undecodable bytes, numbers of thousands of digits, an object that has a key
    twice, and lists or objects nested too deep to recurse over.
    """
    try:
        found = json.loads(text, parse_constant=_refused if strict else None, object_pairs_hook=_once)
        opened = text.count(b"[") + text.count(b"{") if isinstance(text, bytes) else text.count("[") + text.count("{")
        if opened > _DEEPEST:
            _check_depth(found, _DEEPEST)
    except RecursionError:
        raise ValueError("the lists are nested too deep to be read") from None
    return found


def shown(value: Any, most: int = 60) -> str:
    """`value` for an error text, cut at `most` characters."""
    text = repr(value)
    return text if len(text) <= most else text[: most - 3] + "..."


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object whose keys differ: which of two values is meant cannot be known."""
    found = dict(pairs)
    if len(found) < len(pairs):
        keys = [key for key, _ in pairs]
        raise ValueError(f"an object has the key {shown(next(key for key in keys if keys.count(key) > 1))} twice")
    return found


def _check_depth(value: Any, left: int) -> None:
    if isinstance(value, dict | list):
        if not left:
            raise ValueError(f"the lists are nested more than {_DEEPEST} deep")
        for each in value.values() if isinstance(value, dict) else value:
            _check_depth(each, left - 1)


def _refused(name: str) -> NoReturn:
    raise ValueError(f"{name} is not a JSON number")

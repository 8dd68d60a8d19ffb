"""Perceptions: a panorama and a query in, evidence about directions out.

A perception is anything that can be called like `Perception`. `load` makes one from a line of text, and packages add
their own under the entry-point group ``eagor.perceptions`` (a name, and a class or function that makes the perception).
`check_perception` is the test that every one of them has to pass.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Protocol, runtime_checkable

import numpy as np

from eagor.errors import EagorError, QueryError
from eagor.evidence import Evidence

GROUP = "eagor.perceptions"
# Known even where the package runs from a folder, without installed metadata.
BUILT_IN = {
    "colour": "eagor.perception.colour:ColourPerception",
    "endpoint": "eagor.perception.endpoint:from_text",
    "replay": "eagor.perception.replay:ReplayPerception",
    "scout": "eagor.perception.scout:ScoutPerception",
    "truth": "eagor.perception.truth:TruthPerception",
}


@runtime_checkable
class Perception(Protocol):
    """What looks for things in a panorama."""

    def __call__(self, panorama: np.ndarray, query: str, *, stamp: float | None = None) -> Evidence:
        """Evidence for where in `panorama` the thing is that `query` names, in the body frame of the panorama.

        Args:
            panorama: equirectangular image ``(H, W, 3)``, uint8 sRGB, in the layout of `eagor.sphere`. It is not
                changed.
            query: what to look for, in words.
            stamp: when the panorama was captured, seconds; the evidence carries it.

        Raises `QueryError` if the words mean nothing to this perception, `ImageError` if the image is unusable. Not
        finding the thing is no error: the evidence then says that we looked and saw nothing.
        """
        ...


def known() -> dict[str, EntryPoint]:
    """The perceptions that `load` can make, by name; nothing is imported yet."""
    found = {point.name: point for point in entry_points(group=GROUP)}
    return found | {name: EntryPoint(name, value, GROUP) for name, value in BUILT_IN.items()}


def load(spec: str, **options: Any) -> Perception:
    """The perception that `spec` names: ``"colour"``, ``"replay:detections.jsonl"``, or an installed one.

    Text after the first colon becomes the first argument of what makes the perception; `options` are passed on by
    name. Raises `QueryError` for an unknown name, `EagorError` if it cannot be imported or does not take the arguments.
    """
    name, colon, text = str(spec).partition(":")
    choices = known()
    if name not in choices:
        raise QueryError(f"there is no perception {name!r}; known are {', '.join(sorted(choices))}")
    try:
        make: Callable[..., Perception] = choices[name].load()
    except (ImportError, AttributeError) as error:
        raise EagorError(
            f"perception {name!r} ({choices[name].value}) cannot be imported: {error}. Install what it needs"
        ) from error
    arguments = (text,) if colon else ()
    try:
        inspect.signature(make).bind(*arguments, **options)
    except TypeError as error:
        raise EagorError(
            f"perception {spec!r} cannot be made with the options {sorted(options)}: {error}. "
            f"It takes {name}{inspect.signature(make)}; the text after ':' is the first argument"
        ) from error
    return make(*arguments, **options)


def check_perception(
    perception: Perception,
    panorama: np.ndarray,
    query: str,
    *,
    stamp: float = 12.5,
    roll: int | None = None,
    tolerance: float = 1e-3,
) -> None:
    """Raise `AssertionError` unless `perception` keeps the contract on this panorama and query.

    It must return `Evidence` that carries `stamp`, with a response in [0, 1] that fits its grid and finite
    coefficients; leave the panorama as it was; and answer a second call on the same grid.
    With `roll`, the panorama rolled by so many columns must roll the response by the same angle, to `tolerance`
    (largest difference): for perceptions that treat all azimuths alike.
    """
    before = panorama.copy()
    evidence = perception(panorama, query, stamp=stamp)
    _require(isinstance(evidence, Evidence), f"returned {type(evidence).__name__}; wanted eagor.Evidence")
    _require(np.array_equal(before, panorama), "changed the panorama; work on a copy")
    _require(evidence.stamp == stamp, f"was given stamp={stamp}, but the evidence carries {evidence.stamp}")
    response = np.asarray(evidence.response)
    _require(
        response.shape == tuple(evidence.grid.shape),
        f"response has shape {response.shape} on a grid of {tuple(evidence.grid.shape)}",
    )
    _require(bool(((response >= 0) & (response <= 1)).all()), "response leaves [0, 1] or is not finite")
    _require(bool(np.isfinite(np.asarray(evidence.coefficients(3))).all()), "coefficients are not finite")
    again = perception(panorama, query, stamp=stamp)
    _require(
        type(again.grid) is type(evidence.grid) and tuple(again.grid.shape) == tuple(evidence.grid.shape),
        "a second call on the same panorama answers on another grid",
    )
    if roll is None:
        return
    columns, rest = divmod(roll * response.shape[1], panorama.shape[1])
    _require(
        rest == 0,
        f"answers with {response.shape[1]} columns, and roll={roll} is no whole number of those; choose another roll",
    )
    rolled = np.asarray(perception(np.roll(panorama, roll, axis=1), query, stamp=stamp).response)
    _require(rolled.shape == response.shape, "a rolled panorama answers on another grid")
    worst = float(np.abs(rolled - np.roll(response, columns, axis=1)).max())
    _require(worst <= tolerance, f"a roll of the panorama is not a roll of the response: they differ by {worst:.3g}")


def _require(holds: bool, text: str) -> None:
    if not holds:
        raise AssertionError(f"the perception {text}")

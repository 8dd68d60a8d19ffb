"""The error rates of a simulated detector, from which `eagor.perception.truth` draws its mistakes."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

from eagor._checks import within
from eagor.errors import EagorError

WIDEST = 0.7  # radians: square root of the sum of the variances along both axes


@dataclass(frozen=True)
class Noise:
    """Error rates of a detector; docs/simulation.md explains each. The defaults are those of an ideal detector.

    Rates are per frame, for a thing of at least the size `smallest`, and independent of `persistence`. Things wider
    than `WIDEST`, such as a floor, are never confused with the target. `spread` is in radians.

    Raises `EagorError` for numbers out of range.
    """

    miss: float = 0.0
    false_alarm: float = 0.0
    confuse_category: float = 0.0
    confuse_colour: float = 0.0
    spread: float = 0.0
    floor: float = 0.0
    persistence: float = 0.0
    smallest: float = 0.0
    weakest: float = 1.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            highest = {"spread": math.pi / 2, "smallest": math.inf}.get(field.name, 1.0)
            if not within(value, 0, highest):
                unit = " radians (degrees in the text form)" if field.name == "spread" else ""
                raise EagorError(f"{field.name} = {value!r}; wanted a number from 0 to {highest:.4g}{unit}")

    @classmethod
    def ideal(cls) -> Noise:
        """No mistakes: each matching thing at its place with score 1, response 0 elsewhere."""
        return cls()

    @classmethod
    def moderate(cls) -> Noise:
        """A usable detector: 30 % missed, a false alarm in every fifth frame, 8 degrees of error, some confusions."""
        return cls(
            miss=0.3,
            false_alarm=0.2,
            confuse_category=0.1,
            confuse_colour=0.02,
            spread=math.radians(8),
            floor=0.02,
            persistence=0.3,
            smallest=0.1,
            weakest=0.6,
        )

    @classmethod
    def parse(cls, text: str) -> Noise:
        """The noise from text: "ideal", "moderate" (also ""), "miss=0.1,spread=4", "ideal,miss=0.3".

        Pairs change the profile named first, or "moderate"; here `spread` is in degrees. Raises `EagorError`, which
        lists the keys, for other text.
        """
        profiles = {"ideal": cls.ideal, "moderate": cls.moderate}
        first, *rest = [part.strip() for part in text.split(",")]
        pairs = rest if first in ("", *profiles) else [first, *rest]
        names = [field.name for field in fields(cls)]
        changes: dict[str, float] = {}
        for pair in pairs:
            key, _, value = (part.strip() for part in pair.partition("="))
            try:
                if key in changes or key not in names:
                    raise ValueError(key)
                changes[key] = float(value)
            except ValueError:
                raise EagorError(
                    f"truth settings {text!r}: cannot read {pair!r}. Wanted 'ideal', 'moderate' or key=number pairs, "
                    f"separated by commas, each key once, such as 'miss=0.1,spread=4'; keys: {', '.join(names)} "
                    "(spread in degrees)"
                ) from None
        if "spread" in changes:
            changes["spread"] = math.radians(changes["spread"])
        return replace(profiles.get(first, cls.moderate)(), **changes)

"""How a model on a server is asked, by its name alone: the cell of its picture, frame and order of its coordinates."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

from eagor.perception.vlm.boxes import Frame, Order
from eagor.perception.vlm.families import FAMILIES, Family


@dataclass(frozen=True)
class Style:
    """How a family sees and answers.

    Attributes:
        family: its name, as in `families`.
        cell: pixels of one side of an image token; pictures are sent in multiples of it.
        pixels: of a panorama, unless the caller says otherwise.
        view: pixels of one side of a (square) view.
        frame: what its coordinates count.
        order: of its coordinates.
        aspect: width / height of a panorama as it is sent (see `families.Served`).
        grounded: whether it was trained to write boxes; the others are better asked yes or no.
    """

    family: str
    cell: int
    pixels: int
    view: int
    frame: Frame
    order: Order = "xyxy"
    aspect: float = 2.0
    grounded: bool = True


# Qwen2-VL, which runs on servers only, and what is asked of models that no name tells anything about.
_QWEN2_VL = re.compile(r"qwen[\W_]?2[\W_]?vl")
OTHER = Style("other", 28, 700 * 1400, 560, "thousand")


def style_of(model: str) -> Style:
    """The style of a model by its name, such as ``Qwen/Qwen2.5-VL-7B-Instruct`` or ``qwen2.5vl:7b``; else `OTHER`."""
    name = model.lower()
    for family in FAMILIES:
        if family.served and re.search(family.served.pattern, name):
            return _style(family)
    if _QWEN2_VL.search(name):
        return replace(OTHER, family="qwen2_vl")
    return OTHER


def _style(family: Family) -> Style:
    served = family.served
    assert served is not None
    frame = family.frame or served.frame
    return Style(
        family.name,
        served.cell,
        family.pixels,
        served.view,
        frame,
        served.order,
        served.aspect,
        family.frame is not None,
    )

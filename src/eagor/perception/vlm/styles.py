"""How a model on a server is asked, by its name alone: the cell of its picture, frame and order of its coordinates."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

from eagor.perception.vlm.boxes import Frame, Order
from eagor.perception.vlm.families import FAMILIES


@dataclass(frozen=True)
class Style:
    """How the family of this name sees and answers; see `families.Served` for what is not said here.

    `pixels` of a panorama, unless the caller says otherwise. `grounded`: whether it was trained to write boxes; the
    others are better asked yes or no.
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
        said, trained = family.served, family.frame is not None
        if said and re.search(said.pattern, name):
            frame = family.frame or said.frame
            return Style(family.name, said.cell, family.pixels, said.view, frame, said.order, said.aspect, trained)
    return replace(OTHER, family="qwen2_vl") if _QWEN2_VL.search(name) else OTHER

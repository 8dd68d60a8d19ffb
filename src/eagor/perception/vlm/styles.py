"""How a served model is asked, by its name alone: cell size of its pictures, frame and order of its coordinates."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

from eagor.perception.vlm.boxes import Frame, Order
from eagor.perception.vlm.families import FAMILIES


@dataclass(frozen=True)
class Style:
    """How the model of this name sees and answers; other fields as in `families.Served`.

    `pixels`: of a panorama, by default. `grounded`: whether it was trained to write boxes; others are better asked yes
    or no.
    """

    family: str
    cell: int
    pixels: int
    view: int
    frame: Frame
    order: Order = "xyxy"
    aspect: float = 2.0
    grounded: bool = True


# Qwen2-VL, which runs on servers only, and the default for names of no known family.
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

"""How families of models want to be asked: the cell of their picture, their frame and order of coordinates."""

from __future__ import annotations

import re
from dataclasses import dataclass

from eagor.perception.vlm.boxes import Frame, Order


@dataclass(frozen=True)
class Style:
    """How a family sees and answers.

    Attributes:
        family: its name, as in ``model_type`` of its configuration.
        cell: pixels of one side of an image token; pictures are sent in multiples of it.
        pixels: of a panorama, unless the caller says otherwise.
        view: pixels of one side of a (square) view.
        frame: what its coordinates count.
        order: of its coordinates.
        aspect: width / height of a panorama as it is sent. Where processors bring everything to a square, some by
            cutting the sides off, the panorama is squeezed beforehand: cells are then twice as wide as high.
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


_STYLES: tuple[tuple[str, Style], ...] = (
    (r"qwen[\W_]?2[._]?5[\W_]?vl", Style("qwen2_5_vl", 28, 700 * 1400, 560, "pixels")),
    (r"qwen[\W_]?2[\W_]?vl", Style("qwen2_vl", 28, 700 * 1400, 560, "thousand")),
    (r"qwen[\W_]?3[._]?5|qwen[\W_]?3[\W_]?vl", Style("qwen3_vl", 32, 704 * 1408, 576, "thousand")),
    (r"gemma[\W_]?3", Style("gemma3", 56, 896 * 896, 896, "thousand", "yxyx", aspect=1.0, grounded=False)),
    (r"internvl", Style("internvl", 28, 448 * 896, 448, "thousand")),
    (
        r"llava[\W_]?(?:v?1[._]?[56]|7b|13b|hf|\Z)",
        Style("llava", 14, 336 * 336, 336, "unit", aspect=1.0, grounded=False),
    ),
    (r"janus", Style("janus", 16, 384 * 384, 384, "unit", aspect=1.0, grounded=False)),
)
OTHER = Style("other", 28, 700 * 1400, 560, "thousand")


def style_of(model: str) -> Style:
    """The style of a model by its name, such as ``Qwen/Qwen2.5-VL-7B-Instruct`` or ``qwen2.5vl:7b``; else `OTHER`."""
    for pattern, style in _STYLES:
        if re.search(pattern, model.lower()):
            return style
    return OTHER

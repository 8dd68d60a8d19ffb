"""The questions that a model is asked."""

from __future__ import annotations

from typing import Any

from eagor.errors import QueryError
from eagor.perception.vlm.boxes import Frame, Order

# The question without content in relative attention (Zhang et al., "MLLMs know where to look", ICLR 2025).
GENERAL = "Write a general description of the image."

_FRAMES = {
    "pixels": ("in pixels of this image", "100, 150, 220, 310"),
    "thousand": ("as whole numbers from 0 to 1000 of the image's width and height", "100, 150, 220, 310"),
    "unit": ("as fractions from 0 to 1 of the image's width and height", "0.10, 0.15, 0.22, 0.31"),
}
_KEYS = {"xyxy": ("bbox_2d", "x1, y1, x2, y2"), "yxyx": ("box_2d", "y1, x1, y2, x2")}


def phrase(query: str) -> str:
    """`query` on one line. Raises `QueryError` if it is empty."""
    words = " ".join(query.split()) if isinstance(query, str) else ""
    if not words:
        raise QueryError(f"the query is {query!r}; wanted words for what to look for, such as 'red chair'")
    return words


def ask_boxes(query: str, frame: Frame, order: Order = "xyxy") -> str:
    """The request for all boxes of what `query` names, as JSON, in the model's own frame and order of coordinates."""
    name = phrase(query)
    key, corners = _KEYS[order]
    where, numbers = _FRAMES[frame]
    return (
        f"Locate every instance of this in the image: {name}. Answer with a JSON list and nothing else, one entry per "
        f'instance: [{{"{key}": [{corners}], "label": "{name.replace(chr(34), chr(39))}"}}], with the coordinates '
        f"{where}, for example [{numbers}]. If there is none in the image, answer []."
    )


def boxes_schema(frame: Frame, order: Order = "xyxy") -> dict[str, Any]:
    """The JSON schema of the answer to `ask_boxes`."""
    number = {"type": "number"} if frame == "unit" else {"type": "integer"}
    key = _KEYS[order][0]
    entry = {
        "type": "object",
        "properties": {
            key: {"type": "array", "items": number, "minItems": 4, "maxItems": 4},
            "label": {"type": "string"},
        },
        "required": [key, "label"],
        "additionalProperties": False,
    }
    return {"type": "array", "items": entry, "maxItems": 16}


def ask_presence(query: str) -> str:
    """The question whether the picture shows what `query` names, to be answered by yes or no."""
    return f"Does this image show the following: {phrase(query)}? Answer with one word, yes or no."

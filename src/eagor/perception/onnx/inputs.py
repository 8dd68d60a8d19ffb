"""A picture into a network's input, fitted, in the range and order of colours that it wants; and boxes back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from PIL import Image

Fit = Literal["letterbox", "corner", "stretch"]
Values = Literal["unit", "byte", "signed", "imagenet"]
Order = Literal["rgb", "bgr"]
FITS, VALUES, ORDERS = get_args(Fit), get_args(Values), get_args(Order)

PAD = 114  # grey beside a letterboxed picture, as the YOLO family is trained
_MEAN, _STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)  # of ImageNet's colours in [0, 1], red first


@dataclass(frozen=True)
class Placed:
    """Where a picture of ``shape`` (h, w) lies in the input: input pixel = scale * picture pixel + offset (x, y)."""

    shape: tuple[int, int]
    scale: tuple[float, float]
    offset: tuple[float, float]

    def back(self, boxes: np.ndarray) -> np.ndarray:
        """`boxes` ``(n, 4)`` in pixels of the input, in pixels of the picture; nothing is cut off."""
        return (boxes - np.tile(self.offset, 2)) / np.tile(self.scale, 2)


def place(picture: np.ndarray, size: tuple[int, int], fit: Fit) -> tuple[np.ndarray, Placed]:
    """`picture` ``(h, w, 3)`` uint8 in an input of `size` (rows, columns), and where it lies there.

    ``letterbox`` keeps its shape and centres it on grey, ``corner`` puts it at the top left, ``stretch`` fills all.
    """
    (rows, columns), (height, width) = size, picture.shape[:2]
    if fit == "stretch":
        inner = size
    else:
        scale = min(rows / height, columns / width)
        inner = max(1, min(rows, round(height * scale))), max(1, min(columns, round(width * scale)))
    top, left = ((rows - inner[0]) // 2, (columns - inner[1]) // 2) if fit == "letterbox" else (0, 0)
    if inner != (height, width):
        picture = np.asarray(Image.fromarray(picture).resize((inner[1], inner[0]), Image.Resampling.BILINEAR))
    placed = Placed((height, width), (inner[1] / width, inner[0] / height), (float(left), float(top)))
    if inner == size:
        return picture, placed
    canvas = np.full((rows, columns, 3), PAD, dtype=np.uint8)
    canvas[top : top + inner[0], left : left + inner[1]] = picture
    return canvas, placed


def tensor(canvas: np.ndarray, values: Values, order: Order, dtype: np.dtype, channels_first: bool) -> np.ndarray:
    """`canvas` ``(h, w, 3)`` uint8 RGB as a network takes it, without the axis of the batch.

    `values`: ``byte`` 0 to 255, ``unit`` 0 to 1, ``signed`` -1 to 1, ``imagenet`` standardised by the mean and the
    deviation of ImageNet's colours. A uint8 input takes the bytes as they are.
    """
    found = canvas if dtype == np.uint8 else canvas.astype(np.float32)
    if dtype != np.uint8 and values != "byte":
        found = found / 127.5 - 1 if values == "signed" else found / 255
        if values == "imagenet":
            found = (found - np.array(_MEAN, np.float32)) / np.array(_STD, np.float32)
    found = found[..., ::-1] if order == "bgr" else found
    return np.ascontiguousarray(found.transpose(2, 0, 1) if channels_first else found, dtype=dtype)

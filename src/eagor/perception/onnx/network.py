"""A network in an ONNX file that takes one picture, run by onnxruntime; how a picture gets into its input."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from PIL import Image

from eagor._extras import need
from eagor.errors import EagorError

Size = tuple[int, int]  # rows, columns
Fit = Literal["letterbox", "corner", "stretch"]
Values = Literal["unit", "byte", "imagenet"]
Order = Literal["rgb", "bgr"]
FITS, VALUES, ORDERS = get_args(Fit), get_args(Values), get_args(Order)

LARGEST = 8192  # rows or columns of an input
PAD = 114  # grey beside a letterboxed picture, as the YOLO family is trained
_MEAN, _STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)  # of ImageNet's colours in [0, 1], red first
_DTYPES = {
    "tensor(float)": np.float32, "tensor(float16)": np.float16, "tensor(double)": np.float64, "tensor(uint8)": np.uint8,
    "tensor(int64)": np.int64, "tensor(int32)": np.int32, "tensor(bool)": np.bool_,
}  # fmt: skip


def session(file: str | os.PathLike[str], threads: int = 1) -> Any:
    """The network in `file`, to run on the CPU, on `threads` cores: the machine's others belong to the caller.

    Raises what onnxruntime raises; the caller has checked that onnxruntime is there.
    """
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads, options.inter_op_num_threads = threads, 1
    options.log_severity_level = 4  # notes on an export help nobody, and faults are raised
    return onnxruntime.InferenceSession(os.fspath(file), options, providers=["CPUExecutionProvider"])


class Network:
    """A network that takes one picture; `metadata`: what its file says of itself.

    Raises `EagorError` for a file that is none, or takes something else; `MissingExtraError` without onnxruntime.
    """

    def __init__(self, path: str | os.PathLike[str], threads: int = 1) -> None:
        need("a detector in an ONNX file", "photos", "onnxruntime", "cv2")
        self.path = Path(path)
        if not self.path.is_file():
            raise EagorError(f"there is no file {path}; wanted a detector in an ONNX file, such as yolo11n.onnx")
        try:
            self._session = session(self.path, threads)
        except Exception as error:  # onnxruntime has a class for each fault, below none of its own
            raise EagorError(
                f"{path} cannot be opened as an ONNX model ({_short(error)}); export it again, by a version of "
                "ONNX that this onnxruntime knows"
            ) from error
        self.metadata: Mapping[str, str] = self._session.get_modelmeta().custom_metadata_map
        inputs = self._session.get_inputs()
        pictures = [each for each in inputs if _is_picture(each)]
        if len(pictures) != 1:
            shapes = ", ".join(f"{each.name} {each.type} {each.shape}" for each in inputs)
            raise EagorError(f"{path} takes {shapes}; wanted one picture, (1, 3, h, w) or (1, h, w, 3)")
        (self._picture,) = pictures
        self._others = [each for each in inputs if each is not self._picture]
        sides = self._picture.shape[-3:]
        self.channels_first = sides[0] == 3 or sides[2] != 3
        sides = sides[1:] if self.channels_first else sides[:2]
        self.fixed = [side if isinstance(side, int) else None for side in sides]  # else a name, or nothing

    def size(self, asked: int | Size | str | None, usual: int) -> Size:
        """Rows and columns of the input: what is `asked` for, else fixed, else of the metadata, else `usual`.

        Raises `EagorError` if the file does not take what is asked for.
        """
        wanted = _sides(self.metadata.get("imgsz") or usual if asked is None else asked)
        rows, columns = (fixed or side for fixed, side in zip(self.fixed, wanted, strict=True))
        if asked is not None and (rows, columns) != wanted:
            raise EagorError(
                f"size = {asked!r}; {self.path} takes {rows} rows and {columns} columns only. Leave size out, or "
                "export the model for any size (dynamic axes)"
            )
        return rows, columns

    def run(self, canvas: np.ndarray, values: Values, order: Order) -> dict[str, np.ndarray]:
        """All outputs by name for a picture ``(rows, columns, 3)``, uint8 RGB, of the input's size.

        Raises `EagorError` if the network cannot run on it.
        """
        tensor = self._tensor(canvas, values, order)
        feed = {self._picture.name: tensor[None] if len(self._picture.shape) == 4 else tensor}
        feed |= {each.name: self._further(each, canvas.shape) for each in self._others}
        try:
            found = self._session.run(None, feed)
        except Exception as error:
            raise EagorError(
                f"{self.path} does not run on a picture of {canvas.shape[1]} x {canvas.shape[0]} "
                f"({_short(error)}); try another size=..., a multiple of 32"
            ) from error
        return {each.name: np.asarray(array) for each, array in zip(self._session.get_outputs(), found, strict=True)}

    def _tensor(self, canvas: np.ndarray, values: Values, order: Order) -> np.ndarray:
        """`canvas` as the network takes it: its values (a uint8 input takes the bytes), its colours, its axes."""
        dtype = _DTYPES[self._picture.type]
        found = canvas
        if dtype != np.uint8:
            found = canvas.astype(np.float32) / (1 if values == "byte" else 255)
            if values == "imagenet":
                found = (found - np.array(_MEAN, np.float32)) / np.array(_STD, np.float32)
        found = found[..., ::-1] if order == "bgr" else found
        return np.ascontiguousarray(found.transpose(2, 0, 1) if self.channels_first else found, dtype=dtype)

    def _further(self, given: Any, shape: tuple[int, ...]) -> np.ndarray:
        """What an input besides the picture gets: known are the picture's size, columns first, and a mask of it."""
        known = {"orig_target_sizes": np.array([shape[1::-1]]), "pixel_mask": np.ones((1, *shape[:2]))}
        if given.name not in known:
            raise EagorError(
                f"{self.path} wants a further input {given.name} {given.shape}, which is not known here; export it "
                "without, or call it yourself and give eagor.Detector a function"
            )
        return known[given.name].astype(_DTYPES[given.type])


def _is_picture(given: Any) -> bool:
    """Whether an input takes pictures: it has four axes, or three of which the first or the last has three sides."""
    shape = given.shape
    return given.type in _DTYPES and (len(shape) == 4 or (len(shape) == 3 and 3 in (shape[0], shape[2])))


def _sides(asked: Any) -> Size:
    """640, (480, 640), "480x640" or, as metadata have it, "[480, 640]": rows and columns. Raises `EagorError`."""
    found = re.fullmatch(r"[\[(]?(\d+)(?:[x,] ?(\d+))?[\])]?", str(asked))
    sides = [int(side) for side in found.groups() if side] if found else [0]
    if not 8 <= min(sides) <= max(sides) <= LARGEST:
        raise EagorError(f"size = {asked!r}; wanted pixels, 8 to {LARGEST}, or ROWSxCOLUMNS such as 480x640")
    return sides[0], sides[-1]


def _short(error: Exception) -> str:
    return " ".join((str(error) or type(error).__name__).split())[:200]


def letterbox(picture: np.ndarray, size: Size, fit: Fit) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`picture` ``(h, w, 3)`` uint8 in an input of `size`; scale and offset, each x, y.

    Input pixel = scale * picture pixel + offset. ``letterbox`` keeps the picture's shape and centres it on grey,
    ``corner`` puts it at the top left, ``stretch`` fills all.
    """
    (rows, columns), (height, width) = size, picture.shape[:2]
    inner = size
    if fit != "stretch":
        scale = min(rows / height, columns / width)
        inner = max(1, min(rows, round(height * scale))), max(1, min(columns, round(width * scale)))
    top, left = ((rows - inner[0]) // 2, (columns - inner[1]) // 2) if fit == "letterbox" else (0, 0)
    if inner != (height, width):
        picture = np.asarray(Image.fromarray(picture).resize((inner[1], inner[0]), Image.Resampling.BILINEAR))
    canvas = np.full((rows, columns, 3), PAD, dtype=np.uint8)
    canvas[top : top + inner[0], left : left + inner[1]] = picture
    return canvas, np.array([inner[1] / width, inner[0] / height]), np.array([float(left), float(top)])

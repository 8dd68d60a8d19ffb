"""A network in an ONNX file that takes one picture, run by onnxruntime; how a picture gets into its input."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from PIL import Image

from eagor._extras import need
from eagor.errors import EagorError

Size = tuple[int, int]  # rows, columns
FITS, ORDERS = ("letterbox", "corner", "stretch"), ("rgb", "bgr")
# What is taken from colours in [0, 255], red first, and what they are then divided by: ImageNet's mean and deviation.
_MEAN, _STD = np.array([0.485, 0.456, 0.406], np.float32), np.array([0.229, 0.224, 0.225], np.float32)
VALUES = ("unit", "byte", "imagenet")

LARGEST = 8192  # rows or columns of an input
PAD = 114  # grey beside a letterboxed picture, as the YOLO family is trained
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
        self.path = os.fspath(path)
        if not os.path.isfile(path):
            raise EagorError(f"there is no file {path}; wanted a detector in an ONNX file, such as yolo11n.onnx")
        try:
            self._session = session(path, threads)
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
        self._sides = sides[1:] if self.channels_first else sides[:2]  # numbers where they are fixed

    def size(self, asked: int | Size | str | None, usual: int) -> Size:
        """Rows and columns of the input: what is `asked` for, else fixed, else of the metadata, else `usual`.

        They are given as 640, (480, 640), "480x640" or, as metadata have it, "[480, 640]". Raises `EagorError` for
        anything else, and if the file does not take what is asked for.
        """
        wanted = self.metadata.get("imgsz") or usual if asked is None else asked
        match = re.fullmatch(r"[\[(]?(\d+)(?:[x,] ?(\d+))?[\])]?", str(wanted))
        sides = [int(side) for side in match.groups() if side] if match else [0]
        if not 8 <= min(sides) <= max(sides) <= LARGEST:
            raise EagorError(f"size = {wanted!r}; wanted pixels, 8 to {LARGEST}, or ROWSxCOLUMNS such as 480x640")
        pairs = zip(self._sides, (sides[0], sides[-1]), strict=True)
        rows, columns = (fixed if isinstance(fixed, int) else side for fixed, side in pairs)
        if asked is not None and (rows, columns) != (sides[0], sides[-1]):
            raise EagorError(
                f"size = {asked!r}; {self.path} takes {rows} rows and {columns} columns only. Leave size out, or "
                "export the model for any size (dynamic axes)"
            )
        return rows, columns

    def run(self, canvas: np.ndarray, values: str, order: str) -> dict[str, np.ndarray]:
        """All outputs by name for a picture ``(rows, columns, 3)``, uint8 RGB, of the input's size.

        A uint8 input takes its bytes. Raises `EagorError` if the network cannot run on it.
        """
        dtype, tensor = _DTYPES[self._picture.type], canvas
        if dtype != np.uint8:
            tensor = canvas.astype(np.float32) / (1 if values == "byte" else 255)
            tensor = (tensor - _MEAN) / _STD if values == "imagenet" else tensor
        tensor = tensor[..., ::-1] if order == "bgr" else tensor
        tensor = np.ascontiguousarray(tensor.transpose(2, 0, 1) if self.channels_first else tensor, dtype=dtype)
        known = {"orig_target_sizes": np.array([canvas.shape[1::-1]]), "pixel_mask": np.ones((1, *canvas.shape[:2]))}
        feed = {self._picture.name: tensor[None] if len(self._picture.shape) == 4 else tensor}
        for each in self._others:
            if each.name not in known:
                raise EagorError(
                    f"{self.path} wants a further input {each.name} {each.shape}, which is not known here; export it "
                    "without, or call it yourself and give eagor.Detector a function"
                )
            feed[each.name] = known[each.name].astype(_DTYPES[each.type])
        try:
            outputs = self._session.run(None, feed)
        except Exception as error:
            raise EagorError(
                f"{self.path} does not run on a picture of {canvas.shape[1]} x {canvas.shape[0]} "
                f"({_short(error)}); try another size=..., a multiple of 32"
            ) from error
        return {each.name: np.asarray(array) for each, array in zip(self._session.get_outputs(), outputs, strict=True)}


def _is_picture(given: Any) -> bool:
    """Whether an input takes pictures: it has four axes, or three of which the first or the last has three sides."""
    shape = given.shape
    return given.type in _DTYPES and (len(shape) == 4 or (len(shape) == 3 and 3 in (shape[0], shape[2])))


def _short(error: Exception) -> str:
    return " ".join((str(error) or type(error).__name__).split())[:200]


def letterbox(picture: np.ndarray, size: Size, fit: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`picture` ``(h, w, 3)`` uint8 in an input of `size`; scale and offset, each x, y.

    Input pixel = scale * picture pixel + offset. ``letterbox`` keeps the picture's shape and centres it on grey,
    ``corner`` puts it at the top left, ``stretch`` fills all.
    """
    (rows, columns), (height, width), inner = size, picture.shape[:2], size
    if fit != "stretch":
        scale = min(rows / height, columns / width)
        inner = max(1, min(rows, round(height * scale))), max(1, min(columns, round(width * scale)))
    top, left = ((rows - inner[0]) // 2, (columns - inner[1]) // 2) if fit == "letterbox" else (0, 0)
    if inner != (height, width):
        picture = np.asarray(Image.fromarray(picture).resize((inner[1], inner[0]), Image.Resampling.BILINEAR))
    canvas = np.full((rows, columns, 3), PAD, dtype=np.uint8)
    canvas[top : top + inner[0], left : left + inner[1]] = picture
    return canvas, np.array([inner[1] / width, inner[0] / height]), np.array([float(left), float(top)])

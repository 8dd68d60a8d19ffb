"""Networks in ONNX files, run by onnxruntime: how the package opens and runs them all, and a detector's in particular.

A file may come from anywhere. Its weights come from its own folder alone, and a run ends after `SECONDS`. `Network` is
a detector's file: what goes in, how large, what comes out, what the file says about itself. `place` and `tensor` put a
picture into its input, `Placed.back` brings boxes back.
"""

from __future__ import annotations

import ast
import math
import mmap
import os
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from PIL import Image

from eagor._extras import need
from eagor.errors import EagorError

SECONDS = 120.0  # that one run may take; the slowest detectors take some seconds on a robot
Size = tuple[int, int]

LARGEST = 8192  # rows or columns of an input
AREA = 1 << 24  # pixels of an input: 200 MB as floats
MOST = 1 << 25  # numbers in all outputs; a YOLO of 80 classes gives 29 million for 4096 x 4096
_DTYPES = {"tensor(float)": np.float32, "tensor(float16)": np.float16, "tensor(double)": np.float64,
           "tensor(uint8)": np.uint8}  # fmt: skip
_WHOLE = {"tensor(int64)": np.int64, "tensor(int32)": np.int32, "tensor(bool)": np.bool_}
_SIZES = ("orig_target_sizes", "orig_size", "target_sizes")  # inputs that want columns, rows


def session(file: str | os.PathLike[str], threads: int = 1) -> Any:
    """The network in `file`, ready to run on the CPU, on `threads` cores: the machine's others belong to the caller.

    Raises `ValueError` for weights beside the file that lie elsewhere, and what onnxruntime raises for a file that it
    cannot read; the caller has checked that onnxruntime is there.
    """
    import onnxruntime

    if strange := _stranger(Path(file)):
        raise ValueError(f"it names {strange} beside it, which is a link out of its folder, or no file")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads, options.inter_op_num_threads = threads, 1
    options.log_severity_level = 4  # only what ends the process: notes on an export help nobody, faults are raised
    return onnxruntime.InferenceSession(os.fspath(file), options, providers=["CPUExecutionProvider"])


def run(network: Any, feed: Mapping[str, Any], seconds: float | None = None) -> list[Any]:
    """All outputs of a `session` for `feed`, by name of the input.

    Raises `TimeoutError` after `seconds` (default: `SECONDS`), else what onnxruntime raises.
    """
    import onnxruntime

    options, most = onnxruntime.RunOptions(), SECONDS if seconds is None else seconds
    options.log_severity_level = 4

    def end() -> None:
        options.terminate = True

    timer = threading.Timer(most, end)
    timer.daemon = True
    timer.start()
    try:
        return network.run(None, feed, options)
    except Exception as error:
        if options.terminate:
            raise TimeoutError(f"it has not ended after {most:g} seconds") from error
        raise
    finally:
        timer.cancel()


def _stranger(file: Path) -> Path | None:
    """What the model may read as weights and is not in its folder: a link that leads out of it, a pipe, a device.

    A model with weights elsewhere says "location" and their path; other models are not looked at further. Caches of
    downloads keep the model itself and its weights as links into one other folder; these are fine.
    """
    if not file.stat().st_size:
        return None
    with file.open("rb") as opened, mmap.mmap(opened.fileno(), 0, access=mmap.ACCESS_READ) as content:
        if content.find(b"location") < 0:
            return None
        homes = {Path(os.path.realpath(file.parent)), Path(os.path.realpath(file)).parent}
        folders = [file.parent]
        while folders:
            for entry in folders.pop().iterdir():
                if entry.name == file.name or content.find(os.fsencode(entry.name)) < 0:
                    continue
                if entry.is_dir() and not entry.is_symlink():
                    folders.append(entry)
                    continue
                real = Path(os.path.realpath(entry))
                if homes.isdisjoint(real.parents) or not (real.is_dir() or real.is_file()):
                    return entry
    return None


@dataclass(frozen=True)
class Output:
    """An output as it came: its name, its shape, whether it holds whole numbers."""

    name: str
    shape: tuple[int, ...]
    whole: bool = False

    @property
    def plain(self) -> str:
        """The name in small letters, without a path before it or the ``:0`` of TensorFlow after it."""
        return self.name.lower().rpartition("/")[2].removesuffix(":0")


class Network:
    """A network that takes one picture. `fixed`: rows and columns that it takes, None where any will do.

    Raises `EagorError` for a file that is none, or takes something else; `MissingExtraError` without onnxruntime.
    """

    def __init__(self, path: str | os.PathLike[str], threads: int = 1) -> None:
        need("a detector in an ONNX file", "photos", "onnxruntime")
        self.path = Path(path)
        if not self.path.is_file():
            what = "is a folder" if self.path.is_dir() else "is not there"
            raise EagorError(f"the model {self.path} {what}; wanted a detector in an ONNX file, such as yolo11n.onnx")
        try:
            self._session = session(self.path, threads)
        except Exception as error:  # onnxruntime has a class for each fault, below none of its own
            raise EagorError(
                f"{self.path} cannot be opened as an ONNX model ({_first_line(error)}); export it again, by a version "
                "of ONNX that this onnxruntime knows"
            ) from error
        self.notes: Mapping[str, str] = dict(self._session.get_modelmeta().custom_metadata_map)
        told = [each.shape for each in self._session.get_outputs() if all(isinstance(side, int) for side in each.shape)]
        if (many := sum(math.prod(shape) for shape in told)) > MOST:
            raise EagorError(_too_many(self.path, many))
        given = self._session.get_inputs()
        pictures = [each for each in given if _is_picture(each)]
        if len(pictures) != 1:
            shapes = ", ".join(f"{each.name} {each.type} {each.shape}" for each in given)
            raise EagorError(f"{self.path} takes {shapes}; wanted one picture, (1, 3, h, w) or (1, h, w, 3)")
        (self._picture,) = pictures
        self._others = [each for each in given if each is not self._picture]
        self.inputs = tuple(each.name for each in self._others)
        shape = self._picture.shape
        self.dtype: np.dtype[Any] = np.dtype(_DTYPES[self._picture.type])
        self.batched = len(shape) == 4
        if self.batched and isinstance(shape[0], int) and shape[0] != 1:
            raise EagorError(f"{self.path} takes {shape[0]} pictures at once; export it for one, or for any number")
        sides = shape[-3:]
        self.channels_first = sides[0] == 3 or sides[2] != 3
        rows, columns = sides[1:] if self.channels_first else sides[:2]
        self.fixed = _known(rows), _known(columns)

    def size(self, asked: int | Size | str | None, otherwise: int) -> Size:
        """Rows and columns of the input: what is `asked` for, else fixed, else of the metadata, else `otherwise`.

        Raises `EagorError` if the file does not take what is asked for.
        """
        found = _size(asked) if asked is not None else self._noted() or (otherwise, otherwise)
        size = tuple(fixed or each for fixed, each in zip(self.fixed, found, strict=True))
        if min(size) < 1 or max(size) > LARGEST or size[0] * size[1] > AREA:
            raise EagorError(
                f"{self.path} takes pictures of {size[1]} x {size[0]}; wanted at most {LARGEST} columns and rows, and "
                f"{AREA} pixels. Export it for a smaller input, or name a smaller size=... where any will do"
            )
        if asked is not None and size != found:
            raise EagorError(
                f"size = {asked!r}; {self.path} takes {size[1]} columns and {size[0]} rows only. Leave size out, or "
                "export the model for any size (dynamic axes)"
            )
        return size[0], size[1]

    def _noted(self) -> Size | None:
        """``imgsz`` of the metadata: rows, columns."""
        try:
            found = ast.literal_eval(self.notes.get("imgsz", ""))
            return _size(tuple(found) if isinstance(found, list) else found)
        except (ValueError, SyntaxError, TypeError, MemoryError, RecursionError):
            return None

    def run(self, tensor: np.ndarray, size: Size) -> list[np.ndarray]:
        """All outputs for one picture ``(3, h, w)`` or ``(h, w, 3)``; lists and maps are left out.

        Raises `EagorError` if the network cannot run on it.
        """
        feed = {self._picture.name: tensor[None] if self.batched else tensor}
        feed |= {each.name: self._further(each, size) for each in self._others}
        try:
            found = run(self._session, feed)
        except TimeoutError as error:
            raise EagorError(
                f"{self.path} does not run on a picture of {size[1]} x {size[0]}: {error}; a smaller size=..., or more "
                "threads=..., may help"
            ) from error
        except Exception as error:
            raise EagorError(
                f"{self.path} does not run on a picture of {size[1]} x {size[0]} ({_first_line(error)}); try another "
                "size=..., a multiple of 32"
            ) from error
        found = [each if isinstance(each, np.ndarray) else np.zeros(()) for each in found]
        if (many := sum(each.size for each in found)) > MOST:
            raise EagorError(_too_many(self.path, many))
        return found

    def outputs(self, found: list[np.ndarray]) -> tuple[Output, ...]:
        """What `run` found, described."""
        names = [each.name for each in self._session.get_outputs()]
        return tuple(Output(n, each.shape, each.dtype.kind in "iu") for n, each in zip(names, found, strict=True))

    def _further(self, given: Any, size: Size) -> np.ndarray:
        """What an input besides the picture gets; all that these inputs are known for is the picture's size."""
        dtype, name = ({**_DTYPES, **_WHOLE}).get(given.type, np.float32), given.name.lower()
        if name in _SIZES:
            return np.array([size[::-1]], dtype=dtype)
        if name in ("image_shape", "im_shape"):
            return np.array([size], dtype=dtype)
        if name == "scale_factor":
            return np.ones((1, 2), dtype=dtype)
        if name == "pixel_mask":
            sides = [_known(fixed) or free for fixed, free in zip(given.shape[1:], size, strict=False)]
            return np.ones((1, *sides), dtype=dtype)
        raise EagorError(
            f"{self.path} wants a further input {given.name} {given.shape}, which is not known here; export it "
            "without, or call it yourself and give eagor.Detector a function"
        )


def _too_many(path: Path, many: int) -> str:
    return f"{path} gives {many} numbers for a picture; wanted at most {MOST}. Export it for a smaller input"


def _known(side: Any) -> int | None:
    """A side of a shape; None where it is free: a name, or nothing."""
    return side if isinstance(side, int) else None


def _is_picture(given: Any) -> bool:
    shape = given.shape
    if given.type not in _DTYPES or len(shape) not in (3, 4):
        return False
    channels = [each for each in (shape[-3], shape[-1]) if isinstance(each, int)]
    return 3 in channels or (len(channels) < 2 and len(shape) == 4)


def _size(asked: Any) -> Size:
    """640, (480, 640) or "480x640": rows and columns."""
    parts: Any = asked
    if isinstance(asked, str):
        parts = tuple(int(part) if part.isdecimal() else part for part in asked.lower().split("x"))
    parts = parts if isinstance(parts, tuple | list) else (parts,)
    good = all(isinstance(part, int) and not isinstance(part, bool) and 8 <= part <= LARGEST for part in parts)
    if not good or len(parts) not in (1, 2):
        raise EagorError(f"size = {asked!r}; wanted pixels, 8 to {LARGEST}, or ROWSxCOLUMNS such as 480x640")
    return parts[0], parts[-1]


def _first_line(error: Exception) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0][:200]


# --- a picture into the input -----------------------------------------------------------------------------------------

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

"""Detectors for ordinary pictures in ONNX files: the YOLO family, DETR's, torchvision's, CenterNet.

``--perception onnx:MODEL.onnx?labels=coco.txt&layout=yolov8`` runs one without a line of code. Ultralytics' files say
themselves how they write boxes and what their classes are called; `LAYOUTS` lists what else can be stated.

Tested are small graphs with such outputs, DETR and RT-DETR with random weights against their own library, and
published weights of CenterNet alone.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta
from PIL import Image

from eagor._checks import checked_picture
from eagor._extras import require_extra
from eagor.errors import EagorError, ResponseError
from eagor.evidence.shapes import are_fractions
from eagor.perception.json_files import checked, require_field
from eagor.perception.onnx.layouts import LAYOUTS, Labels, choose_layout, literal, names_of

if TYPE_CHECKING:
    from eagor.perception.views import Detector

__all__ = ["LAYOUTS", "OnnxDetector", "from_text"]

MOST = 300  # boxes of a picture: the best
MOST_COMPARED = 2000  # boxes that suppression looks at: the best
OVERLAP = 0.5  # intersection over union beyond which two boxes of a class are of one thing
SLACK = 1e-3  # by which a probability of 16 bits may leave [0, 1]
OF_VIEWS = {"hfov_deg": "hfov_deg", "views": "views", "view": "size", "detector": "detector"}  # names of `Detector`

Size = tuple[int, int]  # rows, columns
# What is taken from colours in [0, 255], red first, and what they are then divided by: ImageNet's mean and deviation.
_MEAN, _STD = np.array([0.485, 0.456, 0.406], np.float32), np.array([0.229, 0.224, 0.225], np.float32)

LARGEST = 8192  # rows or columns of an input
PAD = 114  # grey beside a letterboxed picture, as the YOLO family is trained
_DTYPES = {
    "tensor(float)": np.float32, "tensor(float16)": np.float16, "tensor(double)": np.float64, "tensor(uint8)": np.uint8,
    "tensor(int64)": np.int64, "tensor(int32)": np.int32, "tensor(bool)": np.bool_,
}  # fmt: skip


class _Options(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    threshold: Annotated[float, Meta(ge=0, le=1)] | None = None
    layout: str | None = None
    fit: Annotated[str, Meta(pattern="^(letterbox|corner|stretch)$")] | None = None
    values: Annotated[str, Meta(pattern="^(unit|byte|imagenet)$")] | None = None
    order: Annotated[str, Meta(pattern="^(rgb|bgr)$")] = "rgb"
    threads: Annotated[int, Meta(ge=1, le=1024)] = 1
    together: Annotated[int, Meta(ge=1, le=1024)] = 1


class OnnxDetector:
    """Runs a detector that was exported to ONNX on an ordinary picture.

    Called with a picture ``(h, w, 3)``, uint8 RGB, and a query, which it does not read, it returns boxes ``(n, 4)``
    x0, y0, x1, y1 in pixels of the picture, scores ``(n,)`` in [0, 1], and n labels, the best first, at most 300. A box
    comes once for each of its classes that reaches the threshold.

    - `path`: the file. `labels`: what the classes are called, a file, a list, or names by number (default: what the
      file itself says). There have to be as many as the network has classes.
    - `size`: rows and columns of the network's input, a number or a pair (default: what the file says).
    - ``threshold``: least score, in [0, 1] (default: as usual for the layout).
    - ``layout``: how the network writes boxes, one of `LAYOUTS` (default: what the file's metadata settle).
    - ``fit`` ("letterbox", "corner", "stretch"), ``values`` ("unit": 0 to 1, "byte", "imagenet": standardised),
      ``order`` ("rgb", "bgr"): how the picture is put into the input (default: as usual for the layout).
    - ``threads``: cores that the network runs on; ``together``: pictures that `many` looks at at the same time.

    It tries the network once on a grey picture. Raises `EagorError` for a file that is no such network, for outputs
    whose layout is not told or does not fit, and for options that make no sense; `FormatError` for labels that cannot
    be read; `MissingExtraError` without what the extra ``photos`` brings.

    Attributes: `classes`, the names of all classes; `layout`, its name; `size`, rows and columns.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        labels: Labels | None = None,
        size: int | Size | str | None = None,
        **options: Any,
    ) -> None:
        given = checked(options, _Options, "OnnxDetector")
        layout = given.layout
        require_field(layout in (None, *LAYOUTS), "layout", layout, ", ".join(LAYOUTS))
        self._made_of = partial(OnnxDetector, path, labels, size, **options)
        self._network = Network(path, given.threads)
        metadata, noted = self._network.metadata, "'names' in the file's metadata"
        usual = LAYOUTS.get(layout or metadata.get("layout", ""), LAYOUTS["yolov8"])  # other metadata are YOLO's
        if labels is not None:
            self._names = names_of(labels, usual.first)
        elif metadata.get("names", "").strip():
            self._names = names_of(literal(metadata["names"], noted), 0, noted)
        else:
            raise EagorError(f"{path} does not say what its classes are called; name a file with labels=FILE.txt")
        self.classes = tuple(filter(None, self._names))
        self.size = self._network.size(size, usual.size)
        grey = np.full((*self.size, 3), PAD, dtype=np.uint8)
        tried = self._network.run(grey, given.values or usual.values, given.order)
        try:
            self.layout, self._outputs = choose_layout(layout, metadata, tried, len(self._names))
        except EagorError as error:
            raise EagorError(f"{path}: {error}") from None
        self._layout = usual = LAYOUTS[self.layout]
        self.fit, self.values = given.fit or usual.fit, given.values or usual.values
        self.order, self.together = given.order, given.together
        self.threshold = usual.threshold if given.threshold is None else given.threshold

    def __call__(self, picture: np.ndarray, query: str = "") -> tuple[np.ndarray, np.ndarray, list[str]]:
        """Boxes, scores and labels in `picture`; see the class.

        Raises `ImageError` for what is no such picture, `ResponseError` for an answer that no network of this layout
        gives: numbers that are not finite, scores outside [0, 1], corners in the wrong order, boxes far outside.
        """
        picture = checked_picture(picture, "the picture")
        canvas, scale, offset = letterbox(picture, self.size, self.fit)
        outputs = self._network.run(canvas, self.values, self.order)
        boxes, scores, classes = self._detections([outputs[name] for name in self._outputs])
        height, width = picture.shape[:2]
        boxes = np.clip((boxes - np.tile(offset, 2)) / np.tile(scale, 2), 0, [width, height, width, height])
        real = np.flatnonzero((boxes[:, 2:] > boxes[:, :2]).all(axis=1))
        best = real[np.argsort(-scores[real], kind="stable")][:MOST_COMPARED]  # of equal scores the earlier is better
        if not self._layout.suppressed and len(best):
            import cv2

            suppress: Any = cv2.dnn.NMSBoxesBatched  # its types want lists, it takes arrays
            corners_and_sides = np.hstack([boxes[best, :2], boxes[best, 2:] - boxes[best, :2]])
            best = best[np.asarray(suppress(corners_and_sides, scores[best], classes[best], 0.0, OVERLAP), dtype=int)]
        best = best[:MOST]
        return boxes[best], scores[best], [self._names[at] or f"class {at}" for at in classes[best].tolist()]

    def many(self, pictures: Sequence[np.ndarray], query: str = "") -> list[tuple[np.ndarray, np.ndarray, list[str]]]:
        """What is in each of several pictures, as for one; `together` of them are looked at at the same time."""
        if self.together == 1:
            return [self(picture) for picture in pictures]
        with ThreadPoolExecutor(self.together, "eagor-look") as pool:
            return [*pool.map(self, pictures)]

    def _detections(self, outputs: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Boxes in pixels of the input, scores and numbers of classes, of all that reaches the threshold."""
        self._check(all(np.isfinite(each).all() for each in outputs), "numbers that are not finite")
        layout, count = self._layout, len(self._names)
        batched = layout.outputs(count, 0)[0][0] == 1
        shares = layout.logits and 0 <= outputs[1].min() <= outputs[1].max() <= 1
        self._check(not shares, "probabilities, where logits are wanted")
        single = [(each[0] if batched else each).astype(np.float32, copy=False) for each in outputs]
        boxes, scores, *numbers = (each.astype(np.float64) for each in layout.read(single, count, self.threshold))
        if layout.centred:
            boxes = np.concatenate([boxes[:, :2] - boxes[:, 2:] / 2, boxes[:, :2] + boxes[:, 2:] / 2], axis=1)
        boxes = boxes * np.tile(self.size[::-1], 2) if layout.fractions else boxes
        reach = scores >= self.threshold
        rows, *columns = np.nonzero(reach)
        self._check(not scores.size or (scores.min() >= -SLACK and scores.max() <= 1 + SLACK), "scores outside [0, 1]")
        boxes, scores = boxes[rows], np.clip(scores[reach], 0, 1)
        numbers = numbers[0][rows] if numbers else columns[0]
        classes = np.rint(numbers).astype(np.int64)
        known = (np.abs(numbers - classes) <= SLACK) & (classes >= (not self._names[0])) & (classes < count)
        self._check(known.all(), f"classes such as {numbers[:3].tolist()} of {count} that have labels")
        inverted = (boxes[:, :2] > boxes[:, 2:]).any(axis=1)
        middles = (boxes[:, :2] + boxes[:, 2:]) / 2 / self.size[::-1]
        right = (
            2 * inverted.sum() < max(len(boxes), 1)
            and not are_fractions(boxes, 0.5)
            and (np.abs(middles - 0.5) <= 1.5).all()
        )
        self._check(right, f"boxes such as {boxes[:1].round(3).tolist()}, where corners in pixels are wanted")
        return boxes, scores, classes

    def _check(self, right: Any, what: str) -> None:
        if not right:
            raise ResponseError(
                f"{self._network.path} (layout {self.layout}) gives {what}; state the right layout=... of its outputs, "
                "or the right values=... of its input"
            )

    def __reduce__(self) -> tuple[Any, ...]:
        """Other processes open the file again."""
        return self._made_of, ()


def from_text(text: str = "", /, **options: Any) -> Detector:
    """The perception that ``MODEL.onnx[?option=value&...]`` names: the detector in level views of a panorama.

    Options are those of `OnnxDetector`, and of `eagor.Detector` ``hfov_deg``, ``views``, ``detector`` and ``view``
    (pixels of a view's side; default: as many as the network takes); those that are passed by name win. Raises
    `EagorError` for options that do not exist, and as `OnnxDetector` does.
    """
    from eagor.perception import parse_options

    path, _, written = text.partition("?")
    if not path:
        raise EagorError("onnx wants the detector's file: onnx:MODEL.onnx, or onnx:MODEL.onnx?labels=coco.txt&size=640")
    given = parse_options(written) | options
    if isinstance(given.get("labels"), int | float):
        given["labels"] = str(given["labels"])  # a file that is called 80, say
    return in_views("onnx", os.path.expanduser(path), given)


def in_views(name: str, path: str | os.PathLike[str], given: dict[str, Any]) -> Detector:
    """The detector in a file, looking around, with options as of `from_text`; `name`: of the perception, for errors."""
    from eagor.perception.views import Detector

    own = ["labels", "size", *_Options.__struct_fields__]
    if unknown := sorted(given.keys() - {*own, *OF_VIEWS}):
        raise EagorError(f"{name} has no option {', '.join(unknown)}; it has {', '.join([*own, *OF_VIEWS])}")
    detect = OnnxDetector(path, **{key: given[key] for key in own if key in given})
    settings: dict[str, Any] = {"size": max(detect.size)}
    return Detector(detect, **settings | {OF_VIEWS[key]: given[key] for key in OF_VIEWS if key in given})


# --- a network that takes one picture, run by onnxruntime -------------------------------------------------------------


def session(file: str | os.PathLike[str], threads: int = 1) -> Any:
    """The network in `file`, to run on the CPU, on `threads` cores: the machine's others belong to the caller.

    Raises what onnxruntime raises; the caller has checked that onnxruntime is there.
    """
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads, options.inter_op_num_threads = threads, 1
    # Threads that wait for work by spinning take the CPU from whatever else the machine does: half of it, where busy.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.log_severity_level = 4  # notes on an export help nobody, and faults are raised
    return onnxruntime.InferenceSession(os.fspath(file), options, providers=["CPUExecutionProvider"])


class Network:
    """A network that takes one picture; `metadata`: what its file says of itself.

    Raises `EagorError` for a file that is none, or takes something else; `MissingExtraError` without onnxruntime.
    """

    def __init__(self, path: str | os.PathLike[str], threads: int = 1) -> None:
        require_extra("a detector in an ONNX file", "photos", "onnxruntime", "cv2")
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

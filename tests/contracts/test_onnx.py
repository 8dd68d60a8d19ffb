"""A detector in an ONNX file: every layout gives the boxes that its numbers say; what is wrong is said."""

import math
import pickle

import numpy as np
import pytest
from onnx_files import onnx_file, seeing_file

from eagor.errors import EagorError, FormatError, ImageError, ResponseError
from eagor.perception import known, load
from eagor.perception.onnx import LAYOUTS, OnnxDetector, from_text
from eagor.perception.views import Detector

SIDE = 64
CELLS = 8 * 8 + 4 * 4 + 2 * 2  # of grids with strides 8, 16, 32
THREE = ["chair", "dog", "cup"]
SQUARE = np.zeros((SIDE, SIDE, 3), np.uint8)
WIDE = np.zeros((48, 96, 3), np.uint8)  # two thirds of it fit: 32 x 64, 16 rows of grey above and below

# What all layouts below write: a chair and a dog, in pixels of an input of 64 x 64.
BOXES = np.array([[8.0, 20.0, 24.0, 40.0], [40.0, 24.0, 60.0, 44.0]])
SCORES = np.array([0.9, 0.6])
LABELS = ["chair", "dog"]


def middle(boxes):
    return np.concatenate([(boxes[:, :2] + boxes[:, 2:]) / 2, boxes[:, 2:] - boxes[:, :2]], axis=1)


def rows(n, columns, least=0.0):
    return np.full((n, columns), least, np.float32)


def scored(n=2, columns=3, far=0.0):
    """Scores for each class: the chair's and the dog's."""
    table = np.full((n, columns), far)
    table[0, 0], table[1, 1] = SCORES
    return table


def logit(values):
    return np.log(values) - np.log1p(-values)


def yolov5(n=3 * CELLS):
    table = rows(n, 8)
    table[:2, :4], table[:2, 4], table[:2, 5:] = middle(BOXES), 0.5 + SCORES / 2, scored()
    table[0, 5], table[1, 6] = SCORES / (0.5 + SCORES / 2)
    return {"output0": table[None]}


def yolov8(n=CELLS):
    table = rows(n, 7)
    table[:2] = np.concatenate([middle(BOXES), scored()], axis=1)
    return {"output0": table.T[None].copy()}


def yolov8_transposed():
    return {"output0": yolov8()["output0"].transpose(0, 2, 1).copy()}


def end_to_end(columns=6, n=300):
    table = rows(n, columns, 0.3)
    table[2:, 4] = 0
    table[:2, :6] = np.column_stack([BOXES, SCORES, [0, 1]])
    return {"output0": table[None]}


def yolov7_end_to_end():
    return {"output": np.column_stack([[0, 0], BOXES, [0, 1], SCORES]).astype(np.float32)}


def yolox():
    table = rows(CELLS, 8, -3)
    table[:, 4:] = 0
    # The chair from cell (1, 3) of stride 8, the dog from cell (3, 2) of stride 16.
    for place, cell, stride, box, column in ((3 * 8 + 1, (1, 3), 8, 0, 5), (64 + 2 * 4 + 3, (3, 2), 16, 1, 6)):
        x, y, w, h = middle(BOXES)[box]
        table[place, :4] = x / stride - cell[0], y / stride - cell[1], math.log(w / stride), math.log(h / stride)
        table[place, 4], table[place, column] = 0.95, SCORES[box] / 0.95
    return {"output": table[None]}


def ssd(names=("detection_boxes", "detection_classes", "detection_scores", "num_detections"), first=1):
    boxes, classes, scores = rows(10, 4), rows(10, 1)[:, 0], rows(10, 1)[:, 0]
    boxes[:2], classes[:2], scores[:2] = BOXES[:, [1, 0, 3, 2]] / SIDE, [first, first + 1], SCORES
    boxes[2:], scores[2:] = 0.5, 0.99  # beyond the count: not to be read
    values = boxes[None], classes[None], scores[None], np.array([2], np.float32)
    found = dict(zip(names, values, strict=True))
    return {name: found[name] for name in (names[2], names[0], names[3], names[1])}  # in another order


def ssd_rows():
    table = np.column_stack([[0, 0], [0, 1], SCORES, BOXES / SIDE])
    return {"detection_out": np.concatenate([table, [[-1] + [0.9] * 6]])[None, None].astype(np.float32)}


def detr():
    share = np.full((5, 4), 1e-4)
    share[:2, :3] += scored()
    share[:, 3] = 1 - share[:, :3].sum(axis=1)
    boxes = np.full((5, 4), 0.5)
    boxes[:2] = middle(BOXES) / SIDE
    return {"logits": np.log(share)[None].astype(np.float32), "pred_boxes": boxes[None].astype(np.float32)}


def rtdetr(names=("logits", "pred_boxes")):
    boxes = np.full((5, 4), 0.5)
    boxes[:2] = middle(BOXES) / SIDE
    logits = logit(np.clip(scored(5), 1e-4, 1))
    return {names[0]: logits[None].astype(np.float32), names[1]: boxes[None].astype(np.float32)}


def rtdetr_in_one():
    table = np.concatenate([middle(BOXES) / SIDE, scored()], axis=1)
    return {"output0": np.concatenate([table, np.zeros((298, 7))])[None].astype(np.float32)}


def listed(batch, first):
    found = {"a": SCORES.astype(np.float32), "b": BOXES.astype(np.float32), "c": np.array([0, 1]) + first}
    return {name: each[None] if batch else each for name, each in found.items()}


def mmdet():
    return {"dets": np.column_stack([BOXES, SCORES])[None].astype(np.float32), "labels": np.array([[0, 1]])}


def centernet():
    scores, distances = np.zeros((1, 3, 16, 16), np.float32), np.ones((1, 4, 16, 16), np.float32)
    for kind, (box, score) in enumerate(zip(BOXES, SCORES, strict=True)):
        x, y = (box[:2] + box[2:]) // 8  # the cell of the middle
        column, row = int(x), int(y)
        scores[0, kind, row, column], scores[0, kind, row, column + 1] = score, score - 0.1  # no peak beside a peak
        distances[0, :, row, column] = 4 * column - box[0], 4 * row - box[1], box[2] - 4 * column, box[3] - 4 * row
    return {"scores": scores, "distances": distances}


TFLITE = [f"TFLite_Detection_PostProcess{end}" for end in ("", ":1", ":2", ":3")]
SIZES = [("orig_target_sizes", (1, 2), "int64")]
MASK = [("pixel_mask", ("batch", "h", "w"), "int64")]
CASES = {
    "yolov5": (yolov5(), {}),
    "yolov8": (yolov8(), {}),
    "yolov8 transposed": (yolov8_transposed(), {}),
    "yolov8 with masks": (
        yolov8() | {"output1": np.zeros((1, 32, 16, 16), np.float32)}, {"notes": {"task": "segment"}}
    ),
    "end-to-end": (end_to_end(), {}),
    "end-to-end with masks": (
        end_to_end(38) | {"protos": np.zeros((1, 32, 16, 16), np.float32)}, {"notes": {"task": "segment"}}
    ),
    "end-to-end with key points, named so": (end_to_end(57, 2000), {"notes": {"task": "pose", "end2end": "True"}}),
    "end-to-end by nms=True": (end_to_end(38, 84), {"notes": {"args": "{'batch': 1, 'nms': True}"}}),
    "yolov7-end-to-end": (yolov7_end_to_end(), {}),
    "yolox": (yolox(), {}),
    "ssd": (ssd(), {"kind": "uint8", "shape": (1, SIDE, SIDE, 3)}),
    "ssd with :0": (ssd([f"path/{n}:0" for n in ("detection_boxes", "detection_classes", "detection_scores",
                                                 "num_detections")]), {"kind": "uint8"}),
    "ssd-tflite": (ssd(TFLITE, 0), {}),
    "ssd-rows": (ssd_rows(), {}),
    "detr": (detr(), {"further": MASK}),
    "rtdetr": (rtdetr(), {}),
    "rtdetr in one": (rtdetr_in_one(), {}),
    "rfdetr": (rtdetr(("labels", "dets")), {}),
    "rtdetr-boxes": (listed(True, 0), {"further": SIZES}),
    "torchvision": (listed(False, 1), {"shape": (3, None, None)}),
    "mmdet": (mmdet(), {}),
    "centernet": (centernet(), {}),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_each_layout_is_recognised_and_its_boxes_are_right(case, tmp_path):
    outputs, options = CASES[case]
    detect = OnnxDetector(onnx_file(tmp_path / "d.onnx", outputs, **options), THREE, size=SIDE, fit="stretch")
    assert detect.layout == case.partition(" ")[0]
    assert (detect.classes, detect.size) == (("chair", "dog", "cup"), (SIDE, SIDE))
    boxes, scores, labels = detect(SQUARE, "chair")
    assert labels == LABELS
    np.testing.assert_allclose(scores, SCORES, atol=2e-4)
    np.testing.assert_allclose(boxes, BOXES, atol=1e-4)
    # Stretched from a picture of 48 x 96: x by 1.5, y by 0.75.
    np.testing.assert_allclose(detect(WIDE, "chair")[0], BOXES * [1.5, 0.75, 1.5, 0.75], atol=1e-4)


def test_every_layout_has_a_case():
    assert {case.partition(" ")[0] for case in CASES} == {*LAYOUTS}


@pytest.mark.parametrize(
    ("fit", "offset", "scale"), [("letterbox", (0, 16), (1.5, 1.5)), ("corner", (0, 0), (1.5, 1.5))]
)
def test_a_letterbox_is_undone(fit, offset, scale, tmp_path):
    detect = OnnxDetector(onnx_file(tmp_path / "d.onnx", yolov8()), THREE, fit=fit)
    wanted = np.clip((BOXES - np.tile(offset, 2)) * np.tile(scale, 2), 0, [96, 48, 96, 48])
    np.testing.assert_allclose(detect(WIDE, "")[0], wanted, atol=1e-4)


def test_odd_sizes_are_undone_exactly(tmp_path):
    """The scale is that of the pixels that the picture got, not the ratio that was aimed at."""
    box = [[10.0, 27.0, 20.0, 38.0]]
    table = np.zeros((1, 5, CELLS), np.float32)
    table[0, :4, 0], table[0, 4, 0] = middle(np.array(box))[0], 0.9
    detect = OnnxDetector(onnx_file(tmp_path / "d.onnx", {"output0": table}), ["chair"])
    found = detect(np.zeros((37, 101, 3), np.uint8), "")[0]  # becomes 23 x 64, from row 20
    x, y = 64 / 101, 23 / 37
    np.testing.assert_allclose(found, [[10 / x, 7 / y, 20 / x, 18 / y]], atol=1e-4)


@pytest.mark.parametrize("fit", ["stretch", "letterbox", "corner"])
@pytest.mark.parametrize("shape", [(64, 64), (48, 96), (96, 48), (200, 300)])
def test_a_network_that_sees_finds_the_red_patch(fit, shape, tmp_path):
    height, width = shape
    picture = np.full((*shape, 3), 100, np.uint8)
    y, x = height // 2, width // 4
    tall, wide = height // 8, width // 8
    picture[y : y + tall, x : x + wide] = (250, 10, 10)
    detect = OnnxDetector(seeing_file(tmp_path / "d.onnx"), ["patch"], fit=fit)
    boxes, scores, labels = detect(picture, "patch")
    assert labels[0] == "patch"
    assert scores[0] > 0.4
    centre = (boxes[0, :2] + boxes[0, 2:]) / 2
    assert np.abs(centre - [x + wide / 2, y + tall / 2]).max() <= 4 * max(shape) / SIDE  # a cell
    # The same picture in another order of colours has no red in it.
    blue = OnnxDetector(tmp_path / "d.onnx", ["patch"], fit=fit, order="bgr")
    assert len(blue(picture, "patch")[0]) == 0
    assert len(blue(picture[..., ::-1].copy(), "patch")[0]) > 0


@pytest.mark.parametrize(
    ("values", "white"),
    [("byte", 255.0), ("unit", 1.0), ("signed", 1.0), ("imagenet", (1 - 0.485) / 0.229)],
)
@pytest.mark.parametrize(("kind", "shape"), [("float32", (1, 3, 64, 64)), ("float16", (1, 64, 64, 3))])
def test_the_values_are_those_that_were_asked_for(values, white, kind, shape, tmp_path, monkeypatch):
    detect = OnnxDetector(onnx_file(tmp_path / "d.onnx", yolov8(), shape, kind), THREE, values=values)
    seen = []
    run = detect._network.run
    monkeypatch.setattr(detect._network, "run", lambda tensor, size: [seen.append(tensor), run(tensor, size)][1])
    detect(SQUARE + np.uint8(255), "")
    (tensor,) = seen
    assert tensor.shape == shape[1:]
    assert tensor.dtype == kind
    red = tensor[0, 0, 0]
    assert red == pytest.approx(white, rel=1e-3)


def test_bytes_stay_bytes(tmp_path):
    detect = OnnxDetector(onnx_file(tmp_path / "d.onnx", yolov8(), kind="uint8"), THREE, values="unit")
    assert detect(SQUARE, "")[2] == LABELS


# --- thresholds, suppression -----------------------------------------------------------------------------------------


def test_the_worse_of_two_boxes_of_a_class_falls_and_other_classes_stay(tmp_path):
    table = np.zeros((1, 7, CELLS), np.float32)
    for place, (dx, kind, score) in enumerate([(0, 0, 0.9), (1, 0, 0.8), (1, 1, 0.7), (30, 0, 0.6), (0, 2, 0.1)]):
        table[0, :4, place], table[0, 4 + kind, place] = (16 + dx, 30, 16, 20), score
    path = onnx_file(tmp_path / "d.onnx", {"output0": table})
    assert OnnxDetector(path, THREE)(SQUARE, "")[2] == ["chair", "dog", "chair"]
    assert len(OnnxDetector(path, THREE, overlap=1)(SQUARE, "")[2]) == 4
    assert len(OnnxDetector(path, THREE, threshold=0.05)(SQUARE, "")[2]) == 4
    assert OnnxDetector(path, THREE, threshold=0.95)(SQUARE, "")[2] == []


def test_a_box_comes_once_for_each_class_that_reaches_the_threshold(tmp_path):
    table = np.zeros((1, 7, CELLS), np.float32)
    table[0, :, 0] = 30, 30, 20, 20, 0.5, 0.4, 0.1
    _, scores, labels = OnnxDetector(onnx_file(tmp_path / "d.onnx", {"output0": table}), THREE)(SQUARE, "")
    assert labels == ["chair", "dog"]
    np.testing.assert_allclose(scores, [0.5, 0.4], atol=1e-6)


def test_nothing_found_is_an_empty_answer(tmp_path):
    detect = OnnxDetector(onnx_file(tmp_path / "d.onnx", {"output0": np.zeros((1, 7, CELLS), np.float32)}), THREE)
    boxes, scores, labels = detect(SQUARE, "")
    assert (boxes.shape, scores.shape, labels) == ((0, 4), (0,), [])


def test_boxes_end_at_the_picture_and_those_beside_it_are_left_out(tmp_path):
    table = np.zeros((1, 7, CELLS), np.float32)
    table[0, :, 0] = 2, 30, 20, 20, 0.5, 0, 0
    table[0, :, 1] = 32, 5, 20, 8, 0.6, 0, 0  # on the grey above the wide picture
    boxes, *_ = OnnxDetector(onnx_file(tmp_path / "d.onnx", {"output0": table}), THREE)(WIDE, "")
    np.testing.assert_allclose(boxes, [[0, 6, 18, 36]], atol=1e-4)


def test_logits_are_squashed_if_it_is_said(tmp_path):
    outputs = {"output0": yolov8()["output0"].copy()}
    outputs["output0"][0, 4:] = logit(np.clip(outputs["output0"][0, 4:], 1e-4, 1))
    path = onnx_file(tmp_path / "d.onnx", outputs)
    with pytest.raises(ResponseError, match=r"scores from -9\.21 to 2\.2; wanted \[0, 1\].*sigmoid=true"):
        OnnxDetector(path, THREE)(SQUARE, "")
    np.testing.assert_allclose(OnnxDetector(path, THREE, sigmoid=True)(SQUARE, "")[1], SCORES, atol=1e-4)


# --- sizes -----------------------------------------------------------------------------------------------------------


def test_the_size_is_the_files_or_what_is_asked_for(tmp_path):
    fixed = onnx_file(tmp_path / "fixed.onnx", centernet())
    assert OnnxDetector(fixed, THREE).size == (64, 64)
    with pytest.raises(EagorError, match=r"size = 640; .*fixed\.onnx takes 64 columns and 64 rows only"):
        OnnxDetector(fixed, THREE, size=640)
    free = onnx_file(tmp_path / "free.onnx", centernet(), (None, 3, None, None))
    assert OnnxDetector(free, THREE).size == (512, 512)
    assert OnnxDetector(free, THREE, size="96x160").size == (96, 160)
    assert OnnxDetector(free, THREE, size=(96, 160)).size == (96, 160)
    noted = onnx_file(tmp_path / "noted.onnx", centernet(), (None, 3, None, None), notes={"imgsz": "[320, 640]"})
    assert OnnxDetector(noted, THREE).size == (320, 640)
    half = onnx_file(tmp_path / "half.onnx", centernet(), (1, 3, 96, None))
    assert OnnxDetector(half, THREE).size == (96, 512)


# --- labels ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text",
    [
        "chair\ndog\ncup\n\n", "0 chair\n1 dog\n2 cup", "0: chair\n1: dog\n2: cup", '["chair", "dog", "cup"]',
        '{"0": "chair", "1": "dog", "2": "cup"}', "# what it knows\nchair\ndog\ncup", "\ufeffchair\r\ndog\r\ncup\r\n",
    ],
)  # fmt: skip
def test_files_of_labels(text, tmp_path):
    path = onnx_file(tmp_path / "d.onnx", yolov8())
    (tmp_path / "labels.txt").write_text(text, encoding="utf-8", newline="")
    detect = OnnxDetector(path, tmp_path / "labels.txt")
    assert detect.classes == ("chair", "dog", "cup")
    assert detect(SQUARE, "")[2] == LABELS


@pytest.mark.parametrize(
    ("key", "text"),
    [
        ("names", "{0: 'chair', 1: 'dog', 2: 'cup'}"), ("names", '{"0": "chair", "1": "dog", "2": "cup"}'),
        ("names", "['chair', 'dog', 'cup']"), ("classes", "chair, dog, cup"),
    ],
)  # fmt: skip
def test_names_of_the_file_itself(key, text, tmp_path):
    detect = OnnxDetector(onnx_file(tmp_path / "d.onnx", yolov8(), notes={key: text}))
    assert detect.classes == ("chair", "dog", "cup")


def test_classes_without_names_are_numbered(tmp_path):
    detect = OnnxDetector(onnx_file(tmp_path / "d.onnx", yolov8()))
    assert (detect.layout, detect.classes) == ("yolov8", ("class 0", "class 1", "class 2"))
    with pytest.raises(EagorError, match="neither what its classes are called nor how many"):
        OnnxDetector(onnx_file(tmp_path / "d.onnx", end_to_end()))


@pytest.mark.parametrize(
    ("labels", "wanted"),
    [
        (["chair", "dog"], "2 names, and .* has 3 classes"),
        (["chair", "dog", "cup", "bed"], "4 names, and .* has 3 classes"),
        ({0: "chair", 7: "dog"}, "8 names, and .* has 3 classes"),
        ([], "wanted a list of names"),
        (["chair", 3, "cup"], "wanted a list of names"),
        ({"a": "chair"}, "wanted a list of names"),
        ([["chair"]], "wanted a list of names"),
        (7, "wanted a list of names"),
    ],
)
def test_labels_that_do_not_fit(labels, wanted, tmp_path):
    with pytest.raises(FormatError, match=wanted):
        OnnxDetector(onnx_file(tmp_path / "d.onnx", yolov8()), labels)


@pytest.mark.parametrize(
    ("text", "wanted"),
    [("", "has no labels"), ("1 chair\n1 dog\n2 cup", "number 1 twice"), ("{0: chair", "cannot be read"),
     ("__import__('os').system('true')\n", "1 names, and")],
)  # fmt: skip
def test_files_of_labels_that_are_none(text, wanted, tmp_path):
    (tmp_path / "labels.txt").write_text(text)
    with pytest.raises(FormatError, match=wanted):
        OnnxDetector(onnx_file(tmp_path / "d.onnx", yolov8()), tmp_path / "labels.txt")


def test_a_file_of_labels_that_is_not_there(tmp_path):
    with pytest.raises(FormatError, match=r"coco\.txt cannot be read"):
        OnnxDetector(onnx_file(tmp_path / "d.onnx", yolov8()), tmp_path / "coco.txt")


def test_metadata_is_never_run(tmp_path):
    notes = {"names": "__import__('os').abort()"}
    with pytest.raises(FormatError, match="'names' in the file's metadata cannot be read"):
        OnnxDetector(onnx_file(tmp_path / "d.onnx", yolov8(), notes=notes))


def test_lists_begin_after_the_background_and_numbers_stay(tmp_path):
    path = onnx_file(tmp_path / "d.onnx", listed(False, 1), (3, None, None))
    for labels in (THREE, ["__background__", *THREE], {1: "chair", 2: "dog", 90: "cup"}):
        assert OnnxDetector(path, labels, size=SIDE)(SQUARE, "")[2] == LABELS
    assert OnnxDetector(path, THREE, size=SIDE, first=0)(SQUARE, "")[2] == ["dog", "cup"]
    with pytest.raises(FormatError, match="found class 2, and the labels end with 1, 'chair'"):
        OnnxDetector(path, ["chair"], size=SIDE)(SQUARE, "")


def test_a_number_without_a_name_keeps_its_number(tmp_path):
    detect = OnnxDetector(onnx_file(tmp_path / "d.onnx", yolov8()), {1: "dog"})
    assert detect(SQUARE, "")[2] == ["class 0", "dog"]


# --- what is wrong ---------------------------------------------------------------------------------------------------


def test_files_that_are_no_detectors(tmp_path):
    with pytest.raises(EagorError, match="is not there; wanted a detector in an ONNX file"):
        OnnxDetector(tmp_path / "none.onnx")
    with pytest.raises(EagorError, match="is a folder"):
        OnnxDetector(tmp_path)
    (tmp_path / "text.onnx").write_text("no network")
    with pytest.raises(EagorError, match="cannot be opened as an ONNX model"):
        OnnxDetector(tmp_path / "text.onnx")
    with pytest.raises(EagorError, match=r"images tensor\(float\) \[1, 10\]; wanted one picture"):
        OnnxDetector(onnx_file(tmp_path / "d.onnx", yolov8(), (1, 10)), THREE)
    with pytest.raises(EagorError, match="takes 8 pictures at once"):
        OnnxDetector(onnx_file(tmp_path / "d.onnx", yolov8(), (8, 3, 64, 64)), THREE)
    with pytest.raises(EagorError, match=r"a further input text \[1, 4\], which is not known here"):
        OnnxDetector(onnx_file(tmp_path / "d.onnx", yolov8(), further=[("text", (1, 4), "int64")]), THREE)
    with pytest.raises(EagorError, match="made for the task 'classify'"):
        OnnxDetector(onnx_file(tmp_path / "d.onnx", yolov8(), notes={"task": "classify"}), THREE)


@pytest.mark.parametrize(
    "outputs",
    [
        {"logits": np.zeros((1, 1000), np.float32)},
        {"one": np.zeros((1, 50, 90), np.float32)},
        {"logits": np.zeros((1, 5, 30), np.float32), "pred_boxes": np.zeros((1, 5, 4), np.float32)},
        {"boxes": BOXES[None].astype(np.float32), "scores": SCORES[None].astype(np.float32), "l": np.array([[0, 1]])},
    ],
)
def test_outputs_that_cannot_be_told_are_listed_with_the_layouts(outputs, tmp_path):
    with pytest.raises(EagorError, match="Say which by layout=NAME") as caught:
        OnnxDetector(onnx_file(tmp_path / "d.onnx", outputs))
    for name, array in outputs.items():
        assert f"{name} {array.shape}" in str(caught.value)
    assert all(f"{name}: " in str(caught.value) for name in LAYOUTS)


def test_a_layout_that_is_named_has_to_fit(tmp_path):
    path = onnx_file(tmp_path / "d.onnx", {"one": yolov8()["output0"][..., :20].copy()})
    assert OnnxDetector(path, THREE, layout="yolov8")(SQUARE, "")[2] == LABELS
    with pytest.raises(EagorError, match=r"do not fit layout 'ssd', which wants detection_boxes .*one \(1, 7, 20\)"):
        OnnxDetector(path, THREE, layout="ssd")
    with pytest.raises(EagorError, match="layout = 'yolo'; wanted auto, yolov5"):
        OnnxDetector(path, THREE, layout="yolo")


@pytest.mark.parametrize(
    ("outputs", "notes", "layouts"),
    [
        (end_to_end(38), {"task": "segment"}, "yolov5 yolov8 yolox rtdetr"),
        (end_to_end(38, CELLS), {"task": "segment", "end2end": "True"}, "yolov5 yolov8 yolox rtdetr"),
        (end_to_end(7), {}, "yolov5 yolov8 yolox end-to-end"),  # with angles
        (yolov5(), {}, "yolov8 yolox rtdetr end-to-end"),
        (yolov8(), {}, "yolov5 yolox rtdetr end-to-end"),
        (rtdetr_in_one(), {}, "yolov5 yolov8 yolox"),
    ],
)
def test_a_layout_of_another_table_is_refused(outputs, notes, layouts, tmp_path):
    path = onnx_file(tmp_path / "d.onnx", outputs, notes=notes)
    for layout in layouts.split():
        with pytest.raises(EagorError, match=f"do not fit layout {layout!r}"):
            OnnxDetector(path, THREE, layout=layout)


def test_boxes_far_outside_are_those_of_another_layout(tmp_path):
    outputs = {"output0": rtdetr_in_one()["output0"] * np.array([SIDE] * 4 + [1] * 3, np.float32)}
    with pytest.raises(ResponseError, match="far outside of the picture; name the right layout"):
        OnnxDetector(onnx_file(tmp_path / "d.onnx", outputs), THREE, layout="rtdetr")(SQUARE, "")


def test_the_metadata_may_name_the_layout(tmp_path):
    outputs = {"one": yolov8()["output0"][..., :20].copy()}
    assert OnnxDetector(onnx_file(tmp_path / "d.onnx", outputs, notes={"layout": "yolov8"}), THREE).layout == "yolov8"
    with pytest.raises(EagorError, match="layout = 'mine'; wanted auto"):
        OnnxDetector(onnx_file(tmp_path / "d.onnx", outputs, notes={"layout": "mine"}), THREE)


def test_numbers_that_are_none(tmp_path):
    outputs = yolov8()
    outputs["output0"][0, 2, 5] = np.nan
    with pytest.raises(ResponseError, match="gives 1 numbers that are not finite"):
        OnnxDetector(onnx_file(tmp_path / "d.onnx", outputs), THREE)(SQUARE, "")
    outputs = yolox()
    outputs["output"][0, 25, 2] = 1e4  # its exponential
    with pytest.raises(ResponseError, match="boxes that are not finite"):
        OnnxDetector(onnx_file(tmp_path / "d.onnx", outputs), THREE)(SQUARE, "")
    outputs = end_to_end()
    outputs["output0"][0, 0, 5] = 0.4
    with pytest.raises(ResponseError, match="wanted whole numbers"):
        OnnxDetector(onnx_file(tmp_path / "d.onnx", outputs), THREE)(SQUARE, "")


@pytest.mark.parametrize(
    "options",
    [{"threshold": 1.5}, {"threshold": "high"}, {"fit": "crop"}, {"values": "0..1"}, {"order": "gbr"}, {"overlap": 0},
     {"first": -1}, {"sigmoid": "yes"}, {"threads": 0}, {"size": 4}, {"size": "64x64x3"}, {"size": 0.5},
     {"size": "wide"}],
)  # fmt: skip
def test_options_that_make_no_sense(options, tmp_path):
    (name,) = options
    with pytest.raises(EagorError, match=rf"{name} = .*; wanted"):
        OnnxDetector(onnx_file(tmp_path / "d.onnx", yolov8()), THREE, **options)


@pytest.mark.parametrize("picture", [np.zeros((64, 64)), SQUARE[..., 0], SQUARE.astype(float), SQUARE[:0]])
def test_pictures_that_are_none(picture, tmp_path):
    detect = OnnxDetector(onnx_file(tmp_path / "d.onnx", yolov8()), THREE)
    with pytest.raises(ImageError, match=r"wanted uint8 RGB \(h, w, 3\)"):
        detect(picture, "chair")


def test_a_picture_is_not_changed_and_the_detector_travels(tmp_path):
    picture = np.random.default_rng(0).integers(0, 256, (40, 80, 3), dtype=np.uint8)
    before = picture.copy()
    detect = OnnxDetector(seeing_file(tmp_path / "d.onnx"), ["patch"], threshold=0.01)
    again = pickle.loads(pickle.dumps(detect))
    np.testing.assert_array_equal(detect(picture, "")[0], again(picture, "")[0])
    np.testing.assert_array_equal(picture, before)
    assert repr(again).endswith("centernet, 1 classes)")


# --- by name ---------------------------------------------------------------------------------------------------------


def test_a_line_of_text_names_a_detector(tmp_path):
    path = onnx_file(tmp_path / "d.onnx", centernet(), (1, 3, None, None))
    (tmp_path / "80").write_text("\n".join(THREE))
    made = load(f"onnx:{path}?labels={tmp_path / '80'}&size=96x128&threshold=0.3&hfov_deg=100&views=12&order=bgr")
    assert isinstance(made, Detector)
    (view, *_), count = made.views(), len(made.views())
    assert (round(math.degrees(view.hfov)), count, view.width) == (100, 12, 128)
    assert (made.function.threshold, made.function.order, made.function.size) == (0.3, "bgr", (96, 128))
    assert made.function.classes == tuple(THREE)
    assert from_text(f"{path}?size=64&view=256", threshold=0.1).views()[0].width == 256
    assert "onnx" in known()


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("", "onnx wants the detector's file: onnx:MODEL"),
        ("d.onnx?colour=red", "no option colour; it has labels, size"),
        ("d.onnx?size", "wanted name=value"),
        ("none.onnx", "is not there"),
    ],
)
def test_a_line_of_text_that_names_none(text, wanted):
    with pytest.raises(EagorError, match=wanted):
        from_text(text)

"""A detector in an ONNX file: every layout gives the boxes that its numbers say; what is wrong is said."""

import math
import pickle

import numpy as np
import pytest
from onnx import TensorProto, helper
from onnx_files import onnx_file, seeing_file

from eagor.errors import EagorError, FormatError, ResponseError
from eagor.perception import load
from eagor.perception.onnx import LAYOUTS, Network, OnnxDetector, from_text
from eagor.perception.onnx.layouts import names_of
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


def end_to_end(columns=6, n=300):
    table = rows(n, columns, 0.3)
    table[2:, 4] = 0
    table[:2, :6] = np.column_stack([BOXES, SCORES, [0, 1]])
    return {"output0": table[None]}


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


def centernet():
    scores, distances = np.zeros((1, 3, 16, 16), np.float32), np.ones((1, 4, 16, 16), np.float32)
    for kind, (box, score) in enumerate(zip(BOXES, SCORES, strict=True)):
        x, y = (box[:2] + box[2:]) // 8  # the cell of the middle
        column, row = int(x), int(y)
        scores[0, kind, row, column], scores[0, kind, row, column + 1] = score, score - 0.1  # no peak beside a peak
        distances[0, :, row, column] = 4 * column - box[0], 4 * row - box[1], box[2] - 4 * column, box[3] - 4 * row
    return {"scores": scores, "distances": distances}


SIZES = {"further": [("orig_target_sizes", (1, 2), "int64")]}
MASK = {"further": [("pixel_mask", ("batch", "h", "w"), "int64")], "shape": ("batch", "channels", "h", "w")}
CASES = {  # layout: outputs, and what else the file says or takes
    "yolov5": (yolov5(), {}),
    "yolov8": (yolov8(), {}),
    "yolov8 with masks": (
        {"output0": np.concatenate([yolov8()["output0"], np.full((1, 32, CELLS), 0.9)], 1, dtype=np.float32),
         "output1": np.zeros((1, 32, 16, 16), np.float32)}, {"notes": {"task": "segment"}},
    ),
    "end-to-end": (end_to_end(), {}),
    "end-to-end with masks": (
        end_to_end(38) | {"protos": np.zeros((1, 32, 16, 16), np.float32)}, {"notes": {"task": "segment"}}
    ),
    "end-to-end with key points": (end_to_end(6 + 8, 2000), {"notes": {"task": "pose", "kpt_shape": "[4, 2]"}}),
    "detr": (detr(), MASK),
    "rtdetr": (rtdetr(), {}),
    "rtdetr-table": (rtdetr_in_one(), {}),
    "rfdetr": (rtdetr(("labels", "dets")), {}),
    "rtdetr-boxes": (listed(True, 0), SIZES),
    "torchvision": (listed(False, 1), {"shape": (3, None, None)}),
    "centernet": (centernet(), {}),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_the_boxes_of_each_layout_are_right(case, tmp_path):
    outputs, options = CASES[case]
    layout = case.partition(" ")[0]
    file = onnx_file(tmp_path / "d.onnx", outputs, **options)
    detect = OnnxDetector(file, THREE, size=SIDE, fit="stretch", layout=layout)
    assert (detect.layout, detect.classes, detect.size) == (layout, ("chair", "dog", "cup"), (SIDE, SIDE))
    boxes, scores, labels = detect(SQUARE, "chair")
    assert labels == LABELS
    np.testing.assert_allclose(scores, SCORES, atol=2e-4)
    np.testing.assert_allclose(boxes, BOXES, atol=1e-4)
    # Stretched from a picture of 48 x 96: x by 1.5, y by 0.75.
    np.testing.assert_allclose(detect(WIDE, "chair")[0], BOXES * [1.5, 0.75, 1.5, 0.75], atol=1e-4)


def test_every_layout_has_a_case():
    assert {case.partition(" ")[0] for case in CASES} == {*LAYOUTS}


NAMES = str(dict(enumerate(THREE)))


@pytest.mark.parametrize(
    ("outputs", "notes", "layout"),
    [
        (yolov8(), {"task": "detect"}, "yolov8"),
        (CASES["yolov8 with masks"][0], {"task": "segment", "end2end": "False"}, "yolov8"),
        (end_to_end(), {"task": "detect"}, "end-to-end"),  # the first YOLOv10
        (end_to_end(38), {"task": "segment", "end2end": "True"}, "end-to-end"),
        (end_to_end(57, 84), {"task": "pose", "args": "{'batch': 1, 'nms': True}"}, "end-to-end"),
        (rtdetr_in_one(), {"task": "detect", "description": "Ultralytics RT-DETR-l model"}, "rtdetr-table"),
        (yolov5(), {"stride": "32"}, "yolov5"),
        (centernet(), {"layout": "centernet"}, "centernet"),
    ],
)
def test_metadata_settle_the_layout_and_contradict_another(outputs, notes, layout, tmp_path):
    path = onnx_file(tmp_path / "d.onnx", outputs, notes=notes | {"names": NAMES})
    assert OnnxDetector(path).layout == layout
    assert OnnxDetector(path)(SQUARE)[2] == LABELS
    for other in LAYOUTS.keys() - {layout}:
        with pytest.raises(EagorError, match=rf"layout = '{other}', and the file's metadata say '{layout}'"):
            OnnxDetector(path, layout=other)


@pytest.mark.parametrize("case", CASES)
def test_what_no_metadata_settle_is_refused_until_it_is_stated(case, tmp_path):
    """With a wrong layout a box is wrong, and its score is not."""
    outputs, options = CASES[case]
    if "notes" in options:
        return
    path = onnx_file(tmp_path / "d.onnx", outputs, **options)
    with pytest.raises(EagorError, match=r"do not say how it writes boxes.*layout=NAME; by the shapes") as caught:
        OnnxDetector(path, THREE, size=SIDE)
    assert f"{case}: {LAYOUTS[case].title}" in str(caught.value).partition("it can be ")[2]
    assert all(f"{name} {array.shape}" in str(caught.value) for name, array in outputs.items())
    for other in LAYOUTS.keys() - {"rfdetr", "rtdetr", case}:
        with pytest.raises(EagorError, match=f"do not fit layout {other!r}"):
            OnnxDetector(path, THREE, size=SIDE, layout=other)


@pytest.mark.parametrize("task", ["obb", "classify"])
def test_what_gives_no_upright_boxes_is_refused(task, tmp_path):
    notes = {"task": task, "names": NAMES, "end2end": "True"}
    for layout in (None, "end-to-end"):
        with pytest.raises(EagorError, match=f"made for the task '{task}'; wanted a detector of upright boxes"):
            OnnxDetector(onnx_file(tmp_path / "d.onnx", end_to_end(7), notes=notes), layout=layout)


@pytest.mark.parametrize(
    ("outputs", "layout", "says"),
    [
        ({"output0": end_to_end()["output0"] * np.float32(7)}, "end-to-end", r"scores outside \[0, 1\]"),
        ({"output0": end_to_end()["output0"] + np.float32([0, 0, 0, 0, 0, 0.4])}, "end-to-end", "classes such as"),
        (
            {"output0": end_to_end()["output0"] + np.float32([0, 0, 0, 0, 0, 2])},
            "end-to-end",
            "classes such as .* of 3 that have labels",
        ),
        ({"output0": end_to_end()["output0"][..., [2, 3, 0, 1, 4, 5]]}, "end-to-end", "corners in pixels"),
        ({"output0": end_to_end()["output0"] / np.float32([64] * 4 + [1] * 2)}, "end-to-end", "corners in pixels"),
        ({"output0": end_to_end()["output0"] * np.float32([9] * 4 + [1] * 2)}, "end-to-end", "boxes such as"),
        ({"output0": yolov8()["output0"] * np.nan}, "yolov8", "numbers that are not finite"),
        (rtdetr() | {"logits": scored(5)[None].astype(np.float32)}, "rtdetr", "probabilities, where logits are wanted"),
        (listed(False, 0), "torchvision", "classes such as"),
        ({"output0": end_to_end()["output0"] - np.float32([0, 0, 20, 0, 0, 0])}, "end-to-end", "corners in pixels"),
        (
            {"output0": end_to_end()["output0"] / np.float32([64] * 4 + [1] * 2) - np.float32([0.2, 0, 0, 0, 0, 0])},
            "end-to-end",
            "corners in pixels",
        ),
    ],
)
def test_answers_that_no_such_network_gives_are_refused(outputs, layout, says, tmp_path):
    detect = OnnxDetector(onnx_file(tmp_path / "d.onnx", outputs), THREE, layout=layout)
    with pytest.raises(
        ResponseError, match=rf"d.onnx \(layout {layout}\) gives .*{says}.*state the right layout=\.\.\."
    ):
        detect(SQUARE)


def test_one_class_more_than_labels_is_no_softmax_of_rfdetr(tmp_path):
    outputs = detr()
    path = onnx_file(tmp_path / "d.onnx", {"labels": outputs["logits"], "dets": outputs["pred_boxes"]})
    for layout in (None, "detr", "rfdetr"):
        with pytest.raises(EagorError, match=r"it is none of|as many labels=\.\.\. as there are classes"):
            OnnxDetector(path, THREE, layout=layout)


# --- the picture into the input ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fit", "offset", "scale"), [("letterbox", (0, 16), (1.5, 1.5)), ("corner", (0, 0), (1.5, 1.5))]
)
def test_a_letterbox_is_undone(fit, offset, scale, tmp_path):
    detect = OnnxDetector(onnx_file(tmp_path / "d.onnx", yolov8()), THREE, fit=fit, layout="yolov8")
    wanted = np.clip((BOXES - np.tile(offset, 2)) * np.tile(scale, 2), 0, [96, 48, 96, 48])
    np.testing.assert_allclose(detect(WIDE, "")[0], wanted, atol=1e-4)


def test_odd_sizes_are_undone_exactly(tmp_path):
    """The scale is that of the pixels that the picture got, not the ratio that was aimed at."""
    table = np.zeros((1, 5, CELLS), np.float32)
    table[0, :4, 0], table[0, 4, 0] = middle(np.array([[10.0, 27.0, 20.0, 38.0]]))[0], 0.9
    detect = OnnxDetector(onnx_file(tmp_path / "d.onnx", {"output0": table}), ["chair"], layout="yolov8")
    found = detect(np.zeros((37, 101, 3), np.uint8), "")[0]  # becomes 23 x 64, from row 20
    x, y = 64 / 101, 23 / 37
    np.testing.assert_allclose(found, [[10 / x, 7 / y, 20 / x, 18 / y]], atol=1e-4)


@pytest.mark.parametrize("fit", ["stretch", "letterbox", "corner"])
@pytest.mark.parametrize("shape", [(48, 96), (200, 150)])
def test_a_network_that_sees_finds_the_red_patch(fit, shape, tmp_path):
    height, width = shape
    picture = np.full((*shape, 3), 100, np.uint8)
    y, x, tall, wide = height // 2, width // 4, height // 8, width // 8
    picture[y : y + tall, x : x + wide] = (250, 10, 10)
    before, options = picture.copy(), {"fit": fit, "layout": "centernet"}
    detect = OnnxDetector(seeing_file(tmp_path / "d.onnx"), ["patch"], **options)
    boxes, scores, labels = detect(picture, "patch")
    assert (labels[0], scores[0] > 0.4) == ("patch", True)
    centre = (boxes[0, :2] + boxes[0, 2:]) / 2
    assert np.abs(centre - [x + wide / 2, y + tall / 2]).max() <= 4 * max(shape) / SIDE  # a cell
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(detect))(picture)[0], boxes)
    np.testing.assert_array_equal(picture, before)
    # The same picture in another order of colours has no red in it.
    blue = OnnxDetector(tmp_path / "d.onnx", ["patch"], order="bgr", **options)
    assert len(blue(picture, "patch")[0]) == 0
    assert len(blue(picture[..., ::-1].copy(), "patch")[0]) > 0


WHITE = {"byte": [255] * 3, "unit": [1] * 3, "imagenet": (1 - np.array([0.485, 0.456, 0.406])) / (0.229, 0.224, 0.225)}


@pytest.mark.parametrize("values", WHITE)
@pytest.mark.parametrize(
    ("kind", "shape"), [("float32", (1, 3, 8, 8)), ("float16", (1, 8, 8, 3)), ("uint8", (3, 8, 8))]
)
def test_the_values_are_those_that_were_asked_for(values, kind, shape, tmp_path):
    """By a network that gives back what it gets."""
    nodes = [helper.make_node("Cast", ["images"], ["seen"], to=TensorProto.FLOAT)]
    network = Network(onnx_file(tmp_path / "d.onnx", {"seen": None}, shape, kind, nodes=nodes))
    seen = network.run(np.full((8, 8, 3), 255, np.uint8), values, "rgb")["seen"]
    assert seen.shape == shape
    colours = seen.reshape(-1, 3) if shape[-1] == 3 else seen.reshape(3, -1).T
    wanted = WHITE["byte" if kind == "uint8" else values]
    np.testing.assert_allclose(colours, np.tile(wanted, (64, 1)), rtol=1e-3)


# --- thresholds, suppression ------------------------------------------------------------------------------------------


def test_the_worse_of_two_boxes_of_a_class_falls_and_other_classes_stay(tmp_path):
    table = np.zeros((1, 7, CELLS), np.float32)
    for place, (dx, kind, score) in enumerate([(0, 0, 0.9), (1, 0, 0.8), (1, 1, 0.7), (30, 0, 0.6), (0, 2, 0.1)]):
        table[0, :4, place], table[0, 4 + kind, place] = (16 + dx, 30, 16, 20), score
    path = onnx_file(tmp_path / "d.onnx", {"output0": table})

    def labels(threshold):
        return OnnxDetector(path, THREE, layout="yolov8", threshold=threshold)(SQUARE, "")[2]

    assert (labels(None), labels(0.05), labels(0.95)) == (
        ["chair", "dog", "chair"],
        ["chair", "dog", "chair", "cup"],
        [],
    )


def test_a_box_comes_once_for_each_class_and_ends_at_the_picture(tmp_path):
    table = np.zeros((1, 7, CELLS), np.float32)
    table[0, :, 0] = 2, 30, 20, 20, 0.5, 0.4, 0.1
    table[0, :, 1] = 32, 5, 20, 8, 0.6, 0, 0  # on the grey above the wide picture
    detect = OnnxDetector(onnx_file(tmp_path / "d.onnx", {"output0": table}), THREE, layout="yolov8")
    boxes, scores, labels = detect(WIDE, "")
    assert labels == ["chair", "dog"]
    np.testing.assert_allclose(scores, [0.5, 0.4], atol=1e-6)
    np.testing.assert_allclose(boxes, [[0, 6, 18, 36]] * 2, atol=1e-4)


def test_the_size_is_the_files_or_what_is_asked_for(tmp_path):
    fixed = onnx_file(tmp_path / "fixed.onnx", centernet())
    free = onnx_file(tmp_path / "free.onnx", centernet(), (None, 3, None, None))
    noted = onnx_file(tmp_path / "noted.onnx", centernet(), (None, 3, None, None), notes={"imgsz": "[320, 640]"})
    half = onnx_file(tmp_path / "half.onnx", centernet(), (1, 3, 96, None))

    def size(path, asked=None):
        return OnnxDetector(path, THREE, asked, layout="centernet").size

    assert (size(fixed), size(free), size(noted), size(half)) == ((64, 64), (512, 512), (320, 640), (96, 512))
    assert size(free, "96x160") == size(free, (96, 160)) == (96, 160)
    with pytest.raises(EagorError, match=r"size = 640; .*fixed\.onnx takes 64 rows and 64 columns only"):
        size(fixed, 640)


# --- labels -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text",
    ["chair\ndog\ncup\n\n", "0 chair\n1 dog\n2 cup", "0: chair\n1: dog\n2: cup", '["chair", "dog", "cup"]',
     '{"0": "chair", "1": "dog", "2": "cup"}', "\ufeffchair\r\ndog\r\ncup\r\n"],
)  # fmt: skip
def test_files_of_labels(text, tmp_path):
    (tmp_path / "labels.txt").write_text(text, encoding="utf-8", newline="")
    assert names_of(tmp_path / "labels.txt", 0) == ("chair", "dog", "cup")


@pytest.mark.parametrize(
    ("text", "wanted"),
    [("", "has no labels"), ("1 chair\n1 dog\n2 cup", "a number twice"), ("{0: chair", "cannot be read"),
     ("[1st, 2nd]", "cannot be read"), ("['\\]', 1e]", "cannot be read"),
     ("{'a': 'chair'}", "wanted a list of names"), ("[7, 'chair']", "wanted a list of names"),
     ("999999 chair", "wanted a list of names"), (None, "cannot be read")],
)  # fmt: skip
def test_files_of_labels_that_are_none(text, wanted, tmp_path):
    if text is not None:
        (tmp_path / "labels.txt").write_text(text)
    with pytest.raises(FormatError, match=wanted):
        names_of(tmp_path / "labels.txt", 0)


def test_lists_begin_after_the_background_and_numbers_stay(tmp_path):
    path = onnx_file(tmp_path / "d.onnx", listed(False, 1), (3, None, None))
    for labels in (THREE, ["__background__", *THREE], {1: "chair", 2: "dog", 90: "cup"}):
        assert OnnxDetector(path, labels, SIDE, layout="torchvision")(SQUARE, "")[2] == LABELS
    unnamed = OnnxDetector(path, {1: "chair", 90: "cup"}, SIDE, layout="torchvision")
    assert (unnamed.classes, unnamed(SQUARE, "")[2]) == (("chair", "cup"), ["chair", "class 2"])


def test_a_file_without_names_and_one_whose_names_are_code(tmp_path):
    with pytest.raises(EagorError, match=r"not say what its classes are called; name a file with labels=FILE\.txt"):
        OnnxDetector(onnx_file(tmp_path / "d.onnx", yolov8()), layout="yolov8")
    notes = {"names": "__import__('os').abort()"}
    with pytest.raises(FormatError, match="'names' in the file's metadata cannot be read"):
        OnnxDetector(onnx_file(tmp_path / "d.onnx", yolov8(), notes=notes))


# --- what is wrong ----------------------------------------------------------------------------------------------------


def test_files_that_are_no_detectors(tmp_path):
    (tmp_path / "text.onnx").write_text("no network")
    with pytest.raises(EagorError, match="cannot be opened as an ONNX model"):
        OnnxDetector(tmp_path / "text.onnx")
    for place in (tmp_path / "none.onnx", tmp_path):
        with pytest.raises(EagorError, match=r"there is no file .*; wanted a detector in an ONNX file"):
            OnnxDetector(place)
    for shape, says in (((1, 10), r"images tensor\(float\) \[1, 10\]; wanted one"), ((8, 3, 64, 64), "Expected: 8")):
        with pytest.raises(EagorError, match=says):
            OnnxDetector(onnx_file(tmp_path / "d.onnx", yolov8(), shape), THREE)
    with pytest.raises(EagorError, match=r"a further input text \[1, 4\], which is not known here"):
        OnnxDetector(onnx_file(tmp_path / "d.onnx", yolov8(), further=[("text", (1, 4), "int64")]), THREE)


@pytest.mark.parametrize(
    "options",
    [{"threshold": 1.5}, {"threshold": "high"}, {"layout": "yolo"}, {"fit": "crop"}, {"values": "0..1"},
     {"order": "gbr"}, {"threads": 0}, {"together": 1.5}, {"size": 4}, {"size": "64x64x3"}, {"size": 0.5},
     {"size": "wide64"}],
)  # fmt: skip
def test_options_that_make_no_sense(options, tmp_path):
    (name,) = options
    with pytest.raises(EagorError, match=rf"{name} (is|=) .*; wanted"):
        OnnxDetector(onnx_file(tmp_path / "d.onnx", yolov8()), THREE, **{"layout": "yolov8"} | options)


# --- by name ----------------------------------------------------------------------------------------------------------


def test_a_line_of_text_names_a_detector(tmp_path):
    path = onnx_file(tmp_path / "d.onnx", centernet(), (1, 3, None, None))
    (tmp_path / "80").write_text("\n".join(THREE))
    text = f"{path}?labels={tmp_path / '80'}&layout=centernet"
    made = load(f"onnx:{text}&size=96x128&threshold=0.3&hfov_deg=100&views=12&order=bgr")
    assert isinstance(made, Detector)
    (view, *_), count = made.views(), len(made.views())
    assert (round(math.degrees(view.hfov)), count, view.width) == (100, 12, 128)
    assert (made.function.threshold, made.function.order, made.function.size) == (0.3, "bgr", (96, 128))
    assert made.function.classes == tuple(THREE)
    assert from_text(f"{text}&size=64&view=256", threshold=0.1).views()[0].width == 256


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("", "onnx wants the detector's file: onnx:MODEL"),
        ("d.onnx?colour=red", "no option colour; it has labels, size"),
        ("d.onnx?size", "wanted name=value"),
        ("none.onnx", "there is no file"),
    ],
)
def test_a_line_of_text_that_names_none(text, wanted):
    with pytest.raises(EagorError, match=wanted):
        from_text(text)

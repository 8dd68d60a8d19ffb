"""What people's detectors return is read by its attributes, and checked; what is wrong is said."""

from types import SimpleNamespace

import numpy as np
import pytest
import supervision
import torch

from eagor.errors import ResponseError
from eagor.perception.fusion import RawDetections
from eagor.perception.results import boxes_of

BOXES = np.array([[10.0, 20.0, 30.0, 60.0], [50.0, 10.0, 80.0, 90.0]])
SCORES = np.array([0.9, 0.25])
NAMES = {0: "person", 56: "chair"}


def ultralytics(**more):
    boxes = SimpleNamespace(xyxy=torch.tensor(BOXES), conf=torch.tensor(SCORES), cls=torch.tensor([56.0, 0.0]), id=None)
    return SimpleNamespace(boxes=boxes, names=NAMES, masks=None, **more)


def oriented(**corners):
    """Of an OBB model: rotated corners, or what holds them."""
    boxes = SimpleNamespace(conf=torch.tensor(SCORES), cls=torch.tensor([56.0, 0.0]), **corners)
    return SimpleNamespace(boxes=None, obb=boxes, names=NAMES)


def rhombi():
    (x0, y0, x1, y1), points = BOXES.T, np.zeros((2, 4, 2))
    points[..., 0] = np.stack([x0, (x0 + x1) / 2, x1, (x0 + x1) / 2], axis=1)
    points[..., 1] = np.stack([(y0 + y1) / 2, y0, (y0 + y1) / 2, y1], axis=1)
    return torch.tensor(points)


def mediapipe():
    found = []
    for box, score, name in zip(BOXES, SCORES, ["chair", "person"], strict=True):
        x0, y0, x1, y1 = map(int, box)
        categories = [
            SimpleNamespace(score=score / 2, category_name="other", index=3),
            SimpleNamespace(score=score, category_name=name, index=0),
        ]
        place = SimpleNamespace(origin_x=x0, origin_y=y0, width=x1 - x0, height=y1 - y0)
        found.append(SimpleNamespace(bounding_box=place, categories=categories))
    return SimpleNamespace(detections=found)


def records(**label):
    found = []
    for at, ((x0, y0, x1, y1), score) in enumerate(zip(BOXES, SCORES, strict=True)):
        own = {key: value[at] for key, value in label.items()}
        found.append({"image_id": 1, "bbox": [x0, y0, x1 - x0, y1 - y0], "score": score} | own)
    return found


def pipeline():
    corners = [dict(zip(("xmin", "ymin", "xmax", "ymax"), map(int, box), strict=True)) for box in BOXES]
    return [{"score": s, "label": n, "box": b} for s, n, b in zip(SCORES, ["chair", "person"], corners, strict=True)]


NUMBERS = {"class_id": np.array([56, 0])}
TENSORS = {"boxes": torch.tensor(BOXES, requires_grad=True), "scores": torch.tensor(SCORES).bfloat16()}
FOUND = {
    "plain": (BOXES, SCORES, ["chair", "person"]),
    "lists": [BOXES.tolist(), SCORES.tolist(), np.array(["chair", "person"])],
    "numbers": (BOXES, SCORES, [56, 0]),
    "tensors": (torch.tensor(BOXES), torch.tensor(SCORES), torch.tensor([56, 0])),
    "supervision": supervision.Detections(xyxy=BOXES, confidence=SCORES, **NUMBERS),
    "supervision with names": supervision.Detections(
        xyxy=BOXES, confidence=SCORES, class_id=np.array([1, 2]), data={"class_name": np.array(["chair", "person"])}
    ),
    "ultralytics": ultralytics(),
    "ultralytics, as it returns them": [ultralytics()],
    "ultralytics, oriented": [oriented(xyxy=torch.tensor(BOXES))],
    "ultralytics, rotated corners": oriented(xyxyxyxy=rhombi()),
    "ultralytics, oriented beside none": SimpleNamespace(
        **vars(oriented(xyxy=torch.tensor(BOXES))) | {"boxes": SimpleNamespace(xyxy=BOXES[:0], conf=[], cls=[])}
    ),
    "numbers as text": (BOXES, SCORES, ["56", "0"]),
    "bytes": (BOXES, SCORES, np.array([b"chair", b"person"])),
    **{f"dictionary with {key}": TENSORS | {key: [56, 0]} for key in ("class_ids", "classes", "pred_classes", "cls")},
    **{f"dictionary with {key}": TENSORS | {key: ["chair", "person"]} for key in ("phrases", "class_names", "names")},
    "torchvision": TENSORS | {"labels": torch.tensor([56, 0]), "masks": None},
    "torchvision, as it returns them": [TENSORS | {"labels": torch.tensor([56, 0])}],
    "hugging face": TENSORS | {"labels": torch.tensor([0, 0]), "text_labels": ["chair", "person"]},
    "pipeline": pipeline(),
    "mediapipe": mediapipe(),
    "coco": records(category_id=[56, 0]),
    "coco with names": records(category=["chair", "person"]),
}


@pytest.mark.parametrize("kind", FOUND)
def test_each_kind_is_read(kind):
    boxes, scores, labels = boxes_of(FOUND[kind], NAMES)
    np.testing.assert_allclose(boxes, BOXES, atol=1e-4)
    np.testing.assert_allclose(scores, SCORES, atol=2e-3)
    assert labels == ["chair", "person"]
    assert boxes.dtype == scores.dtype == np.float64


@pytest.mark.parametrize(
    "found",
    [
        [], ([], []), (np.zeros((0, 4)), np.zeros(0)), (np.zeros(0), np.zeros(0), []), supervision.Detections(
            xyxy=np.zeros((0, 4)), confidence=np.zeros(0)), supervision.Detections.empty(),
        SimpleNamespace(detections=[]),
        {"boxes": torch.zeros((0, 4)), "scores": torch.zeros(0), "labels": torch.zeros(0)},
        SimpleNamespace(detections=None),
    ],
)  # fmt: skip
def test_nothing_found_is_no_error(found):
    boxes, scores, _ = boxes_of(found, NAMES)
    assert (boxes.shape, scores.shape) == ((0, 4), (0,))


def test_labels_may_be_left_out():
    assert boxes_of((BOXES, SCORES)).labels is None
    assert boxes_of(records()).labels is None
    assert boxes_of(supervision.Detections(xyxy=BOXES, confidence=SCORES)).labels is None
    assert isinstance(boxes_of((BOXES, SCORES)), RawDetections)


def test_a_list_of_names_will_do_and_own_names_give_way():
    assert boxes_of((BOXES, SCORES, [1, 0]), ["cup", "mug"]).labels == ["mug", "cup"]
    assert boxes_of(ultralytics(), {56: "seat", 0: "human"}).labels == ["seat", "human"]
    for names in (
        {"56": "seat", "0": "human"},
        {"seat": 56, "human": np.int64(0)},
        np.array(["human"] + ["seat"] * 56),
    ):
        assert boxes_of(ultralytics(), names).labels == ["seat", "human"]


def test_boxes_without_area_are_left_out():
    flat = np.array([[10, 20, 10, 60], [10, 20, 30, 20], [10, 20, 30, 60.0]])
    boxes, scores, labels = boxes_of((flat, [0.1, 0.2, 0.3], ["a", "b", "c"]))
    assert (boxes.tolist(), scores.tolist(), labels) == ([[10, 20, 30, 60]], [0.3], ["c"])


@pytest.mark.parametrize(
    ("found", "wanted"),
    [
        (None, r"returned builtins\.NoneType; wanted \(boxes, scores\) or .*supervision"),
        (7, r"returned builtins\.int; wanted"),
        ("chair", r"returned builtins\.str; wanted"),
        (BOXES, r"an array of shape \(2, 4\); wanted"),
        ((BOXES,), r"a tuple of 1 \(ndarray, ...\); wanted"),
        ({"boxes": BOXES}, "a dictionary with boxes; wanted"),
        ([ultralytics(), ultralytics()], "boxes came as types.SimpleNamespace; wanted numbers"),
        ((BOXES, SCORES[:1]), "2 boxes and 1 scores came"),
        ((BOXES, SCORES, ["chair"]), "2 boxes and 1 labels came"),
        ((BOXES[:, :3], SCORES), r"boxes of shape \(2, 3\) came; wanted \(n, 4\)"),
        ((BOXES, ["high", "low"]), "scores came as a list of 2 .*; wanted one number for each box"),
        ((BOXES * np.nan, SCORES), "boxes came that are not finite"),
        ((BOXES, [0.5, np.inf]), "scores came that are not finite"),
        ((BOXES, SCORES * 100), r"scores from 25 to 90 came; scores outside \[0, 1\] want a stated squashing"),
        ((BOXES, -SCORES), r"outside \[0, 1\] want a stated squashing"),
        ((BOXES[:, [2, 1, 0, 3]], SCORES), r"the box \[30\.0, 20\.0, 10\.0, 60\.0\] came; wanted x0 < x1"),
        (([[50, 60, 20, 30]], [0.5]), "If it is x, y, width, height"),
        ((BOXES / 200, SCORES), "seem to be fractions of the picture"),
        ((BOXES, SCORES, [0, 7]), "the label 7 came, and names has 2 entries without it"),
        ((BOXES, SCORES, [0, -1]), "the label -1 came, and names has"),
        ((BOXES, SCORES, [0.5, 1]), r"the label 0\.5 came; wanted a text"),
        ((BOXES, SCORES, [0, 10**400]), "the label 10+.* came; wanted a text"),
        ((BOXES, SCORES, [None, None]), "the label None came; wanted a text.*return boxes and scores alone"),
        ((BOXES, SCORES, [{"id": 56}, {"id": 0}]), "the label {'id': 56} came; wanted a text"),
        (([[0, 0, 1, 1]], [0.5]), "seem to be fractions"),
        ((BOXES / 100 - 0.15, SCORES), "seem to be fractions"),
        ((torch.tensor(BOXES, device="meta"), SCORES), "boxes came as an array of shape"),
        (supervision.Detections(xyxy=BOXES), "without confidence; wanted scores"),
        (SimpleNamespace(boxes=None, obb=None, probs=SCORES), r"neither boxes nor oriented boxes \(obb\)"),
        (oriented(xywhr=BOXES), "has no attribute 'xyxyxyxy'; wanted"),
        (records(label=["chair", None]), "some dictionaries came with a label, some without"),
        ([{"bbox": [1, 2, 3, 4]}], "a list of 1 .* without"),
        ([{"bbox": [1, 2, 3], "score": 0.5}], "a list of 1 .* with an error: not enough values"),
        ([{"bbox": [1, 2, 3, 10**400], "score": 0.5}], "a list of 1 .* with an error: int too large"),
        ((BOXES, [1, 10**400]), "scores came as a list of 2"),
        ([{"box": {"left": 3}, "score": 0.5}], "without 'xmin'; wanted"),
    ],
)
def test_what_is_wrong_is_said(found, wanted):
    with pytest.raises(ResponseError, match=wanted):
        boxes_of(found, NAMES)


@pytest.mark.parametrize("names", [{"person", "chair"}, "person,chair", 7, {0: "person", "chair": 1}])
def test_names_that_are_none(names):
    with pytest.raises(ResponseError, match=r"names of classes came as .*wanted a list, or names by number"):
        boxes_of((BOXES, SCORES, [1, 0]), names)


def test_the_numbers_of_coco_are_no_places_in_a_list():
    with pytest.raises(ResponseError, match=r"category_id, and names as a list.*{1: 'person', 62: 'chair'}"):
        boxes_of(records(category_id=[1, 0]), ["person", "bicycle"])


def test_numbers_without_names():
    with pytest.raises(ResponseError, match="labels came as numbers, such as 56; wanted texts, or names="):
        boxes_of((BOXES, SCORES, [56, 0]))

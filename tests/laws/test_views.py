"""Any detector for ordinary pictures, made to look all around."""

import math
from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.ndimage import binary_dilation, find_objects, label

from eagor import DetectorModel, DirectionTracker, ErpGrid, Evidence, PerspectiveGrid
from eagor.drawing.style import answer_in_words, candidates_in_words
from eagor.errors import EagorError, GridError, ImageError, QueryError
from eagor.evidence import BodyMask
from eagor.grids import tangent_views
from eagor.live.events import Answer
from eagor.perception import as_perception, check_perception, infer
from eagor.perception.fusion import ViewBox, extend_truncated_box, fuse_views
from eagor.perception.views import Detector
from eagor.sources.panorama import turn
from eagor.sphere import angular_distance, direction, world_R_body

GREY = 90
GRID = ErpGrid(256, 512)


def painted(*discs):
    """A grey panorama with red discs: (direction, radius in radians)."""
    panorama = np.full((256, 512, 3), GREY, dtype=np.uint8)
    for where, radius in discs:
        panorama[angular_distance(GRID.directions, where) < radius] = (220, 20, 20)
    return panorama


def red(picture, query):
    """A detector: the boxes of what is red; pixels that nearly touch at a view's border are one thing's."""
    shown = picture[..., 0].astype(int) - picture[..., 1] > 60
    parts = label(binary_dilation(shown, iterations=2))[0] * shown
    boxes = [[x.start, y.start, x.stop, y.stop] for y, x in find_objects(parts)]
    return np.array(boxes, dtype=float).reshape(-1, 4), np.full(len(boxes), 0.9)


def found(panorama, pose=None, **settings):
    return Detector(red, size=128, **settings)(panorama, "thing", stamp=1.0, world_R_body=pose).detections


DIRECTION = st.tuples(st.floats(0, 2 * math.pi), st.floats(-math.pi / 2, math.pi / 2)).map(lambda at: direction(*at))


@given(DIRECTION)
@settings(max_examples=20, deadline=None)
def test_a_small_thing_is_one_detection_wherever_it_is(where):
    seen = found(painted((where, math.radians(6))))
    assert len(seen) == 1, "however many views show it"
    assert angular_distance(seen.directions[0], where) < math.radians(2)
    assert not seen.views, "all was looked at"


@given(DIRECTION)
@settings(max_examples=12, deadline=None)
def test_a_thing_that_all_views_cut_is_put_together(where):
    seen = found(painted((where, math.radians(40))))
    best = seen.directions[int(seen.scores.argmax())]
    assert angular_distance(best, where) < math.radians(8)
    widths = 1 / np.linalg.norm(seen.axes[0], axis=1)
    assert widths.min() > math.radians(12), "it is as wide as it is"


def test_things_side_by_side_stay_two():
    places = direction(0.2, 0.1), direction(0.6, 0.1)
    seen = found(painted(*((place, math.radians(5)) for place in places)))
    assert len(seen) == 2
    for place in places:
        assert np.min(angular_distance(seen.directions, place)) < math.radians(2)


@given(DIRECTION, st.floats(-3, 3), st.floats(-1.2, 1.2), st.floats(-3, 3))
@settings(max_examples=12, deadline=None)
@example(direction(0.2, 0.1), 0.7, math.pi / 2, 0.0)  # straight down, and straight up
@example(direction(0.2, 0.1), 0.7, -math.pi / 2, 0.0)
def test_views_are_level_however_the_camera_is_turned(where, yaw, pitch, roll):
    pose = world_R_body(yaw, pitch, roll)
    perception = Detector(red, size=128)
    for view in perception.views(pose):
        left = pose @ view.body_R_view[:, 1]
        assert abs(left[2]) < 1e-9, "the left side of each picture points at the horizon"
    seen = found(turn(painted((where, math.radians(8))), pose.T), pose)
    assert len(seen) == 1
    assert angular_distance(pose @ seen.directions[0], where) < math.radians(2.5)


def test_an_open_side_widens_and_shifts_what_one_view_alone_has_seen():
    grid = tangent_views(100, math.radians(90), 0.0)[0]
    whole = ViewBox(0, grid, np.array([30.0, 40.0, 60.0, 60.0]), 0.9)
    part = ViewBox(0, grid, np.array([70.0, 40.0, 100.0, 60.0]), 0.9)
    (inside,), (opened,) = fuse_views([whole]), fuse_views([part])
    assert not whole.cut.any()
    assert part.cut.tolist() == [False, False, True, False]
    assert angular_distance(inside.direction, grid.unproject(45.0, 50.0)) < math.radians(1)
    closed = grid.unproject(85.0, 50.0)
    shift = math.atan2(closed[1], closed[0]) - math.atan2(opened.direction[1], opened.direction[0])
    assert math.radians(2) < shift < math.radians(8), "the thing goes on to the right, behind the border"
    across, along = np.linalg.eigvalsh(opened.covariance)
    assert along > 2 * across, "it may go on along the open side, and is no higher"


def test_what_two_borders_cut_goes_on_by_its_own_width_and_height():
    grid = tangent_views(100, math.radians(90), 0.0)[0]
    corner = ViewBox(0, grid, np.array([90.0, 80.0, 100.0, 100.0]), 0.9)
    np.testing.assert_allclose(extend_truncated_box(corner, [corner]), [90, 80, 110, 120])


def test_the_contract_of_perceptions_is_kept():
    panorama = painted((direction(0.4, 0.2), math.radians(8)))
    check_perception(Detector(red, size=96), panorama, "thing")
    model = DetectorModel(detection_probability=0.8, spread=math.radians(3))
    evidence = Detector(red, size=96, detector=model)(panorama, "thing")
    assert evidence.detections.model is model


@pytest.mark.parametrize(("classes", "says"), [(None, "none fits 'green lamp'"), (["lamp"], "is called so")])
def test_labels_that_fit_nothing_are_named_once(classes, says):
    panorama = painted((direction(0.4, 0.2), math.radians(8)))
    views = Detector(lambda picture, query: (*red(picture, query), ["Zebra"] * len(red(picture, query)[0])), size=96)
    views.classes = classes
    with pytest.warns(UserWarning, match=rf"the detector says 'Zebra'; .*{says}.*classes=\[\.\.\.\]"):
        assert len(views(panorama, "green lamp").detections) == 0
    assert len(views(panorama, "green lamp").detections) == 0
    assert len(views(painted(), "lamp").detections) == 0


def test_one_pass_answers_for_every_class_as_a_look_for_each_does():
    panorama, pose = painted((direction(1.0, 0.2), 0.1), (direction(-2.0, -0.3), 0.3)), world_R_body(0.4, 0.2)
    asked = []

    def labelled(picture, query):
        asked.append(query)
        boxes, scores = red(picture, query)
        return boxes, scores, ["ball" if box[2] - box[0] < 20 else "door" for box in boxes]

    views = Detector(labelled, size=128, classes=("ball", "door", "lamp"))
    looks = views.answers(panorama, ("door", "balls", "lamp", "zebra"), stamp=1.0, world_R_body=pose)
    assert len(asked) == len(views.views()), "each view is shown once"
    assert isinstance(looks[3], QueryError)
    together = list(zip(("door", "balls", "lamp"), looks, strict=False))
    assert [len(look.detections) for _, look in together] == [1, 1, 0]
    for query, seen in together:
        alone = views(panorama, query, stamp=1.0, world_R_body=pose)
        np.testing.assert_array_equal(seen.detections.directions, alone.detections.directions)
    open_words = Detector(red, size=128)
    asked.clear()
    open_words.function = labelled
    open_words.answers(panorama, ("door", "ball"))
    assert set(asked) == {"door", "ball"}, "a detector without classes is asked for each query"


@pytest.mark.parametrize(
    "nonsense",
    [
        None,
        "a chair",
        (np.zeros((2, 4)), np.zeros(3)),
        (np.full((1, 4), np.nan), np.ones(1)),
        (np.array([[10.0, 10.0, 5.0, 20.0]]), np.ones(1)),
        (np.array([[1.0, 1.0, 5.0, 20.0]]), np.array([7.0])),
        (np.zeros((1, 3)), np.ones(1)),
    ],
)
def test_a_detector_that_returns_nonsense_is_told_so(nonsense):
    with pytest.raises(EagorError, match="want"):
        Detector(lambda picture, query: nonsense, size=64)(painted(), "thing")


@pytest.mark.parametrize(("right", "said"), [(130, None), (150, "reach far beyond the 128 x 128 picture")])
def test_boxes_of_a_larger_picture_are_doubted(right, said):
    views = Detector(lambda picture: ([[90, 20, right, 60]], [0.9], ["lamp"]), size=128)
    with pytest.warns(UserWarning, match=said) if said else nullcontext():
        views(painted(), "lamp", stamp=0.0)


def test_a_colour_in_the_query_weighs_the_boxes_of_a_detector_that_knows_none():
    left, right = direction(0.6, 0.0), direction(-0.6, 0.0)
    panorama = painted((left, math.radians(8)))
    panorama[angular_distance(GRID.directions, right) < math.radians(8)] = (220, 20, 160)  # more purple than red

    def chairs(picture, query):
        boxes, scores = red(picture, query)
        return boxes, scores, ["chair"] * len(boxes)

    views = Detector(chairs, size=128, classes=["chair"])
    assert len(views(panorama, "chair", stamp=1.0).detections) == 2
    seen = views(panorama, "the red chair", stamp=1.0).detections
    surest = int(seen.scores.argmax())
    assert angular_distance(seen.directions[surest], left) < math.radians(2)
    assert seen.scores[surest] == pytest.approx(0.9), "a red thing fills enough of its box"
    assert np.sort(seen.scores)[:-1].sum() < 0.1
    with pytest.raises(QueryError, match="by the window"):
        views(panorama, "red chair by the window")


def test_the_answer_names_what_was_looked_for_where_that_was_not_asked():
    def chairs(picture, query):
        boxes, scores = red(picture, query)
        return boxes, scores, ["chair"] * len(boxes)

    panorama, view = painted((direction(0.6, 0.0), math.radians(8))), PerspectiveGrid(64, 64, 1.0)
    views = Detector(chairs, size=128, classes=["chair"])
    for query, words in (("chairs", ""), ("footstool", "chair")):
        tracker = DirectionTracker()
        tracker.observe(views(panorama, query, stamp=1.0))
        estimate = tracker.estimate(2.0)
        turned = estimate.turned(3.0, np.eye(3))
        for found in (estimate, turned, views.view(np.zeros((64, 64, 3), np.uint8), view, query)):
            assert found.looked_for == words
        (looks,) = views.answers(panorama, [query])
        assert looks.looked_for == looks.covered(BodyMask(np.ones((8, 16), bool))).looked_for == words
        assert estimate.as_dict().get("looked_for", "") == words
        assert Answer(2.0, query, estimate, None, 1.0, 1.0).as_dict().get("looked_for", "") == words
        for said in (answer_in_words(turned), candidates_in_words(estimate), repr(estimate)):
            assert ("looked for chair" in said) == bool(words)


def test_the_names_in_results_are_the_classes_of_a_detector_that_tells_no_others():
    panorama = painted((direction(0.6, 0.0), math.radians(8)))

    def results(picture, query):
        boxes, scores = red(picture, query)
        found = SimpleNamespace(xyxy=boxes, conf=scores, cls=np.full(len(boxes), 56.0))
        return [SimpleNamespace(boxes=found, obb=None, names={0: "person", 56: "chair"})]

    views = Detector(results, size=128)
    for _ in range(2):
        with pytest.raises(QueryError, match="'lamp' names none of this detector's 2 classes"):
            views(panorama, "lamp")
    assert views.classes == ("person", "chair")
    assert len(views(panorama, "the chairs").detections) == 1
    assert len(Detector(results, size=128)(panorama, "footstool").detections) == 1
    assert not len(views(panorama, "person").detections)
    results.names = {0: "lamp", 56: "sofa"}
    assert len(Detector(results, size=128)(panorama, "couch").detections) == 1, "the detector's own names count"
    assert len(Detector(results, size=128, classes=["chair"] * 57)(panorama, "chair").detections) == 1


def test_wrong_settings_and_pictures_are_refused():
    with pytest.raises(GridError, match="cover the sphere"):
        Detector(red, hfov_deg=120, views=3)
    with pytest.raises(GridError, match="150"):
        Detector(red, hfov_deg=170)
    with pytest.raises(EagorError, match="detect"):
        Detector("yolo.onnx")
    with pytest.raises(EagorError, match="from_ultralytics"):
        Detector(Yolo())
    with pytest.raises(EagorError, match="size"):
        Detector(red, size=0)
    with pytest.raises(ImageError, match="uint8"):
        Detector(red, size=64)(np.zeros((4, 8)), "thing")
    with pytest.raises(QueryError, match="words"):
        Detector(red, size=64)(painted(), " ")


def test_a_look_tells_the_pose_only_to_who_takes_it():
    told = []

    class Takes:
        takes_pose = True

        def __call__(self, panorama, query, *, stamp=None, world_R_body=None):
            told.append(world_R_body)
            return Evidence.from_points(np.zeros((0, 3)))

    def plain(panorama, query, *, stamp=None):
        told.append("nothing")
        return Evidence.from_points(np.zeros((0, 3)))

    for perception in (Takes(), plain):
        infer(perception, painted(), "thing", world_R_body=np.eye(3))
    np.testing.assert_array_equal(told[0], np.eye(3))
    assert told[1] == "nothing"


class Yolo:
    """As a model of Ultralytics: pictures in BGR, results with numbers of classes and their names."""

    def __init__(self):
        self.names = {0: "chair", 1: "ball"}

    def __call__(self, source=None, stream=False, **options):
        raise AssertionError("its call takes other arguments")

    def predict(self, source, verbose=True):
        assert not verbose
        boxes, scores = red(source[..., ::-1], "")
        found = SimpleNamespace(xyxy=boxes, conf=scores, cls=np.ones(len(boxes)), __len__=lambda: len(boxes))
        return [SimpleNamespace(boxes=found, names=self.names)]


class Pipeline:
    """As a pipeline of Hugging Face."""

    def __init__(self, task):
        self.task = task
        self.model = SimpleNamespace(config=SimpleNamespace(id2label={0: "chair", 1: "ball"}))

    def __call__(self, picture, candidate_labels=("ball",)):
        boxes, scores = red(np.asarray(picture), "")
        corners = ("xmin", "ymin", "xmax", "ymax")
        return [
            {"score": score, "label": candidate_labels[0], "box": dict(zip(corners, box.tolist(), strict=True))}
            for box, score in zip(boxes, scores, strict=True)
        ]


@pytest.mark.parametrize(
    ("made", "classes"),
    [
        (lambda: Detector.from_ultralytics(Yolo(), size=128), ("chair", "ball")),
        (lambda: Detector.from_transformers(Pipeline("object-detection"), size=128), ("chair", "ball")),
        (lambda: Detector.from_transformers(Pipeline("zero-shot-object-detection"), size=128), None),
        (lambda: Detector.from_supervision(lambda picture: red(picture, ""), size=128), None),
        (lambda: as_perception(Yolo()), ("chair", "ball")),
    ],
)
def test_models_of_known_libraries_tell_their_classes(made, classes):
    where, perception = direction(0.5, 0.1), made()
    assert perception.classes == classes
    found = perception(painted((where, math.radians(6))), "ball", stamp=0.0).detections
    assert angular_distance(found.directions[0], where) < math.radians(2)
    if classes is not None:
        with pytest.raises(QueryError):
            perception(painted(), "lamp")

"""Every perception keeps the contract; what people write wrong is refused with a text that helps."""

import io
import json
import math
from importlib.metadata import EntryPoint

import numpy as np
import pytest

from eagor import plugins
from eagor.cli import main
from eagor.errors import EagorError, FormatError, ImageError, QueryError, ResponseError, TimeError
from eagor.evidence import Evidence
from eagor.evidence.calibration import Calibration
from eagor.evidence.detector import DetectorModel
from eagor.grids import ErpGrid, PatchGrid, PerspectiveGrid
from eagor.lab.worlds.painted import BALL_COLOURS, Ball, painted_room
from eagor.perception import Perception, check_perception, known, load, short_name
from eagor.perception.colour import COLOURS, SYNONYMS, ColourPerception, parse_colour
from eagor.perception.records import read_looks
from eagor.perception.replay import ReplayPerception, parse_record, write_record
from eagor.perception.truth import TruthPerception
from eagor.queries import Query
from eagor.sphere import angular_distance, azimuth_elevation, direction
from eagor.tracking.tracker import DirectionTracker

BRIGHT = [name for name in BALL_COLOURS if name not in ("white", "black")]  # the room itself has white in it
PANORAMA = {"width": 1024, "height": 512}


def strongest(evidence: Evidence) -> np.ndarray:
    """The direction of the cell with the highest response."""
    return evidence.grid.directions.reshape(-1, 3)[int(np.argmax(evidence.response))]


@pytest.fixture
def replay_file(tmp_path):
    """One record of each kind, a second apart."""
    path = tmp_path / "looks.jsonl"
    with path.open("w") as file:
        write_record(file, 3.0, query="chair", response=np.eye(4, 8) / 2)
        write_record(file, 1.0, image=PANORAMA, boxes=[{"box": [256, 200, 300, 260], "score": 0.9, "label": "chair"}])
        write_record(file, 2.0, points=[{"azimuth_deg": 90, "elevation_deg": 10, "spread_deg": 5, "score": 0.8}])
        write_record(file, 4.0, image=PANORAMA, boxes=[])
    return path


# --- the contract ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("query", ["red", "the light blue ball", "dark grey", "white"])
def test_colour_keeps_the_contract(query):
    # Detections are drawn on cells of two degrees: a roll by whole cells.
    check_perception(ColourPerception(), painted_room(90, 180), query, roll=37)
    check_perception(ColourPerception(calibration=Calibration()), painted_room(64, 128), query, roll=37)


@pytest.mark.filterwarnings("ignore:a picture of 512 x 300")
@pytest.mark.parametrize("shape", [(600, 1200), (300, 512), (3, 5), (1, 1)])
def test_colour_keeps_the_contract_at_any_size(shape):
    panorama = np.random.default_rng(0).integers(0, 256, (*shape, 3), dtype=np.uint8)
    check_perception(ColourPerception(), panorama, "blue")


@pytest.mark.parametrize("stamp", [1.0, 2.0, 3.0, 4.0])
def test_replay_keeps_the_contract(replay_file, stamp):
    check_perception(ReplayPerception(replay_file), painted_room(32, 64), "chair", stamp=stamp)


def test_the_checker_wants_a_roll_that_the_response_can_follow():
    with pytest.raises(AssertionError, match="another roll"):
        check_perception(ColourPerception(rows=8), painted_room(32, 64), "red", roll=3)


@pytest.mark.parametrize("rows", [350, 512])
def test_colour_points_straight_whatever_the_size_of_the_panorama(rows):
    grid, off = ErpGrid(rows, 2 * rows), []
    for azimuth, elevation in ((20, -10), (-100, 5), (3, 30), (150, -40), (-33, 12), (77, -3)):
        panorama = np.full((rows, 2 * rows, 3), 128, dtype=np.uint8)
        centre = direction(math.radians(azimuth), math.radians(elevation))
        panorama[angular_distance(grid.directions, centre) < math.radians(12)] = (220, 20, 20)
        evidence = ColourPerception()(panorama, "red")
        weights = np.asarray(evidence.response) * evidence.grid.weights
        mean = np.einsum("ij,ijk->k", weights, evidence.grid.directions)
        found = np.degrees(azimuth_elevation(mean / np.linalg.norm(mean)))
        off.append([(found[0] - azimuth + 180) % 360 - 180, found[1] - elevation])
    assert np.abs(np.mean(off, axis=0)).max() < 0.1 * 180 / rows  # of a pixel


@pytest.mark.parametrize("rows", [0, -1, 2.5, math.nan, "256", True])
def test_rows_of_colour_are_whole_numbers(rows):
    with pytest.raises(EagorError, match=r"ColourPerception: rows = .*; wanted a whole number, 1 or more"):
        load("colour", rows=rows)


@pytest.mark.parametrize(
    ("spec", "says"),
    [
        ("http://localhost:8000/v1", r"A model on a server is endpoint:MODEL@ADDRESS"),
        ("~nobody-of-this-name/model", "there is no folder '~nobody-of-this-name/model'"),
        ("~nobody-of-this-name", "there is no perception"),
        ("/" + "x" * 5000, "there is no folder"),
        ("scout:moderate", r"calibration = 'moderate'; wanted an eagor\.Calibration"),
    ],
)
def test_names_that_lead_nowhere(spec, says):
    with pytest.raises(EagorError, match=says):
        load(spec)
    assert short_name(spec)


# --- load ------------------------------------------------------------------------------------------------------------


def test_load_makes_the_built_in_ones(replay_file):
    assert isinstance(load("colour"), ColourPerception)
    assert load("colour", rows=64).rows == 64
    assert load("colour:rows=64").rows == 64
    with pytest.raises(EagorError, match="name=value"):
        load("colour:64")
    with pytest.raises(EagorError, match="rows"):
        load("colour:row=64")
    replay = load(f"replay:{replay_file}", tolerance=0.2)
    assert isinstance(replay, ReplayPerception)
    assert isinstance(replay, Perception)
    assert replay.tolerance == 0.2
    assert {"colour", "replay"} <= set(known())


def test_load_makes_installed_ones(monkeypatch):
    points = [
        EntryPoint("upside", "eagor.perception.colour:ColourPerception", "eagor.perceptions"),
        EntryPoint("broken", "eagor.no_such_module:Thing", "eagor.perceptions"),
    ]
    monkeypatch.setattr(plugins, "_installed", lambda group: points)
    assert isinstance(load("upside"), ColourPerception)
    with pytest.raises(EagorError, match=r"'broken'.*cannot be imported"):
        load("broken")
    with pytest.raises(QueryError, match="broken, coco, colour, endpoint, onnx, replay, scout, truth, upside"):
        load("nonsense:1")


def test_a_name_of_ours_cannot_be_taken_and_whoever_tries_is_told(monkeypatch, capsys):
    points = [
        EntryPoint("colour", "somebody.else:Colour", "eagor.perceptions"),
        EntryPoint("waypoint", "eagor.no_such_module:TASK", "eagor.tasks"),
        EntryPoint("torn", "eagor.no_such_module:TASK", "eagor.tasks"),
    ]
    monkeypatch.setattr(plugins, "_installed", lambda group: [point for point in points if point.group == group])
    with pytest.warns(UserWarning, match=r"'colour' \(somebody.else:Colour\).*left out.*another name"):
        assert isinstance(load("colour"), ColourPerception)
    assert main(["doctor", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["perceptions"]["colour"] == found["tasks"]["waypoint"] == "ready"
    assert "no_such_module" in found["tasks"]["torn"]
    assert [text.split()[1:3] for text in found["left_out"]] == [["perception", "'colour'"], ["task", "'waypoint'"]]


@pytest.mark.parametrize("spec", ["", ":", "color-blind", "Replay"])
def test_load_lists_what_it_knows(spec):
    with pytest.raises(QueryError, match=r"known are .*colour.*replay"):
        load(spec)


# --- colour ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", BRIGHT)
def test_a_ball_of_each_colour_is_found_and_no_other(name):
    balls = (Ball((2.0, 0.6, 1.0), 0.35, name),)
    response = ColourPerception().respond(painted_room(128, 256, balls), name)
    azimuth, elevation = azimuth_elevation(np.array([2.0, 0.6, -0.3]))
    angle = angular_distance(PatchGrid(*response.shape).directions, direction(azimuth, elevation))
    assert response[angle < math.radians(5)].mean() > 0.85
    assert response[angle > math.radians(13)].max() < 0.05
    for other in set(BRIGHT) - {name}:
        assert ColourPerception().respond(painted_room(128, 256, balls), other).mean() < 5e-4, other


@pytest.mark.parametrize(
    ("query", "rgb"),
    [
        ("the red chair", (255, 0, 0)),
        ("RED", (110, 15, 20)),
        ("dark red", (90, 10, 15)),
        ("a maroon rug", (100, 10, 20)),
        ("grey", (128, 128, 128)),
        ("gray", (128, 128, 128)),
        ("dark gray sofa", (70, 70, 72)),
        ("light grey", (205, 205, 205)),
        ("white", (250, 250, 250)),
        ("black", (10, 10, 12)),
        ("the blue ball on the red table", (0, 0, 255)),
        ("navy", (0, 0, 110)),
        ("light-blue", (173, 216, 230)),
        ("green", (0, 255, 0)),
        ("dark green armchair", (10, 60, 40)),
        ("yellow", (255, 220, 0)),
        ("orange", (255, 140, 0)),
        ("turquoise", (64, 224, 208)),
        ("purple", (128, 0, 128)),
        ("violet", (148, 0, 211)),
        ("pink", (255, 182, 193)),
        ("hot pink", (255, 105, 180)),
        ("brown", (120, 75, 45)),
        ("beige", (225, 210, 180)),
    ],
)
def test_colour_words_mean_what_people_mean(query, rgb):
    plain = np.full((4, 8, 3), rgb, dtype=np.uint8)
    assert ColourPerception().respond(plain, query).min() > 0.8


@pytest.mark.parametrize(
    ("query", "rgb"),
    [
        ("red", (255, 182, 193)),  # pink
        ("red", (205, 175, 140)),  # a warm wall
        ("red", (120, 75, 45)),  # wood
        ("red", (128, 128, 128)),
        ("red", (6, 3, 3)),  # noise in the dark
        ("light red", (110, 15, 20)),
        ("dark blue", (120, 160, 255)),
        ("blue", (128, 0, 128)),
        ("purple", (0, 0, 255)),
        ("yellow", (255, 140, 0)),
        ("white", (128, 128, 128)),
        ("grey", (130, 130, 190)),
        ("black", (60, 60, 60)),
    ],
)
def test_colour_words_do_not_mean_what_people_do_not(query, rgb):
    assert ColourPerception().respond(np.full((4, 8, 3), rgb, dtype=np.uint8), query).max() < 0.05


def test_shading_does_not_change_a_hue():
    shades = (np.linspace(0.25, 1.0, 32)[:, None, None] * np.array([200, 30, 35])).round().astype(np.uint8)
    assert ColourPerception().respond(np.repeat(shades, 64, axis=1), "red").min() > 0.9


@pytest.mark.parametrize("query", ["", "the chair", "redwood", "rot", None, 7])
def test_a_query_without_a_colour_lists_the_known_ones(query):
    with pytest.raises(QueryError, match=r"red.*turquoise"):
        ColourPerception()(painted_room(8, 16), query)


def test_every_colour_word_is_understood():
    for word in [*COLOURS, *SYNONYMS]:
        for shade in ("", "dark ", "light "):
            parse_colour(f"a {shade}{word} thing")


@pytest.mark.parametrize(
    "panorama",
    [
        np.zeros((8, 16), np.uint8),
        np.zeros((8, 16, 4), np.uint8),
        np.zeros((0, 16, 3), np.uint8),
        np.zeros((8, 16, 3), np.int32),
        np.full((8, 16, 3), 0.5),
        None,
    ],
)
def test_a_panorama_of_another_kind_is_an_image_error(panorama):
    with pytest.raises(ImageError, match="panorama"):
        ColourPerception()(panorama, "red")


def disc(azimuth, elevation, radius, colour, panorama=None, rows=180):
    """A panorama with a disc of a colour in it; angles in degrees."""
    grid = ErpGrid(rows, 2 * rows)
    image = np.full((rows, 2 * rows, 3), 128, dtype=np.uint8) if panorama is None else panorama
    centre = direction(math.radians(azimuth), math.radians(elevation))
    image[angular_distance(grid.directions, centre) < math.radians(radius)] = colour
    return image


RED = (220, 20, 20)


@pytest.mark.parametrize("azimuth", [20, 180, -179])
@pytest.mark.parametrize("elevation", [0, -40, 86, 90])
def test_each_patch_of_a_colour_is_one_detection(azimuth, elevation):
    """Where it is, also across the seam and over a pole; as wide as it is."""
    image = disc(azimuth, elevation, 8, RED, disc(azimuth + 120, -20, 4, RED))
    found = ColourPerception()(image, "red").detections
    assert len(found) == 2
    order = np.argsort(-found.directions @ direction(math.radians(azimuth), math.radians(elevation)))
    for index, where, radius in ((order[0], (azimuth, elevation), 8), (order[1], (azimuth + 120, -20), 4)):
        wanted = direction(*np.radians(where))
        assert math.degrees(float(angular_distance(found.directions[index], wanted))) < 0.5
        spread = np.degrees(1 / np.linalg.norm(found.axes[index], axis=-1))
        assert spread == pytest.approx(math.hypot(radius / 2, 5), rel=0.05)  # a disc has half its radius
    assert found.scores.min() > 0.9


def test_a_wall_of_a_colour_points_nowhere_in_particular():
    image = np.full((180, 360, 3), 128, dtype=np.uint8)
    image[50:130, 60:200] = RED
    tracker = DirectionTracker()
    tracker.observe(ColourPerception()(image, "red", stamp=0.0))
    estimate = tracker.estimate(0.0)
    assert estimate.presence > 0.5
    assert estimate.credible_angle > math.radians(60)
    ball = DirectionTracker()
    ball.observe(ColourPerception()(disc(20, 10, 4, RED), "red", stamp=0.0))
    assert ball.estimate(0.0).within(math.radians(15)) > 0.5 > estimate.within(math.radians(15))


def test_patches_that_are_too_small_for_the_picture_are_no_detections():
    image = np.full((64, 128, 3), 180, dtype=np.uint8)
    image[32, 20:22] = RED  # two pixels; in a finer picture of the same room they would be many
    image[0, 60] = RED  # one at a pole, where columns are narrow
    assert len(ColourPerception()(image, "red").detections) == 0
    image[32:34, 20:22] = RED
    assert len(ColourPerception()(image, "red").detections) == 1
    assert len(ColourPerception()(np.kron(image, np.ones((4, 4, 1), np.uint8)), "red").detections) == 1


# --- replay ----------------------------------------------------------------------------------------------------------


def test_boxes_and_points_of_a_replay_are_detections_unless_a_calibration_is_given(replay_file):
    model = DetectorModel(0.8, 0.3)
    for stamp, count in ((1.0, 1), (2.0, 1), (4.0, 0)):
        plain = ReplayPerception(replay_file)(None, "the chair", stamp=stamp)
        assert len(plain.detections) == count
        assert plain.detections.model == DetectorModel()
        told = ReplayPerception(replay_file, detector=model)(None, "the chair", stamp=stamp)
        assert told.detections.model == model
        own = Calibration(temperature=2.0)
        mapped = ReplayPerception(replay_file, own)(None, "the chair", stamp=stamp)
        assert mapped.detections is None
        assert mapped.calibration == own
    assert ReplayPerception(replay_file)(None, "chair", stamp=3.0).detections is None


def test_a_point_is_spread_as_its_line_says_or_as_the_detector_does():
    points = [{"azimuth_deg": 0, "elevation_deg": 0, "spread_deg": 12}, {"azimuth_deg": 90, "elevation_deg": 0}]
    record = parse_record(json.dumps({"stamp": 1, "points": points}))

    def spreads(model):
        axes = record.evidence("x", detector=model).detections.axes
        return np.degrees(1 / np.linalg.norm(axes, axis=-1))[:, 0]

    assert spreads(None) == pytest.approx([12, 5])
    assert spreads(DetectorModel(spread=math.radians(3))) == pytest.approx([12, 3])


def test_records_are_sorted_and_the_nearest_answers(replay_file):
    replay = ReplayPerception(replay_file, tolerance=0.3)
    assert [r.stamp for r in replay.records] == [1, 2, 3, 4]
    assert [r.kind for r in replay.records] == ["boxes", "points", "response", "boxes"]
    evidence = replay(None, "the chair", stamp=1.2)
    assert evidence.stamp == 1.0  # when the picture was taken, not when we asked
    assert np.degrees(azimuth_elevation(strongest(evidence))) == pytest.approx((82.3, 9.1), abs=1.5)
    assert np.degrees(azimuth_elevation(strongest(replay(None, "chair", stamp=2)))) == pytest.approx((90, 10), abs=1.5)
    assert np.asarray(replay(None, "Chair", stamp=3).response) == pytest.approx(np.eye(4, 8) / 2, abs=1e-6)
    assert np.asarray(replay(None, "chair", stamp=4).response).max() == pytest.approx(0, abs=1e-6)


def test_no_record_near_enough_names_the_nearest(replay_file):
    replay = ReplayPerception(replay_file)
    with pytest.raises(TimeError, match=r"nearest is at 3\.000000 \(-0\.400000 s\)"):
        replay(None, "chair", stamp=3.4)
    with pytest.raises(TimeError, match=r"nearest is at 2\.000000"):
        replay(None, "sofa", stamp=3.0)  # the record at 3 is about chairs
    for stamp in (None, math.nan, math.inf):
        with pytest.raises(TimeError, match="stamp"):
            replay(None, "chair", stamp=stamp)


def test_a_query_that_the_file_is_not_about(tmp_path):
    path = tmp_path / "one.jsonl"
    path.write_text('{"stamp": 0, "query": "the red chair", "boxes": [], "image": {"width": 4, "height": 2}}\n')
    with pytest.raises(QueryError, match="the red chair"):
        ReplayPerception(path)(None, "the sofa", stamp=0)
    with pytest.raises(QueryError, match="wanted words"):
        ReplayPerception(path)(None, None, stamp=0)
    assert ReplayPerception(path)(None, "The  red chair", stamp=0).stamp == 0


@pytest.mark.parametrize("kind", ["boxes", "points", "response"])
def test_a_perspective_image_points_where_it_says_and_is_silent_elsewhere(kind):
    image = {"projection": "perspective", "width": 640, "height": 480, "hfov_deg": 60}
    image |= {"yaw_left_deg": 70, "pitch_up_deg": 20}
    entry = {"stamp": 0, "image": image}
    if kind == "boxes":
        entry["boxes"] = [{"box": [300, 220, 340, 260]}]
    elif kind == "points":
        entry["points"] = [{"azimuth_deg": 70, "elevation_deg": 20}]
    else:
        entry["response"] = {"rows": 3, "cols": 5, "values": [0] * 7 + [1] + [0] * 7}
    evidence = parse_record(json.dumps(entry)).evidence("x")
    assert isinstance(evidence.grid, PerspectiveGrid)
    assert np.degrees(azimuth_elevation(strongest(evidence))) == pytest.approx((70, 20), abs=1.5)
    assert np.isfinite(np.asarray(evidence.coefficients(7))).all()


def test_views_of_one_moment_are_told_apart(tmp_path):
    path = tmp_path / "views.jsonl"
    with path.open("w") as file:
        for yaw in (0, 90, 180, 270):
            image = {"projection": "perspective", "width": 8, "height": 8, "hfov_deg": 90, "yaw_left_deg": yaw}
            write_record(file, 5.0, image=image, boxes=[])
    replay = ReplayPerception(path)
    assert len(replay.near("x", 5.01)) == 4
    with pytest.raises(FormatError, match=r"4 records.*looks\(query, stamp\)"):
        replay(None, "x", stamp=5.0)
    for index, later in enumerate((0.0, 1e-9, 2e-9, -1e-9)):  # clocks are not exact
        path.write_text("" if index == 0 else path.read_text())
        with path.open("a") as file:
            write_record(file, 5.0 + later, points=[])
    assert len(ReplayPerception(path).near("x", 5.01)) == 4
    with path.open("a") as file:
        write_record(file, 5.01, points=[])
    assert len(ReplayPerception(path).near("x", 5.01)) == 1


def line(**changes) -> str:
    """A good line with some keys changed."""
    return json.dumps({"stamp": 1.0, "image": PANORAMA, "boxes": [{"box": [1, 2, 30, 40], "score": 0.5}]} | changes)


BAD_LINES = [
    ("[1, 2]", "the line is .*wanted one JSON object"),
    ("{", "is not JSON"),
    ("{'stamp': 1}", "is not JSON"),
    ("[" * 5000, "is not JSON"),
    ('{"stamp": NaN, "boxes": []}', "NaN is not a JSON number"),
    ('{"stamp": 1e999, "boxes": []}', "stamp is inf; wanted `float` <= 1e"),
    (line(stamp=None), "stamp is missing"),
    (line(stamp="12:00"), "stamp is '12:00'; wanted `float`"),
    (line(stamp=True), "stamp is True"),
    (line(query=""), "query is ''; wanted words"),
    (line(query=5), "query is 5; wanted `str"),
    (line(points=[]), "has boxes and points of"),
    ('{"stamp": 1}', "has none of boxes, points, response, views; wanted exactly one"),
    (line(image="a.png"), "image is 'a.png'"),
    (line(image={}), "height is missing; wanted a whole number"),
    (line(image={"width": 0, "height": 4}), "image.width is 0; wanted `int` >= 1"),
    (line(image={"width": 10.5, "height": 4}), "image.width is 10.5; wanted `int"),
    (line(image=PANORAMA | {"projection": "cubemap"}), "projection is 'cubemap'"),
    (line(image=PANORAMA | {"projection": "perspective"}), "hfov_deg is missing"),
    (line(image=PANORAMA | {"projection": "perspective", "hfov_deg": 180}), "hfov_deg is 180"),
    (line(boxes={}), r"boxes is \{\}; wanted `array"),
    (line(boxes=[[1, 2, 3, 4]]), r"boxes\[0\] is .*; wanted `object`"),
    (line(boxes=[{"score": 1}]), r"box is missing in boxes\[0\]"),
    (line(boxes=[{"box": [1, 2, 3]}]), r"box is \[1, 2, 3\]"),
    (line(boxes=[{"box": [1, 2, 3, "4"]}]), r"box\[3\] is '4'"),
    (line(boxes=[{"box": [1, 40, 30, 2]}]), "box is"),
    (line(boxes=[{"box": [1, 600, 30, 700]}]), "1024 x 512 image"),
    (line(boxes=[{"box": [0, 2, 2000, 40]}]), "1024 x 512 image"),
    (line(boxes=[{"box": [1, 2, 30, 40], "score": 1.5}]), "score is 1.5; wanted a number from 0 to 1"),
    (line(boxes=[{"box": [1, 2, 30, 40], "score": -0.1}]), "score is -0.1"),
    (line(boxes=[{"box": [1, 2, 30, 40], "label": 3}]), "label is"),
    (line(boxes=None, points=[{"azimuth_deg": 3}]), "elevation_deg is missing"),
    (line(boxes=None, points=[{"azimuth_deg": 3, "elevation_deg": 95}]), "elevation_deg is 95"),
    (line(boxes=None, points=[{"azimuth_deg": 3, "elevation_deg": 5, "spread_deg": 0}]), "spread_deg is 0"),
    (line(boxes=None, response=[0, 1]), "response is"),
    (line(boxes=None, response={"rows": 2, "cols": 2, "values": [0, 1, 1]}), "values is '3 values'; wanted .* = 4"),
    (
        line(boxes=None, response={"rows": 1, "cols": 2, "values": [0, 2]}),
        r"values is \[2\.0\]; wanted numbers in \[0, 1\]",
    ),
    (line(boxes=None, response={"rows": 10**9, "cols": 1, "values": []}), "rows is 1000000000"),
    (line(image={"width": 1, "height": 99, "projection": "perspective", "hfov_deg": 9}), "sides up to"),
]


@pytest.mark.parametrize(("bad", "says"), BAD_LINES)
def test_a_bad_line_is_named_with_its_number(tmp_path, bad, says):
    path = tmp_path / "looks.jsonl"
    path.write_text(line() + "\n\n" + bad + "\n" + line() + "\n")
    with pytest.raises(FormatError, match=rf"looks\.jsonl, line 3: .*{says}"):
        ReplayPerception(path)


def test_a_torn_last_line_is_told_apart(tmp_path):
    path = tmp_path / "looks.jsonl"
    path.write_text(line() + "\n" + line()[:-20])
    with pytest.raises(FormatError, match=r"line 2: is not JSON.*writer was probably interrupted"):
        read_looks(path)[1]
    path.write_text(line() + "\n" + line())  # a last line without its newline is whole
    assert len(read_looks(path)[1]) == 2


def test_a_missing_file_and_a_bad_tolerance(tmp_path, replay_file):
    for path in (tmp_path / "no.jsonl", tmp_path, "a\0b"):
        with pytest.raises(FormatError, match="cannot be read"):
            read_looks(path)[1]
    for tolerance in (-1.0, math.nan, "1", None, True):
        with pytest.raises(TimeError, match="tolerance"):
            ReplayPerception(replay_file, tolerance=tolerance)
    for stamp in (None, math.nan, "1"):
        with pytest.raises(TimeError, match="replay needs the time of capture"):
            ReplayPerception(replay_file).near("chair", stamp)


def test_windows_line_ends_and_a_byte_order_mark_are_fine(tmp_path):
    path = tmp_path / "looks.jsonl"
    path.write_bytes(b"\xef\xbb\xbf" + (line() + "\r\n" + line(stamp=2) + "\r\n").encode())
    assert [r.stamp for r in read_looks(path)[1]] == [1, 2]


def test_writing_checks_first():
    file = io.StringIO()
    for wrong in (
        {},
        {"boxes": [{"box": [0, 0, 1, 1]}]},
        {"response": np.full((2, 4), 2.0)},
        {"response": np.zeros(4)},
    ):
        with pytest.raises(FormatError):
            write_record(file, 1.0, **wrong)
    with pytest.raises(FormatError):
        write_record(file, math.nan, points=[])
    with pytest.raises(FormatError, match="cannot be written"):
        write_record(file, 1.0, points=[{"azimuth_deg": object()}])
    assert file.getvalue() == ""
    write_record(file, np.float64(1), query="chair", points=[{"azimuth_deg": np.float32(10), "elevation_deg": 0}])
    assert parse_record(file.getvalue()).values == pytest.approx(np.radians([[10, 0, np.nan]]), nan_ok=True)


def test_a_box_around_everything_names_no_direction():
    with pytest.raises(ResponseError, match="whole sphere"):
        parse_record(line(boxes=[{"box": [0, 0, 1024, 512]}])).evidence("x")


# --- truth -----------------------------------------------------------------------------------------------------------


@pytest.fixture
def labelled_ids():
    """The ids of a wall with three things in front of it, one across the seam, and their labels."""
    ids = np.zeros((72, 144), dtype=np.int32)
    ids[30:40, 20:28], ids[34:44, 80:100], ids[40:46, -6:], ids[40:46, :6] = 1, 2, 3, 3
    labels = [Query("wall"), Query("chair", "red"), Query("sofa", "red"), Query("chair", "blue")]
    return ids, labels


@pytest.mark.parametrize("query", ["the blue chair", "red couch"])
@pytest.mark.parametrize("noise", ["", "ideal", "false_alarm=1,confuse_category=1,persistence=0.9"])
def test_an_episode_of_truth_keeps_the_contract(labelled_ids, noise, query):
    ids, labels = labelled_ids
    episode = TruthPerception(noise).episode(labels, seed=4)
    assert isinstance(episode, Perception)
    check_perception(episode, ids, query, roll=4 * 11 if noise == "ideal" else None)


def test_truth_is_not_told_by_an_image():
    truth = TruthPerception()
    assert isinstance(truth, Perception)
    for image in (painted_room(32, 64), np.zeros((32, 64), dtype=np.int32)):
        with pytest.raises(ImageError, match=r"only a simulator has: use it with `eagor bench run`"):
            truth(image, "red chair")

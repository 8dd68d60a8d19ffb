"""Models at the command line: locate, bench and calibrate heads with tiny models, and what goes wrong."""

import json
import math
import socket
import sys

import numpy as np
import pytest
import transformers
import vlm_models
from commands import answer, eagor, refused
from contract_server import ContractServer, Reply, reddish
from PIL import Image

from eagor.belief import Belief
from eagor.errors import FormatError
from eagor.grids import ErpGrid, PerspectiveGrid
from eagor.harmonics import RealHarmonics
from eagor.perception import is_model, load, short_name
from eagor.perception import transformers as local
from eagor.perception.calibrated import Labelled, cap_radius, read_labelled
from eagor.perception.partial import infer_view
from eagor.perception.transformers import TransformersPerception
from eagor.perception.transformers.language import LanguageModel
from eagor.sources.panorama import cut, read_panorama
from eagor.sphere import angular_distance, direction, world_R_body

QWEN = "qwen2_5_vl"
SMALL = "pixels=25088&seam=false"  # 112 x 224 pixels, 32 tokens
EXAMPLES = [
    Labelled(vlm_models.marked(*place, seed=index), "red thing", np.asarray(direction(*place)), 0.3)
    for index, place in enumerate([(0.5, 0.2), (-1.2, -0.3), (2.5, 0.1), (-2.8, 0.4), (1.5, 0.0), (-0.4, -0.1)])
]


pytestmark = pytest.mark.usefixtures("one_thread")
# Of each family by itself: tests/contracts/test_transformers.py.
families = pytest.mark.parametrize(
    "family",
    [
        one if one in ("qwen2_5_vl", "gemma3") else pytest.param(one, marks=pytest.mark.slow)
        for one in vlm_models.LANGUAGE
    ],
)


@pytest.fixture(scope="module")
def planted(tmp_path_factory):
    """The folder of a family's tiny model with a head that looks at red things, and the file of that head, beside."""
    made = {}

    def folder(family):
        if family not in made:
            transformers.utils.logging.disable_progress_bar()
            place = vlm_models.make(family, tmp_path_factory.mktemp("models") / f"tiny-{family}")
            pixels = vlm_models.PIXELS.get(family)
            language = vlm_models.language_model(place, presence=False, pixels=pixels)
            vlm_models.plant(language)
            language.model.save_pretrained(place)
            found = TransformersPerception(language, "attention", "attention").find_heads(EXAMPLES, 1)
            assert found.heads == (vlm_models.HEAD,)
            found.write(place / "heads.json")
            made[family] = place
        return made[family]

    return folder


@pytest.fixture(scope="module")
def panorama(tmp_path_factory):
    """A panorama with one red thing, 60 degrees to the left and 10 up."""
    file = tmp_path_factory.mktemp("panorama") / "room.png"
    Image.fromarray(vlm_models.marked(math.radians(60), math.radians(10), seed=3)).save(file)
    return file


def off(found):
    """Radians between an answer and the red thing of the panorama."""
    there = direction(math.radians(found["azimuth_deg"]), math.radians(found["elevation_deg"]))
    return float(angular_distance(there, direction(math.radians(60), math.radians(10))))


# --- locate ----------------------------------------------------------------------------------------------------------


@families
def test_locate_points_at_what_the_planted_head_looks_at(planted, panorama, family):
    folder = planted(family)
    spec = f"{folder}?extractor=attention&presence=false&heads={folder / 'heads.json'}"
    spec += f"&pixels={vlm_models.PIXELS[family]}" if family in vlm_models.PIXELS else ""
    found = answer("locate", panorama, "red thing", "--perception", spec)
    rows, cols = load(spec).loaded.plan(2.0).shape
    assert found["source"]["family"] == family
    assert found["source"]["model"] == str(folder)
    assert off(found) < 1.1 * math.hypot(math.pi / rows, 2 * math.pi / cols) / 2


def test_locate_asks_a_server(panorama):
    with ContractServer(reddish, ("qwen2.5-vl-7b",)) as server:
        spec = f"endpoint:qwen2.5-vl-7b@{server.url}?pixels=56448"
        assert off(answer("locate", panorama, "red thing", "--perception", spec)) < math.radians(3)


# --- one ordinary picture --------------------------------------------------------------------------------------------


def seen_in_a_view(perception, place):
    """Where a view of 54 x 96 pixels towards azimuth 0 has its best direction, with a red thing at `place`."""
    grid = PerspectiveGrid(54, 96, math.radians(100), world_R_body(0.0, -0.1))
    image = cut(vlm_models.marked(*place, radius=0.2, rows=256, seed=5), grid)[0]
    evidence = infer_view(perception, image, grid, "red thing", stamp=2.0)
    return evidence, Belief.uniform(15).update(evidence).mode()


@families
def test_a_model_looks_at_an_ordinary_picture(planted, family):
    folder = planted(family)
    pixels = {"pixels": vlm_models.PIXELS[family]} if family in vlm_models.PIXELS else {}
    perception = TransformersPerception(
        str(folder), extractor="attention", presence=False, heads=str(folder / "heads.json"), **pixels
    )
    for place in ((0.45, 0.2), (-0.5, 0.0)):
        evidence, mode = seen_in_a_view(perception, place)
        grid = evidence.grid
        assert isinstance(grid, PerspectiveGrid)
        assert evidence.stamp == 2.0
        assert evidence.source["family"] == family
        assert angular_distance(mode, direction(*place)) < 1.2 * grid.hfov / grid.width, (place, grid.shape)
        # What the camera did not show was not looked at.
        behind = evidence.coefficients(15) @ RealHarmonics(15).evaluate(direction(math.pi, 0.0))
        assert abs(behind) < 0.1


# --- runs ------------------------------------------------------------------------------------------------------------


def records(folder):
    files = sorted(folder.glob("**/*.jsonl"))
    return [json.loads(line) for file in files for line in file.read_text().splitlines() if line]


def test_a_run_with_a_model(planted, tmp_path, monkeypatch):
    loads, really = [], local.load_model
    monkeypatch.setattr(
        local, "load_model", lambda name, *more, **rest: loads.append(name) or really(name, *more, **rest)
    )
    folder = planted(QWEN)
    spec = f"{folder}?{SMALL}&heads={folder / 'heads.json'}"
    words = ("bench", "run", "navigation", "--perception", spec, "--seed", "3", "--set", "max_steps=3")
    words += ("--out", tmp_path / "run", "--episodes", "1", "--methods", "plain", "eagor")
    assert set(answer(*words)["methods"]) == {"plain", "eagor"}
    assert loads == [str(folder)]  # once, for all episodes
    assert json.loads((tmp_path / "run" / "run.json").read_text())["rows"] == 112
    found = [r for r in records(tmp_path / "run") if r.get("status") == "ok"]
    looked = [r["looked"] for r in found if "looked" in r]
    looked += [m["looked"] for r in found for m in r["methods"].values() if "looked" in m]
    assert looked
    for account in looked:
        assert (account["unread"], account["source"]["model"]) == (0, str(folder))
        assert account["looks"] > 0
        assert account["milliseconds"] > 0
        assert account["source"]["revision"].startswith("folder:")
    answer("bench", "report", tmp_path / "run")
    page = (tmp_path / "run" / "report.html").read_text()
    assert str(folder) in page
    assert "ms each on average" in page


def test_a_run_with_a_server_survives_an_answer_that_cannot_be_read(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    asked = []

    def mumbling(request):
        """Every ninth look says nothing of use, the second try included."""
        asked.append(request)
        return Reply("the weather is fine") if len(asked) % 9 in (4, 5) else reddish(request)

    with ContractServer(mumbling, ("qwen2.5-vl-7b",)) as server:
        spec = f"endpoint:qwen2.5-vl-7b@{server.url}?{SMALL}"
        words = ("bench", "run", "tracking", "--perception", spec, "--seed", "3", "--set", "steps=12")
        found = answer(*words, "--episodes", "1", "--methods", "plain", "eagor")
    where = tmp_path / "runs" / "tracking-endpoint-qwen2.5-vl-7b-3"
    assert found["out"] == str(where.relative_to(tmp_path))
    (record,) = (r for r in records(where) if r.get("status") == "ok")
    assert record["looked"]["unread"] >= 1
    assert 12 <= record["looked"]["looks"] <= 13
    assert record["looked"]["source"]["served_as"] == "qwen2.5-vl-7b"


def test_a_run_of_nothing_but_unreadable_answers_fails(tmp_path):
    with ContractServer(lambda request: "the weather is fine", ("qwen2.5-vl-7b",)) as server:
        spec = f"endpoint:qwen2.5-vl-7b@{server.url}?{SMALL}"
        words = ("bench", "run", "tracking", "--perception", spec, "--seed", "3", "--set", "steps=4")
        done = eagor(*words, "--episodes", "1", "--methods", "plain", "--out", tmp_path / "run")
    assert done.returncode == 1
    assert "answers could not be read; the last: " in done.stderr
    assert "no episode could be run" in done.stderr.splitlines()[-1]


def test_the_plain_model_is_compared_where_a_model_looks(monkeypatch):
    from eagor.lab.agents.methods import NAMES, default_methods

    assert default_methods("scout") == NAMES
    assert default_methods("Qwen/Qwen2.5-VL-7B-Instruct") == ("plain", *NAMES)
    assert default_methods("endpoint:qwen2.5vl:7b") == ("plain", *NAMES)


@pytest.mark.parametrize(
    ("spec", "name", "model"),
    [
        ("scout", "scout", False),
        ("truth:miss=0.5", "truth", False),
        ("replay:some/file.jsonl", "replay", False),
        ("onnx:some/yolo11n.onnx?size=640", "onnx-yolo11n", False),
        ("Qwen/Qwen2.5-VL-7B-Instruct", "Qwen2.5-VL-7B-Instruct", True),
        ("Qwen/Qwen2.5-VL-7B-Instruct?extractor=boxes&pixels=401408", "Qwen2.5-VL-7B-Instruct", True),
        ("/models/tiny?heads=a/b.json", "tiny", True),
        ("endpoint", "endpoint", True),
        ("endpoint:http://localhost:8000/v1", "endpoint", True),
        ("endpoint:qwen2.5vl:7b", "endpoint-qwen2.5vl-7b", True),
        ("endpoint:Qwen/Qwen3-VL-8B@http://h:1/v1?timeout=9", "endpoint-Qwen3-VL-8B", True),
    ],
)
def test_names_of_runs_and_files(spec, name, model):
    assert (short_name(spec), is_model(spec)) == (name, model)


# --- what goes wrong -------------------------------------------------------------------------------------------------


def test_servers_that_are_not_there(panorama, tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    spec = f"endpoint:qwen2.5-vl@http://{address}/v1?retries=0&backoff=0&timeout=5"
    words = ("bench", "run", "tracking", "--episodes", "1", "--out", tmp_path / "run")
    for command in (("locate", panorama, "red thing"), words):
        assert "no server answers at" in refused(*command, "--perception", spec, code=1)
    assert not (tmp_path / "run").exists(), "it is said before anything is rendered or recorded"


def test_a_model_that_the_server_lacks(panorama, tmp_path):
    with ContractServer(reddish, ("llava",)) as server:
        server.lasting = "404 model"
        spec = f"endpoint:qwen@{server.url}?retries=0"
        words = ("bench", "run", "tracking", "--episodes", "1", "--out", tmp_path / "run", "--perception", spec)
        for line in (refused(*words), refused("locate", panorama, "red thing", "--perception", spec)):
            assert "has no model 'qwen'" in line
            assert "it has 'llava'" in line


# --- localisation heads ----------------------------------------------------------------------------------------------


def labels(folder, count=12):
    """Panoramas with a red thing each, and the file that says where."""
    lines = []
    for index in range(count):
        azimuth, elevation = math.radians(40 * index - 200), math.radians(12 * (index % 3) - 12)
        Image.fromarray(vlm_models.marked(azimuth, elevation, seed=index)).save(folder / f"{index}.png")
        place = {"azimuth_deg": math.degrees(azimuth), "elevation_deg": math.degrees(elevation), "radius_deg": 17}
        lines.append(json.dumps({"image": f"{index}.png", "query": "red thing", **place}))
    (folder / "labels.jsonl").write_text("\n".join(lines))
    return folder / "labels.jsonl"


@pytest.mark.parametrize(("how", "pixels", "limit"), [("attention", 168 * 336, 23), ("views", 224 * 224, 12)])
def test_heads_are_found_in_pictures_of_ones_own(planted, panorama, tmp_path, how, pixels, limit):
    folder, out = planted(QWEN), tmp_path / "heads.json"
    spec = f"{folder}?extractor={how}&presence=false&pixels={pixels}"
    words = ("calibrate", "heads", "--perception", spec, "--labels", labels(tmp_path), "--take", "1", "--out", out)
    found = answer(*words)
    assert found["heads"] == [list(vlm_models.HEAD)]
    assert (found["found_by"]["panoramas"], found["found_by"]["held_out"]["panoramas"]) == (8, 4)
    assert found["found_by"]["held_out"]["median_error_deg"] < limit
    located = answer("locate", panorama, "red thing", "--perception", f"{spec}&heads={out}")
    assert math.degrees(off(located)) < limit


def test_heads_are_found_in_apartments(planted, tmp_path, monkeypatch):
    """With a model that looks at the thing asked for, wherever it is."""
    really = LanguageModel.observe

    def knowing(self, example, view=None):
        look = really(self, example, view)
        layer, head = vlm_models.HEAD
        look.maps[layer][head] = np.where(look.near, 1.0, 1e-3) / look.near.sum()
        return look

    monkeypatch.setattr(LanguageModel, "observe", knowing)
    monkeypatch.chdir(tmp_path)
    words = ("calibrate", "heads", "--perception", f"{planted(QWEN)}?{SMALL}", "--episodes", "3", "--seed", "5")
    done = eagor(*words)
    assert done.returncode == 0, done.stderr
    file = tmp_path / "heads-tiny-qwen2_5_vl.json"
    assert json.loads(file.read_text())["heads"][0] == list(vlm_models.HEAD)
    assert f"?heads={file.name}&{SMALL}" in done.stdout


def test_a_model_that_looks_at_nothing_has_no_heads(planted, tmp_path, monkeypatch):
    really = LanguageModel.observe

    def blind(self, example, view=None):
        look = really(self, example, view)
        for heads in look.maps.values():
            heads[:, look.near] = 0
        return look

    monkeypatch.setattr(LanguageModel, "observe", blind)
    words = ("calibrate", "heads", "--perception", planted(QWEN), "--labels", labels(tmp_path, 3))
    assert "looks at the labelled targets more than elsewhere" in refused(*words, code=1)


def test_heads_of_what_has_none_are_refused(planted, tmp_path):
    for spec in ("scout", "endpoint:qwen"):
        assert "no attention heads" in refused("calibrate", "heads", "--perception", spec)
    words = ("calibrate", "heads", "--perception", f"{planted(QWEN)}?{SMALL}")
    assert "results" in refused(*words, "--seed", "2000")
    assert "--take 0" in refused(*words, "--take", "0")
    assert "cannot be read" in refused(*words, "--labels", tmp_path / "none.jsonl")
    assert "calibrate heads" in refused("calibrate", "--labels", tmp_path / "none.jsonl")
    localiser = vlm_models.make("owlv2", tmp_path / "owl")
    assert "no attention heads" in refused("calibrate", "heads", "--perception", localiser, "--episodes", "1")
    heads = planted(QWEN) / "heads.json"
    spec = f"{planted(QWEN)}?extractor=boxes&heads={heads}"
    assert "which reads boxes" in refused("locate", "x.png", "red", "--perception", spec)


def test_labels_of_apartments_point_at_the_thing(monkeypatch):
    """The instance that is seen in the direction of a label is the one that the query names."""
    from eagor.lab.envs.places import Place
    from eagor.lab.eval import labelled_looks

    frames = []
    really = Place.ids

    def ids(self, position, turned, rows=64):
        frames.append((self, really(self, position, turned, rows)))
        return frames[-1][1]

    monkeypatch.setattr(Place, "ids", ids)
    hits = []
    for example in labelled_looks.apartment_labels(4, 11, 32):
        place, seen = frames[-1]
        (target,) = (thing for thing, query in place.nameable().items() if str(query) == example.query)
        grid = ErpGrid(*seen.shape)
        near = angular_distance(grid.directions, example.direction) < example.radius
        share = float((grid.weights * (seen == target))[near].sum() / (grid.weights * (seen == target)).sum())
        hits.append(share)
    assert hits
    assert min(hits) > 0.15
    assert np.mean(hits) > 0.5


def test_labels_from_a_file(tmp_path):
    image = np.zeros((64, 128, 3), dtype=np.uint8)
    Image.fromarray(image).save(tmp_path / "a.png")
    file = tmp_path / "labels.jsonl"
    place = {"azimuth_deg": 90, "elevation_deg": 0, "radius_deg": 5}
    lines = [
        {"image": "a.png", "query": "sofa", **place},
        {"image": "a.png", "query": "sofa", "box": [24, 28, 40, 36]},
        {"image": "a.png", "query": "sofa", "box": [124, 28, 4, 36]},
    ]
    file.write_text("\n\n".join(json.dumps(line) for line in lines))
    first, box, seam = read_labelled(file, read_panorama)
    assert isinstance(first, Labelled)
    assert first.panorama.shape == (64, 128, 3)
    for found, azimuth in ((first, 90), (box, 90), (seam, 180)):
        assert angular_distance(found.direction, direction(math.radians(azimuth), 0.0)) < 1e-3
    area = 2 * math.pi * 16 / 128 * 2 * math.sin(math.pi * 4 / 64)
    assert box.radius == pytest.approx(cap_radius(area))
    assert box.radius == pytest.approx(math.sqrt(2) * seam.radius, rel=0.02)


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("{", "line 1: is not JSON"),
        ("[1]", "the line is .*wanted one JSON object"),
        ('{"image": "a.png"}', "query is missing in the line"),
        ('{"image": "a.png", "query": " "}', "wanted words"),
        ('{"image": "a.png", "query": "sofa"}', "azimuth_deg is missing"),
        ('{"image": "a.png", "query": "sofa", "box": [1, 2, 3]}', "box is .*; wanted `array` of length 4"),
        (
            '{"image": "a.png", "query": "s", "azimuth_deg": 0, "elevation_deg": 99, "radius_deg": 5}',
            "elevation_deg is 99; wanted `float` <= 90.0",
        ),
        (
            '{"image": "a.png", "query": "s", "azimuth_deg": 0, "elevation_deg": 9, "radius_deg": 0}',
            "radius_deg is 0; wanted `float` > 0.0",
        ),
        ("", "holds no labels"),
    ],
)
def test_labels_that_are_none(tmp_path, line, says):
    file = tmp_path / "labels.jsonl"
    file.write_text(line)
    with pytest.raises(FormatError, match=says):
        next(read_labelled(file, read_panorama))


def test_an_old_transformers_is_named(planted, panorama, monkeypatch):
    folder = planted(QWEN)
    monkeypatch.setattr(sys.modules["transformers"], "__version__", "5.23.0")  # which is not always what was imported
    assert "transformers 5.24 or newer" in refused("locate", panorama, "red", "--perception", folder)

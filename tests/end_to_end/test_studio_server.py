"""The studio's server from outside, without a browser: views, uploads, runs, export, and who is refused."""

import hashlib
import io
import json
import math
import os
import signal
import socket
import time
from pathlib import Path

import httpx
import numpy as np
import pytest
from PIL import Image
from processes import wait_for
from studio_serving import ancestors, children, studio
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from eagor import studio as studio_server
from eagor.cli import main
from eagor.lab.worlds.painted import painted_room

pytestmark = pytest.mark.xdist_group("real time")

SAMPLE = {
    "time": 0.0, "status": "tracking", "presence": 0.9, "azimuth": 0.5, "cone": 0.1, "distance": 2.0,
    "doing": "walking", "words": "on its way", "wanted": [0.3, 0, 0], "sent": None, "stops": 0, "mode": "armed",
    "reasons": [], "speed": 0.3, "turn": 0.0, "xy": [1.0, 2.0], "yaw": 0.25, "true_xy": None, "error": 0.1,
}  # fmt: skip


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """A folder with a run of one short episode, a robot's report, and a run that was only begun."""
    root = tmp_path_factory.mktemp("runs")
    common = ["--perception", "truth", "--episodes", "1", "--seed", "602", "--set", "max_steps=8"]
    assert main(["bench", "run", "navigation", *common, "--methods", "eagor", "vmf", "--out", str(root / "nav")]) == 0
    (root / "walk").mkdir()
    samples = [SAMPLE | {"time": 0.1 * number} for number in range(300)]
    (root / "walk" / "run.json").write_text(json.dumps({"query": "chair", "ended": "arrived", "samples": samples}))
    (root / "begun").mkdir()
    (root / "begun" / "run.json").write_text(json.dumps({"task": "navigation"}))
    return root


@pytest.fixture(scope="module")
def served(runs):
    with studio("--runs", runs) as found:
        yield found.ready()


@pytest.fixture
def room():
    buffer = io.BytesIO()
    Image.fromarray(painted_room(128, 256)).save(buffer, "PNG")
    return buffer.getvalue()


def refused(answer, status):
    assert answer.status_code == status
    said = answer.json()
    assert said["problem"]
    assert said["change"]
    return said["problem"]


# --- the walk ---


def test_a_walk_shows_a_scene_a_picture_and_a_belief_and_the_person_steers(served):
    with served.page() as page:
        page.say(type="open", view="walk", query="sofa", perception="truth", drive="person", seed=2)
        scene = page.until("scene")
        assert scene["query"] == "sofa"
        assert scene["plan"]["walls"]
        assert any(thing["target"] for thing in scene["plan"]["things"])
        assert scene["calibration"]["words"]
        first = page.until("step")
        assert first["estimate"]["direction"] is None  # nothing has been looked at
        shown = page.until(lambda header: "panorama" in page.blobs)
        assert shown["panorama"]["world_R_camera"] == pytest.approx(first["world_R_camera"])
        picture = Image.open(io.BytesIO(page.blobs["panorama"]))
        assert picture.size[0] == 2 * picture.size[1]
        told = page.until(lambda header: "belief" in page.blobs and header["estimate"]["direction"] is not None)
        sizes = [(term["degree"] + 1) ** 2 for term in told["belief"]["terms"]]
        assert len(page.blobs["belief"]) == 4 * sum(sizes)
        assert np.isfinite(np.frombuffer(page.blobs["belief"], "<f4")).all()
        page.say(type="drive", by="person", turn=1.0, seconds=0.4)
        start = np.array(told["world_R_camera"]).reshape(3, 3)
        turned = page.until(lambda header: np.array(header["world_R_camera"])[0] < start[0, 0] - 0.05 or
                            np.array(header["world_R_camera"])[0] > start[0, 0] + 0.05)  # fmt: skip
        left = start.T @ np.array(turned["world_R_camera"]).reshape(3, 3)[:, 0]
        assert left[1] > 0  # a positive turn is to the left
        assert turned["position"][:2] == pytest.approx(told["position"][:2])
        page.say(type="drive", by="person", forward=-0.5, seconds=0.5)  # ahead is a wall
        page.until(lambda header: math.dist(header["position"][:2], told["position"][:2]) > 0.1)
        page.say(type="methods", names=["vmf", "nonsense"])
        answered = page.until(lambda header: header["rivals"])
        assert list(answered["rivals"]) == ["vmf"]
        page.say(type="query", text="bed", question=7)
        scene = page.until(lambda header: header["type"] == "scene" or header["question"] != 0)
        assert (scene["type"], scene["query"], scene["question"]) == ("scene", "bed", 7)
        step = page.until("step")
        assert step["question"] == 7
        assert step["estimate"]["direction"] is not None  # the first look for it has been taken
        page.say(type="degree", L=7)
        assert page.until("scene")["degree"] == 7
        belief = page.until(lambda header: "belief" in header)["belief"]
        assert max(term["degree"] for term in belief["terms"]) == 7


@pytest.mark.slow
def test_the_policy_walks_towards_the_thing(served):
    with served.page() as page:
        page.say(type="open", view="walk", perception="truth")
        first = page.until(lambda header: header["type"] == "step" and header["goal"]["metres"] is not None)
        closer = page.until(
            lambda header: header["type"] == "step" and header["goal"]["metres"] < first["goal"]["metres"] - 0.3
        )
        assert closer["error_deg"] is not None
        numbers = [page.until("step")["number"] for _ in range(5)]
        assert numbers == sorted({*numbers})
        page.say(type="pause", on=True)


def test_what_nobody_knows_is_said_in_words_and_changes_nothing(served):
    with served.page() as page:
        page.say(type="open", view="walk", query="unicorn", perception="scout", question=1)
        page.until("scene")
        said = next(header for header in iter(page.hear, None) if header["type"] == "problem")
        assert "unicorn" in said["problem"]
        assert (said["fatal"], said["question"]) == (False, 1)
        page.say(type="query", text="bed", question=2)
        page.until(lambda header: header["type"] == "step" and header["look"]["fresh"])
        page.say(type="query", text="unicorn", question=3)
        said = next(header for header in iter(page.hear, None) if header["type"] != "step" or header["question"] != 2)
        assert (said["type"], said["question"]) == ("problem", 3)
        page.until(lambda header: header["question"] == 2 and header["look"]["fresh"])
        page.say(type="query", text="bed", perception="nothing", question=4)
        said = next(header for header in iter(page.hear, None) if header["type"] != "step")
        assert (said["type"], said["question"]) == ("problem", 4)


@pytest.mark.slow
def test_the_first_walk_begins_in_sight_and_leads_behind_a_wall(served):
    with served.page() as page:
        page.say(type="open", view="walk", drive="tour", perception="truth")
        page.until(lambda header: header["type"] == "step" and "is in sight" in header["goal"]["words"])
        hidden = page.until(lambda header: header["type"] == "step" and "A wall has hidden" in header["goal"]["words"])
        assert hidden["drive"] == "tour"
        rows = 0
        while rows < 1024:  # it rests there
            if "panorama" in page.until("step"):
                rows = Image.open(io.BytesIO(page.blobs["panorama"])).height


@pytest.mark.slow
def test_an_eye_that_dies_is_replaced_and_the_view_begins_anew(served):
    with served.page() as page:
        page.say(type="open", view="walk", query="sofa", perception="truth", drive="person")
        page.until(lambda header: header["type"] == "step" and header["look"]["fresh"])
        os.kill(max(children(served.process.pid), key=lambda each: len(ancestors(each))), signal.SIGKILL)
        while (said := page.hear())["type"] != "problem":
            pass
        assert not said["fatal"]
        page.until("scene")
        page.until(lambda header: header["type"] == "step" and header["look"]["fresh"])


# --- pictures ---


def test_a_photograph_is_looked_at_and_the_belief_stays_with_the_world(served, room):
    answer = served.http.post("/api/pictures", content=room, headers={"X-Name": "..%2F..%2Fetc%2Fr%C3%B6om.png"})
    assert answer.status_code == 201
    told = answer.json()
    assert told["name"] == "röom.png"
    assert (told["kind"], told["height"], told["width"]) == ("photo", 128, 256)
    with served.page() as page:
        page.say(type="open", view="picture", id=told["id"], query="red chair", perception="colour")
        page.until("scene")
        step = page.until(lambda header: header["type"] == "step" and header["estimate"]["direction"] is not None)
        where = np.array(step["world_R_camera"]).reshape(3, 3) @ step["estimate"]["direction"]
        page.say(type="camera", yaw=1.2, pitch=0.3, roll=-0.2)
        turned = page.until(lambda header: header.get("attitude", {}).get("yaw") == 1.2 and header["look"]["fresh"])
        pose = np.array(turned["world_R_camera"]).reshape(3, 3)
        assert pose[2, 0] == pytest.approx(math.sin(0.3))  # pitch up
        assert np.array(pose @ turned["estimate"]["direction"]) @ where > math.cos(math.radians(8))


@pytest.mark.parametrize(
    ("content", "status", "says"),
    [
        (b"", 400, "empty"),
        (b"no picture at all", 415, "no picture"),
        (b"\x89PNG\r\n\x1a\n" + bytes(100), 415, "no picture"),
        (b"\x00\x00\x00\x18ftypmp42" + bytes(100), 422, "cannot be used"),
    ],
)
def test_files_that_are_no_pictures_are_refused(served, content, status, says):
    assert says in refused(served.http.post("/api/pictures", content=content, headers={"X-Name": "x.png"}), status)


def test_pictures_of_ordinary_cameras_are_taken_and_too_large_ones_refused(served):
    def post(width, height):
        buffer = io.BytesIO()
        Image.new("RGB", (width, height)).save(buffer, "PNG")
        return served.http.post("/api/pictures", content=buffer.getvalue())

    taken = post(300, 200).json()
    assert taken["ordinary"]
    assert taken["hfov_deg"] is None  # no Exif: the page asks
    assert "million" in refused(post(16000, 8000), 413)
    headers = {"Content-Length": str(1 << 40)}
    with socket.create_connection(("127.0.0.1", httpx.URL(served.address).port), timeout=60) as line:
        host = served.address.removeprefix("http://").rstrip("/")
        lines = ["POST /api/pictures HTTP/1.1", f"Host: {host}", f"Content-Length: {headers['Content-Length']}", "", ""]
        line.sendall("\r\n".join(lines).encode())
        assert b" 413 " in line.recv(4096)  # before anything is sent


def test_a_picture_that_is_not_there_is_said(served):
    with served.page() as page:
        page.say(type="open", view="picture", id="../../etc/passwd", query="chair")
        assert "not here" in page.hear()["problem"]


# --- runs ---


def test_runs_are_listed_with_what_is_wrong(served):
    found = {run["name"]: run for run in served.http.get("/api/runs").json()["runs"]}
    assert {name: run["kind"] for name, run in found.items()} == {"nav": "bench", "walk": "robot", "begun": "bench"}
    assert "no records" in found["begun"]["problem"]
    assert "no records" in refused(served.http.get("/api/runs/begun"), 422)


def played(served, address):
    """The answer once the episode has been played."""
    while (answer := served.http.get(address)).status_code == 202:
        assert answer.json()["progress"] >= 0
        time.sleep(0.1)
    return answer


def test_an_episode_is_played_again_with_the_recorded_figures(served, runs):
    run = served.http.get("/api/runs/nav").json()
    (entry,) = run["episodes"]
    assert {*entry["methods"]} == {"eagor", "vmf"}
    address = f"/api/runs/nav/episodes/{entry['key']}"
    answer = played(served, address)
    assert answer.status_code == 200
    episode = answer.json()
    assert episode["methods"] == ["eagor", "vmf"]
    (record,) = [
        json.loads(line)
        for path in (runs / "nav").glob("records.jsonl")
        for line in path.read_text().splitlines()
        if "eagor" in json.loads(line)["methods"]
    ]
    trace = record["methods"]["eagor"]["trace"]
    assert len(episode["steps"]) == len(trace["error_deg"])
    for step, recorded in zip(episode["steps"], trace["error_deg"], strict=True):
        assert step["error_deg"] == pytest.approx(recorded, abs=0.02)
        assert step["belief"]["coefficients"]
        assert step["methods"]["eagor"]["error_deg"] == recorded
    picture = served.http.get(episode["steps"][0]["panorama"]["url"])
    assert picture.headers["content-type"] == "image/webp"
    assert Image.open(io.BytesIO(picture.content)).size == (1024, 512)
    assert episode["scene"]["paths"]["vmf"]


def test_a_robots_report_is_a_run_of_one_episode(served):
    (entry,) = served.http.get("/api/runs/walk").json()["episodes"]
    episode = played(served, f"/api/runs/walk/episodes/{entry['key']}").json()
    assert 60 < len(episode["steps"]) <= 120
    assert episode["steps"][0]["error_deg"] == pytest.approx(math.degrees(0.1), abs=0.01)
    assert "panorama" not in episode["steps"][0]


@pytest.mark.parametrize(
    "name",
    ["..", "%2e%2e", "..%2f..%2fetc", "nope", "%00", "nav%2f..%2fwalk", "%2fetc", "nav/episodes/..%2f..", "." * 300],
)
def test_names_that_are_no_runs_lead_nowhere(served, name):
    answer = served.http.get(f"/api/runs/{name}")
    assert answer.status_code in (404, 422)
    assert answer.json()["problem"]


@pytest.mark.parametrize(
    "path", ["/assets/../hub.py", "/assets/%2e%2e/hub.py", "/assets/..%2fhub.py", "/static/", "/.."]
)
def test_assets_lead_nowhere_else(served, path):
    with socket.create_connection(("127.0.0.1", httpx.URL(served.address).port), timeout=60) as line:
        host = served.address.removeprefix("http://").rstrip("/")
        line.sendall(f"GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n".encode())
        assert b" 404 " in line.recv(4096).split(b"\r\n")[0]


def test_the_page_in_the_package_is_that_of_its_sources():
    studio = Path(__file__).parents[2] / "studio"
    places = [studio / name for name in ("index.html", "package-lock.json", "tsconfig.json", "vite.config.ts")]
    places += [place for place in (studio / "src").rglob("*") if place.is_file()]
    sums = {place.relative_to(studio).as_posix(): hashlib.sha256(place.read_bytes()).hexdigest() for place in places}
    told = (Path(studio_server.__file__).parent / "static/sources.sha256").read_text(encoding="utf-8").splitlines()
    assert dict(reversed(line.split("  ")) for line in told) == sums, "make page builds it anew"


def test_one_episode_is_one_file(served, runs, tmp_path, capsys):
    out = tmp_path / "page.html"
    assert main(["studio", "export", str(runs / "walk"), "--out", str(out), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["steps"] <= 120
    text = out.read_text(encoding="utf-8")
    assert said["bytes"] == len(text.encode()) < 8_000_000
    held = json.loads(text.split('<script type="application/json" id="episode">')[1].split("</script>")[0])
    assert held["scene"]["query"] == "chair"
    for scheme in ('src="http', 'href="http', "url(http"):
        assert scheme not in text


def test_export_says_what_is_missing(runs, tmp_path, capsys):
    for words, says in (
        (["export"], "wanted the folder"),
        (["export", str(tmp_path / "nowhere"), "--out", "x.html"], "no folder"),
        (["export", str(runs / "nav")], "--out"),
        (["export", str(runs / "nav"), "--out", "x.txt"], "wanted a page"),
        (["export", str(runs / "nav"), "--out", str(tmp_path / "x.html"), "--port", "1"], "--port"),
        (["exprt", "x"], "export RUN"),
        (["--out", "x.html"], "--out is for"),
        (["--poses", "still"], "--poses is for --source"),
        (["--host", "0.0.0.0"], "--token"),
        (["--host", "0.0.0.0", "--token", "short"], "16"),
        (["--port", "70000"], "--port"),
        (["--seed", "-1"], "--seed"),
        (["--source", "nowhere"], "--query"),
    ):
        assert main(["studio", *words]) == 2
        assert says in capsys.readouterr().err


# --- who is refused ---


def test_pages_of_other_sites_and_other_names_are_refused(served):
    assert "another site" in refused(served.http.get("/api/state", headers={"Origin": "http://evil.example"}), 403)
    assert "not called" in refused(served.http.get("/api/state", headers={"Host": "evil.example"}), 421)
    policy = served.http.get("/api/state").headers["content-security-policy"]
    assert "default-src 'self'" in policy
    with pytest.raises(InvalidStatus), connect(served.socket, origin="http://evil.example"):  # type: ignore[arg-type]
        pass


def ended(page):
    """The code with which the server ends a page."""
    try:
        while page.hear():
            pass
    except ConnectionClosed as closed:
        return closed.rcvd.code


def test_rubbish_is_answered_in_words_and_ends_the_page_at_last(served):
    with served.page() as page:
        for _ in range(9):
            page.line.send("rubbish")
            assert "JSON" in page.hear()["problem"]
        page.line.send(b"\x00\x01")
        assert ended(page) == 4400
    with served.page() as page:
        page.line.send("x" * 20_000)
        assert ended(page) == 1009  # too large
    with served.page() as page:  # and others go on
        page.say(type="query", text="bed")
        assert "No view" in page.hear()["problem"]


def test_without_the_token_nothing_is_shown():
    token = "a-token-that-is-long-enough"
    with studio("--token", token, "--seed", "602") as served:
        address = served.address.partition("?")[0]
        served.http.base_url = address
        wait_for(lambda: children(served.process.pid))
        assert served.address.endswith(f"?token={token}")
        refused(served.http.get("/api/state"), 401)
        refused(served.http.get("/api/state", params={"token": "wrong"}), 401)
        with pytest.raises(InvalidStatus), connect(address.replace("http", "ws") + "ws"):
            pass
        opened = served.http.get("/", params={"token": token})
        assert opened.status_code == 303
        assert served.http.get("/api/state").json()["token"]  # by the cookie
        started = children(served.process.pid)
        assert len(started) >= 2  # the engine and the eye
        served.process.terminate()
        wait_for(lambda: not any(Path(f"/proc/{each}/cmdline").exists() for each in started))  # nothing is left

"""The studio's server from outside, without a browser: views, uploads, runs, export, and who is refused."""

import hashlib
import io
import json
import math
import socket
from pathlib import Path

import httpx
import numpy as np
import pytest
from clips import clip
from PIL import Image
from processes import wait_for
from studio_serving import children, studio
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from eagor import studio as studio_server
from eagor.cli import main
from eagor.lab.worlds.painted import painted_room

pytestmark = pytest.mark.xdist_group("real time")


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """A folder with a run of one short episode, and a run that was only begun."""
    root = tmp_path_factory.mktemp("runs")
    common = ["--perception", "truth", "--episodes", "1", "--seed", "602", "--set", "max_steps=8"]
    assert main(["bench", "run", "navigation", *common, "--methods", "eagor", "vmf", "--out", str(root / "nav")]) == 0
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


# --- what is watched ---


def steps(page, fits):
    """The first step that fits."""
    return page.until(lambda header: header["type"] == "step" and fits(header))


def test_a_walk_shows_a_scene_a_picture_and_a_belief_and_the_person_steers(served):
    with served.page() as page:
        page.say(type="open", source="apartment:2", query="sofa", drive="person", question=1)
        scene = page.until("scene")
        assert (scene["query"], scene["perception"], scene["question"], scene["seed"]) == ("sofa", "scout", 1, 2)
        assert scene["plan"]["walls"]
        assert any(thing["target"] for thing in scene["plan"]["things"])
        first = page.until("step")
        assert first["estimate"]["direction"] is None  # nothing has been looked at
        shown = first if "panorama" in page.blobs else steps(page, lambda _: "panorama" in page.blobs)
        assert shown["panorama"]["world_R_camera"] == pytest.approx(first["world_R_camera"], abs=1e-4)
        picture = Image.open(io.BytesIO(page.blobs["panorama"]))
        assert picture.size[0] == 2 * picture.size[1]
        told = steps(page, lambda header: "belief" in page.blobs and header["estimate"]["direction"] is not None)
        heat = Image.open(io.BytesIO(page.blobs["belief"]))
        assert heat.mode == "L"
        assert heat.size[0] == 2 * heat.size[1]
        assert len(page.blobs["belief"]) < 20_000
        assert isinstance(told["error_deg"], float)
        assert "walking left" in told["goal"]["words"]
        page.say(type="drive", by="person", turn=1.0, seconds=0.4)
        start = np.array(told["world_R_camera"]).reshape(3, 3)
        turned = steps(page, lambda header: abs(start[:, 1] @ header["world_R_camera"][::3]) > 0.3)
        assert start[:, 1] @ turned["world_R_camera"][::3] > 0  # a positive turn is to the left
        assert turned["position"][:2] == pytest.approx(told["position"][:2])
        page.say(type="drive", by="person", forward=-0.5, seconds=0.5)  # ahead is a wall
        steps(page, lambda header: math.dist(header["position"][:2], told["position"][:2]) > 0.1)
        page.say(type="ask", query="bed", question=7)
        scene = page.until(lambda header: header["type"] == "scene" or header["question"] != 1)
        assert (scene["type"], scene["query"], scene["question"]) == ("scene", "bed", 7)
        steps(page, lambda header: header["question"] == 7 and header["estimate"]["direction"] is not None)
        page.say(type="ask", query="unicorn", question=8)
        said = next(header for header in iter(page.hear, None) if header["type"] != "step" or header["question"] != 7)
        assert (said["type"], said["question"], said["fatal"]) == ("problem", 8, False)
        assert "unicorn" in said["problem"]
        steps(page, lambda header: header["question"] == 7 and header["look"]["fresh"])  # it goes on
        with served.page() as other:  # another page watches the same, and may not steer it meanwhile
            other.say(type="open", source="apartment:2")
            assert other.until("scene")["query"] == "bed"
            other.until("step")
            other.say(type="ask", query="table", question=9)
            said = next(header for header in iter(other.hear, None) if header["type"] == "problem")
            assert said["question"] == 9
            assert "Somebody else steers" in said["problem"]
        page.say(type="drive", by="person", turn=1.0, seconds=0.4)
        page.say(type="pause", on=True)  # what stands still is shown as finely as it can be
        steps(
            page, lambda _: "panorama" in page.blobs and Image.open(io.BytesIO(page.blobs["panorama"])).height == 1024
        )


@pytest.mark.slow
def test_the_tour_begins_in_sight_and_leads_behind_a_wall(served):
    with served.page() as page:
        page.say(type="open", source="apartment:5")
        scene = page.until("scene")
        assert (scene["drive"], scene["query"]) == ("tour", "orange sofa")
        steps(page, lambda header: "is in sight" in header["goal"]["words"])
        steps(page, lambda header: "A wall has hidden" in header["goal"]["words"])


@pytest.mark.slow
def test_the_policy_walks_towards_the_thing(served):
    with served.page() as page:
        page.say(type="open", source="apartment:602", drive="policy")
        first = steps(page, lambda header: header["goal"]["metres"] is not None)
        steps(page, lambda header: header["goal"]["metres"] < first["goal"]["metres"] - 0.3)


def test_a_photograph_and_a_video_are_looked_at_and_asked_for_more(served, room, tmp_path):
    answer = served.http.post("/api/pictures", content=room, headers={"X-Name": "..%2F..%2Fetc%2Fr%C3%B6om.png"})
    assert answer.status_code == 201
    told = answer.json()
    assert (told["name"], told["kind"]) == ("r\u00f6om.png", "photo")
    film = clip(tmp_path / "film.mp4", [painted_room(128, 256)] * 12, rate=4)
    answer = served.http.post("/api/pictures", content=film.read_bytes(), headers={"X-Name": "film.mp4"})
    assert answer.json()["kind"] == "video"
    with served.page() as page:
        for upload in (told, answer.json()):
            page.say(type="open", source=f"upload:{upload['id']}", query="red chair", perception="colour", question=1)
            scene = page.until("scene")
            assert (scene["title"], scene["pauses"]) == (upload["name"], upload["kind"] == "video")
            step = steps(page, lambda header: header["estimate"]["direction"] is not None)
            assert step["question"] == 1
            page.say(type="ask", query="blue", question=2)  # also of the last picture
            assert page.until("scene")["question"] == 2
            steps(page, lambda header: header["question"] == 2 and header["look"]["age"] is not None)
        page.say(type="ask", query="red", perception="anything.py:function", question=3)
        said = next(header for header in iter(page.hear, None) if header["type"] == "problem")
        assert said["question"] == 3
        assert "Choose one of" in said["change"]


@pytest.mark.parametrize("content", [b"", b"no picture at all", b"\x89PNG\r\n\x1a\n" + bytes(100)])
def test_files_that_are_no_pictures_are_refused(served, content):
    answer = served.http.post("/api/pictures", content=content, headers={"X-Name": "x.png"})
    assert "no picture" in refused(answer, 415)


def sent(served, request, header):
    """The first line of the answer to a request that no client would make."""
    with socket.create_connection(("127.0.0.1", httpx.URL(served.address).port), timeout=60) as line:
        line.sendall(f"{request}\r\nHost: {served.host}\r\n{header}\r\n\r\n".encode())
        return line.recv(4096).split(b"\r\n")[0]


def test_files_that_are_too_large_are_refused_before_they_come(served):
    buffer = io.BytesIO()
    Image.new("L", (16000, 8000)).save(buffer, "PNG")
    assert "million" in refused(served.http.post("/api/pictures", content=buffer.getvalue()), 413)
    assert b" 413 " in sent(served, "POST /api/pictures HTTP/1.1", f"Content-Length: {1 << 40}\r\n\r\nx")


def test_without_the_token_nothing_is_shown_and_with_it_the_page_opens_on_a_source(tmp_path):
    """It asks for the lens of an ordinary camera. At its end no process is left."""
    Image.new("RGB", (64, 48), (200, 30, 30)).save(tmp_path / "0.png")
    token = "a-token-that-is-long-enough"
    options = ("--query", "red", "--perception", "colour", "--poses", "still", "--token", token, "--host", "0.0.0.0")
    with studio("--source", tmp_path, *options) as served:
        assert served.address.endswith(f"?token={token}")
        assert served.http.get("/").status_code == 200  # the page itself tells nothing
        refused(served.http.get("/api/state"), 401)
        refused(served.http.get("/api/state", params={"token": "wrong"}), 401)
        with pytest.raises(InvalidStatus), connect(served.socket.partition("?")[0]):
            pass
        assert served.http.get("/api/runs", params={"token": token}).status_code == 200  # a process of its own tells
        assert served.http.get("/api/state", params={"token": token}).json()["opens"] == "live"
        with served.page() as page:
            page.say(type="open", source="live")
            said = next(header for header in iter(page.hear, None) if header["type"] == "problem")
            assert (said["asks"], said["fatal"]) == ("hfov", True)
            page.say(type="open", source="live", hfov=70)
            assert page.until("scene")["lens"]["plane"][0] == pytest.approx(math.tan(math.radians(35)), abs=1e-4)
            step = steps(page, lambda header: header["estimate"]["direction"] is not None)
            assert "panorama" in step
        with served.page() as page:  # who comes later sees what has come so far
            page.say(type="open", source="live")
            page.until("scene")
            assert page.until("step")["estimate"]["direction"] is not None
            assert {*page.blobs} >= {"panorama", "belief"}
        started = children(served.process.pid)
        served.process.terminate()
        wait_for(lambda: not any(Path(f"/proc/{each}/cmdline").exists() for each in started))  # nothing is left


# --- runs ---


def test_runs_are_listed_with_what_is_wrong(served):
    found = {run["name"]: run for run in served.http.get("/api/runs").json()["runs"]}
    assert {name: run["kind"] for name, run in found.items()} == {"nav": "bench", "begun": "bench"}
    assert "no records" in found["begun"]["problem"]
    assert "no records" in refused(served.http.get("/api/runs/begun"), 422)


def test_an_episode_is_played_again_with_the_recorded_figures(served, runs):
    (entry,) = served.http.get("/api/runs/nav").json()["episodes"]
    answer = served.http.get(f"/api/runs/nav/episodes/{entry['key']}")
    assert answer.status_code == 200
    episode = answer.json()
    assert [each["name"] for each in episode["scene"]["methods"]] == ["eagor", "vmf"]
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
        assert step["belief"] is None or step["belief"]["url"].startswith("data:image/png;base64,")
        assert step["methods"]["eagor"]["error_deg"] == recorded
    picture = served.http.get(episode["steps"][0]["panorama"]["url"])
    assert picture.headers["content-type"] == "image/webp"
    assert Image.open(io.BytesIO(picture.content)).size == (1024, 512)
    assert episode["scene"]["paths"]["vmf"]


@pytest.mark.parametrize("name", ["..", "..%2f..%2fetc", "nope", "%00", "nav%2f..%2fbegun", "%2fetc", "." * 300])
def test_names_that_are_no_runs_lead_nowhere(served, name):
    assert served.http.get(f"/api/runs/{name}").status_code in (404, 422)


@pytest.mark.parametrize("path", ["/assets/../runs.py", "/assets/%2e%2e/runs.py", "/assets/..%2fruns.py", "/.."])
def test_assets_lead_nowhere_else(served, path):
    assert b" 404 " in sent(served, f"GET {path} HTTP/1.1", "Connection: close")


def test_the_page_in_the_package_is_that_of_its_sources():
    studio = Path(__file__).parents[2] / "studio"
    places = [studio / name for name in ("index.html", "package-lock.json", "tsconfig.json", "vite.config.ts")]
    places += [place for place in (studio / "src").rglob("*") if place.is_file()]
    sums = {place.relative_to(studio).as_posix(): hashlib.sha256(place.read_bytes()).hexdigest() for place in places}
    told = (Path(studio_server.__file__).parent / "static/sources.sha256").read_text(encoding="utf-8").splitlines()
    assert dict(reversed(line.split("  ")) for line in told) == sums, "make page builds it anew"


def test_one_episode_is_one_file(served, runs, tmp_path, capsys):
    out = tmp_path / "page.html"
    assert main(["studio", "export", str(runs / "nav"), "--out", str(out), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    text = out.read_text(encoding="utf-8")
    assert said["bytes"] == len(text.encode()) < 8_000_000
    held = json.loads(text.split('<script type="application/json" id="episode">')[1].split("</script>")[0])
    assert len(held["steps"]) == said["steps"]
    assert held["scene"]["query"] in said["title"]
    assert held["steps"][0]["panorama"]["url"].startswith("data:image/webp;base64,")
    for scheme in ('src="http', 'href="http', "url(http"):
        assert scheme not in text


def test_export_says_what_is_missing(runs, tmp_path, capsys):
    for words, says in (
        (["export"], "wanted the folder"),
        (["export", str(tmp_path / "nowhere"), "--out", "x.html"], "no folder"),
        (["export", str(runs / "nav")], "--out"),
        (["export", str(runs / "nav"), "--out", "x.txt"], "wanted where to write"),
        (["export", str(runs / "nav"), "--out", str(tmp_path / "x.html"), "--port", "1"], "--port"),
        (["exprt", "x"], "export RUN"),
        (["--out", "x.html"], "--out is for"),
        (["--poses", "still"], "--poses is for --source"),
        (["--host", "0.0.0.0"], "--token"),
        (["--host", "0.0.0.0", "--token", "short"], "16"),
        (["--port", "70000"], "--port"),
        (["--source", "nowhere"], "--query"),
    ):
        assert main(["studio", *words]) == 2
        assert says in capsys.readouterr().err


# --- who is refused ---


def test_pages_of_other_sites_and_other_names_are_refused(served):
    assert "another site" in refused(served.http.get("/api/state", headers={"Origin": "http://evil.example"}), 403)
    assert "another name" in refused(served.http.get("/api/state", headers={"Host": "evil.example"}), 421)
    policy = served.http.get("/api/state").headers["content-security-policy"]
    assert "default-src 'self'" in policy
    with pytest.raises(InvalidStatus), connect(served.socket, origin="http://evil.example"):  # type: ignore[arg-type]
        pass


def test_rubbish_and_what_a_page_may_not_open_are_answered_in_words(served):
    with served.page() as page:
        for rubbish in ("rubbish", b"\x00\x01", '{"type":"drive","forward":1e9}'):
            page.line.send(rubbish)
            assert "makes no sense" in page.hear()["problem"]
        for source, says in (
            ("upload:../../etc/passwd", "not here"), ("live", "no such source"), ("/etc", "no such source"),
            ("apartment:99999", "no such source"),
        ):  # fmt: skip
            page.say(type="open", source=source, query="chair")
            assert says in page.hear()["problem"]
        page.say(type="ask", query="bed")  # and the page goes on
        assert "Nothing is open" in page.hear()["problem"]
        page.line.send("x" * 20_000)
        with pytest.raises(ConnectionClosed) as closed:
            page.hear()
        assert closed.value.rcvd.code == 1009  # too large

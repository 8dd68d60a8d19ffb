"""The studio's page with its server, in Chromium: a walk, a run, a picture, a live source, and a server that goes."""

from __future__ import annotations

import io
import json
import math
import re
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from clips import clip
from PIL import Image

from eagor.cli import main
from eagor.sphere import angular_distance, world_R_body
from tests.studio_pages import PATIENCE, Watched, browser, in_order, need_browser, serious, tabbed

pytestmark = pytest.mark.xdist_group("real time")

COMMAND = (sys.executable, "-m", "eagor")


@dataclass
class Studio:
    """A studio that runs: its address, its process, a browser's page on it, a picture to drop."""

    address: str
    process: subprocess.Popen[str]
    page: Watched
    picture: Path


def room(red: float) -> Image.Image:
    """A grey room ``(256, 512)`` with a red ball at this azimuth, degrees left, 10 degrees down."""
    pixels = np.full((256, 512, 3), 150, np.uint8)
    pixels[150:] = (120, 105, 90)
    row, column = 256 * (90 + 10) / 180, 512 * (180 - red) / 360
    y, x = np.mgrid[:256, :512]
    pixels[np.hypot(x - column, y - row) < 16] = (205, 25, 25)
    return Image.fromarray(pixels)


@pytest.fixture(scope="module")
def studio(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Studio]:
    need_browser()
    folder = tmp_path_factory.mktemp("studio")
    play = ("bench", "run", "navigation", "--perception", "truth", "--methods", "eagor", "centroid", "--episodes", "1")
    assert main([*play, "--seed", "602", "--set", "max_steps=8", "--out", str(folder / "runs" / "short")]) == 0
    (folder / "runs" / "half").mkdir()
    (folder / "runs" / "half" / "run.json").write_text((folder / "runs" / "short" / "run.json").read_text())
    (folder / "frames").mkdir()
    for index in range(3):
        room(70).save(folder / "frames" / f"{index:03}.png")
    room(40).save(folder / "room.png")
    options = ("--port", "0", "--runs", str(folder / "runs"), "--source", str(folder / "frames"), "--poses", "still",
               "--query", "red ball", "--perception", "colour")  # fmt: skip
    with subprocess.Popen([*COMMAND, "studio", *options], stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            told = process.stdout.readline()
            found = re.search(r"http://\S+", told)
            assert found, told
            warm(found[0], process)
            with browser() as opened:
                page = opened(1440, 900, color_scheme="dark")
                page.goto(found[0])
                yield Studio(found[0], process, page, folder / "room.png")
        finally:
            process.terminate()


def warm(address: str, process: subprocess.Popen[str]) -> None:
    """Wait until the server answers, and has built its apartment."""
    end = time.monotonic() + 2 * PATIENCE
    while True:
        assert process.poll() is None, "the server has ended"
        assert time.monotonic() < end, "the server is never ready"
        with suppress(OSError), urllib.request.urlopen(address + "api/state") as answer:
            if json.load(answer)["ready"]:
                return
        time.sleep(0.2)


def go(studio: Studio, view: str) -> Watched:
    """The page in this view."""
    studio.page.locator(".tabs").get_by_role("link", name=view.capitalize(), exact=True).click()
    studio.page.until(f"document.getElementById('studio').dataset.view === '{view}'")
    return studio.page


def pose(page: Watched) -> np.ndarray:
    return np.array(page.summary()["world_R_camera"]).reshape(3, 3)


def drawn(page: Watched) -> np.ndarray:
    """What the flat panorama shows ``(H, W, 3)``."""
    page.at_rest()
    return np.asarray(Image.open(io.BytesIO(page.locator(".flat-frame").screenshot())).convert("RGB")).astype(float)


def watch_turn(page: Watched, before: np.ndarray) -> None:
    """Keep the sine of the first turn from this pose: a key that is let go late on a busy machine turns on and on."""
    left = before[:, 1].tolist()
    page.evaluate(
        f"(() => {{ window.firstTurn = undefined; const left = {left}; const timer = setInterval(() => {{"
        "const m = window.eagorStudio.summary.world_R_camera; if (!m) return;"
        "const sine = left[0] * m[0] + left[1] * m[3] + left[2] * m[6];"
        "if (Math.abs(sine) > 0.02) { window.firstTurn = sine; clearInterval(timer); } }, 10); })()"
    )


def at_rest(page: Watched) -> np.ndarray:
    """The camera's pose when it no longer turns."""
    while True:
        before, number = pose(page), page.summary()["number"]
        page.until(f"window.eagorStudio.summary.number >= {number} + 4")
        if np.allclose(before, pose(page), atol=1e-6):
            return before


def test_a_walk_shows_a_belief_that_is_the_servers(studio: Studio) -> None:
    page = studio.page
    page.until("window.eagorStudio?.summary.stats.firstPicture")
    assert page.get_by_role("radio", name="tour").is_checked()  # a visitor who does nothing sees the first walk
    page.get_by_label("Perception").select_option("truth")
    page.until("window.eagorStudio.store.scene?.perception.includes('truth') && window.eagorStudio.store.beliefMode")
    page.until("window.eagorStudio.store.modes[0]?.weight > 0.5")
    # The mode that the estimate answers from comes with the belief; the page finds it from the coefficients alone.
    mode, peak, mass = page.evaluate(
        "(() => { const { store, summary } = window.eagorStudio;"
        "return [store.beliefMode, summary.peak, summary.mass]; })()"
    )
    assert math.degrees(float(angular_distance(np.array(mode), np.array(peak)))) < 1.5
    assert abs(mass - 0.9) < 0.02
    assert serious(page) == []
    page.kept("walk")


@pytest.mark.slow
def test_no_answer_is_shown_to_another_question(studio: Studio) -> None:
    """Another perception and another query within a moment; then a word that nobody knows."""
    page = go(studio, "walk")
    page.until("window.eagorStudio.summary.peak")
    name = page.evaluate(
        "(({ targets, query }) => targets.find((one) => one !== query))(window.eagorStudio.store.scene)"
    )
    page.evaluate(
        "(() => { window.shown = []; const { store } = window.eagorStudio; store.on('step', () => {"
        "if (store.direction || store.heat) window.shown.push([store.scene.query, store.scene.perception]); }); })()"
    )
    page.get_by_label("Where is the").fill(name)
    page.evaluate("window.shown.length = 0")
    page.get_by_label("Perception").select_option("scout")
    page.keyboard.press("Shift+Tab")  # no mouse: the box, the button, the choice
    page.get_by_label("Where is the").press("Enter")
    page.evaluate("window.shown.length = 0")
    page.until("window.eagorStudio.store.direction")
    assert page.evaluate("window.shown.map(String)[0]") == f"{name},scout"
    page.evaluate(
        "(() => { window.said = []; const line = document.querySelector('.sentence'); new MutationObserver(() =>"
        "window.said.push(line.textContent)).observe(line, { childList: true, characterData: true, subtree: true });"
        " })()"
    )
    page.get_by_label("Where is the").fill("unicorn")
    page.keyboard.press("Enter")
    page.until("window.said.includes('Looking for “unicorn” …')")  # until it is refused
    page.until("document.querySelector('[role=alert]')?.textContent.includes('unicorn')")
    page.until("window.eagorStudio.store.direction && window.eagorStudio.store.heat")
    assert page.evaluate("window.eagorStudio.store.scene.query") == name
    page.get_by_role("button", name="Close").click()
    page.get_by_label("Where is the").fill("a draft")
    page.get_by_label("Perception").select_option("truth")
    page.until("window.eagorStudio.store.direction && window.eagorStudio.store.scene.perception === 'truth'")
    assert page.get_by_label("Where is the").input_value() == "a draft", "what is typed waits until it is asked"


def test_what_is_paused_is_drawn_with_all_pixels_and_a_fine_picture(studio: Studio) -> None:
    page = go(studio, "walk")
    page.until("window.eagorStudio.store.panorama")
    page.get_by_role("button", name="Pause").click()
    page.until("window.eagorStudio.store.panorama.image.width === 2048")
    page.until(
        "window.eagorStudio.summary.rests && (({ width, clientWidth }) => Math.abs(width - clientWidth) <= 1)"
        "(document.querySelector('.look .scene'))"
    )
    page.kept("walk-paused")
    page.get_by_role("button", name="Go on").click()


@pytest.mark.slow
def test_a_person_steers_with_the_arrow_keys_and_the_stick(studio: Studio) -> None:
    page = go(studio, "walk")
    page.until("window.eagorStudio.store.step")
    page.get_by_role("radio", name="me").check(force=True)
    page.until("window.eagorStudio.store.step?.drive === 'person'")
    page.locator(".look").focus()
    watch_turn(page, at_rest(page))
    page.keyboard.press("ArrowLeft", delay=400)  # 0.4 radians
    page.until("window.firstTurn !== undefined")
    assert page.evaluate("window.firstTurn") > 0, "the left arrow turns left"
    watch_turn(page, at_rest(page))
    page.get_by_role("button", name="Turn right").click(delay=400)
    page.until("window.firstTurn !== undefined")
    assert page.evaluate("window.firstTurn") < 0, "the right button turns right"
    page.kept("walk-steered")
    page.set_viewport_size({"width": 390, "height": 844})
    assert [way.is_visible() for way in page.locator(".way").all()] == 4 * [True], "a phone has all four"
    page.set_viewport_size({"width": 1440, "height": 900})
    page.get_by_role("radio", name="policy").check(force=True)


@pytest.mark.slow
def test_the_degree_is_changed_and_the_belief_with_it(studio: Studio) -> None:
    page = go(studio, "walk")
    page.until("window.eagorStudio.store.scene?.degree === 15 && window.eagorStudio.summary.peak")
    page.get_by_label("Degree L").select_option("7")
    page.until("window.eagorStudio.store.scene?.degree === 7 && window.eagorStudio.summary.peak")
    page.get_by_label("Degree L").select_option("15")
    page.until("window.eagorStudio.store.scene?.degree === 15 && window.eagorStudio.summary.peak")


@pytest.mark.slow
def test_an_episode_of_a_run_is_chosen_and_scrubbed(studio: Studio) -> None:
    page = go(studio, "run")
    page.until("window.eagorStudio.store.scene && window.eagorStudio.store.panorama")
    assert page.locator("tr[data-key]").count() == 1
    count = page.evaluate("window.eagorStudio.store.history.length")
    assert count >= 2
    slider = page.get_by_role("slider", name="Step")
    slider.fill(str(count - 1))
    page.until(f"window.eagorStudio.store.now === {count - 1}")
    assert slider.get_attribute("aria-valuetext").startswith(f"step {count} of {count}")
    page.locator(".rivals summary").click()
    assert page.locator(".rivals .chip").count() == 2
    page.locator(".rivals summary").click()
    page.at_rest()
    assert serious(page) == []
    page.kept("run")


def test_a_run_is_reached_and_played_by_keyboard(studio: Studio) -> None:
    page = go(studio, "run")
    page.until("window.eagorStudio.store.scene && window.eagorStudio.store.panorama")
    page.set_viewport_size({"width": 390, "height": 844})  # all below each other: the order is that of the eye
    in_order(tabbed(page), "Skip", "Run", "602-0", "Panorama from inside", "Play", "Step", "Belief", "Calibration")
    page.set_viewport_size({"width": 1440, "height": 900})
    slider = page.get_by_role("slider", name="Step")
    slider.press("Home")
    slider.press("ArrowRight")
    page.until("window.eagorStudio.store.now === 1")


def dropped(studio: Studio) -> Watched:
    """The picture is dropped on its page, and asked for the ball."""
    page = go(studio, "picture")
    page.get_by_label("Where is the").fill("")
    page.set_input_files("#file", str(studio.picture))
    page.until("window.eagorStudio.store.scene === null && window.eagorStudio.store.panorama")  # nothing is asked yet
    page.get_by_label("Where is the").fill("red ball")
    page.keyboard.press("Enter")
    page.until("window.eagorStudio.summary.peak")
    return page


@pytest.mark.slow
def test_a_picture_is_opened_by_keyboard(studio: Studio) -> None:
    page = go(studio, "picture")
    page.until("document.querySelector('.empty button')")  # nothing is open yet
    names = tabbed(page)
    in_order(names, "Where is the", "Ask", "Perception", "the camera", "Choose a file", "Belief")
    assert not {"Another file", "Panorama from inside", "Zoom in"} & set(names), "of use to nobody yet"
    page.get_by_label("Where is the").fill("red ball")
    with page.expect_file_chooser() as chooser:
        page.get_by_role("button", name="Choose a file").press("Enter")
    chooser.value.set_files(str(studio.picture))
    page.until("window.eagorStudio.store.direction")
    in_order(tabbed(page), "Ask", "Another file", "Panorama from inside", "Zoom in", "Belief")
    before = pose(page)
    page.locator(".look").press("ArrowLeft")
    page.until(f"window.eagorStudio.summary.world_R_camera[3] !== {before[1, 0]}")
    assert (before.T @ pose(page))[1, 0] > 0, "the left arrow turns the camera left"


def test_a_picture_is_dropped_and_the_belief_stays_with_it(studio: Studio) -> None:
    page = dropped(studio)
    page.until("window.eagorStudio.store.direction")
    page.at_rest()
    # Where the ball is in the picture, in the axes of the first pose.
    ball = world_R_body(math.radians(40)) @ np.array([math.cos(math.radians(10)), 0, -math.sin(math.radians(10))])
    peak = np.array(page.summary()["peak"])
    assert math.degrees(float(angular_distance(peak, ball))) < 6
    box = page.locator(".look").bounding_box()
    assert box is not None
    before, start = page.summary(), pose(page)
    focal = box["height"] / 2 / math.tan(math.radians(before["field_deg"]) / 2)
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 200, y, steps=5)
    page.mouse.up()
    wanted = math.degrees(math.atan(200 / focal))
    page.until(  # the server's own pose, not the page's guess
        "(() => { const pose = window.eagorStudio.summary.world_R_camera;"
        f"return Math.atan2(pose[3], pose[0]) * 180 / Math.PI > {wanted} - 1; }})()"
    )
    yaw = math.degrees(math.atan2(*(start.T @ pose(page))[[1, 0], 0]))
    assert yaw == pytest.approx(wanted, abs=0.5)
    assert math.degrees(float(angular_distance(np.array(page.summary()["peak"]), peak))) < 1.0
    assert serious(page) == []
    page.kept("picture")


@pytest.mark.slow
def test_the_newest_look_is_a_layer(studio: Studio) -> None:
    """What the evidence of one look says is highest where the ball is; drawn, it is another picture than the belief."""
    page = dropped(studio)
    page.until("window.eagorStudio.store.evidence !== null")
    azimuth, elevation = page.evaluate(
        "(() => { const { values, columns, rows } = window.eagorStudio.store.evidence;"
        "const best = values.indexOf(Math.max(...values));"
        "return [Math.PI - (best % columns + 0.5) / columns * 2 * Math.PI,"
        "Math.PI / 2 - (Math.floor(best / columns) + 0.5) / rows * Math.PI]; })()"
    )
    frame = page.evaluate("window.eagorStudio.store.evidence.frame")
    d = np.array(
        [math.cos(elevation) * math.cos(azimuth), math.cos(elevation) * math.sin(azimuth), math.sin(elevation)]
    )
    ball = world_R_body(math.radians(40)) @ np.array([math.cos(math.radians(10)), 0, -math.sin(math.radians(10))])
    assert math.degrees(float(angular_distance(d if frame == "world" else pose(page) @ d, ball))) < 6
    before = drawn(page)
    page.get_by_role("button", name="Newest look", exact=True).click()
    page.until("window.eagorStudio.store.showsEvidence")
    assert np.abs(drawn(page) - before).mean() > 1
    page.kept("newest-look")
    page.get_by_role("button", name="Newest look", exact=True).click()


@pytest.mark.slow
def test_a_video_is_dropped_paused_and_sought(studio: Studio, tmp_path: Path) -> None:
    page = go(studio, "picture")
    frames = [np.asarray(room(60)) for _ in range(40)]
    page.set_input_files("#file", str(clip(tmp_path / "walk.mp4", frames, rate=10)))
    page.get_by_label("Where is the").fill("red ball")
    page.keyboard.press("Enter")
    page.until("window.eagorStudio.store.step?.frame?.of > 1 && window.eagorStudio.summary.peak")
    page.get_by_role("button", name="Pause").press("Space")
    slider = page.get_by_role("slider", name="Frame")
    in_order(tabbed(page), "Ask", "Another file", "Go on", "Frame", "Panorama from inside")
    count = page.evaluate("window.eagorStudio.store.step.frame.of")
    slider.fill(str(count - 1))
    page.until(f"window.eagorStudio.store.step.frame.n >= {count - 2}")
    shown, said = "document.querySelector('.frames .count').textContent", "`${frame.n + 1} / ${frame.of}`"
    page.until(f"(({{ frame }}) => {shown} === {said})(window.eagorStudio.store.step)")
    page.until("window.eagorStudio.summary.peak")
    ball = world_R_body(math.radians(60)) @ np.array([math.cos(math.radians(10)), 0, -math.sin(math.radians(10))])
    found = pose(page).T @ np.array(page.summary()["peak"])  # the camera does not turn; its axes may drift a little
    assert math.degrees(float(angular_distance(found, ball))) < 8
    page.kept("video")
    # This perception lists nothing: as if it had seen a green ball. Its line asks for it, and keeps the focus.
    page.evaluate(
        "(() => { const { store } = window.eagorStudio;"
        "store.things = [{ query: 'green ball', direction: [1, 0, 0], sure: 0.4, seen: 1, of: 3 }];"
        "store.emit('step'); })()"
    )
    line = page.get_by_role("button", name="green ball")
    line.press("Enter")
    page.until("window.eagorStudio.store.scene?.query === 'green ball'")
    assert page.get_by_label("Where is the").input_value() == "green ball"


def test_a_run_without_results_shows_nothing_of_the_one_before(studio: Studio) -> None:
    page = go(studio, "run")
    page.until("window.eagorStudio.store.answer && window.eagorStudio.store.panorama")
    none = json.dumps({"kind": "bench", "methods": [], "episodes": [], "problem": "no episode has a result"})
    page.route("**/api/runs/half*", lambda route: route.fulfill(status=200, content_type="application/json", body=none))
    page.locator(".controls select").first.select_option("half")
    page.until("document.querySelector('.empty').textContent.includes('No episode has a result')")
    assert page.evaluate("window.eagorStudio.store.answer") is None
    assert page.get_by_role("button", name="Play", exact=True).count() == 0
    page.unroute("**/api/runs/half*")


@pytest.mark.slow
def test_a_run_that_is_empty_is_said_so(studio: Studio) -> None:
    page = go(studio, "run")
    page.until("document.querySelectorAll('.controls option').length >= 2")
    half = page.locator(".controls option", has_text="half").first
    assert "no records yet" in half.inner_text()
    page.locator(".controls select").first.select_option("half")
    page.until("document.querySelector('[role=alert]')")
    assert len(page.locator("[role=alert]").first.inner_text()) > 20
    page.errors[:] = [error for error in page.errors if "status of 4" not in error]


@pytest.mark.slow
def test_a_folder_without_runs_says_how_to_make_one(studio: Studio) -> None:
    page = studio.page
    empty = json.dumps({"folder": "/nowhere/runs", "runs": []})
    page.route("**/api/runs*", lambda route: route.fulfill(status=200, content_type="application/json", body=empty))
    page.get_by_role("button", name="Look for new runs").click()
    page.until("document.body.textContent.includes('eagor bench run navigation --out runs/first')")
    page.unroute("**/api/runs*")
    page.kept("no-runs")


def test_what_is_no_panorama_is_refused_in_words(studio: Studio, tmp_path: Path) -> None:
    page = go(studio, "picture")
    (tmp_path / "note.png").write_text("no picture")
    page.set_input_files("#file", str(tmp_path / "note.png"))
    page.until("document.querySelector('[role=alert]')")
    assert len(page.locator("[role=alert]").inner_text()) > 20
    page.errors[:] = [error for error in page.errors if "status of 4" not in error]  # Chromium tells of refusals


def test_a_live_source_is_watched(studio: Studio) -> None:
    page = go(studio, "live")
    page.until("window.eagorStudio.store.panorama && window.eagorStudio.summary.peak")
    page.at_rest()
    assert page.get_by_label("Degree L").is_disabled(), "others watch the source, too"
    in_order(tabbed(page), "Where is the", "Ask", "Panorama from inside", "Fill the screen", "Belief")
    page.get_by_label("Where is the").fill("green ball")  # its pictures have all been looked at
    page.keyboard.press("Enter")
    page.until("document.querySelector('[role=alert]')?.textContent.includes('has ended')")
    page.until("window.eagorStudio.summary.peak")
    assert serious(page) == []
    page.kept("live")


@pytest.mark.slow
def test_updates_are_evaluated_as_they_come(studio: Studio) -> None:
    page = go(studio, "walk")
    page.until("window.eagorStudio.store.history.length > 3")
    page.evaluate("window.eagorStudio.store.stats.received = 0")
    page.until("window.eagorStudio.store.stats.received >= 10")
    numbers = page.summary()["stats"]
    assert numbers["evaluated"] > 0
    assert numbers["drawn"] > 0


def test_the_page_is_small_and_asks_only_its_server(studio: Studio) -> None:
    page = studio.page
    assert page.errors == []
    host = studio.address.removeprefix("http:").rstrip("/")
    assert all(url.startswith(("data:", "blob:")) or url.split(":", 1)[1].startswith(host) for url in page.asked)
    size = page.evaluate(
        "performance.getEntriesByType('resource').filter(({ name }) => name.includes('/assets/'))"
        ".reduce((sum, one) => sum + one.decodedBodySize, 0)"
    )
    assert 10_000 < size < 900_000


@pytest.mark.slow
def test_a_server_that_goes_is_said_so(studio: Studio) -> None:
    page = go(studio, "walk")
    page.until("window.eagorStudio.store.step")
    studio.process.terminate()
    page.until("document.querySelector('.problems').textContent.includes('does not answer')")
    assert page.get_by_role("button", name="Try now").count() == 1
    page.kept("server-gone")

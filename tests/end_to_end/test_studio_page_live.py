"""The studio's page with its server, in Chromium: a walk, a run, a picture, a video, a camera, a server that goes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import studio_serving
from PIL import Image
from studio_serving import Served

from eagor.cli import main
from eagor.sphere import angular_distance
from tests.studio_pages import Watched, browser, in_order, need_browser, serious, tabbed

pytestmark = pytest.mark.xdist_group("real time")


@dataclass
class Studio:
    """A studio that runs, a browser's page on it, a picture to drop."""

    served: Served
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
    options = ("--runs", folder / "runs", "--source", folder / "frames", "--poses", "still", "--query", "red ball",
               "--perception", "colour")  # fmt: skip
    with studio_serving.studio(*options) as served, browser() as opened:
        page = opened(1440, 900, color_scheme="dark")
        page.goto(served.ready().address)
        yield Studio(served, page, folder / "room.png")


def go(studio: Studio, view: str) -> Watched:
    """The page in this view."""
    studio.page.locator(".tabs").get_by_role("link", name=view.capitalize(), exact=True).click()
    studio.page.until(f"document.getElementById('studio').dataset.view === '{view}'")
    return studio.page


def answer(page: Watched) -> np.ndarray:
    """The answer, in the axes of the world."""
    page.until("window.eagorStudio.store.direction && window.eagorStudio.store.belief")
    found = page.evaluate("[window.eagorStudio.summary.world_R_camera, window.eagorStudio.store.direction]")
    return np.array(found[0]).reshape(3, 3) @ found[1]


def away(found: np.ndarray, azimuth: float) -> float:
    """Degrees from the ball of a room."""
    a, e = math.radians(azimuth), math.radians(-10)
    return math.degrees(
        float(angular_distance(found, np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])))
    )


def test_the_page_opens_on_the_source_that_it_was_started_with(studio: Studio) -> None:
    page = studio.page
    page.until("document.getElementById('studio').dataset.view === 'live'")
    assert away(answer(page), 70) < 8
    page.at_rest()
    in_order(tabbed(page), "Where is the", "Ask", "Perception", "Panorama from inside", "Fill the screen", "Belief")
    page.get_by_label("Where is the").fill("green ball")  # of its last picture, which stays
    page.keyboard.press("Enter")
    page.until("window.eagorStudio.store.scene.query === 'green ball'")
    assert serious(page) == []
    page.kept("live")


def test_a_walk_is_watched_asked_and_paused(studio: Studio) -> None:
    page = go(studio, "walk")
    page.until("window.eagorStudio.store.direction && window.eagorStudio.store.truth")
    assert page.get_by_role("radio", name="tour").is_checked()  # a visitor who does nothing sees the tour
    assert page.evaluate("window.eagorStudio.store.scene.plan.walls.length") > 0
    page.get_by_label("Where is the").fill("unicorn")
    page.keyboard.press("Enter")
    page.until(
        "document.querySelector('.sentence').textContent.includes('Looking for “unicorn”')"
    )  # until it is refused
    page.until("document.querySelector('[role=alert]')?.textContent.includes('unicorn')")
    page.until("window.eagorStudio.store.direction && window.eagorStudio.store.scene.query === 'orange sofa'")
    page.get_by_role("button", name="Close").click()
    page.get_by_role("button", name="Pause").click()
    page.until("window.eagorStudio.store.panorama.image.width === 2048")
    page.until(
        "window.eagorStudio.summary.rests && (({ width, clientWidth }) => Math.abs(width - clientWidth) <= 1)"
        "(document.querySelector('.look .scene'))"
    )
    assert serious(page) == []
    page.kept("walk-paused")
    page.get_by_role("button", name="Go on").click()


@pytest.mark.slow
def test_a_person_steers_with_the_arrow_keys_and_the_stick(studio: Studio) -> None:
    page = go(studio, "walk")
    page.until("window.eagorStudio.store.step")
    page.get_by_role("radio", name="me").check(force=True)
    page.locator(".look").focus()
    for act, sign in (("ArrowLeft", 1), ("Turn right", -1)):
        page.page.wait_for_timeout(1500)  # what was under way has come
        before = np.array(page.summary()["world_R_camera"]).reshape(3, 3)
        if sign > 0:
            page.keyboard.press(act, delay=400)
        else:
            page.get_by_role("button", name=act).click(delay=400)
        left = before[:, 1].tolist()
        sine = f"{left[0]} * m[0] + {left[1]} * m[3] + {left[2]} * m[6]"
        page.until(f"((m) => Math.abs({sine}) > 0.05)(window.eagorStudio.summary.world_R_camera)")
        assert sign * page.evaluate(f"((m) => {sine})(window.eagorStudio.summary.world_R_camera)") > 0
    page.set_viewport_size({"width": 390, "height": 844})
    assert [way.is_visible() for way in page.locator(".way").all()] == 4 * [True], "a phone has all four"
    page.set_viewport_size({"width": 1440, "height": 900})


def test_a_run_is_reached_and_played_by_keyboard(studio: Studio) -> None:
    page = go(studio, "run")
    page.until("window.eagorStudio.store.scene && window.eagorStudio.store.panorama")
    assert page.locator("tr[data-key]").count() == 1
    page.set_viewport_size({"width": 390, "height": 844})  # all below each other: the order is that of the eye
    in_order(tabbed(page), "Skip", "Run", "602-0", "Panorama from inside", "Play", "Step", "Belief")
    page.set_viewport_size({"width": 1440, "height": 900})
    slider = page.get_by_role("slider", name="Step")
    slider.press("Home")
    slider.press("ArrowRight")
    page.until("window.eagorStudio.store.now === 1")
    count = page.evaluate("window.eagorStudio.store.history.length")
    slider.press("End")
    page.until(f"window.eagorStudio.store.now === {count - 1}")
    assert slider.get_attribute("aria-valuetext").startswith(f"step {count} of {count}")
    page.locator(".rivals summary").click()
    assert page.locator(".rivals .chip").count() == 2
    page.locator(".rivals summary").click()
    assert serious(page) == []
    page.kept("run")


def test_a_run_without_results_shows_nothing_of_the_one_before_and_says_why(studio: Studio) -> None:
    page = go(studio, "run")
    page.until("window.eagorStudio.store.answer && window.eagorStudio.store.panorama")
    assert "no records yet" in page.locator(".controls option", has_text="half").first.inner_text()
    page.locator(".controls select").first.select_option("half")
    page.until("document.querySelector('[role=alert]')")
    assert len(page.locator("[role=alert]").first.inner_text()) > 20
    assert page.evaluate("window.eagorStudio.store.answer") is None
    assert page.get_by_role("button", name="Play", exact=True).count() == 0
    page.errors[:] = [error for error in page.errors if "status of 4" not in error]  # Chromium tells of refusals


def test_a_picture_is_opened_by_keyboard_and_looked_at(studio: Studio) -> None:
    page = go(studio, "picture")
    page.get_by_label("Where is the").fill("")
    page.until("document.querySelector('.empty button')")  # nothing is open yet
    names = tabbed(page)
    in_order(names, "Where is the", "Ask", "Perception", "Choose a file", "Belief")
    assert not {"Another file", "Panorama from inside", "Zoom in"} & set(names), "of use to nobody yet"
    with page.expect_file_chooser() as chooser:
        page.get_by_role("button", name="Choose a file").press("Enter")
    chooser.value.set_files(str(studio.picture))
    page.until("window.eagorStudio.store.scene === null && window.eagorStudio.store.panorama")  # nothing is asked yet
    page.get_by_label("Perception").select_option("colour")
    page.get_by_label("Where is the").fill("red ball")
    page.keyboard.press("Enter")
    assert away(answer(page), 40) < 6
    in_order(tabbed(page), "Ask", "Another file", "Panorama from inside", "Zoom in", "Belief")
    page.get_by_role("button", name="Newest look", exact=True).click()
    page.until("window.eagorStudio.store.showsEvidence")
    page.at_rest()
    page.kept("newest-look")
    page.get_by_role("button", name="Newest look", exact=True).click()
    assert serious(page) == []
    page.kept("picture")


def test_what_is_no_picture_is_refused_in_words(studio: Studio, tmp_path: Path) -> None:
    page = go(studio, "picture")
    (tmp_path / "note.png").write_text("no picture")
    page.set_input_files("#file", str(tmp_path / "note.png"))
    page.until("document.querySelector('[role=alert]')")
    assert len(page.locator("[role=alert]").inner_text()) > 20
    page.errors[:] = [error for error in page.errors if "status of 4" not in error]


def test_the_page_is_small_and_asks_only_its_server(studio: Studio) -> None:
    page = studio.page
    assert page.errors == []
    own = f"//{studio.served.host}"
    assert all(url.startswith(("data:", "blob:")) or url.split(":", 1)[1].startswith(own) for url in page.asked)
    size = page.evaluate(
        "performance.getEntriesByType('resource').filter(({ name }) => name.includes('/assets/'))"
        ".reduce((sum, one) => sum + one.decodedBodySize, 0)"
    )
    assert 10_000 < size < 900_000


@pytest.mark.slow
def test_a_server_that_goes_is_said_so(studio: Studio) -> None:
    page = go(studio, "walk")
    page.until("window.eagorStudio.store.step")
    studio.served.process.terminate()
    page.until("document.querySelector('.problems').textContent.includes('does not answer')")
    assert page.get_by_role("button", name="Try now").count() == 1

"""The studio's page as a person sees it, from a file: what is drawn is where the maths says, by hand and by keys."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from eagor.sphere import angular_distance, direction
from tests.studio_pages import (
    BELIEF,
    POSES,
    STEPS,
    Watched,
    browser,
    exported,
    in_order,
    known_episode,
    need_browser,
    serious,
    tabbed,
)

pytestmark = pytest.mark.xdist_group("real time")


@pytest.fixture(scope="module")
def open_page() -> Iterator[Callable[..., Watched]]:
    need_browser()
    with browser() as opened:
        yield opened


@pytest.fixture(scope="module")
def page(open_page: Callable[..., Watched], tmp_path_factory: pytest.TempPathFactory) -> Watched:
    found = open_page(color_scheme="dark")
    found.goto(exported(tmp_path_factory.mktemp("studio") / "page.html", known_episode()).as_uri())
    found.until("window.eagorStudio?.store.drawn")
    found.until("window.eagorStudio.summary.border")
    # It opens with the answer in view: the end of the episode.
    found.until(f"window.eagorStudio.store.now === {STEPS - 1}")
    assert math.degrees(float(angular_distance(gaze(found), BELIEF.mode()))) < 0.5
    found.locator("input[type=range]").first.fill("0")
    found.until("window.eagorStudio.store.now === 0")
    return found


def gaze(page: Watched) -> np.ndarray:
    """Where the view looks, in the world's axes, which it holds to."""
    told = page.summary()
    return direction(math.radians(told["yaw_deg"]), math.radians(told["pitch_deg"]))


def pixels(page: Watched, place: str) -> np.ndarray:
    """What an element shows ``(H, W, 3)``."""
    page.at_rest()
    return np.asarray(Image.open(io.BytesIO(page.locator(place).screenshot())).convert("RGB")).astype(float)


def press(page: Watched, *names: str) -> None:
    for name in names:
        page.get_by_role("button", name=name, exact=True).click()


def test_the_page_has_no_errors_and_asks_nobody(page: Watched) -> None:
    assert page.errors == []
    assert all(url.startswith(("file:", "data:", "blob:")) for url in page.asked)


def test_the_heat_is_brightest_where_the_belief_has_its_mode(page: Watched) -> None:
    page.evaluate("window.eagorStudio.stage.zoom(1)")
    marks = ("90 % region", "Answer", "Candidates", "Truth")
    press(page, *marks)
    glow = pixels(page, ".flat-frame")
    press(page, "Belief")
    without = pixels(page, ".flat-frame")
    press(page, "Belief", *marks)
    # What the heat added; only a blurred maximum counts, not one pixel.
    from scipy import ndimage

    added = ndimage.gaussian_filter((glow - without)[..., 1], 2)
    height, width = (int(size) for size in glow.shape[:2])
    row, column = divmod(int(np.argmax(added)), width)
    azimuth, elevation = math.pi - 2 * math.pi * (column + 0.5) / width, math.pi / 2 - math.pi * (row + 0.5) / height
    level = math.cos(elevation)
    shown = np.array([level * math.cos(azimuth), level * math.sin(azimuth), math.sin(elevation)])
    assert math.degrees(float(angular_distance(POSES[0] @ shown, BELIEF.mode()))) < 1.5


def test_dragging_keeps_what_was_grabbed_under_the_pointer(page: Watched) -> None:
    page.evaluate("window.eagorStudio.stage.lookAt([1, 0, 0])")
    box, before = page.locator(".look").bounding_box(), page.summary()
    assert box is not None
    focal = box["height"] / 2 / math.tan(math.radians(before["field_deg"]) / 2)
    across, middle = 220.0, (box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    seen = pixels(page, ".look .scene")
    page.mouse.move(*middle)
    page.mouse.down()
    page.mouse.move(middle[0] + across, middle[1], steps=4)
    page.mouse.up()
    after = page.summary()
    # A drag to the right turns the view to the left by the angle of these pixels.
    assert after["yaw_deg"] - before["yaw_deg"] == pytest.approx(math.degrees(math.atan(across / focal)), abs=0.3)
    assert after["pitch_deg"] == pytest.approx(before["pitch_deg"], abs=0.3)
    # And the picture has moved along: what was in the middle is now under the pointer.
    moved = pixels(page, ".look .scene")
    half = 40
    row, column = round(box["height"] / 2), round(box["width"] / 2)
    patch = seen[row - half : row + half, column - half : column + half]
    away = {}
    for shift in range(round(across) - 120, round(across) + 121, 4):
        there = moved[row - half : row + half, column + shift - half : column + shift + half]
        away[shift] = float(np.abs(there - patch).mean())
    assert abs(min(away, key=away.__getitem__) - across) <= 12


def test_the_belief_stays_with_the_world_while_the_camera_turns(page: Watched) -> None:
    page.locator("input[type=range]").first.fill(str(STEPS - 1))
    page.until(f"window.eagorStudio.store.now === {STEPS - 1}")
    page.at_rest()
    told = page.locator(".sentence").inner_text()
    turned = math.degrees(math.atan2(*(np.asarray(BELIEF.mode()) @ POSES[-1])[[1, 0]]))
    assert told.startswith(f"{round(turned)}° left")
    page.kept("export-last-step")


def test_everything_can_be_done_by_keyboard(page: Watched) -> None:
    page.evaluate("window.eagorStudio.stage.lookAt([1, 0, 0])")
    in_order(tabbed(page), "Skip", "Panorama from inside", "Zoom in", "Play", "Step", "Belief")
    page.locator(".look").focus()
    before = page.summary()
    for key in ("ArrowLeft", "ArrowLeft", "ArrowUp", "+"):
        page.keyboard.press(key)
    after = page.summary()
    assert after["yaw_deg"] - before["yaw_deg"] == pytest.approx(10)
    assert after["pitch_deg"] - before["pitch_deg"] == pytest.approx(5)
    assert after["field_deg"] < before["field_deg"]
    page.keyboard.press("Home")
    page.get_by_role("button", name="Play").focus()
    page.keyboard.press("Enter")
    page.until(f"window.eagorStudio.store.now === {STEPS - 1}")


def test_plots_are_told_in_words(page: Watched) -> None:
    page.until("document.getElementById('polar-text').textContent.includes('densest')")
    page.until("document.getElementById('plan-text').textContent.includes('walked 1.6 m')")
    assert "Presence: 90 % at first" in page.locator("#series-text").text_content()
    assert "You look" in page.locator("#stage-looking").text_content()


def test_a_graphics_driver_that_starts_anew_is_survived(page: Watched) -> None:
    before = pixels(page, ".flat-frame")
    page.evaluate("""() => Promise.all(Array.from(document.querySelectorAll("canvas"), (canvas) => {
        const lost = canvas.getContext("webgl2")?.getExtension("WEBGL_lose_context");
        if (!lost) return null;
        const back = new Promise((done) => canvas.addEventListener("webglcontextrestored", done, { once: true }));
        lost.loseContext();
        return new Promise((done) => setTimeout(done, 200)).then(() => lost.restoreContext()).then(() => back);
    }))""")
    assert np.abs(pixels(page, ".flat-frame") - before).mean() < 0.5
    assert page.errors == []


def test_axe_finds_nothing_serious_in_both_schemes(page: Watched) -> None:
    assert serious(page) == []
    page.emulate_media(color_scheme="light")
    assert serious(page) == []
    page.at_rest()
    page.kept("export-light")
    page.emulate_media(color_scheme="dark")


@pytest.mark.slow
def test_a_phone_has_it_all_below_each_other(open_page: Callable[..., Watched], page: Watched) -> None:
    phone = open_page(390, 844, color_scheme="dark", device_scale_factor=2, has_touch=True, is_mobile=True)
    phone.goto(page.url)
    phone.until("window.eagorStudio?.store.drawn")
    assert phone.evaluate("document.documentElement.scrollWidth") <= 390
    small = phone.evaluate(
        "[...document.querySelectorAll('button, select, summary')].filter((one) => one.offsetParent)"
        ".filter((one) => { const box = one.getBoundingClientRect(); return box.width < 32 || box.height < 30; })"
        ".map((one) => one.outerHTML.slice(0, 80))"
    )
    assert small == []
    before = phone.summary()["yaw_deg"]
    touch = phone.context.new_cdp_session(phone.page)
    box = phone.locator(".look").bounding_box()
    assert box is not None
    y, x = box["y"] + box["height"] / 2, box["x"] + 150
    for kind, at in (("touchStart", x), ("touchMove", x + 40), ("touchMove", x + 80), ("touchEnd", None)):
        points = [] if at is None else [{"x": at, "y": y}]
        touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
    assert phone.summary()["yaw_deg"] - before > 10
    phone.kept("export-phone", full_page=True)
    assert phone.errors == []
    phone.context.close()


def test_an_episode_that_cannot_be_read_is_said_so(open_page: Callable[..., Watched], tmp_path: Path) -> None:
    broken = open_page()
    broken.goto(exported(tmp_path / "broken.html", {"steps": "none"}).as_uri())
    broken.until("document.querySelector('[role=alert]')?.textContent.includes('could not be read')")
    broken.context.close()

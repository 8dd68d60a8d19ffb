"""A browser on the studio's page: Debian's Chromium, driven by Playwright; and an episode whose belief is known."""

from __future__ import annotations

import base64
import io
import json
import math
import os
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from eagor import Belief
from eagor.drawing.heat import heat_of
from eagor.grids import ErpGrid
from eagor.harmonics import RealHarmonics
from eagor.sphere import azimuth_elevation, direction, world_R_body

CHROMIUM = next((path for name in ("chromium", "chromium-browser") if (path := shutil.which(name))), None)
PICTURES = Path("runs/studio-page")  # screenshots, to be looked at
STATIC = Path(str(files("eagor.studio") / "static"))
AXE = Path(__file__).parent.parent / "studio/node_modules/axe-core/axe.min.js"
PATIENCE = 200.0  # seconds: a busy machine draws slowly
MARK = '<script type="application/json" id="episode"></script>'


def need_browser() -> None:
    """Skip, and say why, where there is no browser or no page."""
    pytest.importorskip("playwright.sync_api", reason="Playwright is not installed: pip install playwright")
    if CHROMIUM is None:
        pytest.skip("no Chromium to look at the page with: apt-get install chromium")
    if not (STATIC / "index.html").is_file():
        pytest.skip("the page is not built: npm ci && npm run build in studio/")


class Watched:
    """A page, with what went wrong in it and what it asked for."""

    def __init__(self, page: Any) -> None:
        self.page, self.errors, self.asked = page, [], []
        page.set_default_timeout(1000 * PATIENCE)
        page.on("console", lambda told: told.type == "error" and self.errors.append(told.text))
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.on("request", lambda request: self.asked.append(request.url))
        page.on("websocket", lambda socket: self.asked.append(socket.url))

    def __getattr__(self, name: str) -> Any:
        return getattr(self.page, name)

    def until(self, script: str, seconds: float = PATIENCE) -> Any:
        """Wait until `script` gives something true (the page's policy forbids Playwright's own way to wait for it)."""
        end = time.monotonic() + seconds
        while not (found := self.page.evaluate(script)):
            assert time.monotonic() < end, f"never true: {script}; errors: {self.errors}; {self.said()}"
            self.page.wait_for_timeout(50)
        return found

    def said(self) -> str:
        """What the page shows and says, for the messages of tests."""
        return f"{self.summary()}; {self.page.locator('#studio').inner_text()[:1000]!r}"

    def summary(self) -> dict[str, Any]:
        """What the page shows, in numbers."""
        return self.page.evaluate("window.eagorStudio.summary")

    def at_rest(self) -> None:
        """Wait until the newest change is drawn with all pixels; a machine too busy for that is asked again."""
        end = time.monotonic() + PATIENCE
        while self.until("window.eagorStudio.summary.rests") and self.summary()["drawn"] < 1:
            assert time.monotonic() < end, f"never drawn finely: {self.summary()}"
            self.page.evaluate("window.eagorStudio.store.emit('style')")

    def kept(self, name: str, **options: Any) -> Path:
        """A screenshot under `name`."""
        PICTURES.mkdir(parents=True, exist_ok=True)
        path = PICTURES / f"{name}.png"
        self.page.screenshot(path=str(path), timeout=1000 * PATIENCE, **options)
        return path


@contextmanager
def browser() -> Iterator[Callable[..., Watched]]:
    """A browser; what it gives opens a page in a fresh context with the options of Playwright's `new_context`."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        launched = playwright.chromium.launch(
            executable_path=CHROMIUM, args=["--no-sandbox"] if os.geteuid() == 0 else [], timeout=1000 * PATIENCE
        )

        def opened(width: int = 1280, height: int = 800, **options: Any) -> Watched:
            return Watched(launched.new_context(viewport={"width": width, "height": height}, **options).new_page())

        yield opened
        launched.close()


_FOCUSED = """(() => {
    const one = document.activeElement;
    if (one === document.body) return null;
    const box = one.getBoundingClientRect();
    const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
    const top = document.elementFromPoint(x, y), style = getComputedStyle(one);
    const name = one.getAttribute("aria-label") || one.labels?.[0]?.textContent || one.textContent.trim();
    return [(name || one.tagName).slice(0, 60), {
        "has no outline": style.outlineStyle === "none" && !one.matches(".segments input"),
        "is out of view": !top,
        "is covered": top && !one.contains(top) && !one.closest("label")?.contains(top),
        "is too small": box.width < 16 || box.height < 16,
    }];
})()"""


def tabbed(page: Watched) -> list[str]:
    """What the Tab key reaches, from the page's beginning to its end; all of it can be seen when it has the focus."""
    page.evaluate("(() => { document.activeElement?.blur(); window.scrollTo(0, 0); })()")
    page.locator(".skip").focus()
    for key in ("Tab", "Shift+Tab"):  # a focus that comes by keys is shown, whatever was done before
        page.keyboard.press(key)
    names: list[str] = []
    while (told := page.evaluate(_FOCUSED)) is not None:
        wrong = [what for what, holds in told[1].items() if holds]
        assert not wrong, f"{told[0]!r} {wrong}"
        names.append(told[0])
        assert len(names) < 90, f"the focus is trapped: {names[-10:]}"
        page.keyboard.press("Tab")
    return names


def in_order(names: list[str], *wanted: str) -> None:
    """Fail unless names with these beginnings are there, in this order."""
    left = iter(names)
    for each in wanted:
        assert any(name.startswith(each) for name in left), f"{each!r} is not reached, or too early: {names}"


def serious(page: Watched) -> list[str]:
    """What axe-core finds that is serious or worse."""
    if not AXE.is_file():
        pytest.skip("axe-core is not installed: npm ci in studio/")
    page.evaluate(AXE.read_text(encoding="utf-8") + "; 0")
    found = page.evaluate("axe.run(document, {resultTypes: ['violations']})")
    return [
        f"{one['id']}: {one['help']} ({', '.join(node['html'][:120] for node in one['nodes'][:3])})"
        for one in found["violations"]
        if one["impact"] in ("serious", "critical")
    ]


# --- an episode with a known belief ---

DEGREE = 15
STEPS = 6
POSES = [world_R_body(math.radians(10 * step)) for step in range(STEPS)]


def bump(azimuth: float, elevation: float, height: float, width: float) -> np.ndarray:
    """Coefficients ``((DEGREE + 1)^2,)`` of a Gaussian-like bump in the log density, degrees."""
    basis = RealHarmonics(DEGREE)
    grid = basis.quadrature()
    angle = np.arccos(np.clip(grid.directions @ direction(math.radians(azimuth), math.radians(elevation)), -1, 1))
    return basis.analyse(height * np.exp(-0.5 * (angle / math.radians(width)) ** 2), grid)


BELIEF = Belief(bump(64, 22, 6.5, 16) + bump(-60, -12, 4.6, 14) + bump(150, -30, 2.0, 25))


def known_episode() -> dict[str, Any]:
    """An EPISODE of a camera that turns left by 10 degrees a step, with `BELIEF` in the axes of the world."""
    heat = heat_of(BELIEF)
    assert heat is not None
    glow = Image.fromarray(np.rint(255 * heat.contrast**2 * heat.share).astype(np.uint8))
    mode, entropy = np.asarray(BELIEF.mode()), float(BELIEF.entropy())
    steps = []
    for index, pose in enumerate(POSES):
        body = mode @ pose
        azimuth, elevation = (math.degrees(float(angle)) for angle in azimuth_elevation(body))
        estimate = {
            "direction": body.tolist(), "azimuth_deg": azimuth, "elevation_deg": elevation, "credible_angle_deg": 30.0,
            "presence": 0.9, "entropy": entropy, "distance_m": 2.5 - 0.2 * index, "distance_spread": 0.3, "sure": 0.8,
            "moving": None, "status": "tracking",
            "modes": [{"azimuth_deg": azimuth, "elevation_deg": elevation, "weight": 0.6}],
        }  # fmt: skip
        step: dict[str, Any] = {
            "stamp": 0.5 * index, "world_R_camera": pose.reshape(-1).tolist(),
            "position": [0.3 * index, 0.1 * index, 1.2],
            "look": {"age": 0.1, "fresh": True}, "estimate": estimate, "around": around(pose), "truth": body.tolist(),
            "error_deg": 4.0 - 0.3 * index,
            "methods": {"eagor": {"estimate": estimate, "error_deg": 4.0},
                        "centroid": {"estimate": {"direction": [1, 0, 0]}, "error_deg": 40.0}},
        }  # fmt: skip
        if index == 0:  # what does not change is not repeated
            step["belief"] = {"border": [line.tolist() for line in heat.border], "undrawn": "", "url": as_url(glow)}
            step["panorama"] = {"stamp": 0.0, "world_R_camera": pose.reshape(-1).tolist(), "url": as_url(chequered())}
        steps.append(step)
    scene = {
        "title": "a known belief", "query": "white sofa", "targets": [], "region": 0.9, "method": "eagor", "paths": {},
        "plan": {"walls": [[[-1, -2], [4, -2], [4, 2], [-1, 2], [-1, -2]]], "floor": [], "things": []},
        "methods": [{"name": "eagor", "words": "our tracker"}, {"name": "centroid", "words": "the centroid"}],
    }  # fmt: skip
    return {"scene": scene, "steps": steps}


def around(pose: np.ndarray) -> list[float]:
    """`BELIEF` by azimuth in the camera's frame."""
    grid = ErpGrid(64, 128)
    mass = np.exp(BELIEF.log_density(grid.directions @ pose.T)) * grid.weights
    return np.roll(mass.sum(axis=0).reshape(64, 2).sum(axis=1)[::-1], 32).tolist()


def chequered() -> Image.Image:
    """A grey panorama with a field every 15 degrees."""
    grid = ErpGrid(256, 512)
    azimuth, elevation = np.degrees(grid.longitudes)[None, :], np.degrees(grid.latitudes)[:, None]
    grey = 96 + 24 * ((np.floor(azimuth / 15) + np.floor(elevation / 15)) % 2)
    return Image.fromarray(np.repeat(grey[..., None], 3, axis=2).astype(np.uint8))


def as_url(image: Image.Image) -> str:
    file = io.BytesIO()
    image.save(file, "PNG")
    return f"data:image/png;base64,{base64.b64encode(file.getvalue()).decode()}"


def exported(path: Path, episode: dict[str, Any]) -> Path:
    """The one-file page of an episode."""
    page = (STATIC / "export.html").read_text(encoding="utf-8")
    assert page.count(MARK) == 1
    told = json.dumps(episode, allow_nan=False).replace("<", "\\u003c")
    path.write_text(page.replace(MARK, MARK.replace("></", f">{told}</")), encoding="utf-8")
    return path

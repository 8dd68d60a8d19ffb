"""The studio's tour: how it is chosen, and a picture of it.

    python docs/figures/studio.py choose --seeds 16    the rule below, on development seeds 0, 1, ...
    python docs/figures/studio.py picture [OUT.webp]   the page at the far end of the walk (needs Chromium, Playwright)

The rule. In each apartment, of each thing that the scout knows and that has a name of its own: the walk begins at the
roomiest place that is 1.5 to 3 m from the thing and sees it, and leads by the shortest way to a place from which a wall
hides it. Of all such ways of 4 to 8 m on which the thing is in sight for the first 1.5 m and behind a wall for the last
2.5 m, it takes the shortest. The scout looks once a second. The studio shows an apartment that has such a walk,
with its first such thing, where every half second from the third look on, there and on the way back, the 90 % region
that is drawn held the thing's centre, the status was "tracking" and the answer at most 15 degrees off.
"""

from __future__ import annotations

import argparse
import io
import itertools
import json
import math
import shutil
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from PIL import Image

from eagor.errors import EagorError
from eagor.lab.envs.place_env import MobileBase
from eagor.lab.envs.places import APARTMENT, Place, load_place, pixels_of
from eagor.lab.envs.rules import Camera
from eagor.lab.tasks.sim.navigation import distance_to_box
from eagor.lab.tasks.sim.walk import FINE_ROWS, Walker, walled
from eagor.lab.worlds.navmesh import along, length_of
from eagor.perception.scout import ScoutPerception
from eagor.sphere import angular_distance
from eagor.tracking import TrackerConfig
from eagor.tracking.refresh import Follower

NEAR, FAR = 1.5, 3.0  # metres from the thing at first
SHORTEST, LONGEST = 4.0, 8.0  # metres of walking
SEEN, HIDDEN = 1.5, 2.5  # metres in sight at first, out of sight at last
ROOM = 0.35  # metres of clearance
STEP, ASK, LOOK, STANDS = 0.1, 0.5, 1.0, 6.0  # seconds: a step, between answers, between looks, standing at the end
OFF = 15.0  # degrees
TRIES = 40  # ends of ways
MASS = 0.9  # of the region


def in_sight(place: Place, target: int, xy: np.ndarray) -> bool:
    """Whether the camera sees the thing from there: two pixels of 64 x 128, as in the tasks."""
    return pixels_of(place.ids(place.eye(xy, 1.25), np.eye(3)), (target,)) >= 2


def way_of(place: Place, target: int) -> np.ndarray | None:
    """The walk of the rule to a thing: a path ``(n, 2)``, or None."""
    thing, ground = place.scene.instances[target], place.ground
    points = ground.points
    col, row = np.floor((points - ground.origin) / ground.cell).astype(int).T
    room = ground.clearance[row, col]
    away = distance_to_box(points, thing.low[:2], thing.high[:2])
    roomy = np.flatnonzero((away >= NEAR) & (away <= FAR) & (room >= ROOM))
    begin = next((points[k] for k in roomy[np.argsort(-room[roomy], kind="stable")][:TRIES]
                  if in_sight(place, target, points[k])), None)  # fmt: skip
    if begin is None:
        return None
    metres = ground.at_points(ground.field(begin))
    ends = np.flatnonzero((metres >= SHORTEST) & (metres <= LONGEST) & (room >= ROOM))
    ends = ends[np.argsort(metres[ends], kind="stable")]
    for k in ends[:: max(1, len(ends) // TRIES)]:
        if in_sight(place, target, points[k]):
            continue
        way = ground.path(begin, points[k])
        length = length_of(way)
        first = along(way, np.arange(0.0, SEEN + 0.01, 0.5))
        last = along(way, np.arange(length - HIDDEN, length, 0.25))
        if (
            length >= SHORTEST
            and all(in_sight(place, target, xy) for xy in first)
            and all(walled(ground, xy, thing.centre[:2]) and not in_sight(place, target, xy) for xy in last)
        ):
            return way
    return None


@dataclass
class Walked:
    """What was said every half second from the third look on: region right, thing hidden, tracking; errors, degrees."""

    held: list[bool] = field(default_factory=list)
    hidden: list[bool] = field(default_factory=list)
    tracking: list[bool] = field(default_factory=list)
    errors: list[float] = field(default_factory=list)

    @property
    def right(self) -> bool:
        """Whether the rule takes it."""
        return all(self.held) and all(self.tracking) and max(self.errors) <= OFF


def played(place: Place, target: int, way: np.ndarray, query: str) -> Walked:
    """Walk there and back."""
    scout, follower, found = ScoutPerception(), Follower(TrackerConfig()), Walked()
    thing = np.asarray(place.scene.instances[target].centre)
    ahead = thing[:2] - way[0]
    body = MobileBase(place.ground, way[0], math.atan2(ahead[1], ahead[0]))
    walker = Walker(body, "tour", [*way[1:], *way[::-1]])
    known, stood = None, 0.0
    for number in itertools.count():
        stamp, here, pose = number * STEP, body.pose.position, body.pose.world_R_body
        follower.move(stamp, pose, here)
        if number % round(LOOK / STEP) == 0:
            seen = place.renderer.panorama(here, pose, scout.rows, range=False, ids=False).rgb
            assert seen is not None
            follower.observe(scout(seen, query, stamp=stamp))
        if number % round(ASK / STEP) == 0 and stamp > 2 * LOOK:
            estimate = follower.estimate(stamp)
            known = estimate.direction
            assert known is not None
            d = pose.T @ (thing - here) / np.linalg.norm(thing - here)
            found.held.append(estimate.mass_above(d) <= MASS)
            found.hidden.append(not in_sight(place, target, here[:2]))
            found.tracking.append(estimate.status == "tracking")
            found.errors.append(math.degrees(float(angular_distance(known, d))))
        walker.move(STEP, known, False)
        stood = (
            0.0
            if not (np.array_equal(body.pose.position, here) and np.array_equal(body.pose.world_R_body, pose))
            else stood + STEP
        )
        if stood > STANDS and not walker.way:
            return found
    return found


def choose(seeds: int) -> None:
    """Print what the rule finds in each apartment."""
    known = set(ScoutPerception().categories)
    for seed in range(seeds):
        try:
            place = load_place(APARTMENT, seed, Camera().radius)
        except EagorError as error:
            print(f"{seed}: {error}")
            continue
        for target, query in sorted(place.nameable().items()):
            if query.category not in known or (way := way_of(place, target)) is None:
                continue
            found = played(place, target, way, str(query))
            parts = [f"{100 * np.mean(each):.0f} %" for each in (found.held, found.hidden, found.tracking)]
            points = " ".join(f"{x:.2f},{y:.2f}" for x, y in way)
            print(
                f"{seed}: {query}, {length_of(way):.1f} m; region right {parts[0]}, hidden {parts[1]}, tracking "
                f"{parts[2]}, at most {max(found.errors):.1f} degrees off{': right' if found.right else ''}; {points}",
                flush=True,
            )
            break
        else:
            print(f"{seed}: no such walk", flush=True)


WIDTH, HEIGHT, SHARP = 1400, 875, 1.5  # of the picture: CSS pixels, and pixels for each
HIDDEN_FOR = 8.0  # seconds
QUALITY = 80
SHOWN = "window.eagorStudio?.store"


def picture(out: Path) -> None:
    """Start the studio as a visitor does, pause at the far end of the first walk, and keep what the page shows."""
    from playwright.sync_api import sync_playwright

    command = [sys.executable, "-m", "eagor", "studio", "--port", "0", "--json"]
    browser = next(path for name in ("chromium", "chromium-browser") if (path := shutil.which(name)))
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server, sync_playwright() as playwright:
        try:
            assert server.stdout is not None
            address = json.loads(server.stdout.readline())["address"]
            chromium = playwright.chromium.launch(executable_path=browser, args=["--no-sandbox"])
            size = {"width": WIDTH, "height": HEIGHT}
            page = chromium.new_page(viewport=size, device_scale_factor=SHARP, color_scheme="dark")  # type: ignore[arg-type]
            page.goto(address)

            def until(condition: str) -> None:
                while not page.evaluate(condition):
                    page.wait_for_timeout(100)

            until(f"(({SHOWN}?.step?.goal?.words ?? '').match(/hidden .* for (\\d+) s/)?.[1] ?? 0) >= {HIDDEN_FOR}")
            page.get_by_role("button", name="Pause").click()
            until(f"{SHOWN}.panorama.image.width >= {2 * FINE_ROWS} && window.eagorStudio.summary.rests")
            page.wait_for_timeout(1000)
            shot = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
            chromium.close()
        finally:
            server.terminate()
    shot.save(out, quality=QUALITY, method=6)
    print(f"{out}: {shot.width} x {shot.height}, {out.stat().st_size / 1e3:.0f} kB")


def main() -> int:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("choose", "picture"))
    parser.add_argument("out", nargs="?", type=Path, default=Path(__file__).parents[1] / "images" / "studio.webp")
    parser.add_argument("--seeds", type=int, default=20)
    given = parser.parse_args()
    if given.what == "choose":
        choose(given.seeds)
    else:
        picture(given.out)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

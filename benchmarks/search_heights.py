"""Does the search find what lies high or low, with a perfect detector, a noisy one, and one that sees pictures?

    python benchmarks/search_heights.py [--split dev|report] [--scenes 30] [--looks 1] [--samples DIR] [--indoors 0]
                                        [--set tilt=35 ...] [--agents eagor centroid sweep] [--json FILE]

Episodes of H*Bench's kind (ten views of 100 degrees, strict success). The sets:

- balls: coloured balls before a grey wall, 2.5 to 5 degrees in radius, whose elevations are even from -65 to 55
  degrees; three in each scene, each searched for from three starts. The perceptions: `truth:ideal` (no errors), `truth`
  (30 % misses, a false alarm in every fifth view, 8 degrees of error), and `colour`, which sees the pictures.
- photographs: the labelled ones in the folder --samples, among them a chandelier; with both kinds of `truth`.
- indoors: --indoors apartments, in which rugs, ceiling lamps, paintings, books and vases are targets, too.

All agents have the same luck. Brackets are 95 % bootstrap intervals over targets. For each rival the paired difference
in points, ours minus its own, with its interval: a rival is ahead beyond chance where the interval lies below 0.
"""

from __future__ import annotations

import os

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[name] = "1"

import argparse
import json
import math
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from search import FIRST, LUCK, interval, line

from eagor.grids import ErpGrid
from eagor.sphere import angular_distance, direction
from eagor.statistics import paired_difference
from eagor.tasks.hstar import apartments
from eagor.tasks.hstar.data import Episode, read_episodes
from eagor.tasks.hstar.perception import open_eye, open_perception
from eagor.tasks.hstar.play import make_agent, play
from eagor.tasks.hstar.search import SearchRules
from eagor.tasks.places import Place

AGENTS = ("eagor", "centroid", "sweep")
COLOURS = {"red": (205, 30, 35), "green": (30, 150, 60), "blue": (35, 70, 205), "yellow": (230, 205, 40)}
ELEVATIONS = (-65.0, 55.0)
STARTS = (0, 120, 240)
ROWS = 360  # of a ball scene's picture
SEEN = 270  # rows of the views that `colour` sees


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--split", choices=FIRST, default="dev")
    parser.add_argument("--scenes", type=int, default=30, help="with balls; 0: none")
    parser.add_argument("--looks", type=int, default=1, help="repetitions of episodes with truth, with other luck")
    parser.add_argument("--samples", type=Path, help="a folder in H*Bench's layout, such as hstar_mini")
    parser.add_argument("--indoors", type=int, default=0, help="apartments")
    parser.add_argument("--folder", type=Path, help="keep the scenes here")
    parser.add_argument("--agents", nargs="+", default=AGENTS)
    parser.add_argument("--perceptions", nargs="+", default=("truth:ideal", "truth", "colour"))
    parser.add_argument("--set", nargs="+", default=(), metavar="RULE=VALUE", help="of our agent (SearchRules)")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    kinds = {field.name: type(field.default) for field in fields(SearchRules)}
    given = (pair.split("=") for pair in options.set)
    rules = replace(SearchRules(), **{key: kinds[key](value) for key, value in given})
    found: dict[str, Any] = {"split": options.split, "rows": {}}
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        sets: dict[str, list[Episode]] = {}
        if options.scenes:
            sets["balls"] = balls(folder / f"balls_{options.split}", FIRST[options.split], options.scenes)
        if options.samples:
            sets["photographs"] = read_episodes(options.samples, "hos")
        if options.indoors:
            sets["indoors"] = indoors(folder / f"indoors_{options.split}", FIRST[options.split], options.indoors)
        for name, episodes in sets.items():
            for perception in options.perceptions:
                if perception == "colour" and name != "balls":
                    continue  # what it cannot name
                looks = 1 if perception in ("colour", "truth:ideal") else options.looks
                print(f"\n{name}, {perception}, {options.split}: {len(episodes)} episodes, {looks} times each")
                runs = {
                    agent: played(agent, episodes, perception, rules, looks, LUCK[options.split])
                    for agent in options.agents
                }
                found["rows"][f"{name} {perception}"] = told(runs)
    if options.json:
        options.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    return 0


def played(
    agent: str, episodes: Sequence[Episode], perception: str, rules: SearchRules, looks: int, luck: int
) -> list[dict[str, Any]]:
    """The records of an agent, over all episodes and repetitions."""
    opened, records = open_perception(perception), []
    for repetition in range(looks):
        for episode in episodes:
            eye = open_eye(opened, episode, luck + repetition, SEEN)
            records.append(play(episode, make_agent(agent, episode, eye, rules, 10, 0), "strict"))
    print(f"  {agent:9s} {line(records)}", flush=True)
    return records


def told(runs: dict[str, list[dict[str, Any]]]) -> dict[str, Any]:
    """Success of each agent with its interval, and our lead over each rival, in points."""
    scores = {agent: [record["score"] for record in records] for agent, records in runs.items()}
    found: dict[str, Any] = {
        agent: {"success": 100 * float(np.mean(scores[agent])), "interval": interval(scores[agent], records)}
        for agent, records in runs.items()
    }
    for agent, records in runs.items():
        if agent == "eagor" or "eagor" not in runs:
            continue
        groups = [record["cluster"] for record in records]
        lead = paired_difference(scores["eagor"], scores[agent], np.random.default_rng(0), groups=groups)
        ends = 100 * lead.interval.low, 100 * lead.interval.high
        found[agent]["lead"] = [100 * lead.difference, *ends, lead.p]
        ahead = "  AHEAD OF US" if ends[1] < 0 else ""
        said = f"{100 * lead.difference:+.1f} points ({ends[0]:.1f} to {ends[1]:.1f}), p = {lead.p:.3f}"
        print(f"  ours minus {agent}: {said}{ahead}")
    return found


def balls(folder: Path, first: int, count: int) -> list[Episode]:
    """The episodes of so many scenes with three balls each."""
    for seed in range(first, first + count):
        scene = folder / "hos_bench" / f"balls_{seed:04d}"
        if not scene.exists():
            scene.mkdir(parents=True)
            items = ball_scene(scene / "balls.png", np.random.default_rng([seed, 0xBA11]))
            (scene / "annotation.json").write_text(json.dumps(items), encoding="utf-8")
    wanted = {f"balls_{seed:04d}" for seed in range(first, first + count)}
    return [episode for episode in read_episodes(folder, "hos") if episode.scene in wanted]


def ball_scene(picture: Path, rng: np.random.Generator) -> list[dict[str, Any]]:
    """Draw a scene; returns the entries of its annotation.json."""
    grid, items = ErpGrid(ROWS, 2 * ROWS), []
    image = np.repeat(rng.normal(150, 4, grid.shape)[..., None], 3, axis=-1)
    image *= (1 + 0.25 * np.asarray(grid.latitudes))[:, None, None]  # lighter towards the ceiling
    colours = rng.permutation(sorted(COLOURS))[:3]
    for colour, turn in zip(
        colours, rng.permutation(3) * 120 + rng.uniform(-40, 40, 3) + rng.uniform(0, 360), strict=True
    ):
        pitch, radius = rng.uniform(*ELEVATIONS), rng.uniform(2.5, 5.0)
        middle = direction(-math.radians(turn), math.radians(pitch))
        away = np.degrees(angular_distance(grid.directions, middle))
        image[away <= radius] = (
            np.array(COLOURS[str(colour)]) * (1 - 0.4 * (away[away <= radius] / radius) ** 2)[:, None]
        )
        half = math.degrees(math.asin(math.sin(math.radians(radius)) / math.cos(math.radians(pitch))))
        yaw = [round((turn - half) % 360, 2), round((turn + half) % 360, 2)]
        box = {"yaw": yaw, "pitch": [round(pitch - radius, 2), round(pitch + radius, 2)]}
        items.append(
            {"task": f"Find the {colour} ball", **box, "initial yaw": list(STARTS), "level": [0] * len(STARTS)}
        )
    Image.fromarray(np.clip(image, 0, 255).astype(np.uint8)).save(picture)
    return items


def indoors(folder: Path, first: int, count: int) -> list[Episode]:
    """The episodes of so many apartments, with what hangs and lies as targets, too."""
    for seed in range(first, first + count):
        if not (folder / "hos_bench" / f"apartment_{seed:04d}").exists():
            spot = apartments.spot(seed, most=6, named=everything)
            apartments.write_scene(spot, folder / "hos_bench", rows=0)
    return read_episodes(folder, "hos")


def everything(place: Place) -> dict[int, str]:
    """What a query can name, and what `nameable` leaves out: each thing with the only one of its category."""
    names = {index: str(query) for index, query in place.nameable().items()}
    for index, thing in enumerate(place.scene.instances):
        if thing.category in ("ceiling lamp", "rug", "painting", "vase", "book", "books"):
            names.setdefault(index, thing.category)
    return names


if __name__ == "__main__":
    sys.exit(main())

"""The three tasks in our world and in Habitat-Sim: the same apartments, episodes, methods and random numbers.

    python benchmarks/habitat_tasks.py --out FILE.jsonl [--seeds 8500 8501 ...] [--perceptions truth:moderate scout]

Needs Habitat-Sim. Episodes of each task (`--each` per apartment) are planned in our world, and played in both. Each
played episode is a line of FILE.jsonl; the same command goes on where it was stopped. Prints for each method the means
in both worlds, with 95 % intervals (Wilson's for successes, else a bootstrap over apartments), and of the paired
difference, Habitat minus ours. `--table` prints what FILE.jsonl holds, and plays nothing: that needs no Habitat-Sim.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import common
import numpy as np
from habitat_places import Both, need_habitat, opened

from eagor.errors import EagorError
from eagor.statistics import paired_difference, wilson_interval
from eagor.tasks import place_env
from eagor.tasks import task as tasks
from eagor.tasks.episodes import Episode, Slot
from eagor.tasks.places import APARTMENT, Place
from eagor.tasks.play import Player
from eagor.tasks.rules import Camera, Disturbances, as_dict

ROWS = 256  # of the panoramas that a perception sees
WORLDS = ("ours", "habitat")
TASKS = ("waypoint", "tracking", "navigation")
METHODS = ("eagor", "eagor_paper", "vmf")
SHOWN = {
    "waypoint": ("L4", "occ", "mae", "coverage"),
    "tracking": ("error", "time_lost", "coverage"),
    "navigation": ("success", "spl", "steps", "mae"),
}
SCALE = {"coverage": 100, "success": 100, "spl": 100}  # to per cent

Record = dict[str, Any]
Key = tuple[str, str, int, int]  # task, perception, seed of the apartment, index of the episode in it


def key_of(record: Record) -> Key:
    return record["task"], record["perception"], record["seed"], record["index"]


def read(file: Path) -> list[Record]:
    """The records of a file; a last line that was cut off does not count."""
    found = []
    for line in file.read_text().splitlines() if file.is_file() else []:
        try:
            found.append(json.loads(line))
        except json.JSONDecodeError:
            continue
    return found


def played(both: Both, task: str, perception: str, index: int, number: int) -> Record:
    """One episode, planned in our world and played in both.

    Starts are moved onto the mesh if they lie beside it. `WorldError` if there is no episode, or no way in one world.
    """
    kind = tasks.load(task)
    config = {"task": task, "perception": perception, "camera": as_dict(Camera()), "rows": ROWS}
    player = Player(config | {"rules": as_dict(kind.rules()), "disturbances": as_dict(Disturbances())})
    slot = Slot(task, APARTMENT, both.seed, index, number)
    _at(both.ours)
    planned = player.plan(slot)
    record: Record = {"query": planned.query, "worlds": {}}
    for world, place in zip(WORLDS, (both.ours, both.theirs), strict=True):
        _at(place)
        episode = replace(planned, scene_hash=place.scene.hash)
        if kind.walked:
            record["worlds"][world] = _walked(player, _started(episode, place))
        else:
            record["worlds"][world] = _judged(player, episode, slot)
    return record


def _at(place: Place) -> None:
    """Let the environments be in this place."""
    place_env.load_place = lambda *_: place


def _started(episode: Episode, place: Place) -> Episode:
    """The same episode from the nearest free point of this place, with the shortest way in it."""
    start = place.ground.snap(np.array(episode.start), within=0.2)
    if start is None:
        raise EagorError("the start is not on the ground of both worlds")
    way = float(place.way_to(episode.targets).distance(start))
    if not np.isfinite(way):
        raise EagorError("no way leads to the target in one of the worlds")
    return replace(episode, start=(float(start[0]), float(start[1])), shortest=way)


def _walked(player: Player, episode: Episode) -> dict[str, Any]:
    """By method: its metrics, and where it walked (metres)."""
    found = {}
    for method in METHODS:
        walk = player._walk(episode, method, None)
        found[method] = walk["metrics"] | {"path": [pose[:2] for pose in walk["trace"]["pose"]]}
    return found


def _judged(player: Player, episode: Episode, slot: Slot) -> dict[str, Any]:
    """By method: its metrics. Also in which steps the target was visible."""
    recording = player.record(episode)
    found = {method: player.judge(recording, player.method(method, slot))["metrics"] for method in METHODS}
    return found | {"visible": [int(seen) for seen in recording.truth["visible"]]}


def play_all(file: Path, seeds: list[int], each: int, names: list[str], perceptions: list[str]) -> None:
    """Play what the file does not hold yet, one apartment after the other."""
    done = {key_of(record) for record in read(file)}
    for place, seed in enumerate(seeds):
        every = [(task, perception, seed, k) for perception in perceptions for task in names for k in range(each)]
        wanted = [key for key in every if key not in done]
        if not wanted:
            continue
        with tempfile.TemporaryDirectory() as folder:
            both = opened(seed, Path(folder))
            for task, perception, _, index in wanted:
                record: Record = {"task": task, "perception": perception, "seed": seed, "index": index}
                try:
                    record |= played(both, task, perception, index, place * each + index)
                except EagorError as error:
                    record["failed"] = str(error)
                with file.open("a") as stream:
                    stream.write(json.dumps(record) + "\n")
                print(
                    f"  {task} {perception} {seed}-{index}: {record.get('failed', 'played')}",
                    file=sys.stderr,
                    flush=True,
                )
            both.theirs.scene.close()  # pyright: ignore[reportAttributeAccessIssue]


def table(records: list[Record]) -> Iterator[str]:
    """The lines of all tables."""
    groups: dict[tuple[str, str], list[Record]] = defaultdict(list)
    for record in records:
        groups[record["task"], record["perception"]].append(record)
    for (task, perception), group in groups.items():
        kept = [record for record in group if "failed" not in record]
        yield f"{task}, {perception}: {len(kept)} episodes, {len(group) - len(kept)} could not be played"
        yield f"  {'':12}{'':18}" + "".join(f"{name:>24}" for name in SHOWN[task])
        for method in METHODS:
            for world in WORLDS:
                cells = "".join(f"{_mean(kept, world, method, name):>24}" for name in SHOWN[task])
                yield f"  {method if world == 'ours' else '':12}{world:18}{cells}"
            gaps = "".join(f"{_gap(kept, method, name):>24}" for name in SHOWN[task])
            yield f"  {'':12}{'habitat - ours':18}{gaps}"
        yield from _visibility(kept)


def _values(records: list[Record], world: str, method: str, name: str) -> dict[Key, float]:
    """By episode, what a method reached where the metric applies."""
    found = {key_of(record): record["worlds"][world][method][name] for record in records}
    return {key: SCALE.get(name, 1) * value for key, value in found.items() if value is not None}


def _mean(records: list[Record], world: str, method: str, name: str) -> str:
    found = _values(records, world, method, name)
    values, seeds = list(found.values()), [key[2] for key in found]
    if len(set(seeds)) < 2:  # one apartment says nothing about the spread
        return f"{np.mean(values):.1f}" if values else "-"
    if name == "success":
        ends = wilson_interval(round(sum(values) / 100), len(values))
        return _cell(float(np.mean(values)), 100 * ends.low, 100 * ends.high)
    return _cell(*common.mean_of(values, seeds))


def _gap(records: list[Record], method: str, name: str) -> str:
    ours, habitat = (_values(records, world, method, name) for world in WORLDS)
    both = [key for key in ours if key in habitat]
    seeds = [key[2] for key in both]
    theirs, mine = ([world[key] for key in both] for world in (habitat, ours))
    if len(set(seeds)) < 2:
        return f"{np.mean(theirs) - np.mean(mine):.1f}" if both else "-"
    found = paired_difference(theirs, mine, np.random.default_rng(0), seeds)
    return _cell(found.difference, found.interval.low, found.interval.high)


def _cell(value: float, low: float, high: float) -> str:
    return f"{value:.1f} [{low:.1f}, {high:.1f}]"


def _visibility(records: list[Record]) -> Iterator[str]:
    """In how many steps both worlds agree on whether the target is visible."""
    pairs = [
        [record["worlds"][world]["visible"] for world in WORLDS]
        for record in records
        if "visible" in record["worlds"]["ours"]
    ]
    if pairs:
        ours, habitat = (np.concatenate([np.array(pair[k]) for pair in pairs]) for k in (0, 1))
        yield (
            f"  visible in {100 * ours.mean():.1f} % of {len(ours)} steps (ours), {100 * habitat.mean():.1f} % "
            f"(habitat); the worlds agree in {100 * (ours == habitat).mean():.1f} %"
        )


def main() -> int:
    options = common.parser(__doc__)
    options.add_argument("--out", type=Path, required=True)
    options.add_argument("--seeds", nargs="+", type=int, default=list(range(8500, 8510)))
    options.add_argument("--each", type=int, default=1, help="episodes of each task in each apartment")
    options.add_argument("--tasks", nargs="+", choices=TASKS, default=list(TASKS))
    options.add_argument("--perceptions", nargs="+", default=["truth:moderate", "scout"])
    options.add_argument("--table", action="store_true", help="print what FILE.jsonl holds")
    given = options.parse_args()
    if not given.table:
        need_habitat()
        play_all(given.out, given.seeds, given.each, given.tasks, given.perceptions)
    print("\n".join(table(read(given.out))))
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Relative directions as OSR-Bench asks for them, with true bearings and floor contacts: how often is the answer right?

    python benchmarks/osr.py [--scenes 200] [--seed 2000]

In rooms of the built-in apartments every triple of categories (P, O, Q) with one P is asked. Labels are made by the
benchmark's own rule from a layout of 10 x 10 cells that is drawn as the published ones are, mirrored; answers are
compared with the corrected labels, in which left and right are put right again. Printed, with 95 % intervals over
apartments:

- *clear*: triples whose dot and cross products both exceed one squared cell. Among them *wall*: with a thing that does
  not touch the floor; *tied*: with several things equally near to P, of which the label takes the one at the smallest
  angle;
- *border*: one of the products is at most one squared cell; where it is zero, the label is a single word, which no
  answer that knows the places better than to a cell will ever be;
- triples whose label is empty, which the benchmark leaves out, are counted.

The rows tell what the agent knows:

- *places*: where everything is. What is missing from 100 % is due to the rounding of the labels alone.
- *contacts*: the true bearing of everything, and the elevation of the floor below the middle of what stands on it; what
  does not stand on the floor gets its range from the wall behind or the thing below. With *metres*, the answer of the
  places as they are; without, the likeliest label after rounding.
- *outlines*: boxes alone, as a perfect detector would give; ranges come from their lower edges.
- *no walls*: contacts, and nobody knows where the walls are.
- *bearings*: everything at the same range.
"""

from __future__ import annotations

import itertools
import sys
from collections import Counter, defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import common
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from osr_apartments import views

from eagor.tasks.osr.data import Scene
from eagor.tasks.osr.geometry import Placed, draw
from eagor.tasks.osr.play import Around, Eagor, laid_out
from eagor.tasks.osr.scoring import Layout, is_tied, named, products, steps, swapped
from eagor.tasks.osr.sightings import Room, Seen, sightings

ROWS = ("places", "contacts", "contacts, metres", "outlines", "no walls", "bearings")


def main() -> int:
    parser = common.parser(__doc__)
    parser.add_argument("--scenes", type=int, default=200)
    parser.add_argument("--seed", type=int, default=2000)
    options = parser.parse_args()
    entries: list[dict[str, Any]] = []
    for seed in itertools.count(options.seed):
        if len(entries) >= options.scenes:
            break
        entries += [counted(view.id, view.room, view.layout) | {"seed": seed} for view in views(seed)]
        if sys.stderr.isatty():
            print(f"\r{len(entries)} scenes", end="", file=sys.stderr)
    print(f"{len(entries)} scenes in {len({entry['seed'] for entry in entries})} apartments, from seed {options.seed}")
    report(entries)
    return 0


def counted(name: str, room: Room, layout: Layout) -> dict[str, Any]:
    """How many triples of a scene there are of each kind, and how many of them each row has right."""
    asked = triples(room, layout)
    counts: dict[str, Any] = {"all": dict(Counter(kind for *_, kinds in asked for kind in kinds)), "right": {}}
    for row in ROWS:
        agent, around = seen_by(row, name, room)
        right: Counter[str] = Counter()
        for P, O, Q, label, kinds in asked:
            if label and agent.where(around, P, O, Q)[0] == label:
                right.update(kinds)
        counts["right"][row] = dict(right)
    return counts


def triples(room: Room, layout: Layout) -> list[tuple[str, str, str, str, list[str]]]:
    """P, O, Q, the corrected label, and what kind of triple it is."""
    number = Counter(body.name for body in room.bodies)
    hung = {body.name for body in room.bodies if not body.stands}
    found = []
    for P, O, Q in itertools.permutations(sorted(layout), 3):
        if number[P] != 1:
            continue
        apart = steps(layout, P, O, Q)
        assert not isinstance(apart, str)
        dot, cross = products(*apart)
        label = swapped(named(dot, cross))
        if not label:
            found.append((P, O, Q, "", ["empty"]))
            continue
        clear = min(abs(dot), abs(cross)) > 1
        kinds = ["clear" if clear else "border"]
        if clear:
            kinds += ["wall"] if hung & {P, O, Q} else []
            kinds += ["tied"] if is_tied(layout, P, O) or is_tied(layout, P, Q) else []
        found.append((P, O, Q, label, kinds))
    return found


def seen_by(row: str, name: str, room: Room) -> tuple[Eagor, Around]:
    """The agent of a row of the table, and the room as it sees it."""
    agent = Eagor(_nobody, "metres" if row == "contacts, metres" else "auto")
    things = tuple(sightings(room, exact=row != "outlines"))
    seen = Seen(things, None if row in ("no walls", "bearings") else room.walls, room.camera)
    if row == "places":
        placed = tuple(Placed(body.name, tuple(body.centre.tolist()), "contact") for body in room.bodies)
        return agent, Around(name, seen, placed, draw(placed, seen.walls, np.random.default_rng(0)))
    return agent, laid_out(name, seen, "unit" if row == "bearings" else "floor")


def _nobody(scene: Scene, names: Sequence[str]) -> Seen:
    raise AssertionError("what was seen is given")


def report(entries: list[dict[str, Any]]) -> None:
    """The table of all rows."""
    total: Counter[str] = sum((Counter(entry["all"]) for entry in entries), Counter())
    words = ", ".join(f"{total[kind]} {kind}" for kind in ("clear", "wall", "tied", "border", "empty"))
    print(f"triples: {words}\n{'':18s}{'clear':>22s}{'wall':>10s}{'tied':>10s}{'border':>10s}")
    for row in ROWS:
        right: Counter[str] = sum((Counter(entry["right"][row]) for entry in entries), Counter())
        share = {kind: f"{100 * right[kind] / total[kind]:.1f}" if total[kind] else "-" for kind in total}
        low, high = interval(entries, row)
        clear = f"{share.get('clear', '-')} [{100 * low:.1f}, {100 * high:.1f}]"
        print(f"{row:18s}{clear:>22s}" + "".join(f"{share.get(kind, '-'):>10s}" for kind in ("wall", "tied", "border")))


def interval(entries: list[dict[str, Any]], row: str) -> tuple[float, float]:
    """95 % of the share of clear triples that are right: apartments are drawn again, whole."""
    sums: dict[int, np.ndarray] = defaultdict(lambda: np.zeros(2))
    for entry in entries:
        sums[entry["seed"]] += entry["right"][row].get("clear", 0), entry["all"].get("clear", 0)
    table, rng = np.array(list(sums.values())), np.random.default_rng(0)
    drawn = table[rng.integers(0, len(table), (2000, len(table)))].sum(axis=1)
    low, high = np.quantile(drawn[:, 0] / np.maximum(drawn[:, 1], 1), [0.025, 0.975])
    return float(low), float(high)


if __name__ == "__main__":
    sys.exit(main())

"""Draw what docs/results.md says at a glance, from the tables of the pages below it; each table has its command there.

python docs/figures/results.py [FOLDER]
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from common import INK, OURS, QUIET, TARGET, THEIRS, THIRD, figure, keep, lines, titled
from matplotlib.lines import Line2D

PAGES = Path(__file__).parents[1] / "results"
SHOWN = {
    "eagor": (OURS, "eagor"),
    "best_detection": (THEIRS, "the best box so far, turned with the camera"),
    "last_detection": ("#e69f00", "the last box, turned with the camera"),
    "bot_sort": ("#7b5ea7", "BoT-SORT, boxes turned with the camera"),
    "vmf": (TARGET, "von Mises-Fisher filter"),
    "grid_filter": (THIRD, "grid filter"),
    "eagor_paper": (QUIET, "eagor as published"),
}
RUNS = {
    "walks, scout": "Waypoint Following: 80 episodes",
    "walks, truth": "Waypoint Following: 40 episodes",
    "balls, scout": "Target Direction Estimation: 80 episodes",
    "balls, truth": "Target Direction Estimation: 40 episodes",
}
Table = dict[str, list[float]]  # method: the figures of its row


def rows(page: str, first: str) -> list[str]:
    """The lines below the one that begins with `first`, to the end of its block of text. Raises `ValueError`."""
    text = (PAGES / page).read_text(encoding="utf-8")
    for block in re.findall(r"^```text\n(.*?)^```", text, re.MULTILINE | re.DOTALL):
        found = block.splitlines()
        for at, row in enumerate(found, 1):
            if row.startswith(first):
                return found[at:]
    raise ValueError(f"no table of {page} has a line that begins with {first!r}")


def figures(text: str) -> list[float]:
    """The numbers of a row, without intervals, and without the signs of tests, which stand behind a number."""
    text = re.sub(r"\[[^\]]*\]", "", text).replace("−", "-")
    return [float(word) for word in re.findall(r"(?<![\w.])[+-]?\d+(?:\.\d+)?", text)]


def run(first: str, page: str = "walks.md") -> Table:
    """The table of `eagor bench run` that begins with the line `first`, and a line with the columns."""
    found: Table = {}
    for row in rows(page, first)[1:]:
        method, _, rest = row.partition(" ")
        if method in ("", "cases"):
            break
        found[method] = figures(rest)
    return found


def photographs() -> dict[str, Table]:
    """Of each condition: the error at the first look and in the last ten, the share within 15 degrees, the coverage."""
    found: dict[str, Table] = {}
    for row in rows("photographs.md", "              method"):
        condition, method, *_ = row.split()
        found.setdefault(condition, {})[method] = figures(row.split(method, 1)[1])
    return {name: table for name, table in found.items() if {"eagor", "vmf", "eagor_paper"} <= table.keys()}


def right() -> None:
    """How often the answer is right on photographs, and how far it is off on walks."""
    drawn = figure(1100, 480)
    left, walk = drawn.subplots(1, 2, width_ratios=(1.7, 1))
    seen, methods = photographs(), [name for name in SHOWN if name != "eagor_paper"]
    for number, method in enumerate(methods):
        colour, label = SHOWN[method]
        places = np.arange(len(seen)) + 0.14 * (number - 2.5)
        left.bar(places, [table[method][2] for table in seen.values()], 0.13, color=colour, label=label)
    left.set_xticks(range(len(seen)), list(seen))
    left.set_ylim(0, 1)
    titled(left, "Real photographs, a small real detector", "share of answers within 15 degrees, after 30 to 40 looks")
    legs = run(RUNS["walks, scout"])
    for method, (colour, _) in SHOWN.items():
        if method in legs:
            walk.plot(range(1, 5), legs[method][:4], "o-", color=colour)
    walk.set_xticks(range(1, 5), [f"leg {number}" for number in range(1, 5)])
    walk.set_ylim(0, 60)
    titled(walk, "Walks in built-in apartments, scout", "mean error, degrees; the first leg is the search")
    for axes in (left, walk):
        lines(axes)
    marks = [Line2D([], [], color=colour, marker="o", label=label) for colour, label in SHOWN.values()]
    drawn.legend(handles=marks, loc="lower center", ncols=3, frameon=False, fontsize=9, labelcolor=INK)
    drawn.subplots_adjust(left=0.05, right=0.99, top=0.87, bottom=0.22, wspace=0.1)
    keep(drawn, "results-right.png")


def honest() -> None:
    """Of 90 % regions, how many hold the truth."""
    drawn = figure(1100, 400)
    axes = drawn.subplots()
    groups = {
        f"photographs,\n{name}": {m: v[3] for m, v in table.items() if len(v) == 4}
        for name, table in photographs().items()
    }
    for name, first in RUNS.items():
        groups[name.replace(", ", ",\n")] = {method: row[-1] / 100 for method, row in run(first).items()}
    axes.axhline(0.9, color=QUIET, linewidth=1)
    for method in ("eagor_paper", "grid_filter", "vmf", "eagor"):
        colour, label = SHOWN[method]
        axes.plot([group[method] for group in groups.values()], "o", color=colour, label=label, markersize=9)
    axes.set_xticks(range(len(groups)), list(groups), fontsize=9)
    axes.set_ylim(0, 1.02)
    lines(axes)
    titled(
        axes,
        "Regions that claim 90 %: the share that holds the truth",
        "below the line: too sure; above it: too cautious",
    )
    drawn.legend(loc="lower center", ncols=4, frameon=False, fontsize=9, labelcolor=INK)
    drawn.subplots_adjust(left=0.05, right=0.99, top=0.84, bottom=0.24)
    keep(drawn, "results-honest.png")


def searches() -> None:
    """How many walks end at the thing, and by which way: with the paper's policy, and of a body that searches."""
    drawn = figure(1100, 640)
    walks = ("follows its estimate", "searches")
    for number, (walk, perception) in enumerate(((w, p) for w in walks for p in ("scout", "truth")), 1):
        axes = drawn.add_subplot(2, 2, number)
        table = run(f"{perception}, the body {walk}", "navigation.md")
        for at, (method, row) in enumerate(reversed(table.items())):
            colour = SHOWN[method][0] if method in SHOWN else QUIET
            axes.barh(at + 0.2, row[0], 0.36, color=colour)
            axes.barh(at - 0.2, row[1], 0.36, color=colour, alpha=0.55)
            axes.text(row[0] + 1, at + 0.2, f"{row[0]:.1f} %", va="center", fontsize=8, color=INK)
            axes.text(row[1] + 1, at - 0.2, f"SPL {row[1]:.0f}", va="center", fontsize=8, color=INK)
        axes.set_yticks(range(len(table)), list(reversed(table)), fontsize=9)
        axes.set_xlim(0, 112)
        lines(axes)
        titled(
            axes,
            f"A body {walk}, {perception}",
            "success, and below it SPL: success, less for detours",
        )
    drawn.subplots_adjust(left=0.08, right=0.98, top=0.9, bottom=0.05, wspace=0.25, hspace=0.45)
    keep(drawn, "results-searches.png")


def cost() -> None:
    """CPU time of one look, where the camera turns and where it walks."""
    drawn = figure(1100, 340)
    first = {"turns": "camera turns, target stands", "walks": "camera walks, 0.25 m"}
    for axes, (title, heading) in zip(drawn.subplots(1, 2), first.items(), strict=True):
        table: list[tuple[str, list[float]]] = []
        for row in rows("../estimator.md", heading):
            name, *more = re.split(r"\s{2,}", row.strip())
            if not more:
                break
            table.insert(
                0, (f"{table[0][0]}, smoothed" if name.startswith("the same") else name, figures(" ".join(more)))
            )
        for at, (name, row) in enumerate(table):
            axes.barh(at, row[-1], 0.7, color=OURS if name.startswith("eagor") else QUIET)
            axes.text(row[-1] * 1.1, at, f"{row[-1]:g} ms, {row[0]:.1f}°", va="center", fontsize=8, color=INK)
        axes.set_yticks(range(len(table)), [name for name, _ in table], fontsize=8)
        axes.set_xscale("log")
        axes.set_xlim(0.1, 400)
        axes.set_xticks([0.1, 1, 10, 100], ["0.1", "1", "10", "100 ms"])
        lines(axes)
        titled(axes, f"The camera {title}", "CPU time per look, and the mean error")
    drawn.subplots_adjust(left=0.17, right=0.99, top=0.8, bottom=0.1, wspace=0.65)
    keep(drawn, "results-cost.png")


if __name__ == "__main__":
    right()
    honest()
    searches()
    cost()
